"""Select the records for a panel of a figure, and label its axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from siamloc.reproduce.published import Record, measures
from siamloc.reproduce.recipe_book import axis


def names_of(figure: Mapping[str, Any], key: str) -> list[str]:
    """Return the settings named by a panel's `series` or `panels`: none, one or several."""
    named = figure.get(key, "descriptor" if key == "series" and "y" not in figure else [])
    return [named] if isinstance(named, str) else list(named)


def shown(figure: Mapping[str, Any], records: Sequence[Record]) -> list[Record]:
    """Return the records of a figure: those of its measure that have all the settings it is drawn over."""
    where = figure.get("where", {})
    needed = [
        figure["x"],
        *names_of(figure, "panels"),
        *([figure["y"]] if "y" in figure else names_of(figure, "series")),
    ]
    return [
        one
        for one in records
        if one.measure == figure["measure"]
        and all(one.settings.get(key) == value for key, value in where.items())
        and all(name in one.settings for name in needed)
    ]


def title(name: str, value: Any) -> str:
    """Return the label of a setting and its value, as in "k1 8" or "homomorphic filter"."""
    if name == "filter":
        return "homomorphic filter" if value else "no filter"
    about = axis(name)
    if "factor" in about:
        value = round(about["factor"] * value, 6)
    written = f"{value:g}" if isinstance(value, float) else str(value).replace("_", " ")
    if name in ("descriptor", "distance", "data", "method"):
        return written
    ending = f" {about['unit']}" if "factor" in about else ""
    return f"{about.get('short', name.replace('_', ' '))} {written}{ending}"


def unit(measure: str) -> str:
    """Return the unit of a measure; "" if it has none."""
    found = str(measures().get(measure, {}).get("unit", "s" if measure.endswith("seconds") else "1"))
    return "" if found == "1" else found


def said(measure: str) -> str:
    """Return the label of a measure; "seconds" becomes "time"."""
    if measure == "seconds":
        return "time"
    return measure.removesuffix("_seconds").replace("_", " ") + (" time" if measure.endswith("_seconds") else "")
