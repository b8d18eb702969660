"""`Table`: columns with names, units and formats, as text, Markdown or CSV; the report shows the same table as HTML."""

from __future__ import annotations

import math
import textwrap
import unicodedata
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

from foundation.files import csv_text
from foundation.settings import shortened

NOTHING = "–"
WIDTH = 116
_NARROW = 7  # characters, within which a heading is not broken
_LONGEST_NAME = 40  # characters in a picture

Form = int | Literal["text", "short", "count", "percent", "share"]


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        name: heading of the column.
        unit: unit of the values, shown with the heading; "" for none.
        form: how its values are shown: a number with that many decimals; "count", a whole number; "percent", a share in
            percent; "share", two counts (hits, all) as their ratio; "short", a number with four digits; or "text".
        part: name of another column whose values are a part of this column's, drawn as a bar in the report.
    """

    name: str
    unit: str = ""
    form: Form = "text"
    part: str = ""

    @property
    def heading(self) -> str:
        """The name with the unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def shown(self, value: Any) -> str:
        """Return a value as text; a dash if it is None or NaN."""
        if self.form == "share" and value is not None:
            hits, every = value
            return f"{percent(hits / every if every else None)} ({count(hits)}/{count(every)})"
        if isinstance(self.form, int):
            return number(value, self.form)
        if self.form == "percent":
            return percent(value)
        if value is None or value != value:
            return NOTHING
        if self.form == "count":
            return count(value)
        return f"{value:.4g}" if isinstance(value, float) else value if isinstance(value, str) else str(value)


@dataclass(frozen=True)
class Table:
    """Rows of plain values under named columns.

    Attributes:
        name: what the table is about, in one word.
        columns: columns of the table. The first ones with the form "text" label the rows.
        rows: a value for each column; None or NaN if it is unknown.
        title: a heading.
        notes: sentences that belong to the table.
        upright: whether the table, which then has one row, is shown as a list of names and values.

    Example:
        >>> columns = (Column("method"), Column("mean", "m", 2), Column("hit rate", form="percent"))
        >>> table = Table("errors", columns, (("hog", 0.251, 0.5), ("gist", 1.5, None)))
        >>> print(table.text())
                mean     hit
        method   [m]    rate
        hog     0.25  50.0 %
        gist    1.50       –
        >>> print(table.csv())
        method,mean [m],hit rate
        hog,0.251,0.5
        gist,1.5,
        <BLANKLINE>
    """

    name: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Any, ...], ...]
    title: str = ""
    notes: tuple[str, ...] = ()
    upright: bool = False

    @property
    def labels(self) -> int:
        """The number of columns that label the rows."""
        return next((i for i, column in enumerate(self.columns) if column.form != "text"), len(self.columns))

    @property
    def cells(self) -> list[list[str]]:
        """All values as text, row by row."""
        return [[column.shown(value) for column, value in zip(self.columns, row, strict=True)] for row in self.rows]

    def text(self, width: int = WIDTH) -> str:
        """Return the table as aligned text; columns that do not fit into the width follow below, with the labels."""
        if self.upright:
            names = [column.heading for column in self.columns]
            lines = [f"{name:{max(map(len, names))}}  {cell}" for name, cell in zip(names, self.cells[0], strict=True)]
        else:
            lines = _blocks(self._justified(), self.labels, width)
        return "\n".join([*filter(None, [self.title]), *lines, *self.notes])

    def markdown(self) -> str:
        """Return the table in Markdown, with the cells on one line and their vertical bars escaped."""
        rules = ["---" if column.form == "text" else "---:" for column in self.columns]
        lines = [[column.heading for column in self.columns], rules, *self.cells]
        plain = ([" ".join(cell.splitlines()).replace("|", r"\|") for cell in line] for line in lines)
        return "\n".join(f"| {' | '.join(line)} |" for line in plain)

    def csv(self) -> str:
        """Return the table as CSV: numbers in full precision, unknown values empty."""
        rows = ([one[0] / max(one[1], 1) if isinstance(one, tuple) else one for one in row] for row in self.rows)
        return csv_text([[column.heading for column in self.columns], *rows])

    def _justified(self) -> list[list[str]]:
        """Return the lines of each column, equally long: heading, unit, and cells."""
        heads, cells = [], [list(column) for column in zip(*self.cells, strict=True)] or [[] for _ in self.columns]
        for column, values in zip(self.columns, cells, strict=True):
            widest = max(_NARROW, *map(width_of, (*column.name.split(), *values)))
            heads.append([*textwrap.wrap(column.name, widest), *([f"[{column.unit}]"] if column.unit else [])])
        lines = [
            [""] * (max(map(len, heads)) - len(head)) + head + values for head, values in zip(heads, cells, strict=True)
        ]
        widths = [max(map(width_of, column)) for column in lines]
        return [
            [_padded(line, width, column.form == "text") for line in own]
            for column, own, width in zip(self.columns, lines, widths, strict=True)
        ]


def _padded(text: str, width: int, left: bool) -> str:
    pad = " " * (width - width_of(text))
    return text + pad if left else pad + text


def _blocks(columns: list[list[str]], labels: int, width: int) -> list[str]:
    """Return the lines of a table whose columns are put below each other if they are wider than `width`."""
    widths = [width_of(column[0]) + 2 for column in columns]
    while labels > 1 and sum(widths[:labels]) > width // 2:
        labels -= 1
    blocks, used = [columns[:labels]], sum(widths[:labels])
    for column, own in zip(columns[labels:], widths[labels:], strict=True):
        if used + own - 2 > width and len(blocks[-1]) > labels:
            blocks.append(columns[:labels])
            used = sum(widths[:labels])
        blocks[-1].append(column)
        used += own
    lines: list[str] = []
    for block in blocks:
        lines += [""] * bool(lines) + ["  ".join(line).rstrip() for line in zip(*block, strict=True)]
    return lines


def width_of(text: str) -> int:
    """Return how many columns of a terminal a text takes: Chinese, Japanese and Korean letters take two each.

    Example:
        >>> width_of("lab"), width_of("厨房")
        (3, 4)
    """
    return len(text) + sum(unicodedata.east_asian_width(letter) in ("W", "F") for letter in text)


def short_names(names: Iterable[str]) -> list[str]:
    """Return the names of all rooms as a picture shows them: very long ones are cut, unless they differ in the middle.

    Example:
        >>> short_names(["the corridor on the east side behind the stairs", "lab"])
        ['the corridor on th ... behind the stairs', 'lab']
    """
    whole = list(names)
    cut = [shortened(name, _LONGEST_NAME) for name in whole]
    return cut if len(set(cut)) == len(set(whole)) else whole


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with `digits` decimals; a dash if it is unknown."""
    return NOTHING if value is None or not math.isfinite(value) else f"{value:.{digits}f}"


def percent(share: float | None) -> str:
    """Return a share in percent with one decimal; a dash if it is unknown."""
    return NOTHING if share is None or not math.isfinite(share) else f"{100 * share:.1f} %"


def count(value: int) -> str:
    """Return a count with thousands separators."""
    return f"{value:,}"
