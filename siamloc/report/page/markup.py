"""Build HTML that is always escaped, and format numbers for people."""

from __future__ import annotations

import html
import json
import math
from typing import Any

NOTHING = "–"


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


def section(title: str, *children: Content, name: str) -> Markup:
    """Return a section of the page with its heading."""
    return tag("section", tag("h3", title), *children, class_=name)


def script_data(identifier: str, value: Any) -> Markup:
    """Return a script element that holds a plain value as JSON for the page's script."""
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    # Only "<" can end a script element; JSON allows it only in strings, where the escape means the same.
    text = text.replace("<", "\\u003c")
    return Markup(f'<script type="application/json" id="{html.escape(identifier)}">{text}</script>')


def number(value: float | None, digits: int = 3) -> str:
    """Return a number with `digits` decimals, or a dash if there is none."""
    return NOTHING if value is None or not math.isfinite(value) else f"{value:.{digits}f}"


def percent(share: float | None) -> str:
    """Return a share in percent with one decimal, or a dash if there is none."""
    return NOTHING if share is None or not math.isfinite(share) else f"{100 * share:.1f} %"


def count(value: int) -> str:
    """Return a count with thousands separators."""
    return f"{value:,}"


def plural(value: int, what: str, many: str | None = None) -> str:
    """Return a count with its noun: "1 query", "1,887 queries"."""
    return f"{value:,} {what if value == 1 else many or what + 's'}"
