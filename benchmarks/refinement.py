"""Measure poses finer than the map, by map spacing: each query is compared with the map frames that it resembles.

The map is every frame of one drive, or every 2nd, 5th, 10th or 20th; the queries are other drives under three
lightings, with unknown headings. A query is compared with 3 map frames, or with 8 if the map holds every 10th or 20th.
The shipped network is used as it is, and fine-tuned with the recipe `fine_tuning` and relative=True on three drives,
one of which is the map; `--run` adds another network. The analytic way, between the three nearest map frames by HOG, is
evaluated for comparison.

Targets for the mean of the fine-tuned networks over the seeds, under every lighting: with every fifth frame a mean
error of at most 0.06 m, 95 % below 0.15 m, and a median heading error of at most 0.5 degrees; with every twentieth a
mean of at most 0.25 m; and 87 to 93 % of the positions inside their 90 % ellipses, which are learned from the drives
that the checkpoint was chosen on. Without training: less than the nearest frame's error. The cost is measured with the
usual building: at most 3 ms for a query and 3 map frames on one core, and at most 8 kB per frame in the map.

    siamloc simulate camera=panorama out=data
    OMP_NUM_THREADS=1 python -m benchmarks.refinement --data data/freiburg_like

For buildings on which nothing was chosen, such as `siamloc simulate camera=panorama building=random seed=101 out=data`:

    OMP_NUM_THREADS=1 python -m benchmarks.refinement --data data/annex --ways "without training"
"""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import siamloc
from analytic import Description
from benchmarks.building import LIGHTINGS, MAP, QUERIES, TRAIN, USUAL, VALIDATION, Building, mean_and_range, report_name
from benchmarks.refinement_picture import draw
from benchmarks.report import Report, hardware, milliseconds, parser
from siamloc.data import FrameTable
from siamloc.evaluation.metrics import heading_error, localization_error

RECIPE = siamloc.training.recipe("fine_tuning")
COMPARING: dict[str, Any] = {
    "epochs": 3,
    "pairs": {"near": 0.75, "reach": 4.0, "epoch_batches": 80},
    "optimizer": {"frozen_stages": 4, "learning_rate": 0.002},
}
"""Changes to the recipe that train only the comparing part, with pairs of places a map's spacing apart."""
EVERY = (1, 2, 5, 10, 20)
COMPARED = {1: 3, 2: 3, 5: 3, 10: 8, 20: 8}
"""Map frames that a query is compared with: the farther apart they are, the less often the right ones are nearest."""
AS_IT_IS, TUNED, ANALYTIC = "without training", "fine-tuned on three drives", "between frames by HOG"
WAYS = (AS_IT_IS, TUNED, ANALYTIC)
MOST_MEAN, MOST_P95, MOST_TURN, MOST_SPARSE = 0.06, 0.15, 0.5, 0.25
MOST_MS, MOST_BYTES = 3.0, 8000
_STEP = 0.15  # metres between the frames of a drive
_RUNS = 100


