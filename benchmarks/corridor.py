"""The main job on real photographs: AlexNet trained on one drive through a corridor, tested on another.

Trains with several seeds, so that the spread is seen, and measures raw thumbnails and the untrained networks with the
same evaluator. Nothing is chosen on the test drive: every setting tried stands in the table. A row is what these
commands give, for one seed:

    siamloc train experiment=corridor data.manifest=corridor/manifest.csv run=runs/corridor seed=0
    siamloc map run=runs/corridor
    siamloc evaluate run=runs/corridor

    python -m benchmarks.corridor --manifest corridor/manifest.csv --out benchmarks/results
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

SETTINGS = {"labels over the whole corridor": [], "labels over 20 frames": ["pairs.scale=20"]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--manifest", required=True)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results"))
    options = parser.parse_args()
    rows: dict[str, list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for setting, words in SETTINGS.items():
            for seed in range(options.seeds):
                results = run(Path(folder) / f"{len(rows)}-{seed}", options.manifest, seed, words)
                rows.setdefault(f"trained, {setting}", []).append(figures(results["measures"]))
                rows.setdefault("untrained", []).append(figures(results["baselines"]["untrained"]))
                rows["thumbnail 8 x 32, correlation"] = [figures(results["baselines"]["thumbnail"])]
    summary = {name: summarize(found) for name, found in rows.items()}
    for name, row in summary.items():
        print(f"{name:<45} mean error {row['mean_frames']}  recall@1 within 3 frames {row['recall_percent']}")
    report = {"date": date.today().isoformat(), "versions": versions(), "seeds": options.seeds, "rows": rows}
    write_json(options.out / "corridor.json", {**report, "summary": summary})


def run(folder: Path, manifest: str, seed: int, words: list[str]) -> dict[str, Any]:
    """Train, map and evaluate; return results.json."""
    for command in (
        ["train", "experiment=corridor", f"data.manifest={manifest}", f"run={folder}", f"seed={seed}", *words],
        ["map", f"run={folder}"],
        ["evaluate", f"run={folder}", "task.plots=false"],
    ):
        if siamloc.cli.main(command) != 0:
            raise SystemExit(f"siamloc {' '.join(command)} failed")
    return json.loads((folder / "evaluation" / "network" / "results.json").read_text(encoding="utf-8"))


def figures(measures: dict[str, Any]) -> dict[str, float]:
    overall = measures["absolute"]["overall"]
    first = next(recall for recall in overall["recall"] if recall["k"] == 1)
    return {
        "mean_frames": overall["error"]["mean"],
        "median_frames": overall["error"]["median"],
        "recall": first["recall"],
        "queries": overall["queries"],
    }


def summarize(found: list[dict[str, float]]) -> dict[str, str]:
    """Return mean and range over the seeds, as text."""

    def text(values: list[float], digits: int) -> str:
        mean = f"{statistics.mean(values):.{digits}f}"
        return mean if len(values) == 1 else f"{mean} ({min(values):.{digits}f} to {max(values):.{digits}f})"

    return {
        "mean_frames": text([row["mean_frames"] for row in found], 1),
        "median_frames": text([row["median_frames"] for row in found], 1),
        "recall_percent": text([100 * row["recall"] for row in found], 1),
    }


if __name__ == "__main__":
    main()
