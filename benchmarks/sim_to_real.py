"""Measure which variations in pretraining help on real photographs, by leaving each out once.

Short pretrainings that differ in one point only: the same buildings and batches in the same order. Each network locates
real photographs of a corridor that no network was trained on: one drive is the map and the other one the queries, then
vice versa; and again with the queries disturbed as a camera may disturb them. In a simulated building that it never
saw, the map is every fifth frame of one drive, and the queries are drives under three lightings. Several seeds of the
recipe show the spread: a difference that is not larger means nothing.

    siamloc simulate camera=panorama out=data
    python -m benchmarks.sim_to_real --manifest corridor/manifest.csv --data data/freiburg_like
    python -m benchmarks.sim_to_real --manifest corridor/manifest.csv --data data/freiburg_like \
        --ways "the recipe" --seeds 1 2 --keep
"""

from __future__ import annotations

import statistics
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import siamloc
from benchmarks.building import LIGHTINGS, Building, located, mean_and_range
from benchmarks.corridor import RADIUS, library
from benchmarks.report import Report, hardware, parser
from foundation.files import read_json
from siamloc.pretraining import RECIPE, pretrain

DISTURBED = ("exposure", "white_balance", "blur", "motion_blur", "jpeg", "vignette", "occlude")
_STRENGTH, _NOISE = 0.5, 0.005  # of each disturbance, from 0 to 1; variance
_EFFECTS: list[Any] = list(RECIPE.augmentation["all_of"])


@dataclass(frozen=True)
class Way:
    """A variant of the recipe.

    Attributes:
        without: word in the steps that are left out of the augmentation; if empty, none is left out.
        views: fields of `ViewSettings` that differ from the recipe.
    """

    without: str = ""
    views: dict[str, Any] = field(default_factory=dict)

    def augmentation(self) -> dict[str, Any]:
        """Return the augmentation of the images."""
        kept = [one for one in _EFFECTS if not self.without or f"'{self.without}'" not in repr(one)]
        assert len(kept) < len(_EFFECTS) or not self.without, f"{self.without} is not in the recipe"
        return {**RECIPE.augmentation, "all_of": kept}


WAYS = {
    "the recipe": Way(),
    "without changes of light in the pictures": Way(without="any_light"),
    "without blur, motion blur and JPEG": Way(without="jpeg"),
    "without vignetting": Way(without="vignette"),
    "without occlusion": Way(without="occlude"),
    "best exposure and white balance, no noise": Way(views={"exposure": "metered"}),
    "panoramas only": Way(views={"cameras": "panoramas"}),
    "one camera only": Way(views={"cameras": "built_in"}),
}


def main() -> None:
    """Train, locate, print a table and write the file."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--manifest", required=True, help="manifest of the corridor")
    arguments.add_argument("--data", type=Path, required=True, help="folder of a rendered building")
    arguments.add_argument("--seeds", type=int, nargs="*", default=[0])
    arguments.add_argument("--batches", type=int, default=500, help="batches per training")
    arguments.add_argument("--ways", nargs="*", default=list(WAYS), choices=list(WAYS))
    options = arguments.parse_args()
    report = Report("sim_to_real", options.out)
    frames = siamloc.data.read("manifest", manifest=options.manifest, unit="frame")
    photographs = library(frames, RECIPE.image_size)
    building = Building(options.data, RECIPE.image_size)
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in options.ways}
    if options.keep and report.path.is_file():  # with --keep the other seeds of a row stay as well
        former = read_json(report.path)["rows"]
        rows = {name: [row for row in former.get(name, []) if row["seed"] not in options.seeds] for name in rows}
    for seed in options.seeds:
        for name in options.ways:
            begin = time.monotonic()
            with tempfile.TemporaryDirectory() as folder:
                weights = trained(WAYS[name], seed, options.batches, Path(folder))
                row = {"seed": seed, "batches": options.batches, **on_photographs(weights, photographs)}
                row["building"] = located(building, siamloc.models.load(weights), (5,))["5"]
            row["seconds"] = time.monotonic() - begin
            rows[name].append(row)
            print(f"{name}: {row}", flush=True)
            report.write({"rows": report.kept(rows, list(WAYS)) if options.keep else rows})
    found = report.kept(rows, list(WAYS)) if options.keep else rows
    print(f"{hardware()['cpu']}\n\n{table({name: some for name, some in found.items() if some})}")


def trained(way: Way, seed: int, batches: int, folder: Path) -> Path:
    """Pretrain a network briefly, and return the file of its weights."""
    network = RECIPE.build(seed=seed)
    run = pretrain(
        network,
        run=folder / "run",
        views=way.views,
        augmentation=way.augmentation(),
        seed=seed,
        epochs=1,
        pairs={"epoch_batches": batches},
    )
    return run.weights


def on_photographs(weights: Path, photographs: siamloc.data.PanoramaLibrary) -> dict[str, float]:
    """Return the share of photographs located within a few frames, as they are and disturbed."""
    settings = siamloc.models.load(weights).settings
    network = siamloc.models.build(**{**settings, "circular": False, "canonical": False, "weights": str(weights)})
    drives = [photographs.frames.select(sequence=name) for name in ("ref", "query")]
    share: dict[str, list[float]] = {}
    for known, asked in (drives, drives[::-1]):
        found = siamloc.evaluation.robustness(
            siamloc.maps.build(network, photographs, known, progress=False),
            photographs,
            asked,
            every=1,
            radius=RADIUS,
            noise=(0.0, _NOISE),
            occlusion=(),
            effects=DISTURBED,
            strengths=(_STRENGTH,),
            name="it",
        )
        for name, levels in found.measures["methods"]["it"].items():
            if name == "noise":
                share.setdefault("corridor", []).append(levels[0]["share"])
            share.setdefault(name, []).append(levels[-1]["share"])
    mean = {name: statistics.mean(both) for name, both in share.items()}
    return {**mean, "disturbed": statistics.mean(mean[name] for name in ("noise", *DISTURBED))}


def table(rows: dict[str, list[dict[str, Any]]]) -> str:
    """Return a table with one line for each way."""
    lines = [
        "| pretraining | corridor, % | corridor, disturbed, % | building: excess, m |",
        "|---|---|---|---|",
    ]
    for name, found in rows.items():
        corridor, disturbed = ([100 * row[key] for row in found] for key in ("corridor", "disturbed"))
        excess = [statistics.mean(row["building"][light]["excess"] for light in LIGHTINGS) for row in found]
        cells = (mean_and_range(corridor, 1), mean_and_range(disturbed, 1), mean_and_range(excess, 3))
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
