"""Compare the published training with ours on the simulated building, under three lightings and with several seeds.

`published`: AlexNet with the head 500-500-5, pairs with metric labels and the contrastive loss, trained on three
drives (`experiment=freiburg_sim`); `augmented`: the same with the policy of the thesis; `ours`:
`siamloc.training.recipe("modern")`. Headings are not given. The analytic descriptors, which need no training, are
evaluated for comparison. The map is one drive, with every fifth frame and with all frames.

Targets for the mean of `ours` over the seeds: with every fifth frame an excess over the floor of at most 0.02 m, and
95 % of the errors at most 0.48 m; with all frames a mean error of at most 0.13 m; at most 6 minutes of training on two
cores.

    siamloc simulate camera=panorama out=data
    python -m benchmarks.recipes --data data/freiburg_like

Another building, `building=annex out=data` with `--data data/annex` or `building=random seed=11 out=data` with
`--data data/random_11`, gets its own file, named after it.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import siamloc
from benchmarks.building import LIGHTINGS, TRAIN, VALIDATION, Building, located, mean_and_range, report_name
from benchmarks.report import Report, hardware, parser

RECIPE = siamloc.training.recipe("modern")
PUBLISHED: dict[str, Any] = {
    "epochs": 25,
    "batch_size": 16,
    "pairs": {"label": "distance", "same_room_share": 0.4, "epoch_pairs": 640},
    "monitor": "loss",
}
"""The settings of conf/experiment/freiburg_sim.yaml."""
ANALYTIC = ("fs", "hog", "gist", "wisurf", "briefgist", "radon_fourier", "hsv")
EVERY = (5, 1)
RECIPES = ("published", "augmented", "ours")
FIGURES = ("mean", "excess", "p95")
MOST_EXCESS, MOST_P95, MOST_MEAN, MOST_MINUTES = 0.02, 0.48, 0.13, 6.0


def main() -> None:
    """Train, evaluate, print tables and write the file."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--data", type=Path, required=True, help="folder of a rendered building")
    arguments.add_argument("--seeds", type=int, default=3)
    arguments.add_argument("--runs", type=Path, help="where to keep the networks, for benchmarks.headings")
    arguments.add_argument("--recipes", nargs="*", default=RECIPES, choices=RECIPES)
    arguments.add_argument("--analytic", nargs="*", default=ANALYTIC, choices=ANALYTIC, help="descriptors to compare")
    options = arguments.parse_args()
    report = Report(report_name("recipes", options.data), options.out)
    small, large = Building(options.data, RECIPE.image_size), Building(options.data)
    rows: dict[str, list[dict[str, Any]]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.runs or Path(temporary)
        for name in options.recipes:
            rows[name] = [trained(small, name, seed, folder / f"{name}{seed}") for seed in range(options.seeds)]
    for name in options.analytic:
        rows[name] = [located(large, name)]
    rows = report.kept(rows, (*RECIPES, *ANALYTIC)) if options.keep else rows
    judge(report, rows.get("ours", []))
    print(f"{options.seeds} seeds: mean (lowest to highest); {hardware()['cpu']}")
    for every in EVERY:
        print(f"\n{table(rows, every)}")
    report.write({"seeds": options.seeds, "rows": rows})


def trained(building: Building, name: str, seed: int, run: Path) -> dict[str, Any]:
    """Train a network, and return its errors on the queries and the minutes its training took."""
    train, validation = building.drives(TRAIN), building.drives(VALIDATION)
    begin = time.monotonic()
    if name == "ours":
        network = RECIPE.build(seed=seed)
        RECIPE.fit(network, building.images, train, run=run, validation=validation, seed=seed)
    else:
        network = siamloc.models.build("alexnet", "fc500_500_5", RECIPE.image_size, seed=seed)
        augmentation = "thesis" if name == "augmented" else None
        options = {"validation": validation, "seed": seed, "augmentation": augmentation, **PUBLISHED}
        siamloc.training.fit(network, building.images, train, run=run, **options)
    minutes = (time.monotonic() - begin) / 60
    found = located(building, network)
    print(f"{name}, seed {seed}: {found}, {minutes:.1f} minutes", flush=True)
    return {**found, "minutes": minutes}


def judge(report: Report, rows: list[dict[str, Any]]) -> None:
    """Compare the means over the seeds with the targets."""
    limits = (("5", "excess", MOST_EXCESS), ("5", "p95", MOST_P95), ("1", "mean", MOST_MEAN))
    for every, figure, most in limits if rows else ():
        for light in LIGHTINGS:
            mean = statistics.mean(row[every][light][figure] for row in rows)
            report.target(f"{light}, 1 in {every}: {figure} at most {most} m ({mean:.3f})", mean <= most)
    if rows:
        longest = max(row["minutes"] for row in rows)
        report.target(f"each training at most {MOST_MINUTES:g} minutes ({longest:.1f})", longest <= MOST_MINUTES)


def table(rows: dict[str, list[dict[str, Any]]], every: int) -> str:
    """Return a table of mean errors with the excess in brackets, the floor in the first row."""
    floors = next(iter(rows.values()))[0][str(every)]
    lines = [
        f"| 1 frame in {every} | cloudy | night | sunny |",
        "|---|---|---|---|",
        "| floor | " + " | ".join(f"{floors[light]['floor']:.2f}" for light in LIGHTINGS) + " |",
    ]
    for name, found in rows.items():
        cells = []
        for light in LIGHTINGS:
            means = mean_and_range([row[str(every)][light]["mean"] for row in found], 3)
            excess = statistics.mean(row[str(every)][light]["excess"] for row in found)
            cells.append(f"{means}, excess {excess:.3f}")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
