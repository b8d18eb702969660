"""The exception of this package."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class AugmentError(ValueError):
    """A parameter, a policy or a batch that cannot be used; one sentence says which and what to do."""


def nearest(name: object, valid: Iterable[str]) -> str:
    """Return a hint that names the valid spellings, the nearest one first: for the end of an error message."""
    options = list(valid)
    close = get_close_matches(str(name), options, n=1, cutoff=0.5)
    return (f"did you mean {close[0]!r}? " if close else "") + f"valid: {', '.join(options) or 'none'}"
