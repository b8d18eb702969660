"""Localization on the simulated building: absolute and hierarchical, single frames and sequences, three lightings.

HOG, gist and a trained network, each by the same protocol (`freiburg_sim`, map and queries from different drives). The
network is that of `experiment=freiburg_sim` with `pairs.scale=4`, a second one for rooms has `pairs=room`; they are
trained into the folder of `--runs` unless they are there. The filter's settings are chosen on the validation drives.
Every row is what one `siamloc evaluate` gives; the commands are written with the figures.

Targets: hierarchical search over nodes loses at most 10 % in mean error while it compares at most 25 % of the
descriptors; the sequence filter reduces the 95 % error at night and in the sun.

    siamloc simulate camera=panorama out=data
    python -m benchmarks.localization --data data/freiburg_like --runs runs/localization
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import siamloc.cli
from benchmarks.report import Report, parser

LIGHTINGS = ("cloudy", "night", "sunny")
METHODS = {"HOG": "hog_mapping", "gist": "gist_mapping", "network": "network"}
# What is searched first, by its name in the table: the words that build and rank it, and the descriptor it is built of.
LAYERS = {
    "40 clusters of HOG": (["build=spectral", "build.nodes=40", "task.candidates=3"], "hog_mapping"),
    "nodes of HOG": (["build=incremental_sparse", "task.candidates=3"], "hog_mapping"),
    "nodes of HOG, published thresholds": (["build=incremental", "task.candidates=3"], "hog_mapping"),
    "the room network's room": (["build=rooms", "task.candidates=1"], "rooms"),
    "the room network's vote": (["build=rooms", "task.candidates=1", "task.coarse.by=vote"], "rooms"),
}
MOST_LOSS, MOST_COMPARED = 0.10, 0.25
TRAINED = {"network": ["pairs.scale=4"], "rooms": ["pairs=room"]}


def main() -> None:
    """Train what is not there, evaluate, print tables and write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="folder of the rendered building, freiburg_like")
    arguments.add_argument("--runs", type=Path, required=True, help="folder of the runs")
    options = arguments.parse_args()
    report = Report("localization", options.out)
    bench = Bench(options.data, options.runs)
    for name, words in TRAINED.items():
        bench.train(name, words)
    sparse = [bench.absolute(method, 5) for method in METHODS]
    dense = [bench.absolute(method, 1) for method in METHODS]
    hierarchical = [bench.hierarchical(method, layer) for layer in LAYERS for method in METHODS if fits(method, layer)]
    judge(report, sparse, hierarchical)
    print(table(sparse), table(dense), layers(hierarchical), filtered([*sparse, *dense]), sep="\n\n")
    report.write({"trained": TRAINED, "absolute": [*sparse, *dense], "hierarchical": hierarchical})


def fits(method: str, layer: str) -> bool:
    """Return whether both layers read panoramas of one size; those of the networks are half as large as the others."""
    return method == "network" or LAYERS[layer][1] not in TRAINED


class Bench:
    """Runs commands and reads what they wrote.

    Args:
        data: folder of the rendered building.
        runs: folder of the runs.
    """

    def __init__(self, data: Path, runs: Path) -> None:
        self.data, self.runs = data, runs

    def train(self, name: str, words: list[str]) -> None:
        """Train a network, unless its run is finished."""
        if not (self.runs / name / "run.json").is_file():
            self._siamloc(
                "train", "experiment=freiburg_sim", *words, f"data.root={self.data}", f"run={self.runs / name}"
            )

    def absolute(self, method: str, every: int) -> dict[str, Any]:
        """Return the figures of a search in the whole map, of single frames and filtered."""
        words = [
            *self._of(method, every),
            "task=absolute",
            "task.filter=true",
            "task.filter_tune=true",
            "task.baselines=[]",
            "task.plots=false",
        ]
        command, results = self._evaluate(method, METHODS[method], words)
        measures = results["measures"]
        return {
            "method": method,
            "every": every,
            "command": command,
            "map_frames": measures["absolute"]["map_frames"],
            "single": figures(measures["absolute"]),
            "filtered": figures(measures["absolute_filtered"]),
        }

    def hierarchical(self, method: str, layer: str) -> dict[str, Any]:
        """Return the figures of a search in the best nodes only."""
        ranked, coarse = LAYERS[layer]
        described = str(self.runs / coarse) if coarse in TRAINED else coarse
        words = [*self._of(method, 1), "task=hierarchical", *ranked, f"task.coarse.descriptor={described}"]
        vote = ["vote"] if "task.coarse.by=vote" in ranked else []
        parts = [METHODS[method], f"network-{coarse}" if coarse in TRAINED else coarse]
        parts = list(dict.fromkeys([*parts, ranked[0].removeprefix("build="), *vote]))
        command, results = self._evaluate(method, f"hierarchical-{'-'.join(parts)}", [*words, "task.plots=false"])
        measures = results["measures"]["hierarchical"]
        overall = measures["overall"]
        return {
            "method": method,
            "layer": layer,
            "command": command,
            "single": figures(measures),
            "coarse_accuracy": overall["coarse"]["accuracy"],
            "given_right": overall["given_right"]["error"]["mean"],
            "given_wrong": overall["given_wrong"]["error"]["mean"],
            "perfect_coarse": overall["perfect_coarse"]["error"]["mean"],
            "absolute": overall["absolute"]["error"]["mean"],
            "loss": overall["loss"],
            "compared": overall["comparisons"]["share"],
            "nodes": results["denominators"]["nodes"],
        }

    def _of(self, method: str, every: int) -> list[str]:
        run = "network" if method == "network" else METHODS[method]
        words = [f"run={self.runs / run}", f"protocol.map.every={every}"]
        if method == "network":
            return words
        return [*words, f"descriptor={METHODS[method]}", "data=freiburg_sim", f"data.root={self.data}"]

    def _evaluate(self, method: str, folder: str, words: list[str]) -> tuple[str, dict[str, Any]]:
        command = self._siamloc("evaluate", *words)
        run = self.runs / ("network" if method == "network" else METHODS[method])
        path = run / "evaluation" / folder / "results.json"
        return command, json.loads(path.read_text(encoding="utf-8"))

    @staticmethod
    def _siamloc(*words: str) -> str:
        if siamloc.cli.main(list(words)) != 0:
            raise SystemExit(f"siamloc {' '.join(words)} failed")
        return f"siamloc {' '.join(words)}"