def main() -> None:
    """Train, locate, time, print a table, write the file and draw the picture."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--data", type=Path, required=True, help="folder of a rendered building")
    arguments.add_argument("--seeds", type=int, default=3)
    arguments.add_argument("--ways", nargs="*", default=WAYS, choices=WAYS)
    arguments.add_argument("--run", type=Path, help="run of another network to evaluate")
    arguments.add_argument("--picture", type=Path, help="PNG of the errors against the map spacing")
    options = arguments.parse_args()
    report = Report(report_name("refinement", options.data), options.out)
    building = Building(options.data, RECIPE.image_size)
    rows: dict[str, list[dict[str, Any]]] = {}
    network = siamloc.models.pretrained()
    if AS_IT_IS in options.ways:
        rows[AS_IT_IS] = [refined(building, network)]
    if options.run is not None:
        rows[f"run {options.run.name}"] = [refined(building, siamloc.models.load(options.run))]
    if TUNED in options.ways:
        rows[TUNED] = [refined(building, trained(building, seed)) for seed in range(options.seeds)]
    if ANALYTIC in options.ways:
        rows[ANALYTIC] = [interpolated(Building(options.data))]
    rows = report.kept(rows, WAYS) if options.keep else rows
    for name, found in rows.items():
        judge(report, name, found)
        print(f"\n{name}\n{table(found)}")
    cost = costs(building, network) if options.data.resolve().name == USUAL else {}
    if cost:
        for k in sorted(set(COMPARED.values())):
            print(f"{cost[f'ms_{k}']:.2f} ms for a query and {k} map frames")
        text = f"at most {MOST_MS:g} ms for a query and 3 map frames ({cost['ms_3']:.2f})"
        report.target(text, cost["ms_3"] <= MOST_MS)
        report.target(f"at most {MOST_BYTES} bytes for a map frame ({cost['bytes']})", cost["bytes"] <= MOST_BYTES)
        print(hardware()["cpu"])
    found = {"rows": rows, "compared": {str(every): k for every, k in COMPARED.items()}}
    report.write({**found, "cost": cost} if cost else found)
    if options.picture is not None:
        print(f"picture: {draw(rows, options.picture)}")


def trained(building: Building, seed: int) -> siamloc.models.Network:
    """Fine-tune a network that compares images."""
    network = RECIPE.build(seed=seed)
    train, validation = building.drives(TRAIN), building.drives(VALIDATION)
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run"
        RECIPE.fit(network, building.images, train, run=run, validation=validation, seed=seed, **COMPARING)
    return network


def refined(building: Building, network: siamloc.models.Network) -> dict[str, Any]:
    """Return errors by map spacing and lighting: of the nearest map frame, refined, and followed along the drives."""
    known = siamloc.maps.build(network, building.images, building.drives(MAP), progress=False)
    queries = building.drives(QUERIES)
    asked = description(siamloc.maps.build(network, building.images, queries, progress=False))
    validation = building.drives(VALIDATION)
    other = description(siamloc.maps.build(network, building.images, validation, progress=False))
    found: dict[str, Any] = {}
    for every in EVERY:
        part = known.take(range(0, len(known), every))
        k = COMPARED[every]
        nearest = siamloc.maps.match(part, asked, k)
        poses = siamloc.maps.refine(part, asked, nearest, k=k)
        apart = siamloc.maps.refine(part, other, siamloc.maps.match(part, other, k), k=k)
        unlearned = poses.inside(queries.xy)
        poses = poses.widened(apart.widening(validation.xy))
        followed = siamloc.maps.PoseFilter(_STEP).run(poses, queries.sequence)
        found[str(every)] = by_light(
            queries,
            **errors_of(part, nearest, queries, poses.xy, poses.theta),
            inside=poses.inside(queries.xy),
            inside_unlearned=unlearned,
            followed=localization_error(followed.xy, queries.xy),
        )
    print(found, flush=True)
    return found


def interpolated(building: Building) -> dict[str, Any]:
    """Return errors by map spacing and lighting of the nearest map frame by HOG, and between the three nearest."""
    known = siamloc.maps.build("hog", building.images, building.drives(MAP), progress=False)
    queries = building.drives(QUERIES)
    asked = siamloc.maps.build("hog", building.images, queries, progress=False).description
    found: dict[str, Any] = {}
    for every in EVERY:
        part = known.take(range(0, len(known), every))
        nearest = siamloc.maps.match(part, asked, 3)
        turned = siamloc.maps.headings(part, asked, nearest, 3)
        poses = siamloc.maps.interpolate_poses(nearest, part.frames, 3, 1.5 * every * _STEP, turned)
        assert poses.theta is not None
        found[str(every)] = by_light(queries, **errors_of(part, nearest, queries, poses.xy, poses.theta))
    return found


def errors_of(
    known: siamloc.maps.VisualMap,
    nearest: siamloc.maps.Retrieval,
    queries: FrameTable,
    xy: NDArray[np.float64],
    theta: NDArray[np.float64],
) -> dict[str, Any]:
    """Return errors (n,) of the nearest map frames and of estimated poses, as `by_light` takes them."""
    error = localization_error(xy, queries.xy)
    return {
        "retrieval": localization_error(known.frames.xy[nearest.indices[:, 0]], queries.xy),
        "mean": error,
        "p95": (error, 95),
        "heading": (np.degrees(heading_error(theta, queries.theta)), 50),
    }


def by_light(
    queries: FrameTable, **figures: NDArray[np.float64] | tuple[NDArray[np.float64], float]
) -> dict[str, dict[str, float]]:
    """Return means of values (n,), or percentiles of values where one is given, under each lighting."""
    found: dict[str, dict[str, float]] = {light: {} for light in LIGHTINGS}
    for light, row in found.items():
        shown = queries.lighting == light
        for name, values in figures.items():
            of = np.percentile(values[0][shown], values[1]) if isinstance(values, tuple) else np.nanmean(values[shown])
            row[name] = float(of)
    return found


def description(known: siamloc.maps.VisualMap) -> Description:
    """Return the descriptions of a map's frames, to use them as queries."""
    return known.turning()


