r"""Measure a map that lives: a simulated building changes for six months, and one drive each month maintains its map.

The first drive, cloudy1, makes the map. In each month, cloudy2, another drive along the same path, is located in that
map as it was (`unmaintained`); in the map that `siamloc.maps.update` has maintained with the drive cloudy1 of each
month so far, whose poses are the true ones (`maintained`) or found in the map with odometry (`by itself`, `located` is
their mean error in m); and in a map made of this month's cloudy1 alone (`afresh`). Errors are means in m, of the
nearest map frame and refined; `lost` is the share of frames whose nearest map frame is more than 1 m away. At the end,
cloudy2 of the first month is located in each maintained map. `changed` is the share of the surfaces in view that the
months have changed. The drives keep one frame every 0.4 m; what is not rendered yet is rendered first. "random" is a
building drawn from each seed.

Targets for the last month, mean over the seeds: a maintained map is at most 0.02 m worse than a map made afresh, has at
most 1.5 times as many frames as at the start, and is at most 0.01 m worse than the first map on the first month's
drive.

    OMP_NUM_THREADS=1 python -m benchmarks.months --data data/months --buildings annex freiburg_like
    OMP_NUM_THREADS=1 python -m benchmarks.months --data data/months --seeds 601 602 603 606 607 --keep \
        --buildings random
"""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import siamloc
from benchmarks.report import Report, hardware, parser
from foundation.files import read_json
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.maps import VisualMap, match, refine, update
from siamloc.models.registry import PRETRAINED_SIZE
from siamloc.simulate import SimulateConfig, simulate
from siamloc.simulate.produce import CHANGES_FILE

MONTHS = 6
METRES = 0.4
FAR = 1.0  # m
MOST = {"afresh": 0.02, "frames": 1.5, "first": 0.01}  # m, times, m
WAYS = ("maintained", "by itself")


def main() -> None:
    """Let the months pass, print a table and write the file."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--data", type=Path, required=True, help="folder of the rendered buildings")
    arguments.add_argument("--buildings", nargs="+", default=["annex"], help="names of buildings, or random")
    arguments.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    options = arguments.parse_args()
    report = Report("months", options.out)
    rows = {
        name: {str(seed): lived(rendered(options.data, name, seed), name) for seed in options.seeds}
        for name in options.buildings
    }
    rows = report.kept(rows) if options.keep else rows
    for name, row in rows.items():
        judge(report, name, row)
    print(f"{hardware()['cpu']}\n\n{table(rows)}")
    report.write({"rows": rows})


def rendered(data: Path, name: str, seed: int) -> Path:
    """Render two drives in each month, or complete them, and return the folder of the building."""
    asked = SimulateConfig(
        out=data / f"seed{seed}",
        building=name,
        seed=seed,
        runs=("cloudy1", "cloudy2"),
        months=MONTHS,
        spacing=METRES,
        camera="panorama",
        workers=1,
    )
    return simulate(settings=asked).folder


def lived(data: Path, name: str) -> dict[str, Any]:
    """Return the figures of a building in each month, and of the drive of the first month at the end."""
    frames = siamloc.data.read("cold", root=data)
    images = PanoramaLibrary(frames, image_size=PRETRAINED_SIZE)

    def drive(run: str, month: int) -> FrameTable:
        return frames.select(sequence=f"*_{run}" + (f"_month{month}" if month else ""))

    def described(some: FrameTable) -> VisualMap:
        return siamloc.maps.build("pretrained", images, some, progress=False)

    first, asked = described(drive("cloudy1", 0)), described(drive("cloudy2", 0))
    known = dict.fromkeys(WAYS, first)
    months: list[dict[str, Any]] = [{"changed": 0.0, "unmaintained": figures(first, asked)}]
    for month in range(1, MONTHS + 1):
        seen, queries = described(drive("cloudy1", month)), described(drive("cloudy2", month))
        nowhere = np.full(len(seen), np.nan)
        drives = {"maintained": seen.frames, "by itself": seen.frames.with_columns(x=nowhere, y=nowhere, theta=nowhere)}
        updates = {way: update(known[way], images, drives[way], progress=False) for way in WAYS}
        known, told = {way: one.known for way, one in updates.items()}, updates["by itself"].drive
        maps = {"unmaintained": first, **known, "afresh": seen}
        row = {way: figures(one, queries) for way, one in maps.items()}
        at = round(float(_off(told.xy, seen).mean()), 3)
        months.append({"changed": changed(data, f"cloudy2_month{month}"), "located": at, **row})
        print(f"{name}, month {month}: {months[-1]}", flush=True)
    return {"months": months, "first drive": {way: figures(known[way], asked) for way in WAYS}}


def figures(known: VisualMap, asked: VisualMap) -> dict[str, float]:
    """Return the frames of a map, the mean errors of a drive in it in m, and the share of its frames that are lost."""
    queries = asked.turning()
    nearest = match(known, queries, 3)
    off = _off(known.frames.xy[nearest.indices[:, 0]], asked)
    refined = _off(refine(known, queries, nearest).xy, asked)
    return {
        "frames": len(known),
        "nearest": round(float(off.mean()), 3),
        "refined": round(float(refined.mean()), 3),
        "lost": round(float((off > FAR).mean()), 3),
    }


def changed(data: Path, run: str) -> float:
    """Return the share of the surfaces in view that had changed on a drive."""
    (file,) = data.glob(f"part_*/seq*_{run}/localization/{CHANGES_FILE}")
    return float(read_json(file)["changed"])


def judge(report: Report, name: str, seeds: dict[str, Any]) -> None:
    """Compare the last month of a building with the targets."""
    for way in WAYS:
        for error in ("nearest", "refined"):
            worse = _mean(seeds, way, error) - _mean(seeds, "afresh", error)
            limit, former = MOST["afresh"], f"{name}, {way}, {error}"
            report.target(f"{former}: at most {limit} m worse than afresh ({worse:+.3f})", worse <= limit)
            before = statistics.mean(row["months"][0]["unmaintained"][error] for row in seeds.values())
            worse = statistics.mean(row["first drive"][way][error] for row in seeds.values()) - before
            limit = MOST["first"]
            report.target(f"{former}: at most {limit} m worse on the first drive ({worse:+.3f})", worse <= limit)
        times, limit = _mean(seeds, way, "frames") / _mean(seeds, "unmaintained", "frames"), MOST["frames"]
        report.target(f"{name}, {way}: at most {limit} times as many frames ({times:.2f})", times <= limit)


def table(rows: dict[str, Any]) -> str:
    """Return the figures of the last month as a table of Markdown, means over the seeds."""
    lines = [
        "| last month | changed | map | frames | nearest, m | refined, m | lost |",
        "|---|---|---|---|---|---|---|",
    ]
    digits = {"frames": 0, "nearest": 2, "refined": 2, "lost": 3}
    for name, seeds in rows.items():
        share = statistics.mean(row["months"][-1]["changed"] for row in seeds.values())
        for way in ("unmaintained", *WAYS, "afresh"):
            cells = (f"{_mean(seeds, way, key):.{places}f}" for key, places in digits.items())
            lines.append(f"| {name} | {share:.2f} | {way} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _mean(seeds: dict[str, Any], way: str, figure: str) -> float:
    """Return the mean of a figure in the last month over the seeds."""
    return statistics.mean(row["months"][-1][way][figure] for row in seeds.values())


def _off(xy: NDArray[np.float64], asked: VisualMap) -> NDArray[np.float64]:
    """Return the distances of positions (n, 2) from the true ones."""
    return np.hypot(*(xy - asked.frames.xy).T)


if __name__ == "__main__":
    main()
