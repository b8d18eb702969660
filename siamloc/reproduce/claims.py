"""The documents' claims about their numbers, in a form that published and measured numbers can be checked against.

There are three kinds of checks:

- `order`: `measure` is larger for the records of `more` than for those of `less`; `others` are all records that the
  opposite side leaves. `pick` selects the numbers compared on each side: `each` (the smallest of `more` with the
  largest of `less`), `min`, `max` or `mean`. With `factor`, the number of `more` must be at least that many times the
  number of `less`. A factor below 1 lets it be smaller, but not by much: 0.97 stands for "at most 3 % smaller". So
  what a document calls no worse is `more` for a hit rate, where larger is better, but `less` for an error or a time.
- `trend`: `measure` goes `up` or `down` `along` a setting; records at the same place are represented by their mean, or
  as `pick` says. `within` is the share of a value by which a step may go the opposite way. A trend that goes `flat` has
  no value more than that share above the smallest. Neither this nor `factor` is for measures that may be negative.
- `threshold`: `measure` is `above`, `below`, `at_least` or `at_most` a number, for `each` record, or for their `min`,
  `max` or `mean`.

`where` filters the records; `match` applies the check to every group with equal values of these settings. A setting
may be given as a value, a list of values, bounds (`above`, `below`, `at_least`, `at_most`), or `not` with a value or a
list.

Numbers do not decide an order or a trend if they are equal, or if they differ by less than such a difference varies
between seeds (`Record.spread`): another seed could then give another verdict. A claim that numbers are about alike
(`goes: flat`, a `factor` below 1) holds if they are, equal ones too; otherwise it is undecided if they differ by less
than that. Thresholds are compared as they are.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from statistics import fmean
from typing import Any

from foundation.calls import typed
from foundation.errors import known
from foundation.settings import Settings, Text
from siamloc.errors import ConfigError, hint
from siamloc.reproduce.published import Record, Source, contents, grouped, measures, published

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
    """A sentence of a document about its numbers, with the check that represents the sentence.

    Attributes:
        id: id of the claim.
        source: document, section, table and figures that the sentence is about.
        sentence: the claim in our words.
        check: what numbers must fulfil, see the module's docstring.
        entries: ids of the published numbers in the sentence; empty if these are in a figure.
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
        return examine(self.check, [record for entry in self.entries for record in published(entry).records()]).holds


@dataclass(frozen=True)
class Finding:
    """The result of checking a claim against numbers.

    Attributes:
        holds: whether the numbers support the claim; None if they do not decide, since numbers are missing, equal, or
            differ by less than the spread of such differences.
        why: the reason, in words, why the numbers do not decide; "" if they do.
    """

    holds: bool | None
    why: str = ""


_NOTHING = Finding(None, "the numbers that it compares are missing")


def claim(id: str) -> Claim:
    """Return a claim by its id.

    Raises:
        ConfigError: an unknown id.
    """
    every = {one.id: one for one in claims()}
    return every[known(id, every, "claim")]


@cache
def claims() -> tuple[Claim, ...]:
    """Return all claims, in the order of the documents."""
    return tuple(map(Claim.of, contents("claims")["claims"]))


def spread_of(kind: str, one: Record) -> float:
    """Return how much the difference of two numbers of a measure varies between seeds, from `claims.yaml`.

    Args:
        kind: the kind of experiment, a key of `siamloc.reproduce.experiments.KINDS`, such as "retrieval".
        one: one of the two numbers, with the name of its measure.

    Returns:
        The standard deviation of the difference, in the unit of the number; 0 if `claims.yaml` has none.
    """
    stated = float(contents("claims")["spreads"].get(kind, {}).get(one.measure, 0))
    relative = measures().get(one.measure, {}).get("unit", "1") not in ("1", "share")
    return stated * abs(one.value) if relative else stated


