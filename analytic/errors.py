"""The exception of this package."""

from __future__ import annotations

from foundation.errors import ConfigError


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
