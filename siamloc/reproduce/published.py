"""Published numbers by table, as printed rows and as records to compare with measured ones."""

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
    """Where something was published, by section instead of page."""

    document: str
    """"T", "I" or "C", the documents listed in `published.yaml`; "none" if it is not one of them."""
    section: str
    table: str | None = None
    figures: str | None = None

    @property
    def place(self) -> str:
        """The table or figures in words, "" if it is neither."""
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
    """Settings shared by all numbers of the column, such as the lighting."""
    key: str | None = None
    """The setting's key in siamloc's configuration, if any."""
    names: Mapping[Any, Any] = field(default_factory=dict)
    """Names in siamloc by printed label."""


@dataclass(frozen=True)
class Record:
    """One number with everything it depends on; published and measured ones have the same form."""

    measure: str
    value: float
    """In the measure's own unit: m, s, deg, shares instead of percent."""
    settings: Mapping[str, Any]
    """In siamloc's names."""
    entry: str = ""
    printed: str = ""
    """The number as printed, in the column's unit; empty for a measured one."""
    relation: str = "="
    """"=", or "~", "<", ">" if the number is only approximate, or an upper or lower bound."""


@dataclass(frozen=True)
class Published:
    """A published table, or the numbers given in the text of a section."""

    id: str
    title: str
    source: Source
    data: str
    protocol: Mapping[str, str]
    """`train`, `map` and `query` in a few words."""
    settings: Mapping[str, Any]
    """Settings that all rows have in common, in siamloc's names."""
    columns: tuple[Column, ...]
    rows: tuple[Mapping[str, Any], ...]
    """Cells by column, with the labels as printed (in English); a cell that was not printed is missing or None."""
    notes: tuple[str, ...]
    """Doubtful points: misprints, and contradictions between text and table."""

    def records(self) -> tuple[Record, ...]:
        """Return each number as a record of its own, in siamloc's names and units, to be joined with measured ones."""
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
    """Return the published numbers with an id, such as "table_5_7" or "section_3_5_1".

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
    """Return all published tables and numbers, in the order of the documents."""
    return tuple(_entries().values())


def measures() -> Mapping[str, Mapping[str, str]]:
    """Return the measures by name, each with its `unit` and description (`says`)."""
    return MappingProxyType(_contents()["measures"])


def as_printed(cell: float | str, column: Column) -> str:
    """Return a number with as many decimals as were printed."""
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
    further = dict.fromkeys(name for row in rows for name in row if name not in listed)  # settings of only a few rows
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
