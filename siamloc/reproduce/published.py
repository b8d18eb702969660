"""Published numbers by table, as printed rows and as records to compare with measured ones."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from statistics import fmean, stdev
from typing import Any

import yaml

from foundation.errors import known
from foundation.settings import Settings, Text

_NUMBER = re.compile(r"([~<>]?)(-?\d+(?:\.\d+)?)")
_ORDER: Mapping[str, Sequence[Any]] = {
    "distance": ("manhattan", "euclidean", "correlation", "cosine"),
    "method": ("spectral", "som", "sampling", "incremental"),
}


@dataclass(frozen=True)
class Source(Settings):
    """Where a number or claim was published, by section instead of page.

    Attributes:
        document: "T", "I" or "C", the documents listed in `published.yaml`; "none" for other sources.
        section: number of the section.
        table: number of the table, if any.
        figures: numbers of the figures, if any.
    """

    document: Text
    section: Text
    table: Text | None = None
    figures: Text | None = None

    @property
    def place(self) -> str:
        """The table or figures in words; "" for a section."""
        if self.table:
            return f"table {self.table}"
        several = self.figures is not None and bool(re.search("-| and ", self.figures))
        return f"figure{'s' if several else ''} {self.figures}" if self.figures else ""


@dataclass(frozen=True)
class Column(Settings):
    """A column of a published table: a setting of its rows, or a measure.

    Attributes:
        name: name of the column.
        unit: unit as printed: one of `units` in `published.yaml`.
        measure: name of the measure of the numbers; None for a setting.
        decimals: number of decimals that were printed.
        at: settings shared by all numbers of the column, such as the lighting.
        key: the setting's key in siamloc's configuration, if any.
        names: siamloc's names of the setting's values, by printed label.
    """

    name: Text
    unit: Text
    measure: Text | None = None
    decimals: int | None = None
    at: dict[str, Any] = field(default_factory=dict)
    key: Text | None = None
    names: dict[Any, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Record:
    """A published or measured number, with everything it depends on.

    Attributes:
        measure: name of the measure, a key of `measures()`, such as "error".
        value: number in the measure's own unit: m, s, deg, shares instead of percent.
        settings: settings that the number depends on, in siamloc's names.
        relation: "=", or "~", "<", ">" if the number is only approximate, or an upper or lower bound.
        spread: standard deviation over seeds of the value or of its difference to others, in its unit; 0 if unknown.
    """

    measure: str
    value: float
    settings: Mapping[str, Any]
    relation: str = "="
    spread: float = 0.0


@dataclass(frozen=True)
class Published(Settings):
    """A published table, or the numbers given in the text of a section.

    Attributes:
        id: id such as "table_5_7".
        title: what the table shows.
        source: where it was published.
        data: the images that were used.
        protocol: `train`, `map` and `query` in a few words.
        columns: columns of the table.
        rows: cells by column, with the labels as printed (in English); a cell that was not printed is missing or None.
        notes: doubtful points: misprints, and contradictions between text and table.
        settings: settings that all rows have in common, in siamloc's names.
    """

    id: Text
    title: Text
    source: Source
    data: Text
    protocol: dict[str, str]
    columns: tuple[Column, ...]
    rows: tuple[dict[str, Any], ...]
    notes: tuple[Text, ...]
    settings: dict[str, Any] = field(default_factory=dict)

    def records(self) -> tuple[Record, ...]:
        """Return each number as a record in siamloc's names and units, to compare with measured records."""
        return tuple(record for row in self.rows for record in self._of_row(row))

    def _of_row(self, row: Mapping[str, Any]) -> Iterator[Record]:
        cells = [(column, row[column.name]) for column in self.columns if row.get(column.name) is not None]
        factors = {name: unit.get("factor") for name, unit in contents("published")["units"].items()}
        own = {column.name: _setting(cell, column, factors) for column, cell in cells if column.measure is None}
        for column, cell in cells:
            if column.measure is not None:
                match = _NUMBER.fullmatch(as_printed(cell, column))
                assert match is not None, f"{cell!r} is not a number"
                value = round(float(match[2]) * (factors[column.unit] or 1), 9)
                yield Record(column.measure, value, {**self.settings, **own, **column.at}, match[1] or "=")


