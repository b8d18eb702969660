"""Survey 2,800 frames of several drives together, by odometry and images, and add one frame after the other to it.

The seconds are those beyond describing the images, which a map needs as well: the time of `siamloc.maps.survey` less
that of `siamloc.maps.build`. Memory is that of the whole process, at its most, after half of the frames and after all.
`live` is the time of `LiveSurvey.add` for the frames that follow, describing included.

Targets: 2,800 frames in at most 60 s beyond describing; memory at most doubles from half of the frames to all; one
frame more in at most 50 ms (median).

    OMP_NUM_THREADS=1 python -m benchmarks.survey_scale --data data/freiburg_like
"""

from __future__ import annotations

import resource
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import siamloc
from benchmarks.report import Report, parser
from benchmarks.survey import drawn
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.maps import LiveSurvey, build
from siamloc.models.registry import PRETRAINED_SIZE

FRAMES, LIVE = 2_800, 100
LONGEST, MOST_MEMORY, MOST_LIVE = 60.0, 2.0, 50.0  # s, times, ms


def main() -> None:
    """Survey half of the frames, all of them, and those that follow one by one; write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="a rendered building of 2,900 frames or more")
    options = arguments.parse_args()
    report = Report("survey_scale", options.out, packages=("scipy",))
    frames = siamloc.data.read("cold", root=options.data)
    images = PanoramaLibrary(frames, image_size=PRETRAINED_SIZE)
    frames = images.readable(frames).take(np.arange(FRAMES + LIVE))
    wheels = np.concatenate([drawn(frames.take(rows), 1) for rows in frames.rows_by("sequence").values()])
    unknown = FrameTable(path=frames.path, sequence=frames.sequence)
    build("pretrained", images, unknown.take(np.arange(100)), progress=False)  # warms up
    half, whole = (surveyed(images, unknown.take(np.arange(n)), wheels[:n]) for n in (FRAMES // 2, FRAMES))
    live = added(images, unknown, wheels, whole.pop("found"))
    del half["found"]
    report.target(f"2,800 frames in at most {LONGEST:g} s beyond describing ({whole['s']:.0f})", whole["s"] <= LONGEST)
    growth = whole["mb"] / half["mb"]
    report.target(f"memory at most {MOST_MEMORY:g} times that of half the frames ({growth:.2f})", growth <= MOST_MEMORY)
    report.target(f"one frame more in at most {MOST_LIVE:g} ms ({live['ms']:.0f})", live["ms"] <= MOST_LIVE)
    report.write({"rows": {"half": half, "whole": whole, "live": live}})


def surveyed(images: PanoramaLibrary, unknown: FrameTable, wheels: NDArray[np.float64]) -> dict[str, Any]:
    """Survey frames, and return the survey, the seconds beyond describing, the loops and the memory in MB."""
    posed = unknown.with_columns(x=wheels[:, 0], y=wheels[:, 1], theta=wheels[:, 2])
    begin = time.perf_counter()
    build("pretrained", images, posed, progress=False)
    described = time.perf_counter()
    found = siamloc.maps.survey("pretrained", images, unknown, odometry=wheels, progress=False)
    seconds = time.perf_counter() - described - (described - begin)
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    figures = {"frames": len(unknown), "drives": len(unknown.rows_by("sequence")), "s": seconds, "mb": most}
    return {**figures, "described_s": described - begin, "loops": int(found.loops.accepted.sum()), "found": found}


def added(
    images: PanoramaLibrary, unknown: FrameTable, wheels: NDArray[np.float64], found: siamloc.maps.Survey
) -> dict[str, float]:
    """Return the ms of a frame that is added to a survey."""
    live = LiveSurvey("pretrained", found, build("pretrained", images, found.frames, progress=False))
    rows = np.arange(len(live), len(unknown))
    panoramas = np.concatenate(list(images.batches(unknown.take(rows))))
    times = []
    for row, panorama in zip(rows, panoramas, strict=True):
        begin = time.perf_counter()
        live.add(panorama, str(unknown.path[row]), odometry=wheels[row])
        times.append(1e3 * (time.perf_counter() - begin))
    return {"frames": len(times), "ms": float(np.median(times)), "p95_ms": float(np.percentile(times, 95))}


if __name__ == "__main__":
    main()
