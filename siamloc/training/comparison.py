"""Runs side by side: what they were trained with, where that differs, and how well each did."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from siamloc.errors import ConfigError, hint
from siamloc.files import write_text
from siamloc.runs import Run, higher_is_better

_CHOSEN_BY = ("val/error", "val/room", "val/loss")
_MEASURED = ("epoch", "finished", "run")
# What only says where things lie, or follows from the rest.
_LEFT_OUT = ("frames", "data.cache", "data.name", "model.image_size")


@dataclass(frozen=True, repr=False)
class Comparison:
    """A row for each run, the best first.

    Attributes:
        by: the figure that the rows are ordered by, such as "val/error".
        differing: the settings in which the runs differ, such as "model.branch" and "seed".
        rows: for each run the settings that differ, under `by` its best figure, `epoch` (from 1) in which it was
            reached, `finished`, the number of epochs, and `run`, the folder. A run without the figure has NaN, and
            comes last.
    """

    by: str
    differing: tuple[str, ...]
    rows: tuple[Mapping[str, Any], ...]

    def table(self) -> str:
        """Return the rows as text, columns aligned."""
        names = [*self.differing, self.by, *_MEASURED]
        cells = [names, *([_shown(row[name]) for name in names] for row in self.rows)]
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        lines = ("  ".join(map(str.ljust, line, widths)).rstrip() for line in cells)
        return "\n".join(lines)

    def save(self, path: str | Path) -> Path:
        """Write the rows as CSV, numbers with every digit, unknown ones empty; return the path."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        names = [*self.differing, self.by, *_MEASURED]
        writer.writerow(names)
        for row in self.rows:
            writer.writerow(["" if row[name] is None or row[name] != row[name] else row[name] for name in names])
        write_text(Path(path), text.getvalue())
        return Path(path)

    def __repr__(self) -> str:
        return self.table()


def compare(runs: str | Path | Iterable[str | Path | Run], by: str | None = None) -> Comparison:
    """Compare runs by their best epoch: those of a sweep, or any others.

    Args:
        runs: a folder with runs in it, such as that of a sweep; or the folders of runs.
        by: the figure of the curves that counts, such as "val/error"; what checkpoints are chosen by if None. Of
            accuracies, rooms, spreads and distances of two rooms the highest is the best, of all others the lowest.

    Raises:
        ConfigError: no runs, none that has finished an epoch, or no such figure.
        FormatError: a run of another version, or an altered one.

    Example:
        >>> print(siamloc.training.compare("runs/sweep"))  # doctest: +SKIP
        model.branch  seed  val/error  epoch  finished  run
        panoresnet    0     0.2411     6      6         runs/sweep/model-branch-panoresnet_seed-0
        alexnet       0     0.2633     5      6         runs/sweep/model-branch-alexnet_seed-0
    """
    found = _opened(runs)
    curves = {run.folder: run.curves() for run in found if run.metrics.is_file()}
    if not curves:
        raise ConfigError(f"none of the {len(found)} runs has finished an epoch: there is nothing to compare yet")
    figures = set.intersection(*map(set, curves.values()))
    if by is None:
        chosen = {f"val/{run.settings.get('training', {}).get('monitor')}" for run in found}
        first = sorted(chosen) if len(chosen) == 1 else []
        by = next((name for name in (*first, *_CHOSEN_BY) if name in figures), None)
    known = sorted({name for figure in curves.values() for name in figure if "/" in name})
    if by is None or by not in known:
        asked = (
            "the runs have no figure in common by which checkpoints are chosen"
            if by is None
            else f"no run has the figure {by!r}"
        )
        raise ConfigError(f"{asked}: {hint(by or '', known)}")
    settings = [_flat(run.settings) for run in found]
    keys = {key: None for values in settings for key in values}
    differing = [key for key in keys if len({repr(values.get(key)) for values in settings}) > 1]
    if all(values.get("model.seed") == values.get("seed") for values in settings):  # as commands have it
        differing = [key for key in differing if key != "model.seed"]
    rows = [
        {**{key: values.get(key) for key in differing}, **_measured(run, curves.get(run.folder, {}), by)}
        for run, values in zip(found, settings, strict=True)
    ]
    sign = -1 if higher_is_better(by) else 1
    rows.sort(key=lambda row: (math.isnan(row[by]), 0.0 if math.isnan(row[by]) else sign * row[by]))
    return Comparison(by, tuple(differing), tuple(rows))


def _opened(runs: str | Path | Iterable[str | Path | Run]) -> list[Run]:
    if isinstance(runs, (str, Path)):
        if not Path(runs).is_dir():
            raise ConfigError(f"there is no folder {runs}: name that of a sweep, such as runs/sweep")
        records = sorted(Path(runs).glob("**/run.json"))
        if not records:
            raise ConfigError(f"there are no runs in {runs}: name the folder of a sweep, such as runs/sweep")
        return [Run(record.parent) for record in records]
    found = [run if isinstance(run, Run) else Run(Path(run)) for run in runs]
    if not found:
        raise ConfigError("no runs to compare: name the folder of a sweep, or several runs")
    return found


def _measured(run: Run, curves: Mapping[str, Any], by: str) -> dict[str, Any]:
    values = curves.get(by, [])
    usable = [(value, row) for row, value in enumerate(values) if math.isfinite(value)]
    best, row = (max if higher_is_better(by) else min)(usable, key=lambda pair: pair[0], default=(math.nan, None))
    return {
        by: float(best),
        "epoch": None if row is None else int(curves["epoch"][row]) + 1,
        "finished": len(curves.get("epoch", [])),
        "run": run.folder.as_posix(),
    }


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return settings by dotted keys, as the command line calls them, without what says nothing of the training."""
    found: dict[str, Any] = {}
    for name, value in settings.items():
        key = f"{prefix}{name}".removeprefix("training.")
        if key in _LEFT_OUT:
            continue
        found |= _flat(value, f"{key}.") if isinstance(value, Mapping) and value else {key: value}
    return found


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else f"{value:.4g}"
    return "" if value is None else str(value)
