"""The exception of this package, and the spelling hint at the end of its messages."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class AugmentError(ValueError):
    """The error for a parameter, policy or batch that cannot be used; the message says which, and what to do."""


def hint(name: object, valid: Iterable[str]) -> str:
    """Return the end of an error message about an unknown name: the nearest valid spelling, then all of them.

    Example:
        >>> hint("bulp", ["bulb", "blur"])
        "did you mean 'bulb'? valid: bulb, blur"
    """
    options = list(valid)
    close = get_close_matches(str(name), options, n=1, cutoff=0.5)
    return (f"did you mean {close[0]!r}? " if close else "") + f"valid: {', '.join(options) or 'none'}"
