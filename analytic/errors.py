"""The exception of this package, and the hint at the end of its messages."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class AnalyticError(ValueError):
    """The error for a parameter, image or description that cannot be used; one sentence says which, and what to do.

    Example:
        >>> import analytic
        >>> try:
        ...     analytic.descriptor("hogg")
        ... except analytic.AnalyticError as error:
        ...     print(str(error).split(" valid:")[0])
        unknown descriptor 'hogg': did you mean 'hog'?
    """


def known(name: object, valid: Iterable[str], what: str) -> str:
    """Return the name if it is valid.

    Raises:
        AnalyticError: the name is not valid, or not a string.

    Example:
        >>> known("hog", ["gist", "hog"], "descriptor")
        'hog'
    """
    options = list(valid)
    if not isinstance(name, str) or name not in options:
        raise AnalyticError(f"unknown {what} {name!r}: {hint(name, options)}")
    return name


def hint(name: object, valid: Iterable[object]) -> str:
    """Return the end of an error message about an unknown name: the closest valid spelling, then all of them.

    Example:
        >>> hint("manhatan", ["manhattan", "cosine"])
        "did you mean 'manhattan'? valid: manhattan, cosine"
    """
    options = [str(option) for option in valid]
    close = get_close_matches(str(name), options, n=1, cutoff=0.5)
    listed = ", ".join(options) if options else "none"
    return (f"did you mean {close[0]!r}? " if close else "") + f"valid: {listed}"
