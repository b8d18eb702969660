"""Train the small networks of [T] table 5.7 from random weights, as published but for the images, and with AdamW.

`simple1`, `simple2` and `alexnet` with the head 500-500-5 learn from panoramas of 128 x 512 of three drives whether two
of them show the same room: batches of 256 pairs, 34 an epoch, half of them of one room, by SGD with a learning rate of
0.001 and a momentum of 0.9 ([T] 5.3.4, 5.4.1). Then 7,000 pairs of the training frames and 7,000 of three other drives
are told apart, after the first five epochs, as in the table, and at the end. The loss by epoch, and the spread of the
queries' descriptors in units of the loss's margin, show whether a network has learned anything at all: without it, the
loss stays where it began and all descriptors lie in one place. AdamW has a learning rate of 0.0003. Where
the processor has instructions for it, the arithmetic is in bfloat16.

The runs stay in `--runs`. An interrupted call continues each exactly where it was.

    siamloc simulate camera=panorama out=data
    python -m benchmarks.published_scale --data data/freiburg_like --runs runs/published_scale
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

import siamloc
from benchmarks.building import MAP, QUERIES, TRAIN, Building, begun
from benchmarks.report import Report, parser

BRANCHES = ("simple1", "simple2", "alexnet")
OPTIMIZERS: dict[str, dict[str, Any]] = {
    "sgd": {"name": "sgd", "learning_rate": 0.001, "momentum": 0.9},
    "adamw": {"name": "adamw", "learning_rate": 0.0003},
}
MARGIN = 2.0
PAIRS: dict[str, Any] = {"label": "room", "same_room_share": 0.5, "epoch_pairs": 34 * 256}
JUDGED: dict[str, Any] = {"pairs": {"count": 7000, "same_room_share": 0.5}, "protocol": "same_run"}


def main() -> None:
    """Train, tell pairs apart, print a table and write the file after each row."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--data", type=Path, required=True, help="folder of the rendered building, freiburg_like")
    arguments.add_argument("--runs", type=Path, required=True, help="where the runs are kept")
    arguments.add_argument("--branches", nargs="+", default=BRANCHES, choices=BRANCHES)
    arguments.add_argument("--optimizers", nargs="+", default=list(OPTIMIZERS), choices=list(OPTIMIZERS))
    arguments.add_argument("--epochs", nargs="+", type=int, default=[5, 30], help="when pairs are told apart")
    options = arguments.parse_args()
    report, building = Report("published_scale", options.out), Building(options.data)
    rows: dict[str, Any] = report.kept({}) if options.keep else {}
    for epochs in sorted(options.epochs):
        for branch in options.branches:
            for optimizer in options.optimizers:
                row = rows.setdefault(f"{branch}, {optimizer}", {"after": {}})
                row |= trained(building, branch, optimizer, epochs, options.runs / f"{branch}_{optimizer}")
                row["after"][str(epochs)] = row.pop("judged")
                print(f"{branch}, {optimizer}, {epochs} epochs: {row['after'][str(epochs)]}", flush=True)
                report.write({"rows": rows})


def trained(building: Building, branch: str, optimizer: str, epochs: int, run: Path) -> dict[str, Any]:
    """Train until some epoch, and return the curve of the loss, pairs a second, and what the network can tell apart."""
    network = siamloc.models.build(branch, "fc500_500_5", (128, 512), seed=0)
    done = len(siamloc.training.Run(run).curves()["epoch"]) if begun(run) else 0
    start = time.monotonic()
    siamloc.training.fit(
        network,
        building.images,
        building.drives(TRAIN),
        run=run,
        resume=begun(run),
        epochs=epochs,
        batch_size=256,
        checkpoint_every=2,
        pairs=PAIRS,
        optimizer=OPTIMIZERS[optimizer],
        margin=MARGIN,
        trainer={"precision": "auto"},
    )
    seconds = time.monotonic() - start
    rate = {"pairs_per_second": (epochs - done) * PAIRS["epoch_pairs"] / seconds} if epochs > done else {}
    loss = siamloc.training.Run(run).curves()["train/loss"].tolist()
    return {**rate, "loss": loss, "judged": judged(building, network)}


def judged(building: Building, network: Any) -> dict[str, Any]:
    """Return the shares of pairs told apart, of training frames and queries, and the spread of the queries."""
    described = siamloc.models.as_descriptor(network)
    known = siamloc.maps.build(described, building.images, building.drives(MAP, every=5), progress=False)
    shares: dict[str, Any] = {}
    for phase, drives in (("train", TRAIN), ("test", QUERIES)):
        asked = building.drives(drives)
        result = siamloc.evaluation.localization(known, building.images, asked, names=("room_retrieval",), **JUDGED)
        shares[phase] = result.parts["room_pairs"]["overall"]
    queries = siamloc.maps.build(described, building.images, building.drives(QUERIES, every=5), progress=False)
    apart = np.linalg.norm(queries.descriptors - queries.descriptors.mean(axis=0), axis=1)
    return {**shares, "spread": float(np.sqrt((apart**2).mean()) / MARGIN)}


if __name__ == "__main__":
    main()