@typed
def examine(check: Mapping[str, Any], records: Sequence[Record]) -> Finding:
    """Check a claim against published or measured numbers.

    Args:
        check: the claim as plain values: `kind` is "order", "trend" or "threshold"; the module's docstring lists the
            further keys of each kind.
        records: the numbers; those of other measures than `check["measure"]` do not count.

    Returns:
        Whether the numbers support the claim; undecided if they are missing or too close to each other.

    Raises:
        ConfigError: an unknown kind of check or key.

    Example:
        >>> examine({"kind": "threshold", "measure": "error", "below": 0.5}, [Record("error", 0.4, {})]).holds
        True
    """
    kind = known(str(check.get("kind")), _KINDS, "kind of check")
    passes, keys = _KINDS[kind][0], _KINDS[kind][1] | _COMMON
    for key in set(check) - keys:
        raise ConfigError(f"a check of kind {kind} has no key {key!r}; {hint(key, sorted(keys))}")
    found = [one for one in records if one.measure == check["measure"] and _fits(one, check.get("where", {}))]
    return combined([passes(check, group) for group in grouped(check.get("match", ()), found).values()])


def combined(findings: Iterable[Finding]) -> Finding:
    """Combine findings about one claim: it holds if it holds wherever there are numbers to compare."""
    compared = [one for one in findings if one != _NOTHING]
    failed = [one for wanted in (False, None) for one in compared if one.holds is wanted]
    return [*failed, *compared, _NOTHING][0]


def _order(check: Mapping[str, Any], records: Sequence[Record]) -> Finding:
    more = _side(records, check["more"], check["less"])
    less = _side(records, check["less"], check["more"])
    if not more or not less:
        return _NOTHING
    pick, factor = check.get("pick"), check.get("factor", 1)
    (high, above), (low, below) = (
        _picked(pick if pick in PICKS else each, side) for each, side in (("min", more), ("max", less))
    )
    if factor < 1:
        return _about(high >= factor * low, [low, high], max(above, below))
    return _apart([factor * low, high], max(above, factor * below)) or Finding(high >= factor * low)


def _side(records: Sequence[Record], wanted: Any, opposite: Any) -> list[Record]:
    """Return the records of one side of an order; the side "others" has all records that do not fit the opposite."""
    if wanted == "others":
        return [one for one in records if not _fits(one, opposite)]
    return [one for one in records if _fits(one, wanted)]


def _trend(check: Mapping[str, Any], records: Sequence[Record]) -> Finding:
    along, within = check["along"], check.get("within", 0)
    places = grouped([along], [one for one in records if along in one.settings])
    if len(places) < 2:
        return _NOTHING
    values, spreads = zip(*(_picked(check.get("pick", "mean"), part) for part in places.values()), strict=True)
    spread = max(spreads)
    if check["goes"] == "flat":
        return _about(max(values) <= (1 + within) * min(values), values, spread)
    sign = 1 if check["goes"] == "up" else -1
    worst = min(sign * (after - before) + within * abs(before) for before, after in pairwise(values))
    if -spread < worst < 0:
        step = f"a step the other way, {-worst:.2g}"
        return Finding(None, f"{step}, is smaller than the spread of such differences, {spread:.2g}")
    return _apart(values, spread) or Finding(worst >= 0)


def _threshold(check: Mapping[str, Any], records: Sequence[Record]) -> Finding:
    values = [one.value for one in records]
    if not values:
        return _NOTHING
    picked = [PICKS[check["pick"]](values)] if check.get("pick") in PICKS else values
    return Finding(all(_BOUNDS[name](value, check[name]) for name in _BOUNDS if name in check for value in picked))


def _picked(pick: str, records: Sequence[Record]) -> tuple[float, float]:
    """Return the value that represents some records, and its spread."""
    if pick == "mean":
        return fmean(one.value for one in records), fmean(one.spread for one in records)
    one = (min if pick == "min" else max)(records, key=lambda one: one.value)
    return one.value, one.spread


def _apart(values: Sequence[float], spread: float) -> Finding | None:
    """Return why values do not decide; None if they lie far enough apart."""
    low, high = min(values), max(values)
    if low == high:
        return Finding(None, f"all compared values are {low:.4g}")
    less = f"{low:.4g} and {high:.4g} differ by less than the spread of such differences, {spread:.2g}"
    return Finding(None, less) if high - low < spread else None


def _about(alike: bool, values: Sequence[float], spread: float) -> Finding:
    """Return whether values are alike; undecided if they are not, but differ by less than the spread."""
    return Finding(True) if alike else _apart(values, spread) or Finding(False)


# Each kind of check, with the keys that only it has.
_KINDS: dict[str, tuple[Callable[[Mapping[str, Any], Sequence[Record]], Finding], set[str]]] = {
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
