"""Survey drives without true poses, and locate other drives in the surveyed map.

A drive of each lighting is surveyed with its images and simulated odometry, with its images alone, and with these and
the height of the camera above the floor; then all three drives together. Figures are mean distances of the surveyed
positions in m after the best rigid motion (without odometry also after the best scale), of odometry alone, and mean
errors of the headings in degrees. The map is then the cloudy drive
with the surveyed poses, moved onto the true ones: errors of other drives are compared with those in the map of true
poses, nearest frame and refined. Odometry is drawn three times; the drives keep one frame every 0.3 m.

Targets for the mean: with odometry at most 0.10 m (the path-traced house 0.12 m) and 1 degree, together at most 0.12 m;
without odometry at most 0.30 m after scale, which is within 5 %; no loop that is wrong by more than 1 m keeps more than
a tenth of its weight; locating costs at most 0.05 m more.

    siamloc simulate camera=panorama out=data
    OMP_NUM_THREADS=1 python -m benchmarks.survey --data data/freiburg_like house/manifest.csv
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import siamloc
from benchmarks.building import LIGHTINGS, opened
from benchmarks.report import Report, hardware, parser
from foundation.files import read_json
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.data.moves import relative, wrapped
from siamloc.evaluation.metrics import aligned_trajectory
from siamloc.maps import Survey, SurveySettings
from siamloc.models.registry import PRETRAINED_SIZE
from siamloc.simulate.odometry import odometry

WITHOUT = {"alone": "images alone", "height": "images and height"}
DRIVES = {"cloudy": "*seq2_cloudy3", "night": "*seq2_night[12]", "sunny": "*seq2_sunny[13]"}
QUERIES = {"cloudy": ("*seq2_cloudy[12]",), "night": ("*seq2_night[12]",), "sunny": ("*seq2_sunny[12]",)}
MOST = {"odometry": 0.10, "degrees": 1.0, "together": 0.12, "alone": 0.30, "scale": 0.05, "costs": 0.05, "house": 0.12}
METRES = 0.3
_WRONG = 1.0  # m
_HEIGHT = 1.0  # of the camera in the house, in m


def main() -> None:
    """Survey, locate, print a table and write the file."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--data", type=Path, nargs="+", required=True, help="rendered buildings, or manifests")
    arguments.add_argument("--seeds", type=int, default=3)
    options = arguments.parse_args()
    report = Report("survey", options.out)
    rows = dict(measured(data, options.seeds) for data in options.data)
    rows = report.kept(rows) if options.keep else rows
    for name, row in rows.items():
        judge(report, name, row)
    print(f"{hardware()['cpu']}\n\n{table(rows)}")
    report.write({"seeds": options.seeds, "rows": rows})


def measured(data: Path, seeds: int) -> tuple[str, dict[str, Any]]:
    """Return the name of a building, and its figures."""
    name, frames = opened(data)
    height = _HEIGHT if data.is_file() else read_json(next(data.rglob("camera.json")))["height"]
    images = PanoramaLibrary(frames, image_size=PRETRAINED_SIZE)
    frames = images.readable(frames)
    drives = {light: last(frames, pattern).spaced(METRES) for light, pattern in DRIVES.items()}
    row: dict[str, Any] = {
        way: {light: unrolled(images, drive, given) for light, drive in drives.items()}
        for way, given in (("alone", None), ("height", height))
    }
    with_odometry: dict[str, list[dict[str, float]]] = {light: [] for light in drives}
    together, costs = list[dict[str, float]](), list[dict[str, Any]]()
    for seed in range(seeds):
        wheels = {light: drawn(drive, seed) for light, drive in drives.items()}
        for light, drive in drives.items():
            found = surveyed(images, drive, wheels[light])
            with_odometry[light].append(figures(found, drive, wheels[light]))
            if light == "cloudy":
                costs.append(located(images, frames, drive, found))
        whole = siamloc.data.concatenate(list(drives.values()))
        found = surveyed(images, whole, np.concatenate(list(wheels.values())))
        together.append(figures(found, whole, None))
    row |= {"odometry": with_odometry, "together": together, "costs": costs}
    print(f"{name}: {row}", flush=True)
    return name, row


def surveyed(images: PanoramaLibrary, drive: FrameTable, wheels: NDArray[np.float64] | None, **options: Any) -> Survey:
    """Survey a drive whose true poses are taken away."""
    unknown = FrameTable(path=drive.path, sequence=drive.sequence)
    return siamloc.maps.survey("pretrained", images, unknown, odometry=wheels, progress=False, **options)


def unrolled(images: PanoramaLibrary, drive: FrameTable, height: float | None) -> dict[str, float]:
    """Return the figures of a survey without odometry."""
    begin = time.monotonic()
    found = surveyed(images, drive, None, settings=SurveySettings(height=height))
    return {**figures(found, drive, None), "seconds": time.monotonic() - begin, "frames": float(len(drive))}


