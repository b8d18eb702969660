"""Measure how much augmentation helps a network that has seen only one lighting, on the simulated building.

Trains the network of `experiment=freiburg_sim` on the cloudy run alone, with and without the policy `thesis`: the same
network, the same number of steps, the same pairs, several seeds. The map is made from the training run, the queries
are other runs under the three lightings. For one seed, these commands do the same:

    siamloc train experiment=freiburg_sim protocol=freiburg_sim_cloudy augment=thesis run=runs/thesis seed=0
    siamloc map run=runs/thesis
    siamloc evaluate run=runs/thesis task=absolute

    siamloc simulate camera=panorama out=data
    python -m benchmarks.augmentation_training --data data/freiburg_like
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import siamloc
from benchmarks.building import LIGHTINGS, MAP, QUERIES, Building, by_lighting, mean_and_range
from benchmarks.report import Report, parser

SIZE = (64, 256)


def main() -> None:
    """Train, evaluate, print a table and write it."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="folder of the rendered building, freiburg_like")
    arguments.add_argument("--policies", nargs="+", default=["none", "thesis"])
    arguments.add_argument("--seeds", type=int, default=3)
    arguments.add_argument("--epochs", type=int, default=25)
    options = arguments.parse_args()
    report = Report("augmentation_training", options.out)
    building = Building(options.data, SIZE)
    rows: dict[str, list[dict[str, float]]] = {name: [] for name in options.policies}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(options.seeds):
            for policy in options.policies:
                run = Path(folder) / f"{policy}-{seed}"
                rows[policy].append(errors(building, policy, seed, options.epochs, run))
                print(f"seed {seed}, augment={policy}: {rows[policy][-1]}", flush=True)
    summary = {
        policy: {name: mean_and_range([row[name] for row in found]) for name in LIGHTINGS}
        for policy, found in rows.items()
    }
    print(f"\n{'augment':<10}" + "".join(f"{lighting:>24}" for lighting in LIGHTINGS) + "   mean error, m")
    for policy, row in summary.items():
        print(f"{policy:<10}" + "".join(f"{row[lighting]:>24}" for lighting in LIGHTINGS))
    report.write({"seeds": options.seeds, "epochs": options.epochs, "rows": rows, "summary": summary})


def errors(building: Building, policy: str, seed: int, epochs: int, run: Path) -> dict[str, float]:
    """Train on the cloudy run and return the mean error in m under each lighting."""
    network = siamloc.models.build("alexnet", "fc500_500_5", SIZE, seed=seed)
    siamloc.training.fit(
        network,
        building.images,
        building.drives(MAP),
        run=run,
        validation=building.drives(["*seq2_cloudy1"]),
        augmentation=policy,
        epochs=epochs,
        seed=seed,
        pairs={"label": "distance", "same_room_share": 0.4, "epoch_pairs": 640},
        monitor="loss",
    )
    known = siamloc.maps.build(network, building.images, building.drives(MAP, every=5))
    result = siamloc.evaluation.localization(known, building.images, building.drives(QUERIES), names=("absolute",))
    return by_lighting(result.parts["absolute"])


if __name__ == "__main__":
    main()
