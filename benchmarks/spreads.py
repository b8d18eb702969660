"""Measure how much the difference of two reproduced numbers varies between seeds, by kind of experiment.

The jobs of some experiments at the scale `short` are repeated: every repetition has another seed for weights, pairs,
noise and clusters, and takes other frames of the query drives, or, where a drive is mapped without queries, every third
frame of it, starting with another one. A claim compares numbers that were measured with the same seed and the same
frames, so that what they have in common cancels: for each two numbers of an experiment, the standard deviation over
seeds of their difference is computed, relative to their mean if the measure has a unit such as metres, and averaged.
`siamloc/reproduce/claims.yaml` states these spreads; for the errors of trained networks it uses
`augmentation_training`. The grid and the dense drives of the building are rendered as docs/results/published.md says.

    python -m benchmarks.spreads --data data/freiburg_like --work runs/spreads
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.report import Report, parser
from foundation.files import content_key
from siamloc.reproduce.experiments import Data, measured
from siamloc.reproduce.published import Record, measures
from siamloc.reproduce.running import open_data
from siamloc.reproduce.study_book import Job, experiment

REPEATED = {
    "hits_fs": 5,
    "hits_hog": 5,
    "disturbed_hog": 5,
    "incremental_hog": 3,
    "spectral_hog": 3,
    "compact_hog": 5,
    "chosen_hog": 5,
    "shares_vgg16": 3,
}
"""How often the jobs of each experiment in the building itself are measured."""
EXACT = ("frames", "descriptor_size", "floor", "information")
"""Measures that depend on no seed."""


def main() -> None:
    """Measure, print and write the spreads."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="folder of the rendered building, freiburg_like")
    arguments.add_argument("--work", type=Path, required=True, help="folder for trainings in progress")
    arguments.add_argument("--only", nargs="*", default=list(REPEATED), choices=REPEATED, help="some experiments")
    options = arguments.parse_args()
    for name in options.only:
        jobs, seeds = [one for one in experiment(name).jobs("short") if one.at in ("", "grid")], REPEATED[name]
        data = open_data(jobs[0], "freiburg_sim", options.data, options.work, {})
        found = [one for seed in range(seeds) for job in jobs for one in repeated(job, data, seed)]
        row = {"kind": jobs[0].kind, "seeds": seeds, "spread": spreads_of(found)}
        print(name, row, flush=True)
        report = Report("spreads", options.out)
        report.write({"rows": report.kept({name: row}, list(REPEATED))})


def repeated(job: Job, data: Data, seed: int) -> Iterator[Record]:
    """Measure a job with a seed and with frames that differ by the seed."""
    moved, every = ("query", {}) if "query" in job.roles else ("map", {"every": 3})
    role = {**job.roles[moved], **every}
    roles = {**job.roles, moved: {**role, "offset": seed} if role.get("every", 1) > seed else role}
    for one in measured(replace(job, roles=roles, options={**job.options, "seed": seed}), data):
        if one.measure in measures() and one.measure not in EXACT:
            yield replace(one, settings={**one.settings, "seed": seed})


def spreads_of(records: list[Record]) -> dict[str, float]:
    """Average the standard deviations over seeds of the differences between any two numbers of a measure."""
    each: dict[str, dict[str, dict[int, float]]] = defaultdict(lambda: defaultdict(dict))
    for one in records:
        settings = {name: value for name, value in one.settings.items() if name != "seed"}
        each[one.measure][content_key(settings)][one.settings["seed"]] = one.value
    spreads = {}
    for measure, numbers in each.items():
        values = np.array([[value for _, value in sorted(found.items())] for found in numbers.values()])
        first, second = np.triu_indices(len(values), 1)
        spread = (values[first] - values[second]).std(axis=1, ddof=1)
        if measures()[measure]["unit"] not in ("1", "share"):
            spread /= (abs(values[first]) + abs(values[second])).mean(axis=1) / 2
        spreads[measure] = round(float(spread.mean()), 4)
    return spreads


if __name__ == "__main__":
    main()