def figures(found: Survey, drive: FrameTable, wheels: NDArray[np.float64] | None) -> dict[str, float]:
    """Return mean distance, heading error in degrees, distance after scale, the scale, and the wrong loops' weight."""
    true = np.column_stack([drive.xy, drive.theta])
    given = np.column_stack([found.frames.xy, found.frames.theta])
    seen = relative(true, found.loops.first, found.loops.second)
    off = np.hypot(*(found.loops.pose - seen)[:, :2].T)
    wrong = found.loops.accepted & (off > _WRONG)
    aligned, scaled = aligned_trajectory(given, true), aligned_trajectory(given, true, scale=True)
    scale = float(np.ptp(scaled[:, 0]) / max(np.ptp(aligned[:, 0]), 1e-9))
    return {
        "mean": _off(aligned, true),
        "degrees": float(np.degrees(np.abs(wrapped(aligned[:, 2] - true[:, 2]))).mean()),
        "scaled": _off(scaled, true),
        "scale": scale,
        "wrong_weight": float(found.loops.weight[wrong].max(initial=0.0)),
        "loops": float(found.loops.accepted.sum()),
        **({} if wheels is None else {"odometry": _off(aligned_trajectory(wheels, true), true)}),
    }


def located(images: PanoramaLibrary, frames: FrameTable, drive: FrameTable, found: Survey) -> dict[str, Any]:
    """Return mean errors of other drives in the map of true poses and in the surveyed one, nearest and refined."""
    true = np.column_stack([drive.xy, drive.theta])
    x, y, theta = aligned_trajectory(np.column_stack([found.frames.xy, found.frames.theta]), true).T
    maps = {"true": drive, "surveyed": drive.with_columns(x=x, y=y, theta=theta)}
    known = {name: siamloc.maps.build("pretrained", images, one, progress=False) for name, one in maps.items()}
    result: dict[str, Any] = {}
    for light, patterns in QUERIES.items():
        asked = last(frames, *patterns).spaced(METRES)
        queries = siamloc.maps.build("pretrained", images, asked, progress=False).turning()
        for name, held in known.items():
            nearest = siamloc.maps.match(held, queries, 3)
            refined = siamloc.maps.refine(held, queries, nearest)
            errors = {"nearest": held.frames.xy[nearest.indices[:, 0]], "refined": refined.xy}
            result.setdefault(light, {})[name] = {way: _off(xy, asked.xy) for way, xy in errors.items()}
    return result


def judge(report: Report, name: str, row: dict[str, Any]) -> None:
    """Compare the figures of a building with the targets."""
    limit = MOST["house"] if name == "house" else MOST["odometry"]
    for light in LIGHTINGS:
        one = row["odometry"][light]
        mean, degrees = (statistics.mean(each[key] for each in one) for key in ("mean", "degrees"))
        report.target(f"{name}, {light}, odometry and images: at most {limit:.2f} m ({mean:.3f})", mean <= limit)
        report.target(
            f"{name}, {light}: headings at most {MOST['degrees']:g} degree ({degrees:.2f})", degrees <= MOST["degrees"]
        )
        for way, said in WITHOUT.items():
            without = row[way][light]
            report.target(
                f"{name}, {light}, {said}: at most {MOST['alone']:.2f} m after scale ({without['scaled']:.3f})",
                without["scaled"] <= MOST["alone"],
            )
            report.target(
                f"{name}, {light}, {said}: scale within {MOST['scale']:.0%} ({without['scale']:.3f})",
                abs(without["scale"] - 1) <= MOST["scale"],
            )
        for way in ("nearest", "refined"):
            cost = statistics.mean(each[light]["surveyed"][way] - each[light]["true"][way] for each in row["costs"])
            report.target(
                f"{name}, {light}, {way}: at most {MOST['costs']} m more than with true poses ({cost:.3f})",
                cost <= MOST["costs"],
            )
    mean = statistics.mean(each["mean"] for each in row["together"])
    report.target(
        f"{name}, three drives together: at most {MOST['together']:.2f} m ({mean:.3f})", mean <= MOST["together"]
    )
    alone = [one for way in WITHOUT for one in row[way].values()]
    surveys = [*row["together"], *alone, *(each for one in row["odometry"].values() for each in one)]
    weight = max(each["wrong_weight"] for each in surveys)
    report.target(f"{name}: wrong loops weigh at most a tenth ({weight:.2f})", weight <= 0.1)


def table(rows: dict[str, Any]) -> str:
    """Return the figures as a table of Markdown."""
    lines = ["| mean error, m | cloudy | night | sunny |", "|---|---|---|---|"]
    for name, row in rows.items():
        for label, key in (("odometry alone", "odometry"), ("odometry and images", "mean")):
            cells = (f"{statistics.mean(one[key] for one in row['odometry'][light]):.2f}" for light in LIGHTINGS)
            lines.append(f"| {name}, {label} | {' | '.join(cells)} |")
        for way, said in WITHOUT.items():
            cells = (f"{row[way][light]['scaled']:.2f} ({row[way][light]['scale']:.3f})" for light in LIGHTINGS)
            lines.append(f"| {name}, {said}, after scale | {' | '.join(cells)} |")
    return "\n".join(lines)


def last(frames: FrameTable, *patterns: str) -> FrameTable:
    """Return the last drive of those that match."""
    some = frames.select(sequence=list(patterns))
    return some.select(sequence=sorted(set(some.sequence.tolist()))[-1])


def drawn(drive: FrameTable, seed: int | Sequence[int]) -> NDArray[np.float64]:
    """Draw what the wheels report along a drive (n, 3), by a seed."""
    return odometry(np.column_stack([drive.xy, drive.theta]), np.random.default_rng(seed))


def _off(found: NDArray[np.float64], true: NDArray[np.float64] | Sequence[Any]) -> float:
    return float(np.hypot(*(found[:, :2] - np.asarray(true)[:, :2]).T).mean())


if __name__ == "__main__":
    main()
