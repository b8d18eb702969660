"""Compare where loops of a survey come from: frames that look alike, or the closures of the incremental mapper ([I]).

A drive of each lighting, one frame every 0.3 m, is surveyed with simulated odometry. Candidates are the frames that
look most alike (the default); those that the mapper, version 2, puts into one node, each with the eight most alike
(`nodes`); or its closures, each frame with the most similar one before it (`images`). The mapper sees the descriptors
of the shipped network, or of HOG. Figures are means over the three drives: candidates, how many of them were taken
within 1.5 m of each other, loops used, and mean distance in m of the surveyed positions after the best rigid motion.

    OMP_NUM_THREADS=1 python -m benchmarks.closures --data data/freiburg_like data/random_701
"""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import siamloc
from analytic.mapper import IncrementalMapper
from benchmarks.report import Report, parser
from benchmarks.survey import DRIVES, METRES, drawn, figures, last, surveyed
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.data.moves import relative
from siamloc.models.registry import PRETRAINED_SIZE

NEAR, ALIKE = 1.5, 8  # m; frames of a node
DESCRIPTORS = ("pretrained", "hog")


def main() -> None:
    """Survey with each source of candidates, print the figures and write the file."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--data", type=Path, nargs="+", required=True, help="rendered buildings")
    options = arguments.parse_args()
    report = Report("closures", options.out)
    rows = {data.resolve().name: measured(data) for data in options.data}
    report.write({"rows": report.kept(rows) if options.keep else rows})


def measured(data: Path) -> dict[str, dict[str, float]]:
    """Return the figures of a building for each source of candidates."""
    frames = siamloc.data.read("cold", root=data)
    images = PanoramaLibrary(frames, image_size=PRETRAINED_SIZE)
    frames = images.readable(frames)
    drives = [last(frames, pattern).spaced(METRES) for pattern in DRIVES.values()]
    rows: dict[str, list[dict[str, float]]] = {}
    for drive in drives:
        rows.setdefault("look alike", []).append(judged(images, drive, None))
        for name in DESCRIPTORS:
            by_nodes, by_images = closures(images, drive, name)
            rows.setdefault(f"{name}, nodes", []).append(judged(images, drive, by_nodes))
            rows.setdefault(f"{name}, images", []).append(judged(images, drive, by_images))
    means = {
        source: {key: statistics.mean(one[key] for one in some) for key in some[0]} for source, some in rows.items()
    }
    for source, row in means.items():
        print(data.name, source, {key: round(value, 3) for key, value in row.items()}, flush=True)
    return means


def closures(images: PanoramaLibrary, drive: FrameTable, name: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return pairs of frames of one node, and pairs that the mapper closes (p, 2)."""
    descriptor: Any = siamloc.models.as_descriptor(siamloc.models.pretrained()) if name == "pretrained" else name
    known = siamloc.maps.build(descriptor, images, drive, progress=False)
    mapper = IncrementalMapper(known.describes, version=2)
    for row in range(len(drive)):
        mapper.add(known.turning(np.array([row])), row)
    labels, pairs = mapper.labels(), list[tuple[int, int]]()
    for row in np.flatnonzero(labels >= 0):
        others = np.flatnonzero(labels == labels[row])
        unlike = np.square(known.learned[others] - known.learned[row]).sum(axis=1)
        unlike[np.abs(others - row) < 10] = np.inf  # frames along 3 m
        pairs += [(row, other) for other in others[np.argsort(unlike)[:ALIKE]]]
    return np.array(pairs), np.array(mapper.graph().loops, dtype=np.int64).reshape(-1, 2)


def judged(images: PanoramaLibrary, drive: FrameTable, candidates: NDArray[np.int64] | None) -> dict[str, float]:
    """Survey a drive with its odometry and these candidates, and return the figures."""
    found = surveyed(images, drive, drawn(drive, 0), candidates=candidates)
    poses = np.column_stack([drive.xy, drive.theta])
    apart = np.hypot(*relative(poses, found.loops.first, found.loops.second)[:, :2].T)
    return {
        "candidates": float(len(apart)),
        "near": float((apart < NEAR).sum()),
        "used": float(found.loops.accepted.sum()),
        "mean": figures(found, drive, None)["mean"],
    }


if __name__ == "__main__":
    main()
