"""The documents' claims about their numbers, in a form that published and measured numbers can be checked against.

There are three kinds of checks:

- `order`: `measure` is larger for the records of `more` than for those of `less`; `others` are all records that the
  opposite side leaves. `pick` selects the numbers compared on each side: `each` (the smallest of `more` with the
  largest of `less`), `min`, `max` or `mean`. With `factor`, it must be larger by at least that factor.
- `trend`: `measure` goes `up` or `down` `along` a setting; records at the same place are represented by their mean, or
  as `pick` says. `within` is the share of a value by which a step may go the opposite way. A trend that goes `flat` has
  no value more than that share above the smallest.
- `threshold`: `measure` is `above`, `below`, `at_least` or `at_most` a number, for `each` record, or for their `min`,
  `max` or `mean`.

`where` filters the records; `match` applies the check to every group with equal values of these settings. A setting
may be given as a value, a list of values, bounds (`above`, `below`, `at_least`, `at_most`), or `not` with a value or a
list.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from statistics import fmean
from typing import Any

from foundation.calls import typed
from foundation.settings import Settings, Text
from siamloc.errors import ConfigError, hint
from siamloc.reproduce.published import Record, Source, contents, grouped, named, published

_BOUNDS: dict[str, Callable[[Any, Any], bool]] = {
    "above": operator.gt,
    "below": operator.lt,
    "at_least": operator.ge,
    "at_most": operator.le,
}
_COMMON = {"kind", "measure", "where", "match", "pick"}
PICKS: dict[str, Callable[[Sequence[float]], float]] = {"min": min, "max": max, "mean": fmean}


@dataclass(frozen=True)
class Claim(Settings):
    """A sentence of a document, with the check that represents it.

    Attributes:
        id: id of the claim.
        source: where the sentence stands.
        sentence: the claim in our words.
        check: what numbers must fulfil, see above.
        entries: ids of the published numbers it refers to; empty if those are in a figure.
        reading: how the check interprets vague words of the sentence.
    """

    id: Text
    source: Source
    sentence: Text
    check: dict[str, Any]
    entries: tuple[Text, ...] = ()
    reading: str = ""

    def printed(self) -> bool | None:
        """Return whether the document's own numbers support the claim; None if they were not printed."""
        return holds(self.check, [record for entry in self.entries for record in published(entry).records()])


def claim(id: str) -> Claim:
    """Return a claim by its id.

    Raises:
        ConfigError: an unknown id.
    """
    return named(_claims(), id, "claim")


def claims() -> tuple[Claim, ...]:
    """Return all claims, in the order of the documents."""
    return tuple(_claims().values())


@typed
def holds(check: Mapping[str, Any], records: Sequence[Record]) -> bool | None:
    """Return whether published or measured numbers pass a check.

    Returns:
        None if the records lack what the check compares.

    Raises:
        ConfigError: an unknown kind of check or key.

    Example:
        >>> holds({"kind": "threshold", "measure": "error", "below": 0.5}, [Record("error", 0.4, {})])
        True
    """
    kind = str(check.get("kind"))
    if kind not in _KINDS:
        raise ConfigError(f"unknown kind of check {kind!r}; {hint(kind, _KINDS)}")
    passes, keys = _KINDS[kind][0], _KINDS[kind][1] | _COMMON
    for key in set(check) - keys:
        raise ConfigError(f"a check of kind {kind} has no key {key!r}; {hint(key, sorted(keys))}")
    found = [one for one in records if one.measure == check["measure"] and _fits(one, check.get("where", {}))]
    results = [passes(check, group) for group in grouped(check.get("match", ()), found).values()]
    decided = [result for result in results if result is not None]
    return all(decided) if decided else None


def _order(check: Mapping[str, Any], records: Sequence[Record]) -> bool | None:
    more = _side(records, check["more"], check["less"])
    less = _side(records, check["less"], check["more"])
    if not more or not less:
        return None
    pick = check.get("pick")
    high, low = (PICKS[pick](more), PICKS[pick](less)) if pick in PICKS else (min(more), max(less))
    return high >= check["factor"] * low if "factor" in check else high > low


def _side(records: Sequence[Record], wanted: Any, opposite: Any) -> list[float]:
    """Return the values of one side; the side "others" has all records that do not fit the opposite one."""
    if wanted == "others":
        return [one.value for one in records if not _fits(one, opposite)]
    return [one.value for one in records if _fits(one, wanted)]


def _trend(check: Mapping[str, Any], records: Sequence[Record]) -> bool | None:
    along, pick, within = check["along"], PICKS[check.get("pick", "mean")], check.get("within", 0)
    places = grouped([along], [one for one in records if along in one.settings])
    if len(places) < 2:
        return None
    picked = [pick([one.value for one in part]) for part in places.values()]
    if check["goes"] == "flat":
        return max(picked) <= (1 + within) * min(picked)
    sign = 1 if check["goes"] == "up" else -1
    return all(sign * (after - before) >= -within * abs(before) for before, after in pairwise(picked))


def _threshold(check: Mapping[str, Any], records: Sequence[Record]) -> bool | None:
    values = [one.value for one in records]
    if not values:
        return None
    picked = [PICKS[check["pick"]](values)] if check.get("pick") in PICKS else values
    return all(_BOUNDS[name](value, check[name]) for name in _BOUNDS if name in check for value in picked)


# Each kind of check, with the keys that only it has.
_KINDS: dict[str, tuple[Callable[[Mapping[str, Any], Sequence[Record]], bool | None], set[str]]] = {
    "order": (_order, {"more", "less", "factor"}),
    "trend": (_trend, {"along", "goes", "within"}),
    "threshold": (_threshold, set(_BOUNDS)),
}


def _fits(record: Record, wanted: Mapping[str, Any]) -> bool:
    """Return whether a record has all these settings; a missing setting never fits."""
    return all(name in record.settings and _equal(record.settings[name], value) for name, value in wanted.items())


def _equal(value: Any, wanted: Any) -> bool:
    if isinstance(wanted, Mapping):
        bounds = _BOUNDS | {"not": lambda value, bound: not _equal(value, bound)}
        return all(bounds[name](value, bound) for name, bound in wanted.items())
    return value in wanted if isinstance(wanted, (list, tuple)) else value == wanted


@cache
def _claims() -> dict[str, Claim]:
    return {one["id"]: Claim.of(one) for one in contents("claims")["claims"]}
