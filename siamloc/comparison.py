"""`Comparison`: trainings or evaluations as rows of a table, best first, with a plot and a verdict."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foundation.calls import typed
from foundation.files import expanded, real_path, write_text
from foundation.settings import leaves, within
from siamloc.errors import ConfigError
from siamloc.runs import Run
from siamloc.tables import Column, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NAMED = 400
"""Most characters of the names of runs in a note."""


@dataclass(frozen=True, repr=False)
class Comparison:
    """Trainings or evaluations as the rows of a table, best first.

    Attributes:
        by: the measure by which the rows are ordered, such as "val/error" or "error".
        differing: the settings in which the rows differ, such as "model.branch" and "seed".
        measured: the other columns, including `by`; the last one is the folder.
        rows: for each training or evaluation, the differing settings and the measures. Rows without the measure `by`
            have NaN and come last.
        highest: whether a higher value is better.
        unit: unit of the measure `by`; "" if it has none, or not always the same.
        notes: sentences on why the rows may not be comparable, and on runs that are unfinished, ended early, or not
            measured.
    """

    by: str
    differing: tuple[str, ...]
    measured: tuple[str, ...]
    rows: tuple[Mapping[str, Any], ...]
    highest: bool = False
    unit: str = ""
    notes: tuple[str, ...] = ()

    def in_order(self) -> Comparison:
        """Return the comparison with the best row first; ties keep their order."""
        sign = -1 if self.highest else 1
        ranked = sorted(self.rows, key=lambda row: (math.isnan(row[self.by]), sign * row[self.by]))
        return replace(self, rows=tuple(ranked))

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the columns: settings first."""
        return (*self.differing, *self.measured)

    @property
    def best(self) -> Mapping[str, Any]:
        """The best row."""
        return self.rows[0]

    def verdict(self) -> str:
        """Return a sentence that names the best row, and counts those that are as good; then the notes, one a line."""
        folder = self.best[self.measured[-1]]
        if math.isnan(self.best[self.by]):
            return f"best: none, {self.by} is not known of any"
        cells = dict(zip(self.columns, self.summary().cells[0], strict=True))
        said = [f"{name}={cells[name]}" for name in self.differing]
        equal = sum(row[self.by] == self.best[self.by] for row in self.rows) - 1
        more = f", and {equal} more with the same {self.by}" if equal else ""
        best = f"best: {', '.join([*said, f'{self.by} {cells[self.by]}'])}, in {folder}{more}"
        return "\n".join([best, *self.notes])

    def summary(self) -> Table:
        """Return the rows as a table, labelled by the settings."""
        columns = [Column(name) for name in self.differing]
        columns += [Column(name, form="short") for name in self.measured[:-1]]
        rows = (tuple(row[name] for name in self.columns) for row in self.rows)
        return Table("comparison", (*columns, Column(self.measured[-1])), tuple(rows))

    def table(self) -> str:
        """Return the rows as a text table."""
        return self.summary().text()

    @typed
    def save(self, path: str | Path) -> Path:
        """Write the rows as CSV and return the path; numbers keep full precision, unknown numbers are empty.

        Raises:
            ConfigError: a file whose name does not end in .csv.
            StorageError: the disk refuses.
        """
        if Path(path).suffix.lower() != ".csv":
            raise ConfigError(f"the comparison is a CSV file: give it a name ending in .csv, not {path}")
        write_text(Path(path), self.summary().csv())
        return Path(path)

    @typed
    def plot(self, against: str | None = None) -> Figure:
        """Plot the measure `by` against a setting, with a line for each combination of the other settings.

        Args:
            against: a setting in `differing`. If None, the first numeric one other than the seed, or else the first.

        Raises:
            ConfigError: a setting that is not in `differing`.
            DataError: nothing differs, or nothing was measured.
        """
        from siamloc.report.draw.curves import swept_curves

        return swept_curves(self.rows, self.differing, self.by, against, highest=self.highest, unit=self.unit)

    @typed
    def save_picture(self, path: str | Path, against: str | None = None) -> Path:
        """Write the plot as PNG and return its path.

        Args:
            path: the file to write.
            against: the setting on the x axis, as for `plot`.

        Raises:
            ConfigError, DataError: as `plot`.
            StorageError: the disk refuses.
        """
        from siamloc.report.draw.look import save

        return save(self.plot(against), path)

    def __repr__(self) -> str:
        return self.table()


def flat(settings: Mapping[str, Any], without: Sequence[str] = (), prefix: str = "") -> dict[str, Any]:
    """Return settings by dotted keys, as on the command line.

    Args:
        settings: plain values, nested.
        without: keys to leave out.
        prefix: text in front of all keys.

    Example:
        >>> flat({"training": {"seed": 1}, "model": {"branch": "vgg16"}}, ["model.branch"])
        {'seed': 1}
    """
    named = {name.removeprefix("training."): value for name, value in leaves(settings, prefix)}
    return {name: value for name, value in named.items() if not within(name, without)}


def differing(settings: Sequence[Mapping[str, Any]], keys: Iterable[str] | None = None) -> list[str]:
    """Return the keys whose values differ between settings; of all keys if none are given.

    Example:
        >>> differing([{"seed": 0, "epochs": 5}, {"seed": 1, "epochs": 5}])
        ['seed']
    """
    keys = list(dict.fromkeys(key for values in settings for key in values)) if keys is None else list(keys)
    return [key for key in keys if len({repr(values.get(key)) for values in settings}) > 1]


def without_own(keys: Iterable[str], settings: Sequence[Mapping[str, Any]], kept: Container[str] = ()) -> list[str]:
    """Return keys without parameters that each choice of a group has for itself, such as the margin of a loss.

    They are those with one value for each name of their group that not all settings have, and the class if all names
    are known. Parameters of descriptors, of ways to build nodes and of tasks go if all settings have them, too: the
    same word means something else in each.

    Args:
        keys: keys whose values differ.
        settings: values by key.
        kept: keys to return in any case.

    Example:
        >>> losses = [{"loss.name": "triplet", "loss.margin": 0.2}, {"loss.name": "circle", "loss.m": 0.4}]
        >>> without_own(["loss.name", "loss.margin", "loss.m"], losses)
        ['loss.name']
    """
    keys = list(keys)
    for name in [key for key in keys if key in ("descriptor", "build", "task") or key.endswith(".name")]:
        group = name.removesuffix(".name")
        names = [repr(values.get(name)) for values in settings]
        for key in [key for key in keys if within(key, [group]) and key != name and key not in kept]:
            pairs = {(named, repr(values.get(key))) for named, values in zip(names, settings, strict=True)}
            known = key == f"{group}.class" and "None" not in names
            own = name == group or known or any(key not in values for values in settings)
            if own and len(pairs) == len(set(names)):
                keys.remove(key)
    return keys


def files_named(folders: str | Path | Iterable[str | Path | Run], name: str) -> list[Path]:
    """Return the files with a given name in and below folders or runs, each once.

    Raises:
        ConfigError: no folders, or one that is missing.
    """
    several = [folders] if isinstance(folders, str | Path) else list(folders)
    if not several:
        raise ConfigError("nothing to compare: name the folder of a sweep, or several folders")
    found: dict[Path, Path] = {}
    for folder in (one.folder if isinstance(one, Run) else expanded(one) for one in several):
        if not folder.is_dir():
            raise ConfigError(f"there is no folder {folder}: name that of a sweep, such as runs/sweep")
        for path in sorted(folder.rglob(name)):
            found.setdefault(real_path(path), path)
    return list(found.values())
