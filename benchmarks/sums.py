"""Compare the shipped network with the best sum of analytic descriptors that there is for each map and lighting.

The distances of a query to all map frames by each of six descriptors are divided by their mean over queries and map
frames, and added, for every set of descriptors. The set with the smallest mean error, and that with the smallest 95 %
error, are chosen for each cell by the queries themselves: nobody can choose a better one beforehand. Maps are as in
`benchmarks.zero_shot`; of the queries, every third is used. Targets: mean and 95 % error of the network are below.

    OMP_NUM_THREADS=1 python -m benchmarks.sums --data data/freiburg_like data/annex
"""

from __future__ import annotations

from itertools import chain, combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import siamloc
from benchmarks.building import LIGHTINGS, MAP, QUERIES, Building
from benchmarks.report import Report, hardware, parser
from siamloc.models.registry import PRETRAINED_SIZE

SUMMED = ("hsv", "hog", "gist", "wisurf", "fs", "briefgist")
"""Descriptors that are not turned before they are compared."""
STEPS = (5, 20, 40)
FIGURES = {"mean": "mean", "p95": "95 % error"}


def main() -> None:
    """Locate, print a table and write the file."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--data", type=Path, nargs="+", required=True, help="rendered buildings")
    options = arguments.parse_args()
    report = Report("sums", options.out)
    rows = {data.resolve().name: measured(data) for data in options.data}
    rows = report.kept(rows) if options.keep else rows
    lines = [
        "| building, one frame in | lighting | network: mean, 95 % | best sum: mean | best sum: 95 % |",
        "|---" * 5 + "|",
    ]
    for name, row in rows.items():
        for step, light in ((step, light) for step in map(str, STEPS) for light in LIGHTINGS):
            ours, best = row[step][light]["network"], row[step][light]["best"]
            for figure, text in FIGURES.items():
                report.target(
                    f"{name}, 1 frame in {step}, {light}: {text} below that of any sum, {best[figure]['error']:.2f} m "
                    f"({ours[figure]:.2f})",
                    ours[figure] < best[figure]["error"],
                )
            cells = (f"{best[figure]['error']:.2f} ({'+'.join(best[figure]['sum'])})" for figure in FIGURES)
            lines.append(f"| {name}, {step} | {light} | {ours['mean']:.2f}, {ours['p95']:.2f} | {' | '.join(cells)} |")
    print(f"{hardware()['cpu']}\n\n" + "\n".join(lines))
    report.write({"rows": rows})


def measured(data: Path) -> dict[str, Any]:
    """Return the figures of the network and of the best sums, by the share of frames in the map and by lighting."""
    large, small = Building(data), Building(data, PRETRAINED_SIZE)
    first = min(STEPS)
    maps = {name: siamloc.maps.build(name, large.images, large.drives(MAP, first), progress=False) for name in SUMMED}
    ours = siamloc.maps.build("pretrained", small.images, small.drives(MAP, first), progress=False)
    row: dict[str, Any] = {str(step): {} for step in STEPS}
    for light, drive in zip(LIGHTINGS, QUERIES, strict=True):
        asked = large.drives([drive], 3)
        apart = {
            name: siamloc.maps.frame_distances(
                known, siamloc.maps.build(name, large.images, asked, progress=False).description
            )
            for name, known in maps.items()
        }
        seen = siamloc.maps.build("pretrained", small.images, asked, progress=False).turning()
        for step in STEPS:
            rows = np.arange(0, len(ours), step // first)
            true = np.hypot(*(ours.frames.xy[None, rows] - asked.xy[:, None]).transpose(2, 0, 1))
            found = siamloc.maps.match(ours.take(rows), seen).indices[:, 0]
            row[str(step)][light] = {
                "network": errors(true, found),
                "best": best_sums({name: one[:, rows] for name, one in apart.items()}, true),
            }
    return row


def best_sums(apart: dict[str, NDArray[np.float64]], true: NDArray[np.float64]) -> dict[str, Any]:
    """Return, for each figure, the smallest error of the sums of any set of descriptors, and that set."""
    sets = list(chain.from_iterable(combinations(apart, count) for count in range(1, len(apart) + 1)))
    found = [errors(true, sum(apart[name] / apart[name].mean() for name in one).argmin(axis=1)) for one in sets]
    chosen: dict[str, Any] = {}
    for figure in FIGURES:
        place = min(range(len(sets)), key=lambda row: found[row][figure])
        chosen[figure] = {"error": found[place][figure], "sum": list(sets[place])}
    return chosen


def errors(true: NDArray[np.float64], found: NDArray[np.int64]) -> dict[str, float]:
    """Return mean and 95 % error of map frames (n,) that were found, by the true distances (n, m)."""
    off = true[np.arange(len(true)), found]
    return {"mean": float(off.mean()), "p95": float(np.quantile(off, 0.95))}


if __name__ == "__main__":
    main()
