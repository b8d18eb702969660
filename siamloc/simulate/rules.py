"""Rules for the values of settings and building file entries; a broken rule says in one sentence what is wrong."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from siamloc.errors import hint

#: Takes any value that YAML or Python can hold; returns the end of a sentence, or "" if the value is fine.
Rule = Callable[[Any], str]


def must_be(expected: str, holds: Callable[[Any], bool]) -> Rule:
    """Make a rule of a description and a test.

    >>> must_be("a list", lambda value: isinstance(value, list))(3)
    'must be a list, got 3'
    """
    return lambda value: "" if holds(value) else f"must be {expected}, got {value!r}"


def one_of(words: Collection[str]) -> Rule:
    """Allow one of some words; the sentence names the nearest one.

    >>> one_of(("north", "south"))("nort")
    "'nort' is unknown; did you mean 'north'? valid: north, south"
    """
    return lambda value: (
        "" if isinstance(value, str) and value in words else f"{value!r} is unknown; {hint(str(value), words)}"
    )


def number(above: float | None = None, at_least: float | None = None) -> Rule:
    """Allow a number below a million.

    >>> number(above=0)(-2)
    'must be a number above 0, got -2'
    """
    return must_be(f"a number{_bound(above, at_least)}", lambda value: _is_number(value, above, at_least))


def numbers(count: int, above: float | None = None, at_least: float | None = None) -> Rule:
    """Allow a list of a given number of numbers.

    >>> numbers(2)([1, "two"])
    "must be a list of 2 numbers, got [1, 'two']"
    """
    return must_be(
        f"a list of {count} numbers{_bound(above, at_least)}",
        lambda value: (
            isinstance(value, (list, tuple))
            and len(value) == count
            and all(_is_number(one, above, at_least) for one in value)
        ),
    )


def whole(low: int | None = None, high: int | None = None) -> Rule:
    """Allow a whole number between two bounds.

    >>> whole(1, 100)(0)
    'must be a whole number between 1 and 100, got 0'
    """
    between = f" between {low} and {high}" if high is not None else _bound(None, low)

    def holds(value: Any) -> bool:
        if not isinstance(value, (int, np.integer)) or isinstance(value, bool):
            return False
        return (low is None or int(value) >= low) and (high is None or int(value) <= high)

    return must_be(f"a whole number{between}", holds)


def row(**parts: Rule) -> Rule:
    """Allow a list with one value for each part.

    >>> row(material=one_of(["tiles"]), height=number())(["tiles", "high"])
    "has a wrong height: it must be a number, got 'high'"
    """

    def broken_by(value: Any) -> str:
        if not isinstance(value, (list, tuple)) or len(value) != len(parts):
            names = ", ".join(name.replace("_", " ") for name in parts)
            return f"must be a list [{names}], got {value!r}"
        for (name, rule), one in zip(parts.items(), value, strict=True):
            if broken := rule(one):
                return f"has a wrong {name.replace('_', ' ')}: {'it ' if broken.startswith('must') else ''}{broken}"
        return ""

    return broken_by


def optional(rule: Rule) -> Rule:
    """Allow None and what another rule allows."""
    return lambda value: "" if value is None else rule(value)


FLAG = must_be("true or false", lambda value: isinstance(value, bool))
LIST = must_be("a list", lambda value: isinstance(value, (list, tuple)))
MAPPING = must_be("a mapping", lambda value: isinstance(value, dict))
TEXT = must_be("a name", lambda value: isinstance(value, (str, int)) and not isinstance(value, bool) and value != "")
#: For text that becomes part of a file name or of a list whose columns are separated by spaces.
WORD = must_be(
    "a word of letters, digits, '.', '-' and '_'",
    lambda value: not TEXT(value) and re.fullmatch(r"\w[\w.-]*", str(value)) is not None,
)


def _is_number(value: Any, above: float | None, at_least: float | None) -> bool:
    if not isinstance(value, (int, float, np.number)) or isinstance(value, bool) or not abs(value) < 1e6:  # nor NaN
        return False
    return (above is None or bool(value > above)) and (at_least is None or bool(value >= at_least))


def _bound(above: float | None, at_least: float | None) -> str:
    return f" above {above:g}" if above is not None else f" of at least {at_least:g}" if at_least is not None else ""
