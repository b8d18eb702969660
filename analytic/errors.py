"""The exception of this package, and the hint at the end of its messages."""

from __future__ import annotations

from collections.abc import Iterable

from foundation.errors import ConfigError, hint


class AnalyticError(ConfigError):
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
    """Check that a name, such as the name of a descriptor, is among the valid ones, and return it.

    Args:
        name: the name.
        valid: the valid names.
        what: noun for a valid name in the error message, such as "descriptor".

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
