"""Train on one cloudy drive, query at night and in the sun, and measure how much each part of the recipe helps.

`ours` is `siamloc.training.recipe("modern")`, trained on the cloudy drive alone, with several seeds. The other rows
leave out one part of it, or use the published one instead, and train for two epochs instead of five. Headings are not
given, and the map is every fifth frame of the cloudy drive. The analytic descriptors are evaluated for comparison.

Targets for the mean over the seeds: better than every analytic descriptor under every lighting, and an excess over the
floor of at most 0.05 m under clouds, 0.10 m at night and 0.15 m in the sun.

    siamloc simulate camera=panorama out=data
    python -m benchmarks.light_gap --data data/freiburg_like

The recipe was chosen by this ablation, on the queries of freiburg_like. In another building, without the ablation, it
has had no influence on any choice; its file is named after the building:

    siamloc simulate building=random seed=301 camera=panorama out=data
    python -m benchmarks.light_gap --data data/random_301 --changes
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import siamloc
from benchmarks.building import LIGHTINGS, MAP, Building, located, mean_and_range, report_name
from benchmarks.report import Report, hardware, parser

RECIPE = siamloc.training.recipe("modern")
VALIDATION = ("*seq2_cloudy1",)
ANALYTIC = ("fs", "hog", "gist", "wisurf", "briefgist", "radon_fourier", "hsv")
SHORT = 2  # epochs of the ablation
MOST_EXCESS = {"cloudy": 0.05, "night": 0.10, "sunny": 0.15}


def _changed(policy: str, normalize: str = "local") -> dict[str, Any]:
    return {"normalize": normalize, "augmentation": {"name": "changed", "policy": policy, "rotate": 1.0}}


def _own(*effects: dict[str, Any]) -> dict[str, Any]:
    steps = [*effects, {"policy": "lighting"}, {"effect": "noise", "variance": [0.0001, 0.002], "probability": 0.3}]
    return {"normalize": "local", "augmentation": {"name": "changed", "all_of": steps, "rotate": 1.0}}


_WINDOWS = {"one_of": [{"effect": "windows"}, {"effect": "windows", "level": 255}], "probability": 0.5}
_ELSEWHERE = ({"effect": "relight", "probability": 0.7}, *({"effect": "doorway", "probability": 0.4},) * 2)
CHANGES: dict[str, dict[str, Any]] = {
    "ours in two epochs": _changed("any_light"),
    "each image normalized instead of surroundings": _changed("any_light", "image"),
    "policy lighting": _changed("lighting"),
    "policy thesis": _changed("thesis"),
    "rotation alone": _changed("none"),
    "without windows": _own(*_ELSEWHERE),
    "without relight and doorway": _own(_WINDOWS),
    "each image normalized, policy lighting": _changed("lighting", "image"),
}
"""The changes in the rows of the ablation."""
DRAWN = {
    **{"fs": "Fourier signature", "hog": "HOG", "wisurf": "WI-SURF", "briefgist": "BRIEF-gist"},
    **{"radon_fourier": "Radon, Fourier", "hsv": "HSV histograms"},
}


def main() -> None:
    """Train, evaluate, print tables, draw and write the file."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--data", type=Path, required=True, help="folder of the rendered building, freiburg_like")
    arguments.add_argument("--seeds", type=int, default=3)
    arguments.add_argument("--picture", type=Path, help="where to draw the ablation (PNG)")
    arguments.add_argument("--changes", nargs="*", default=list(CHANGES), choices=list(CHANGES), help="ablation rows")
    arguments.add_argument("--analytic", nargs="+", default=ANALYTIC, choices=ANALYTIC, help="descriptors to compare")
    options = arguments.parse_args()
    report = Report(report_name("light_gap", options.data), options.out)
    small, large = Building(options.data, RECIPE.image_size), Building(options.data)
    rows: dict[str, list[dict[str, Any]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        rows["ours"] = [trained(small, seed, Path(folder) / f"ours{seed}") for seed in range(options.seeds)]
        short = {"epochs": SHORT}
        for number, name in enumerate(options.changes):
            rows[name] = [trained(small, 0, Path(folder) / f"change{number}", **short, **CHANGES[name])]
            print(f"{name}: {rows[name][0]}", flush=True)
    for name in options.analytic:
        rows[name] = [located(large, name, every=(5,))["5"]]
    rows = report.kept(rows, ("ours", *CHANGES, *ANALYTIC)) if options.keep else rows
    judge(report, rows)
    print(f"{options.seeds} seeds: mean (lowest to highest); {hardware()['cpu']}\n\n{table(rows)}")
    report.write({"seeds": options.seeds, "rows": rows})
    if options.picture is not None:
        draw(rows, options.picture)


def trained(building: Building, seed: int, run: Path, **changes: Any) -> dict[str, Any]:
    """Train on the cloudy drive, and return the errors on the queries and the minutes the training took."""
    network = RECIPE.build(seed=seed, normalize=changes.pop("normalize", RECIPE.model["normalize"]))
    drives = {"frames": building.drives(MAP), "validation": building.drives(VALIDATION)}
    begin = time.monotonic()
    RECIPE.fit(network, building.images, run=run, seed=seed, **drives, **changes)
    minutes = (time.monotonic() - begin) / 60
    found = {**located(building, network, every=(5,))["5"], "minutes": minutes}
    print(f"seed {seed}: {found}", flush=True)
    return found


def judge(report: Report, rows: dict[str, list[dict[str, Any]]]) -> None:
    """Compare the means over the seeds with the targets and the analytic descriptors."""
    for light, most in MOST_EXCESS.items():
        excess = statistics.mean(row[light]["excess"] for row in rows["ours"])
        best, name = min((rows[name][0][light]["excess"], name) for name in ANALYTIC if name in rows)
        report.target(f"{light}: excess at most {most} m ({excess:.3f})", excess <= most)
        report.target(f"{light}: less than the best analytic descriptor, {name} ({best:.3f})", excess < best)


def table(rows: dict[str, list[dict[str, Any]]]) -> str:
    """Return a table of mean errors with the excess in brackets, the floor in the first row."""
    floor = " | ".join(f"{rows['ours'][0][light]['floor']:.2f}" for light in LIGHTINGS)
    lines = [f"| error in m | {' | '.join(LIGHTINGS)} |", "|---|---|---|---|", f"| floor | {floor} |"]
    for name, found in rows.items():
        cells = []
        for light in LIGHTINGS:
            excess = statistics.mean(row[light]["excess"] for row in found)
            cells.append(f"{mean_and_range([row[light]['mean'] for row in found], 3)}, excess {excess:.3f}")
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def draw(rows: dict[str, list[dict[str, Any]]], path: Path) -> None:
    """Draw the excess of every row under each lighting."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    colours = {"cloudy": "#64748b", "night": "#1e3a8a", "sunny": "#f59e0b"}
    figure, axes = pyplot.subplots(figsize=(9, 0.42 * len(rows) + 1.4), layout="constrained")
    names = list(rows)[::-1]
    for light in LIGHTINGS:
        means = [statistics.mean(row[light]["excess"] for row in rows[name]) for name in names]
        axes.plot(means, range(len(names)), "o", color=colours[light], label=light, markersize=7)
    for at in range(len(names)):
        axes.axhline(at, color="#e2e8f0", linewidth=0.8, zorder=0)
    axes.axhline(sum(name in ANALYTIC for name in names) - 0.5, color="#334155", linewidth=0.8)
    axes.set_xscale("log")
    axes.set_xticks([0.02, 0.05, 0.1, 0.2, 0.5, 1, 2], labels=["2 cm", "5", "10", "20", "50 cm", "1 m", "2 m"])
    axes.minorticks_off()
    axes.set_yticks(range(len(names)), labels=[DRAWN.get(name, name) for name in names])
    axes.set_xlabel("mean error above the floor, trained under clouds alone")
    axes.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1))
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.tick_params(axis="y", length=0)
    figure.savefig(path, dpi=130)


if __name__ == "__main__":
    main()
