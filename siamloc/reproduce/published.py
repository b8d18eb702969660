"""Published numbers, table by table, as rows as they were printed and as records to compare with measured ones."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

from siamloc.errors import ConfigError, hint

_FILE = Path(__file__).with_name("published.yaml")
_NUMBER = re.compile(r"([~<>]?)(-?\d+(?:\.\d+)?)")


@dataclass(frozen=True)
class Source:
    """Where something was published. Sections stand for pages."""

    document: str
    """"T", "I" or "C", the documents that `published.yaml` names; "none" where it is none of them."""
    section: str
    table: str | None = None
    figures: str | None = None

    @property
    def place(self) -> str:
        """The table or the figures in words, "" where it is neither."""
        if self.table:
            return f"table {self.table}"
        several = self.figures is not None and bool(re.search("-| and ", self.figures))
        return f"figure{'s' if several else ''} {self.figures}" if self.figures else ""


@dataclass(frozen=True)
class Column:
    """A column of a published table: a setting of its rows, or a measure."""

    name: str
    unit: str
    """As printed: one of `units` in `published.yaml`."""
    measure: str | None = None
    """What the numbers measure; None for a setting."""
    decimals: int | None = None
    at: Mapping[str, Any] = field(default_factory=dict)
    """Settings that belong to all numbers of the column, such as the lighting."""
    key: str | None = None
    """The setting's key in siamloc's configuration, where there is one."""
    names: Mapping[Any, Any] = field(default_factory=dict)
    """Labels with what they are called in siamloc."""


@dataclass(frozen=True)
class Record:
    """One number with all that it depends on; a measured one is written in the same way."""

    measure: str
    value: float
    """In the measure's own unit: m, s, deg, shares instead of percent."""
    settings: Mapping[str, Any]
    """In siamloc's names."""
    entry: str = ""
    printed: str = ""
    """The number as it was printed, in the column's unit; empty for a measured one."""
    relation: str = "="
    """"=", or "~", "<", ">" where only about, below or above is known."""


@dataclass(frozen=True)
class Published:
    """A published table, or the numbers that a section's text names."""

    id: str
    title: str
    source: Source
    data: str
    protocol: Mapping[str, str]
    """`train`, `map` and `query` in a few words."""
    settings: Mapping[str, Any]
    """What all rows have in common, in siamloc's names."""
    columns: tuple[Column, ...]
    rows: tuple[Mapping[str, Any], ...]
    """Cells by column, with the labels as printed (in English); a cell that was not printed is missing or None."""
    notes: tuple[str, ...]
    """Doubtful places: misprints, and what text and table say differently."""

    def records(self) -> tuple[Record, ...]:
        """Return each number of a measure on its own, in siamloc's names and units, for a join with measured ones."""
        return tuple(record for row in self.rows for record in self._of_row(row))

    def _of_row(self, row: Mapping[str, Any]) -> Iterator[Record]:
        units = _contents()["units"]
        settings = dict(self.settings)
        for column in self.columns:
            cell = row.get(column.name)
            if column.measure is None and cell is not None:
                settings[column.name] = _setting(cell, column, units[column.unit])
        for column in self.columns:
            cell = row.get(column.name)
            if column.measure is not None and cell is not None:
                printed = as_printed(cell, column)
                value, relation = _value(printed)
                factor = units[column.unit].get("factor", 1)
                yield Record(
                    measure=column.measure,
                    value=round(value * factor, 9),
                    settings=MappingProxyType({**settings, **column.at}),
                    entry=self.id,
                    printed=printed,
                    relation=relation,
                )


def published(id: str) -> Published:
    """Return what was published under an id, such as "table_5_7" or "section_3_5_1".

    Raises:
        ConfigError: an unknown id.

    Example:
        >>> published("table_5_17").records()[0].settings["same_share"]
        0.8
    """
    entries = _entries()
    if id not in entries:
        raise ConfigError(f"nothing was published as {id!r}; {hint(id, entries)}")
    return entries[id]


def published_all() -> tuple[Published, ...]:
    """Return everything that was published, in the order of the documents."""
    return tuple(_entries().values())


def measures() -> Mapping[str, Mapping[str, str]]:
    """Return the measures by name, each with its `unit` and what it `says`."""
    return MappingProxyType(_contents()["measures"])


def as_printed(cell: float | str, column: Column) -> str:
    """Return a number with the decimals that it was printed with."""
    return cell if isinstance(cell, str) else f"{cell:.{column.decimals}f}"


@cache
def _contents() -> dict[str, Any]:
    contents: dict[str, Any] = yaml.safe_load(_FILE.read_text(encoding="utf-8"))
    return contents


@cache
def _entries() -> dict[str, Published]:
    known = _contents()["settings"]
    return {entry["id"]: _entry(entry, known) for entry in _contents()["published"]}


def _entry(entry: Mapping[str, Any], known: Mapping[str, Any]) -> Published:
    columns = [_column(column, known) for column in entry["columns"]]
    listed = [column.name for column in columns]
    rows = [row if isinstance(row, dict) else dict(zip(listed, row, strict=True)) for row in entry["rows"]]
    further = dict.fromkeys(name for row in rows for name in row if name not in listed)  # settings of a few rows only
    columns += [_column({"name": name}, known) for name in further]
    return Published(
        id=entry["id"],
        title=entry["title"],
        source=Source(**entry["source"]),
        data=entry["data"],
        protocol=MappingProxyType(entry["protocol"]),
        settings=MappingProxyType(entry.get("settings", {})),
        columns=tuple(columns),
        rows=tuple(MappingProxyType(row) for row in rows),
        notes=tuple(entry["notes"]),
    )


def _column(column: Mapping[str, Any], known: Mapping[str, Any]) -> Column:
    return Column(**{**known.get(column["name"], {}), **column})


def _setting(cell: Any, column: Column, unit: Mapping[str, Any]) -> Any:
    if isinstance(cell, list):
        return tuple(_setting(one, column, unit) for one in cell)
    if "factor" in unit:
        return round(cell * unit["factor"], 9)
    return column.names.get(cell, cell)


def _value(printed: str) -> tuple[float, str]:
    match = _NUMBER.fullmatch(printed)
    if match is None:
        raise ValueError(f"{printed!r} is not a number")
    return float(match[2]), match[1] or "="
