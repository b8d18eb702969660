"""Measure how much a reproduced number varies between seeds, for the kinds of experiments that depend on one.

Some jobs of the scale `short` are repeated: every repetition has another seed for weights, pairs, noise and clusters,
and takes other frames of the query drives. The standard deviations are averaged over the numbers of a measure, relative
to each number if the measure has a unit such as metres. `siamloc/reproduce/claims.yaml` states them. For the errors of
trained networks see `augmentation_training`. The grid and the dense drives of the building are rendered as
docs/results/published.md says.

    python -m benchmarks.spreads --data data/freiburg_like --work runs/spreads
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any

from benchmarks.report import Report, parser
from siamloc.reproduce.experiments import Data, measured
from siamloc.reproduce.published import Record, measures, over_seeds
from siamloc.reproduce.running import open_data
from siamloc.reproduce.study_book import Job, experiment

REPEATED = {
    "hits_fs": 5,
    "hits_hog": 5,
    "disturbed_hog": 5,
    "spectral_hog": 5,
    "compact_hog": 5,
    "shares_vgg16": 3,
}
"""How often the last job of each experiment in the building itself is measured."""
SPREAD = ("hit_rate", "error", "heading_error", "accuracy", "silhouette", "inertia")
"""Measures for which claims compare numbers, without times."""


def main() -> None:
    """Measure, print and write the spreads."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="folder of the rendered building, freiburg_like")
    arguments.add_argument("--work", type=Path, required=True, help="folder for trainings in progress")
    arguments.add_argument("--only", nargs="*", default=list(REPEATED), choices=REPEATED, help="some experiments")
    options = arguments.parse_args()
    for name in options.only:
        job = [one for one in experiment(name).jobs("short") if one.at in ("", "grid")][-1]
        data = open_data(job, "freiburg_sim", options.data, options.work, {})
        spreads = spreads_of([one for seed in range(REPEATED[name]) for one in repeated(job, data, seed)])
        row = {"kind": job.kind, "seeds": REPEATED[name], "spread": spreads}
        print(name, row, flush=True)
        report = Report("spreads", options.out)
        report.write({"rows": report.kept({name: row}, list(REPEATED))})


def repeated(job: Job, data: Data, seed: int) -> Iterator[Record]:
    """Measure a job with a seed and with the query frames of that offset."""
    roles = {role: _moved(options, seed) if role == "query" else options for role, options in job.roles.items()}
    for one in measured(replace(job, roles=roles, options={**job.options, "seed": seed}), data):
        if one.measure in SPREAD:
            yield replace(one, settings={**one.settings, "seed": seed})


def _moved(role: Mapping[str, Any], seed: int) -> dict[str, Any]:
    return {**role, "offset": seed} if role.get("every", 1) > seed else dict(role)


def spreads_of(records: list[Record]) -> dict[str, float]:
    """Average the standard deviations over seeds of each measure."""
    each: dict[str, list[float]] = defaultdict(list)
    for one in over_seeds(records):
        relative = measures()[one.measure]["unit"] not in ("1", "share")
        each[one.measure].append(one.spread / abs(one.value) if relative else one.spread)
    return {measure: round(fmean(found), 4) for measure, found in each.items()}


if __name__ == "__main__":
    main()
