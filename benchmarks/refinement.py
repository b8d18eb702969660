"""Poses finer than the map: each query compared with the map frames that it resembles, by map spacing.

The map is every frame of one drive, or every 2nd, 5th, 10th or 20th; the queries are other drives under three
lightings, and nobody knows headings. Networks are trained by the recipe `modern` with relative=True, on three drives,
one of which is the map; `--run` takes one that was trained already, such as by `siamloc pretrain`.

Targets, of the mean over the seeds, under every lighting: with every fifth frame a mean error of at most 0.06 m, 95 %
below 0.15 m, and a median heading error of at most 0.5 degrees; with every twentieth a mean of at most 0.25 m; and 87
to 93 % of the positions inside their 90 % ellipses, which are learned from the drives that chose the checkpoint. And
whatever the building: at most 3 ms for a query and 3 map frames on one core, and at most 8 kB in the map for a frame.

    siamloc simulate camera=panorama out=data
    OMP_NUM_THREADS=1 python -m benchmarks.refinement --data data/freiburg_like
"""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import siamloc
from analytic import Description
from benchmarks.building import LIGHTINGS, MAP, QUERIES, TRAIN, VALIDATION, Building, mean_and_range, report_name
from benchmarks.report import Report, hardware, milliseconds, parser
from siamloc.files import read_json

RECIPE = siamloc.training.recipe("modern")
EVERY = (1, 2, 5, 10, 20)
COMPARED = 3
MOST_MEAN, MOST_P95, MOST_TURN, MOST_SPARSE = 0.06, 0.15, 0.5, 0.25
MOST_MS, MOST_BYTES = 3.0, 8000
_RUNS = 100


def main() -> None:
    """Train, locate, time, print a table and write the file."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--data", type=Path, required=True, help="folder of a rendered building")
    arguments.add_argument("--seeds", type=int, default=3)
    arguments.add_argument("--run", type=Path, help="of a network to take instead of training some")
    options = arguments.parse_args()
    report = Report(report_name("refinement", options.data), options.out)
    building = Building(options.data, RECIPE.image_size)
    if options.run is not None:
        networks = {f"run {options.run.name}": [siamloc.models.load(options.run)]}
    else:
        networks = {"three drives": [trained(building, seed) for seed in range(options.seeds)]}
    rows = {name: [refined(building, network) for network in some] for name, some in networks.items()}
    if options.keep and report.path.is_file():
        rows = report.kept(rows, [*rows, *read_json(report.path)["rows"]])
    for name, found in rows.items():
        judge(report, name, found)
        print(f"\n{name}\n{table(found)}")
    cost = costs(building, next(iter(networks.values()))[0])
    report.target(f"at most {MOST_MS:g} ms for a query ({cost['ms']:.2f})", cost["ms"] <= MOST_MS)
    report.target(f"at most {MOST_BYTES} bytes for a map frame ({cost['bytes']})", cost["bytes"] <= MOST_BYTES)
    print(hardware()["cpu"])
    report.write({"rows": rows, "cost": cost, "compared": COMPARED})


def trained(building: Building, seed: int) -> siamloc.models.Network:
    """Train a network that compares."""
    network = RECIPE.build(seed=seed, relative=True)
    train, validation = building.drives(TRAIN), building.drives(VALIDATION)
    with tempfile.TemporaryDirectory() as folder:
        RECIPE.fit(network, building.images, train, run=Path(folder) / "run", validation=validation, seed=seed)
    return network


def refined(building: Building, network: siamloc.models.Network) -> dict[str, Any]:
    """Return errors by map spacing and lighting: of the nearest map frame, and refined."""
    known = siamloc.maps.build(network, building.images, building.drives(MAP), progress=False)
    queries = building.drives(QUERIES)
    asked = description(siamloc.maps.build(network, building.images, queries, progress=False))
    validation = building.drives(VALIDATION)
    other = description(siamloc.maps.build(network, building.images, validation, progress=False))
    found: dict[str, Any] = {}
    for every in EVERY:
        part = known.take(range(0, len(known), every))
        nearest = siamloc.maps.match(part, asked, COMPARED)
        poses = siamloc.maps.refine(part, asked, nearest, k=COMPARED)
        apart = siamloc.maps.refine(part, other, siamloc.maps.match(part, other, COMPARED), k=COMPARED)
        poses = poses.widened(apart.widening(validation.xy))
        inside = poses.inside(queries.xy)
        error = np.hypot(*(poses.xy - queries.xy).T)
        retrieved = np.hypot(*(part.frames.xy[nearest.indices[:, 0]] - queries.xy).T)
        off = np.degrees(np.abs(np.angle(np.exp(1j * (poses.theta - queries.theta)))))
        found[str(every)] = {
            light: {
                "retrieval": float(retrieved[queries.lighting == light].mean()),
                "mean": float(error[queries.lighting == light].mean()),
                "p95": float(np.percentile(error[queries.lighting == light], 95)),
                "heading": float(np.median(off[queries.lighting == light])),
                "inside": float(inside[queries.lighting == light].mean()),
            }
            for light in LIGHTINGS
        }
    print(found, flush=True)
    return found


def description(known: siamloc.maps.VisualMap) -> Description:
    """Return what a map holds of its frames, as descriptions of queries."""
    return known.turning(np.arange(len(known)))


def costs(building: Building, network: siamloc.models.Network) -> dict[str, float]:
    """Return the median time that the poses of one query take on one core, and what a map frame takes."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    known = siamloc.maps.build(network, building.images, building.drives(MAP, 20), progress=False)
    query = description(known).take(np.array([0]))
    nearest = siamloc.maps.match(known, query, COMPARED)
    time = milliseconds(lambda: siamloc.maps.refine(known, query, nearest, k=COMPARED), _RUNS)
    torch.set_num_threads(threads)
    assert known.heading is not None
    return {**time, "bytes": known.heading.values[0].nbytes}


def judge(report: Report, name: str, rows: list[dict[str, Any]]) -> None:
    """Compare the means over the seeds with the targets."""
    for light in LIGHTINGS:
        for every, figure, most, text in (
            ("5", "mean", MOST_MEAN, "mean error at most 0.06 m"),
            ("5", "p95", MOST_P95, "95 % below 0.15 m"),
            ("5", "heading", MOST_TURN, "median heading error at most 0.5 degrees"),
            ("20", "mean", MOST_SPARSE, "mean error at most 0.25 m"),
        ):
            found = statistics.mean(row[every][light][figure] for row in rows)
            report.target(f"{name}, {light}, 1 in {every}: {text} ({found:.3f})", found <= most)
    inside = statistics.mean(row["5"][light]["inside"] for row in rows for light in LIGHTINGS)
    report.target(f"{name}, 1 in 5: 87 to 93 % inside their 90 % ellipses ({inside:.1%})", 0.87 <= inside <= 0.93)


def table(rows: list[dict[str, Any]]) -> str:
    """Return mean errors by map spacing."""
    lines = [f"| map: every frame, m | {' | '.join(f'{light}: nearest | refined' for light in LIGHTINGS)} |"]
    lines.append("|---" * (1 + 2 * len(LIGHTINGS)) + "|")
    for every in map(str, EVERY):
        cells = [
            mean_and_range([row[every][light][figure] for row in rows], 3)
            for light in LIGHTINGS
            for figure in ("retrieval", "mean")
        ]
        lines.append(f"| {every} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
