"""Compare runs: their settings where they differ, and the results of each."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from foundation.calls import typed
from foundation.files import real_path
from foundation.settings import shortened
from siamloc.comparison import NAMED, Comparison, differing, files_named, flat, without_own
from siamloc.errors import ConfigError, hint
from siamloc.runs import Run, higher_is_better

_CHOSEN_BY = ("val/error", "val/room", "val/loss")
_MEASURED = ("epoch", "finished", "run")
# Only locations, or what follows from the rest.
_LEFT_OUT = ("frames", "data.cache", "data.name", "model.image_size")
_NAME = "name the folder of a sweep, such as runs/sweep"


@typed
def compare(runs: str | Path | Iterable[str | Path | Run], by: str | None = None) -> Comparison:
    """Compare runs, of a sweep or any others, by their best epochs.

    Args:
        runs: a run, or a folder with runs in it, such as the folder of a sweep; or several of them.
        by: the figure of the curves to rank by, such as "val/error"; if None, the figure that chose the checkpoints.
            Higher is better for recall, accuracies, rooms, spreads and distances of two rooms; lower for all others.

    Raises:
        ConfigError: no runs, no run with a finished epoch, or no such figure.
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
        none = "the runs have no figure in common by which checkpoints are chosen"
        raise ConfigError(f"{none if by is None else f'no run has the figure {by!r}'}: {hint(by or '', known)}")
    settings = [flat(run.settings, _LEFT_OUT) for run in found]
    names = differing(settings)
    if all(values.get("model.seed") == values.get("seed") for values in settings):  # as with commands
        names = [key for key in names if key != "model.seed"]
    names = without_own(names, settings)
    rows = [
        {**{key: values.get(key) for key in names}, **_measured(run, curves.get(run.folder, {}), by)}
        for run, values in zip(found, settings, strict=True)
    ]
    columns, notes = (by, *_MEASURED), tuple(_short(rows, settings))
    return Comparison(by, tuple(names), columns, tuple(rows), highest=higher_is_better(by), notes=notes).in_order()


def _short(rows: Iterable[Mapping[str, Any]], settings: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """Name the runs that have fewer epochs than they were started for: unfinished, or ended early."""
    fewer = [
        f"{row['run']} ({row['finished']} of {values['epochs']} epochs)"
        for row, values in zip(rows, settings, strict=True)
        if row["finished"] < (values.get("epochs") or 0)
    ]
    if fewer:
        yield f"unfinished, or ended early: {shortened(', '.join(fewer), NAMED)}"


def _opened(runs: str | Path | Iterable[str | Path | Run]) -> list[Run]:
    found: dict[Path, Run] = {}
    for one in [runs] if isinstance(runs, str | Path) else runs:
        named = one if isinstance(one, Run) else Run(Path(one))
        alone = isinstance(one, Run) or named.record.is_file()
        inside = [named] if alone else [Run(record.parent) for record in files_named(named.folder, "run.json")]
        if not inside:
            raise ConfigError(f"there are no runs to compare in the folder {one}: {_NAME}")
        found |= {real_path(run.folder): run for run in inside}
    if not found:
        raise ConfigError(f"there are no runs to compare: {_NAME}")
    return list(found.values())


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
