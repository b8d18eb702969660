"""`listing`: what can be reproduced, what it needs, and roughly how long it takes."""

from __future__ import annotations

import textwrap

from foundation.calls import typed
from siamloc.reproduce.recipe_book import (
    Recipe,
    check_scale_and_data,
    data_named,
    recipes,
    seconds_of,
    without_measurement,
)


@typed
def listing(data: str = "freiburg_sim", scale: str = "short") -> str:
    """Return a list of what can be reproduced: for each id, what it is, what it needs, and roughly how long it takes.

    Args:
        data: "cold", "freiburg_sim" or "mini".
        scale: "smoke", "short" or "full".

    Raises:
        ConfigError: an unknown data set or scale.
    """
    check_scale_and_data(scale, data)
    lines: list[str] = []
    for one in recipes():
        lines += [f"{one.id:<14} {one.title}", f"{'':<14} {_needs(one, data, scale)}"]
    about = data_named(data)
    covered = [f"{id:<14} is measured by {one.id}" for one in recipes() for id in one.covers]
    nothing = [f"{id:<14} {reason}" for id, reason in without_measurement().items()]
    return "\n".join(
        [
            f"What can be reproduced, what it needs, and about how long it takes alone at scale={scale} on two cores:",
            *("", *lines, ""),
            *("Panels of these, or the same numbers drawn differently:", "", *covered, ""),
            *("Nothing to measure:", "", *nothing, ""),
            *textwrap.wrap(f"data={data} is {about['title']}: {about['how']}", 118, break_on_hyphens=False),
        ]
    )


def _needs(one: Recipe, data: str, scale: str) -> str:
    jobs = one.jobs(scale)
    runs = sorted({run for job in jobs for role in job.roles.values() for run in role["runs"]})
    trained = sum(job.kind in ("trained", "named_rooms") for job in jobs)
    parts = [
        f"[{one.source.document}] {one.source.place or 'section ' + one.source.section}",
        f"drives {' '.join(runs)}",
    ]
    if any(job.dense for job in jobs) and data_named(data).get("dense"):
        parts.append("frames every 5 cm")
    if any(job.kind == "buildings" for job in jobs):
        parts.append(f"the same drive of {data_named(data)['other']['folder']}")
    if trained:
        parts.append(f"{trained} training{'s' if trained > 1 else ''}")
    if trained and scale == "full":
        return "; ".join([*parts, "hours each on a graphics card"])
    return "; ".join([*parts, _lasting(sum(seconds_of(job, scale) for job in jobs))])


def _lasting(seconds: float) -> str:
    """Return a rough duration in words."""
    if seconds < 90:
        return "seconds" if seconds < 30 else "a minute"
    return f"{seconds / 60:.0f} minutes" if seconds < 5400 else f"{seconds / 3600:.0f} hours"
