"""What several parts of a report page are made of: their frame, and the switch between lightings."""

from __future__ import annotations

from collections.abc import Mapping

from siamloc.report.gathered import ALL
from siamloc.report.markup import Content, Markup, count, tag


def section(title: str, *children: Content, name: str) -> Markup:
    """Return a part with its heading."""
    return tag("section", tag("h3", title), *children, class_=name)


def lighting_switch(name: str, groups: Mapping[str, int]) -> Markup | None:
    """Return buttons that choose a lighting for everything about an evaluation; None where there is no choice.

    Args:
        name: of the switch, different from all others on the page.
        groups: what each lighting holds, and all together.
    """
    if len(groups) < 2:
        return None
    radios = [
        tag(
            "label",
            tag("input", type="radio", name=name, value=label, checked=label == ALL),
            tag("span", label, " ", tag("small", count(rows))),
        )
        for label, rows in groups.items()
    ]
    return tag("fieldset.switch", tag("legend", "lighting"), *radios)


def under(label: str, *children: Content) -> Markup:
    """Return what the page shows under one lighting alone."""
    return tag("div", *children, data_under=label)
