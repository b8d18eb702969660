"""Build HTML that is always escaped, and show tables as HTML."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterable
from pathlib import Path
from string import Template
from typing import Any

from siamloc.summaries import ALL
from siamloc.tables import Table, count

_ASSETS = Path(__file__).parent / "assets"


class Markup(str):
    """Text that is already HTML."""

    __slots__ = ()


Content = str | int | None


def tag(name: str, /, *children: Content, **attributes: Any) -> Markup:
    """Return an element; children and attributes are escaped unless they are `Markup`.

    Example:
        >>> tag("p.note", "1 < 2", data_row=3)
        '<p class="note" data-row="3">1 &lt; 2</p>'

    Args:
        name: name of the element, with its classes after dots: "p.note".
        children: text or elements; None is left out.
        attributes: underscores become hyphens, a trailing one is dropped; True gives a bare attribute, None and False
            give none.
    """
    name, *classes = name.split(".")
    given = {key.removesuffix("_").replace("_", "-"): value for key, value in attributes.items()}
    if classes:
        given = {"class": " ".join(classes), **given}
    text = "".join(
        f" {key}" if value is True else f' {key}="{html.escape(str(value))}"'
        for key, value in given.items()
        if value is not None and value is not False
    )
    if name in ("img", "input", "br"):
        return Markup(f"<{name}{text}>")
    return Markup(f"<{name}{text}>{join(*children)}</{name}>")


def join(*children: Content) -> Markup:
    """Return the children one after another, escaped unless they are HTML."""
    return Markup(
        "".join(
            child if isinstance(child, Markup) else html.escape(str(child)) for child in children if child is not None
        )
    )


def fragment(file: str, /, **values: Content) -> Markup:
    """Return a file of the folder `assets` with its $placeholders replaced by values, escaped unless `Markup`."""
    text = (_ASSETS / file).read_text(encoding="utf-8")
    filled = {key: join(value) for key, value in values.items()}
    return Markup(Template(text).substitute(filled) if filled else text)


def section(title: str, *children: Content, name: str) -> Markup:
    """Return a section of the page with its heading; `name` is the class of the element, for the style sheet."""
    return tag("section", tag("h3", title), *children, class_=name)


def script_data(identifier: str, value: Any) -> Markup:
    """Return a script element that holds a plain value as JSON for the page's script."""
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    # Only "<" can end a script element; JSON allows it only in strings, where the escape means the same.
    text = text.replace("<", "\\u003c")
    return Markup(f'<script type="application/json" id="{html.escape(identifier)}">{text}</script>')


def plural(value: int, what: str, many: str | None = None) -> str:
    """Return a count with its noun: "1 query", "1,887 queries".

    Args:
        value: the count.
        what: the noun in the singular.
        many: the noun in the plural; `what` with an "s" if None.
    """
    return f"{count(value)} {what if value == 1 else many or what + 's'}"


def key_values(pairs: Iterable[tuple[str, Content]]) -> Markup:
    """Return a table of two columns: keys and values."""
    rows = (tag("tr", tag("th", key, scope="row"), tag("td", value)) for key, value in pairs)
    return tag("table.values", tag("tbody", *rows))


def grid(table: Table) -> Markup:
    """Return a table as HTML, with its notes; it scrolls by itself if the page is too narrow for it.

    Rows with the same first label are grouped, and the rows of all queries are marked. A column with a `part` gets bars
    that show this part and the rest, and its smallest value among several methods is bold.
    """
    headings, cells, labels = [column.heading for column in table.columns], table.cells, table.labels
    if table.upright:
        return key_values(zip(headings, cells[0], strict=True))
    bars = {i: _bars(table, i) for i, column in enumerate(table.columns) if column.part}
    blocks: dict[str, list[int]] = {}
    for i, row in enumerate(cells):
        blocks.setdefault(row[0] if labels > 1 else "", []).append(i)
    bodies = []
    for first, rows in blocks.items():
        lines = []
        for i in rows:
            own = [tag("th", cells[i][j], scope="row") for j in range(labels - 1 if labels > 1 else 0, labels)]
            if labels > 1 and i == rows[0]:
                own.insert(0, tag("th", first, scope="rowgroup", rowspan=len(rows)))
            own += [tag("td.n", bars[j][i] if j in bars else cells[i][j]) for j in range(labels, len(headings))]
            lines.append(tag("tr", *own, class_="all" if cells[i][labels - 1] == ALL else None))
        bodies.append(tag("tbody", *lines, data_method=first or None))
    head = tag(
        "tr", *(tag("th" if j < labels else "th.n", _unbroken(text), scope="col") for j, text in enumerate(headings))
    )
    made = tag("table", tag("thead", head), *bodies, class_=f"grid {table.name}")
    return join(tag("div.scroll", made, tabindex=0), *(tag("p.caption", note) for note in table.notes))


def _bars(table: Table, column: int) -> list[Markup]:
    """Return the cells of a column with bars below the numbers."""
    part = next((j for j, one in enumerate(table.columns) if one.name == table.columns[column].part), column)
    whole = [row[column] for row in table.rows]
    longest = max((value for value in whole if value is not None), default=0)
    smallest: dict[str, float] = {}
    if table.labels > 1 and len({row[0] for row in table.rows}) > 1:
        for row in table.rows:
            if row[column] is not None:
                label = row[table.labels - 1]
                smallest[label] = min(row[column], smallest.get(label, row[column]))
    made = []
    for row, cells in zip(table.rows, table.cells, strict=True):
        value, text = row[column], cells[column]
        shown = tag("b", text) if value is not None and value == smallest.get(row[table.labels - 1]) else join(text)
        if longest > 0:
            floor = min(row[part] or 0, value or 0)  # estimates that are no frame of the map can be below it
            shares = {"floor": floor, "excess": (value or 0) - floor}
            bits = (tag(f"i.{kind}", style=f"width:{100 * share / longest:.1f}%") for kind, share in shares.items())
            shown = join(shown, tag("span.bar", *bits, aria_hidden="true"))
        made.append(shown)
    return made


def _unbroken(text: str) -> str:
    """Return a text whose unit is not separated from its number or name by a line break."""
    return text.replace(" ", "\u00a0") if len(text) < 12 else re.sub(r"(?<=\d) (?=\w+$)| (?=\[)", "\u00a0", text)
