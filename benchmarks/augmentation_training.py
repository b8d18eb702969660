"""What augmentation does for a network that has seen one lighting only, on the simulated building.

Trains the network of `experiment=freiburg_sim` on the cloudy run alone, with and without the policy `thesis`: the same
network, the same number of steps, the same pairs, several seeds. The map is made of the training run, the queries are
other runs under the three lightings. A pair of rows is what these commands give, for one seed:

    siamloc train experiment=freiburg_sim protocol=freiburg_sim_cloudy augment=thesis run=runs/thesis seed=0
    siamloc map run=runs/thesis
    siamloc evaluate run=runs/thesis

    siamloc simulate camera=panorama out=data
    python -m benchmarks.augmentation_training --data data/freiburg_like --out benchmarks/results
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
from datetime import date
from pathlib import Path
from typing import Any

import siamloc.cli
from siamloc.files import write_json
from siamloc.results import versions

LIGHTINGS = ("cloudy", "night", "sunny")


def main() -> None:
    """Train, evaluate, print a table and write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, help="folder of the rendered building, freiburg_like")
    parser.add_argument("--policies", nargs="+", default=["none", "thesis"])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--epochs", type=int, help="another number than the experiment's")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    options = parser.parse_args()
    words = [f"epochs={options.epochs}"] if options.epochs else []
    rows: dict[str, list[dict[str, float]]] = {name: [] for name in options.policies}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(options.seeds):
            for name in options.policies:
                results = run(Path(folder) / f"{name}-{seed}", options.data, name, seed, words)
                rows[name].append(figures(results))
                print(f"seed {seed}, augment={name}: {rows[name][-1]}", flush=True)
    summary = {name: summarize(found) for name, found in rows.items()}
    print(f"\n{'augment':<10}" + "".join(f"{lighting:>24}" for lighting in LIGHTINGS) + "   mean error, m")
    for name, row in summary.items():
        print(f"{name:<10}" + "".join(f"{row[lighting]:>24}" for lighting in LIGHTINGS))
    report = {"date": date.today().isoformat(), "versions": versions(), "seeds": options.seeds, "words": words}
    write_json(options.out / "augmentation_training.json", {**report, "rows": rows, "summary": summary})


def run(folder: Path, data: str, policy: str, seed: int, words: list[str]) -> dict[str, Any]:
    """Train, map and evaluate; return results.json."""
    train = ["train", "experiment=freiburg_sim", "protocol=freiburg_sim_cloudy", f"data.root={data}"]
    for command in (
        [*train, f"augment={policy}", f"run={folder}", f"seed={seed}", *words],
        ["map", f"run={folder}"],
        ["evaluate", f"run={folder}", "task=absolute", "task.plots=false", "task.baselines=[]"],
    ):
        if siamloc.cli.main(command) != 0:
            raise SystemExit(f"siamloc {' '.join(command)} failed")
    return json.loads((folder / "evaluation" / "network" / "results.json").read_text())


def figures(results: dict[str, Any]) -> dict[str, float]:
    """Return the mean error in m under each lighting."""
    return {name: group["error"]["mean"] for name, group in results["measures"]["absolute"]["lighting"].items()}


def summarize(rows: list[dict[str, float]]) -> dict[str, str]:
    """Return mean over the seeds with the smallest and largest."""
    found = {}
    for lighting in LIGHTINGS:
        values = [row[lighting] for row in rows]
        found[lighting] = f"{statistics.mean(values):.2f} ({min(values):.2f} to {max(values):.2f})"
    return found


if __name__ == "__main__":
    main()
