"""Locate drives in a house that others modelled and rendered: shipped network, analytic descriptors, one cloudy drive.

The map is every 4th, 14th or 30th frame of one cloudy drive, 0.6, 2.1 or 4.5 m apart; the queries are three other
drives, one in each light. The rows `modern` are of `siamloc.training.recipe("modern")`, trained on the map's drive
alone, with several seeds; no drive chooses its checkpoint. Refined poses come from comparing a query with 3 map
frames, or with 8 where they are metres apart.

Targets of the shipped network, under each light: every 0.6 m an excess over the floor of at most 0.01 m, ahead of
WI-SURF, refined at most 0.05 m; every 2.1 m at most 0.05 m, refined 0.12 m; every 4.5 m at most 0.30 m, ahead of HSV.
Of `modern`, every 0.6 m: at night and in the sun an excess at most 0.02 m above that under clouds.

    OMP_NUM_THREADS=1 python -m benchmarks.house --data house/manifest.csv
"""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path
from typing import Any

import siamloc
from benchmarks.building import LIGHTINGS, MAP
from benchmarks.refinement import by_light
from benchmarks.report import Report, hardware, parser
from siamloc.data import PanoramaLibrary
from siamloc.evaluation.metrics import error_floor, localization_error

RECIPE = siamloc.training.recipe("modern")
QUERIES = ("*seq2_cloudy1", "*seq2_night1", "*seq2_sunny1")
ANALYTIC = ("hsv", "hog", "gist", "wisurf")
COMPARED = {4: 3, 14: 8, 30: 8}
"""Every which frame of the drive is in the map, and how many of them are compared with a query."""
MOST_EXCESS = {4: 0.01, 14: 0.05, 30: 0.30}
MOST_REFINED = {4: 0.05, 14: 0.12}
BEHIND = {4: "wisurf", 30: "hsv"}
MOST_DARKER = 0.02


def main() -> None:
    """Locate, train, print a table and write the file."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--data", type=Path, required=True, help="manifest of the house")
    arguments.add_argument("--seeds", type=int, default=3)
    arguments.add_argument("--analytic", nargs="*", default=ANALYTIC, choices=ANALYTIC, help="descriptors to compare")
    options = arguments.parse_args()
    report = Report("house", options.out)
    frames = siamloc.data.read("manifest", manifest=options.data)
    small, large = (PanoramaLibrary(frames, image_size=size) for size in (RECIPE.image_size, (128, 512)))
    rows = {"pretrained": [located(small, "pretrained")]}
    rows |= {name: [located(large, name)] for name in options.analytic}
    with tempfile.TemporaryDirectory() as folder:
        if options.seeds:
            rows["modern"] = [located(small, trained(small, seed, Path(folder))) for seed in range(options.seeds)]
    rows = report.kept(rows, ("pretrained", "modern", *ANALYTIC)) if options.keep else rows
    print(f"{hardware()['cpu']}\n\n{table(rows)}")
    judge(report, rows)
    report.write({"rows": rows})


def trained(images: PanoramaLibrary, seed: int, folder: Path) -> siamloc.models.Network:
    """Train a network on the map's drive."""
    network = RECIPE.build(seed=seed)
    RECIPE.fit(network, images, images.frames.select(sequence=list(MAP)), run=folder / f"run{seed}", seed=seed)
    return network


def located(images: PanoramaLibrary, descriptor: Any) -> dict[str, dict[str, dict[str, float]]]:
    """Return floor, mean, excess and 95 % of the error in m, and its mean when refined, by map and lighting."""
    whole = siamloc.maps.build(descriptor, images, images.frames.select(sequence=list(MAP)), progress=False)
    asked = siamloc.maps.build(descriptor, images, images.frames.select(sequence=list(QUERIES)), progress=False)
    parts, refines = asked.turning(), getattr(asked.descriptor, "compares", False)
    found: dict[str, dict[str, dict[str, float]]] = {}
    for every, compared in COMPARED.items():
        known = whole.take(range(0, len(whole), every))
        nearest = siamloc.maps.match(known, parts, compared)
        error = localization_error(known.frames.xy[nearest.indices[:, 0]], asked.frames.xy)
        floor = error_floor(known.frames.xy, asked.frames.xy)
        finer = {}
        if refines:
            poses = siamloc.maps.refine(known, parts, nearest, k=compared)
            finer["refined"] = localization_error(poses.xy, asked.frames.xy)
        found[str(every)] = by_light(
            asked.frames, floor=floor, mean=error, excess=error - floor, p95=(error, 95), **finer
        )
    print(found, flush=True)
    return found


def judge(report: Report, rows: dict[str, list[dict[str, Any]]]) -> None:
    """Compare the figures with the targets."""
    for every, most in MOST_EXCESS.items():
        for light in LIGHTINGS:
            ours, where = rows["pretrained"][0][str(every)][light], f"1 frame in {every}, {light}"
            report.target(f"{where}: excess at most {most} m ({ours['excess']:.3f})", ours["excess"] <= most)
            if every in MOST_REFINED:
                text = f"{where}: refined at most {MOST_REFINED[every]} m ({ours['refined']:.3f})"
                report.target(text, ours["refined"] <= MOST_REFINED[every])
            if (other := BEHIND.get(every)) in rows:
                mean = rows[str(other)][0][str(every)][light]["mean"]
                report.target(f"{where}: mean below {other}'s {mean:.3f} m ({ours['mean']:.3f})", ours["mean"] < mean)
    if "modern" in rows:
        excess = {light: statistics.mean(row["4"][light]["excess"] for row in rows["modern"]) for light in LIGHTINGS}
        for light in LIGHTINGS[1:]:
            text = f"modern, {light}: at most {MOST_DARKER} m above clouds ({excess[light] - excess['cloudy']:.3f})"
            report.target(text, excess[light] - excess["cloudy"] <= MOST_DARKER)


def table(rows: dict[str, list[dict[str, Any]]]) -> str:
    """Return a table of mean errors over the seeds, refined ones after a slash; the floor is in the first row."""
    heads = [f"{every}, {light}" for every in COMPARED for light in LIGHTINGS]
    lines = [f"| 1 frame in | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    for name, figure in [("pretrained", "floor"), *((name, "mean") for name in rows)]:
        cells = []
        for every in COMPARED:
            for light in LIGHTINGS:
                seeds = [row[str(every)][light] for row in rows[name]]
                cell = f"{statistics.mean(one[figure] for one in seeds):.3f}"
                finer = [one["refined"] for one in seeds if "refined" in one and figure == "mean"]
                cells.append(f"{cell} / {statistics.mean(finer):.3f}" if finer else cell)
        lines.append(f"| {'floor' if figure == 'floor' else name} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
