"""Rooms instead of positions: whether two images show the same room, and which one, under three lightings.

Networks are trained on the simulated building, three drives under three lightings, in three ways:

- `positions and rooms`: the recipe `modern` with half of the target taken from the rooms (`loss.room=0.5`);
- `rooms alone`: the same without positions, from room labels and the order of the frames (`pairs.by=sequence`, with
  `loss.sigma=1`, counted in frames);
- `photographs`: `siamloc.training.recipe("rooms")` on images like those of an ordinary camera, cut out of the same
  panoramas: 81 to 90 degrees wide, in a direction that wanders as the robot drives, each with its own exposure and
  white balance. The analytic descriptors `hsv` and `hog` are evaluated for comparison.

Pairs of queries are judged by the distance of their descriptors, with a limit learned from the map; the room of a query
is that of the most similar map frame. The map of the first network is also searched in two layers, nodes and frames,
both with its own descriptors.

Targets for the mean over the seeds: 99 % of the pairs and of the rooms right under every lighting in the first two
ways; in two layers at most 10 % of the comparisons, and no larger mean error than in the whole map; with photographs
more rooms right than with `hsv` and `hog` under every lighting.

    siamloc simulate camera=panorama out=data
    python -m benchmarks.rooms --data data/freiburg_like
"""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import siamloc
from benchmarks.building import LIGHTINGS, MAP, QUERIES, TRAIN, Building, begun, mean_and_range, report_name
from benchmarks.report import Report, hardware, parser
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.maps import VisualMap
from siamloc.models.batch_losses import make_loss

RECIPE = siamloc.training.recipe("modern")
WAYS: dict[str, dict[str, dict[str, Any]]] = {
    "positions and rooms": {"loss": {"room": 0.5}, "pairs": {}},
    "rooms alone": {
        "loss": {"room": 0.5, "sigma": 1.0},
        "pairs": {"by": "sequence", "radius": 1.0, "near": 0.5, "reach": 10.0},
    },
}
LEAST, MOST_COMPARED = 0.99, 0.10
ALL = "all"
"""All queries together, and pairs whose images may be taken under different lightings."""
NODES, CANDIDATES, RATIO, ALONG = 30, 4, 1.3, 2
"""Settings of the two layers, chosen on the validation drives."""
PHOTOGRAPHS = "photographs"
ANALYTIC = ("hsv", "hog")
WIDE, ROWS, COLUMNS = 0.25, 120, 160
"""A photograph: the largest share of a full turn that it shows, and its size in pixels."""
STEADY, JERK = 0.9, 4.0
"""How the camera turns: the share of the last turn kept from frame to frame, and random degrees added to it."""


