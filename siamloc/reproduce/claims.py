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
from pathlib import Path
from statistics import fmean
from types import MappingProxyType
from typing import Any

import yaml

from foundation.calls import typed
from siamloc.errors import ConfigError, hint
from siamloc.reproduce.published import Record, Source, published

_FILE = Path(__file__).with_name("claims.yaml")
_BOUNDS: dict[str, Callable[[Any, Any], bool]] = {
    "above": operator.gt,
    "below": operator.lt,
    "at_least": operator.ge,
    "at_most": operator.le,
}
_PICKS: dict[str, Callable[[Sequence[float]], float]] = {"min": min, "max": max, "mean": fmean}
_COMMON = {"kind", "measure", "where", "match", "pick"}
_KEYS = {
    "order": _COMMON | {"more", "less", "factor"},
    "trend": _COMMON | {"along", "goes", "within"},
    "threshold": _COMMON | set(_BOUNDS),
}


@dataclass(frozen=True)
class Claim:
    """A sentence of a document, with the check that represents it."""

    id: str
    source: Source
    sentence: str
    check: Mapping[str, Any]
    entries: tuple[str, ...] = ()
    """Ids of the published numbers it refers to; empty if those are in a figure."""
    reading: str = ""
    """How the check interprets vague words of the sentence."""

    def printed(self) -> bool | None:
        """Return whether the document's own numbers support the claim; None if they were not printed."""
        return holds(self.check, [record for entry in self.entries for record in published(entry).records()])


def claim(id: str) -> Claim:
    """Return a claim by its id.

    Raises:
        ConfigError: an unknown id.
    """
    known = _claims()
    if id not in known:
        raise ConfigError(f"there is no claim {id!r}; {hint(id, known)}")
    return known[id]


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
    kind = check.get("kind")
    if kind not in _KEYS:
        raise ConfigError(f"unknown kind of check {kind!r}; {hint(str(kind), _KEYS)}")
    for key in set(check) - _KEYS[kind]:
        raise ConfigError(f"a check of kind {kind} has no key {key!r}; {hint(key, sorted(_KEYS[kind]))}")
    found = [one for one in records if one.measure == check["measure"] and _fits(one, check.get("where", {}))]
    groups: dict[tuple[Any, ...], list[Record]] = {}
    for one in found:
        groups.setdefault(tuple(one.settings.get(name) for name in check.get("match", ())), []).append(one)
    results = [_KINDS[kind](check, group) for group in groups.values()]
    decided = [result for result in results if result is not None]
    return all(decided) if decided else None


def _order(check: Mapping[str, Any], records: Sequence[Record]) -> bool | None:
    more, less = _sides(check, records)
    if not more or not less:
        return None
    pick = check.get("pick", "each")
    high, low = (min(more), max(less)) if pick == "each" else (_PICKS[pick](more), _PICKS[pick](less))
    return high >= check["factor"] * low if "factor" in check else high > low


def _sides(check: Mapping[str, Any], records: Sequence[Record]) -> tuple[list[float], list[float]]:
    more, less = check["more"], check["less"]
    chosen = [_fits(one, less if more == "others" else more) for one in records]
    if more == "others":
        inside = [not yes for yes in chosen]
        outside = chosen
    else:
        inside = chosen
        outside = [not yes if less == "others" else _fits(one, less) for yes, one in zip(chosen, records, strict=True)]
    return _values(records, inside), _values(records, outside)


def _trend(check: Mapping[str, Any], records: Sequence[Record]) -> bool | None:
    places: dict[Any, list[float]] = {}
    for one in records:
        if check["along"] in one.settings:
            places.setdefault(one.settings[check["along"]], []).append(one.value)
    if len(places) < 2:
        return None
    picked = [_PICKS[check.get("pick", "mean")](places[place]) for place in sorted(places)]
    within = check.get("within", 0)
    if check["goes"] == "flat":
        return max(picked) <= (1 + within) * min(picked)
    sign = 1 if check["goes"] == "up" else -1
    return all(sign * (after - before) >= -within * abs(before) for before, after in pairwise(picked))


def _threshold(check: Mapping[str, Any], records: Sequence[Record]) -> bool | None:
    values = [one.value for one in records]
    if not values:
        return None
    pick = check.get("pick", "each")
    picked = values if pick == "each" else [_PICKS[pick](values)]
    bounds = {name: check[name] for name in _BOUNDS if name in check}
    return all(_BOUNDS[name](value, bound) for name, bound in bounds.items() for value in picked)


_KINDS = {"order": _order, "trend": _trend, "threshold": _threshold}


def _values(records: Sequence[Record], chosen: Sequence[bool]) -> list[float]:
    return [one.value for one, yes in zip(records, chosen, strict=True) if yes]


def _fits(record: Record, wanted: Mapping[str, Any]) -> bool:
    """Return whether a record has all these settings; a missing setting never fits."""
    return all(name in record.settings and _equal(record.settings[name], value) for name, value in wanted.items())


def _equal(value: Any, wanted: Any) -> bool:
    if isinstance(wanted, Mapping):
        return all(
            not _equal(value, bound) if name == "not" else _BOUNDS[name](value, bound) for name, bound in wanted.items()
        )
    return value in wanted if isinstance(wanted, (list, tuple)) else value == wanted


@cache
def _claims() -> dict[str, Claim]:
    contents = yaml.safe_load(_FILE.read_text(encoding="utf-8"))
    return {one["id"]: _claim(one) for one in contents["claims"]}


def _claim(one: Mapping[str, Any]) -> Claim:
    return Claim(
        **{
            **one,
            "source": Source(**one["source"]),
            "check": MappingProxyType(one["check"]),
            "entries": tuple(one.get("entries", ())),
        }
    )