def costs(building: Building, network: siamloc.models.Network) -> dict[str, float]:
    """Return bytes, and the median times for the pose of one query on one core, with onnxruntime as on the robot.

    Description and search are not included.
    """
    import onnxruntime

    from siamloc.runtime.onnx_model import export_relative

    known = siamloc.maps.build(network, building.images, building.drives(MAP, 20), progress=False)
    query = description(known).take(np.array([0]))
    nearest = siamloc.maps.match(known, query, max(COMPARED.values()))
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    with tempfile.TemporaryDirectory() as folder:
        export_relative(network, path := Path(folder) / "relative.onnx")
        session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])

    def compares(queries: NDArray[np.float32], frames: NDArray[np.float32]) -> Any:
        return session.run(None, {"query": queries, "known": frames})

    found: dict[str, float] = {}
    for k in sorted(set(COMPARED.values())):
        time = milliseconds(partial(siamloc.maps.refine, known, query, nearest, compares, k), _RUNS)
        found[f"ms_{k}"] = time["ms"]
    assert known.orientation is not None
    return {**found, "bytes": known.orientation[0].nbytes}


def judge(report: Report, name: str, rows: list[dict[str, Any]]) -> None:
    """Compare the means over the seeds with the targets."""

    def mean(every: str, light: str, figure: str) -> float:
        return statistics.mean(row[every][light][figure] for row in rows)

    for light in LIGHTINGS:
        if name == AS_IT_IS:
            for every in map(str, EVERY):
                found, nearest = mean(every, light, "mean"), mean(every, light, "retrieval")
                text = f"{name}, {light}, 1 in {every}: below the nearest frame's {nearest:.3f} m ({found:.3f})"
                report.target(text, found < nearest)
        if name != TUNED:
            continue
        for every, figure, most, text in (
            ("5", "mean", MOST_MEAN, "mean error at most 0.06 m"),
            ("5", "p95", MOST_P95, "95 % below 0.15 m"),
            ("5", "heading", MOST_TURN, "median heading error at most 0.5 degrees"),
            ("20", "mean", MOST_SPARSE, "mean error at most 0.25 m"),
        ):
            found = mean(every, light, figure)
            report.target(f"{name}, {light}, 1 in {every}: {text} ({found:.3f})", found <= most)
    if name == TUNED:
        inside = statistics.mean(mean("5", light, "inside") for light in LIGHTINGS)
        report.target(f"{name}, 1 in 5: 87 to 93 % inside their 90 % ellipses ({inside:.1%})", 0.87 <= inside <= 0.93)


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return mean errors by map spacing."""
    shown = [one for one in ("retrieval", "mean", "followed") if one in rows[0]["5"][LIGHTINGS[0]]]
    words = {"retrieval": "nearest", "mean": "refined", "followed": "followed"}
    heads = [f"{light}: {' | '.join(words[one] for one in shown)}" for light in LIGHTINGS]
    lines = [f"| map: 1 in | {' | '.join(heads)} |", "|---" * (1 + len(shown) * len(LIGHTINGS)) + "|"]
    for every in map(str, EVERY):
        cells = [
            mean_and_range([row[every][light][figure] for row in rows], 3) for light in LIGHTINGS for figure in shown
        ]
        lines.append(f"| {every} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