@cache
def published(id: str) -> Published:
    """Return the published numbers with an id, such as "table_5_7" or "section_3_5_1".

    Raises:
        ConfigError: an unknown id.

    Example:
        >>> published("table_5_17").records()[0].settings["same_share"]
        0.8
    """
    entries = {one["id"]: one for one in contents("published")["published"]}
    entry, settings = entries[known(id, entries, "published table")], contents("published")["settings"]
    listed = [column["name"] for column in entry["columns"]]
    rows = [row if isinstance(row, dict) else dict(zip(listed, row, strict=True)) for row in entry["rows"]]
    further = dict.fromkeys(name for row in rows for name in row if name not in listed)  # settings of only a few rows
    columns = [*entry["columns"], *({"name": name} for name in further)]
    columns = [{**settings.get(column["name"], {}), **column} for column in columns]
    return Published.of({**entry, "columns": columns, "rows": rows})


def measures() -> Mapping[str, Mapping[str, str]]:
    """Return the measures by name, each with its `unit` and description (`says`)."""
    found: Mapping[str, Mapping[str, str]] = contents("published")["measures"]
    return found


def as_printed(cell: float | str, column: Column) -> str:
    """Return a number as text with the decimals that the column has in print; a text stays as it is."""
    return cell if isinstance(cell, str) else f"{cell:.{column.decimals}f}"


def grouped(names: Sequence[str], records: Sequence[Record]) -> dict[tuple[Any, ...], list[Record]]:
    """Return records grouped by their values of the settings `names`, in the order of a figure's lines and axes.

    A group's key holds a value for each setting, None if its records lack the setting.
    """
    groups: dict[tuple[Any, ...], list[Record]] = {}
    for one in records:
        groups.setdefault(tuple(one.settings.get(name) for name in names), []).append(one)
    seen = {name: list(dict.fromkeys(one.settings.get(name) for one in records)) for name in names}

    def rank(key: tuple[Any, ...]) -> list[float]:
        return [_rank(value, _ORDER.get(name, ()), seen[name]) for name, value in zip(names, key, strict=True)]

    return {key: groups[key] for key in sorted(groups, key=rank)}


def over_seeds(records: Sequence[Record]) -> list[Record]:
    """Replace records that differ in their `seed` alone by their mean, with the standard deviation as its spread."""
    groups: dict[str, list[Record]] = {}
    for number, one in enumerate(records):
        others = {name: value for name, value in one.settings.items() if name != "seed"}
        key = repr((one.measure, others)) if "seed" in one.settings else str(number)
        groups.setdefault(key, []).append(replace(one, settings=others))
    return [
        replace(part[0], value=fmean(one.value for one in part), spread=stdev(one.value for one in part))
        if len(part) > 1
        else part[0]
        for part in groups.values()
    ]


@cache
def contents(name: str) -> dict[str, Any]:
    """Return the contents of a YAML file of this package: "published", "claims" or "study_book"; read once."""
    found: dict[str, Any] = yaml.safe_load(Path(__file__).with_name(f"{name}.yaml").read_text(encoding="utf-8"))
    return found


def _setting(cell: Any, column: Column, factors: Mapping[str, float | None]) -> Any:
    if isinstance(cell, list | tuple):
        return tuple(_setting(one, column, factors) for one in cell)
    factor = factors[column.unit]
    return column.names.get(cell, cell) if factor is None else round(cell * factor, 9)


def _rank(value: Any, order: Sequence[Any], seen: Sequence[Any]) -> float:
    if isinstance(value, bool | int | float):
        return float(value)
    return order.index(value) if value in order else len(order) + seen.index(value)