def figures(measures: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Return error, floor and excess in m under each lighting and overall."""
    groups = {**{name: measures["lighting"][name] for name in LIGHTINGS}, "overall": measures["overall"]}
    return {
        name: {
            "mean": group["error"]["mean"],
            "p95": group["error"]["p95"],
            "floor": group["floor"]["mean"],
            "excess": group["excess"]["mean"],
            "queries": group["queries"],
        }
        for name, group in groups.items()
    }


def judge(report: Report, sparse: list[dict[str, Any]], hierarchical: list[dict[str, Any]]) -> None:
    """Compare the figures with the targets."""
    for row in hierarchical:
        met = row["loss"] <= MOST_LOSS and row["compared"] <= MOST_COMPARED
        if "room" not in row["layer"]:
            report.target(
                f"{row['method']} in {row['layer']}: loses at most {MOST_LOSS:.0%} ({row['loss']:.1%}), comparing at "
                f"most {MOST_COMPARED:.0%} ({row['compared']:.1%})",
                met,
            )
    for row in sparse:
        for lighting in ("night", "sunny"):
            before, after = (row[kind][lighting]["p95"] for kind in ("single", "filtered"))
            report.target(
                f"{row['method']}, {lighting}: the filter reduces the 95 % error ({before:.2f} to {after:.2f} m)",
                after < before,
            )


def table(rows: list[dict[str, Any]]) -> str:
    """Return mean error and excess by lighting, with the floor in the first row."""
    first = rows[0]["single"]
    lines = [
        f"| map of {rows[0]['map_frames']} frames | cloudy | night | sunny |",
        "|---|---|---|---|",
        "| floor | " + " | ".join(f"{first[name]['floor']:.2f}" for name in LIGHTINGS) + " |",
    ]
    for row in rows:
        cells = [f"{row['single'][name]['mean']:.2f} ({row['single'][name]['excess']:.2f})" for name in LIGHTINGS]
        lines.append(f"| {row['method']} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def layers(rows: list[dict[str, Any]]) -> str:
    """Return the table of hierarchical search."""
    lines = [
        "| searched first | then | cloudy | night | sunny | loss | compared | right | given right | given wrong |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = [f"{row['single'][name]['mean']:.2f} ({row['single'][name]['excess']:.2f})" for name in LIGHTINGS]
        wrong = row["given_wrong"]
        lines.append(
            f"| {row['layer']} | {row['method']} | {' | '.join(cells)} | {100 * row['loss']:+.1f} % "
            f"| {100 * row['compared']:.1f} % | {100 * row['coarse_accuracy']:.1f} % | {row['given_right']:.2f} "
            f"| {'-' if wrong is None or math.isnan(wrong) else f'{wrong:.2f}'} |"
        )
    return "\n".join(lines)


def filtered(rows: list[dict[str, Any]]) -> str:
    """Return the table of 95 % errors of single frames and of the filter."""
    lines = ["| map frames | method | cloudy | night | sunny |", "|---|---|---|---|---|"]
    for row in rows:
        cells = [f"{row['single'][name]['p95']:.2f} to {row['filtered'][name]['p95']:.2f}" for name in LIGHTINGS]
        lines.append(f"| {row['map_frames']} | {row['method']} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
