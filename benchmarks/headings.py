"""Compare the headings found by a network alone with those of the analytic descriptors, under three lightings.

`ours` is `siamloc.training.recipe("modern")`, trained on three drives, and `untrained` the same network with random
weights; both find headings with their own features. The others are the analytic descriptors that can do the same in a
network's map (`heading=hog`). Each query is compared with the map frame that is truly nearest, so that wrong places do
not count as wrong headings. The map is one drive, with all frames and with every fifth. All see the same panoramas.

The analytic descriptors answer in whole columns of the panorama, 1.4 degrees; ours looks between its columns.

Target: median and 95 % error of `ours`, averaged over the seeds, below those of HOG under every lighting.

    siamloc simulate camera=panorama out=data
    python -m benchmarks.recipes --data data/freiburg_like --recipes ours --runs runs/recipes
    python -m benchmarks.headings --data data/freiburg_like --runs runs/recipes
"""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import analytic
import siamloc
from analytic import Description
from benchmarks.building import LIGHTINGS, MAP, QUERIES, TRAIN, VALIDATION, Building
from benchmarks.report import Report, parser
from siamloc.evaluation.metrics import heading_error
from siamloc.maps import Retrieval, VisualMap

RECIPE = siamloc.training.recipe("modern")
ANALYTIC: dict[str, dict[str, Any]] = {
    "hog": {},
    "fs": {"turns": 256},
    "gist": {"orientations": 16},
    "radon_fourier": {},
}
EVERY = (1, 5)
FARTHEST = 0.5  # m, from a query to its map frame


def main() -> None:
    """Train, compare headings, print a table and write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="folder of the rendered building, freiburg_like")
    arguments.add_argument("--seeds", type=int, default=3)
    arguments.add_argument("--runs", type=Path, help="where benchmarks.recipes --runs has kept the networks")
    options = arguments.parse_args()
    report, building = Report("headings", options.out), Building(options.data, RECIPE.image_size)
    rows: dict[str, list[dict[str, Any]]] = {"ours": [], "untrained": []}
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.runs or Path(temporary)
        for seed in range(options.seeds):
            rows["untrained"].append(row(building, RECIPE.build(seed=seed), None))
            rows["ours"].append(row(building, trained(building, seed, folder / f"ours{seed}"), None))
    for name, parameters in ANALYTIC.items():
        rows[name] = [row(building, analytic.descriptor("thumbnail"), analytic.descriptor(name, **parameters))]
    for every in EVERY:
        for light in LIGHTINGS:
            for figure in ("median", "p95"):
                ours, hog = (mean(rows[name], every, light, figure) for name in ("ours", "hog"))
                text = f"{light}, 1 in {every}: {figure} of ours below that of HOG ({ours:.2f}, {hog:.2f} degrees)"
                report.target(text, ours < hog)
        print(f"\n{table(rows, every)}\n")
    report.write({"seeds": options.seeds, "farthest_m": FARTHEST, "rows": rows})


def trained(building: Building, seed: int, run: Path) -> Any:
    """Return the network of a run, training it if there is none yet."""
    if run.is_dir():
        finished, asked = len(siamloc.training.Run(run).curves()["epoch"]), RECIPE.training["epochs"]
        if finished != asked:
            raise SystemExit(f"{run} has {finished} of {asked} epochs: remove it, or finish it")
        return siamloc.models.load(run)
    network, validation = RECIPE.build(seed=seed), building.drives(VALIDATION)
    RECIPE.fit(network, building.images, building.drives(TRAIN), run=run, validation=validation, seed=seed)
    return network


def row(building: Building, described_by: Any, heading: Any) -> dict[str, Any]:
    """Return the heading errors in degrees with each part of the map under each lighting, and bytes of a map frame."""
    known = siamloc.maps.build(described_by, building.images, building.drives(MAP), heading=heading, progress=False)
    assert known.orientation is not None
    found: dict[str, Any] = {"bytes": known.orientation[0].nbytes}
    queries = building.drives(QUERIES)
    seen = Description.concatenate(list(siamloc.maps.describe(known, building.images, queries)))
    for every in EVERY:
        errors = _errors(known.take(range(0, len(known), every)), queries, seen)
        found[str(every)] = {light: _figures(errors[queries.lighting == light]) for light in LIGHTINGS}
    return found


def mean(rows: list[dict[str, Any]], every: int, light: str, figure: str) -> float:
    """Return the mean over the seeds of one figure."""
    return statistics.mean(row[str(every)][light][figure] for row in rows)


def table(rows: dict[str, list[dict[str, Any]]], every: int) -> str:
    """Return a table of the median and the 95 % error."""
    lines = [f"| 1 frame in {every} | cloudy | night | sunny | bytes |", "|---|---|---|---|---|"]
    for name, found in rows.items():
        cells = [
            " / ".join(f"{mean(found, every, light, key):.2f}" for key in ("median", "p95")) for light in LIGHTINGS
        ]
        lines.append(f"| {name} | {' | '.join(cells)} | {found[0]['bytes']:,} |")
    return "\n".join(lines)


def _errors(known: VisualMap, queries: siamloc.data.FrameTable, seen: Description) -> np.ndarray:
    """Return the error of each query in degrees, NaN for those too far from the map."""
    apart = np.linalg.norm(queries.xy[:, None] - known.frames.xy[None], axis=2)
    nearest = Retrieval(apart.argmin(axis=1)[:, None], apart.min(axis=1)[:, None])
    told = siamloc.maps.headings(known, seen, nearest)[:, 0]
    errors = np.degrees(heading_error(told, queries.theta))
    return np.where(apart.min(axis=1) <= FARTHEST, errors, np.nan)


def _figures(errors: np.ndarray) -> dict[str, float]:
    known = errors[np.isfinite(errors)]
    return {"median": float(np.median(known)), "p95": float(np.percentile(known, 95)), "count": len(known)}


if __name__ == "__main__":
    main()