def main() -> None:
    """Train, evaluate, print a table and write the file."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--data", type=Path, required=True, help="folder of a rendered building")
    arguments.add_argument("--seeds", type=int, default=3)
    arguments.add_argument("--runs", type=Path, help="folder in which the runs are kept and resumed")
    arguments.add_argument("--ways", nargs="+", default=[*WAYS, PHOTOGRAPHS], choices=[*WAYS, PHOTOGRAPHS])
    options = arguments.parse_args()
    report = Report(report_name("rooms", options.data), options.out)
    building = Building(options.data, RECIPE.image_size)
    rows: dict[str, list[dict[str, Any]]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.runs or Path(temporary)
        for way in options.ways:
            if way == PHOTOGRAPHS:
                rows.update(photographed(building, options.seeds, folder))
                continue
            for seed in range(options.seeds):
                network = trained(building, way, seed, folder / f"{way}{seed}")
                rows.setdefault(way, []).append(measured(building, network, layers=way == "positions and rooms"))
                print(f"{way}, seed {seed}: {rows[way][-1]}", flush=True)
    rows = report.kept(rows, (*WAYS, PHOTOGRAPHS, *ANALYTIC)) if options.keep else rows
    for way, found in ((way, rows[way]) for way in WAYS if way in rows):
        for figure in ("rooms", "pairs"):
            for light in (*LIGHTINGS, ALL):
                mean = statistics.mean(row[light][figure] for row in found)
                report.target(f"{way}, {light}: {LEAST:.0%} of the {figure} ({mean:.1%})", mean >= LEAST)
    if layers := [row["layers"] for found in rows.values() for row in found if "layers" in row]:
        share, loss = (statistics.mean(row[figure] for row in layers) for figure in ("share", "loss"))
        report.target(f"two layers: at most {MOST_COMPARED:.0%} compared ({share:.1%})", share <= MOST_COMPARED)
        report.target(f"two layers: no larger mean error ({loss:+.2%})", loss <= 0)
    for light in LIGHTINGS if PHOTOGRAPHS in rows else ():
        ours = statistics.mean(row[light]["rooms"] for row in rows[PHOTOGRAPHS])
        best, name = max((rows[name][0][light]["rooms"], name) for name in ANALYTIC)
        report.target(f"photographs, {light}: {ours:.1%} of the rooms, more than {name} ({best:.1%})", ours > best)
    print(f"{options.seeds} seeds: mean (lowest to highest); {hardware()['cpu']}\n\n{table(rows)}")
    report.write({"seeds": options.seeds, "rows": rows})


def trained(building: Building, way: str, seed: int, run: Path) -> Any:
    """Train on three drives, with or without their positions."""
    network = RECIPE.build(seed=seed)
    frames = building.drives(TRAIN)
    if way == "rooms alone":
        frames = FrameTable(path=frames.path, sequence=frames.sequence, room=frames.room, lighting=frames.lighting)
    loss = make_loss(**{**(RECIPE.loss or {}), **WAYS[way]["loss"]})
    RECIPE.fit(
        network, building.images, frames, run=run, seed=seed, loss=loss, pairs=WAYS[way]["pairs"], resume=begun(run)
    )
    return network


def photographed(building: Building, seeds: int, folder: Path) -> dict[str, list[dict[str, Any]]]:
    """Train on photographs with room labels, and return the shares of rooms and pairs found by ours and the others."""
    frames = photographs(building, folder / PHOTOGRAPHS)
    recipe = siamloc.training.recipe("rooms")
    small = PanoramaLibrary(frames, folder / "cache", image_size=recipe.image_size, circular=False)
    large = PanoramaLibrary(frames, folder / "cache", image_size=(128, 160), circular=False)
    found: dict[str, list[dict[str, Any]]] = {PHOTOGRAPHS: []}
    for seed in range(seeds):
        network = recipe.build(seed=seed)
        drives = frames.select(sequence=list(TRAIN))
        run = folder / f"{PHOTOGRAPHS}{seed}"
        recipe.fit(network, small, drives, run=run, seed=seed, resume=begun(run))
        found[PHOTOGRAPHS].append(shares(small, mapped(small, network)))
        print(f"{PHOTOGRAPHS}, seed {seed}: {found[PHOTOGRAPHS][-1]}", flush=True)
    return found | {name: [shares(large, mapped(large, name))] for name in ANALYTIC}


def photographs(building: Building, folder: Path) -> FrameTable:
    """Cut a photograph out of every panorama, in a direction that wanders along each drive; return their table."""
    frames = building.drives([*TRAIN, *MAP, *QUERIES])
    taken: dict[str, str] = {}
    for sequence in sorted(set(frames.sequence.tolist())):
        generator = np.random.default_rng([*sequence.encode()])  # the same for a drive, whatever else was rendered
        heading, turn = generator.uniform(0, 360), 0.0
        for path in frames.select(sequence=sequence).path.tolist():
            panorama = cv2.imread(path)
            rows, columns = panorama.shape[:2]
            turn = STEADY * turn + generator.normal(0, JERK)
            heading += turn
            zoom = generator.uniform(0.9, 1)
            top = generator.integers(0, rows - int(zoom * rows) + 1)
            ahead = np.roll(panorama, round(heading / 360 * columns), axis=1)
            view = ahead[top : top + int(zoom * rows), : int(WIDE * zoom * columns)]
            light = generator.uniform(0.8, 1.2) * generator.normal(1, 0.03, 3)
            picture = np.clip(cv2.resize(view, (COLUMNS, ROWS)) * light, 0, 255).astype(np.uint8)
            target = folder / sequence / f"{Path(path).stem}.png"
            target.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(target), picture)
            taken[path] = str(target)
    return FrameTable(
        path=[taken[path] for path in frames.path.tolist()],
        sequence=frames.sequence,
        room=frames.room,
        lighting=frames.lighting,
    )


def measured(building: Building, network: Any, layers: bool) -> dict[str, Any]:
    """Return the shares of rooms and pairs found under each lighting, and the cost and loss of two layers."""
    known = mapped(building.images, network)
    found = shares(building.images, known)
    if layers:
        queries = building.drives(QUERIES)
        nodes = siamloc.maps.group(known, "spectral", nodes=NODES)
        settings: dict[str, Any] = {"candidates": CANDIDATES, "coarse": {"ratio": RATIO}, "along": ALONG}
        result = siamloc.evaluation.hierarchical(known, building.images, queries, nodes, **settings)
        overall = result.parts["hierarchical"]["overall"]
        found["layers"] = {"loss": overall["loss"], "share": overall["comparisons"]["share"]}
    return found


def mapped(images: PanoramaLibrary, descriptor: Any) -> VisualMap:
    """Return the map of one drive."""
    return siamloc.maps.build(descriptor, images, images.frames.select(sequence=list(MAP)), progress=False)


def shares(images: PanoramaLibrary, known: VisualMap) -> dict[str, Any]:
    """Return the shares of rooms and pairs found under each lighting, by the nearest frame of the map."""
    parts = siamloc.evaluation.rooms(known, images, images.frames.select(sequence=list(QUERIES))).parts
    rooms = parts["room_retrieval"]
    found: dict[str, Any] = {light: {"rooms": rooms["lighting"][light]["accuracy"]} for light in LIGHTINGS}
    found[ALL] = {"rooms": rooms["overall"]["accuracy"]}
    if "room_pairs" in parts:  # only for networks
        pairs = {**parts["room_pairs"]["lighting"], ALL: parts["room_pairs"]["overall"]}
        for light, figures in found.items():
            figures["pairs"] = pairs[light]["overall"]
    return found


def table(rows: dict[str, list[dict[str, Any]]]) -> str:
    """Return a table of the shares found."""
    lines = [f"| way | figure | {' | '.join((*LIGHTINGS, ALL))} |", "|---|---|---|---|---|---|"]
    for way, found in rows.items():
        for figure in ("rooms", "pairs") if "pairs" in found[0][ALL] else ("rooms",):
            cells = [mean_and_range([100 * row[light][figure] for row in found], 1) for light in (*LIGHTINGS, ALL)]
            name = f"{way}, {PHOTOGRAPHS}" if way in ANALYTIC else way
            lines.append(f"| {name} | {figure} right [%] | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
