"""The exceptions that all packages share, and parts of their messages."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any


class SiamlocError(Exception):
    """Base of every error that siamloc raises on purpose.

    The message says what was expected, what was found, which file or key it concerns, and what to do. The command
    line prints it on one line and exits with status 2.
    """


class DataError(SiamlocError, ValueError):
    """Files, tables or images that cannot be used as they are."""


class ConfigError(SiamlocError, ValueError):
    """A parameter or a configuration key that has no meaning, or that contradicts another one."""


class FormatError(SiamlocError, ValueError):
    """A file that siamloc wrote and cannot read back: cut short, altered, or of another version."""


class OldFormatError(FormatError):
    """A file that an older siamloc wrote, in a version of its format that is no longer read."""


class StorageError(SiamlocError, OSError):
    """The disk refused: full, read-only, or gone."""


def hint(name: object, valid: Iterable[object]) -> str:
    """Return the end of an error message about an unknown name: the nearest valid spelling, then all of them.

    Example:
        >>> hint("manhatan", ["manhattan", "cosine"])
        "did you mean 'manhattan'? valid: manhattan, cosine"
        >>> hint("optimizer.lr", ["optimizer.name", "optimizer.learning_rate"]).partition("?")[0]
        "did you mean 'optimizer.learning_rate'"
    """
    options = [str(option) for option in valid]
    close = [option for option in options if "_" in option and _initials(option) == str(name)]
    close = close or get_close_matches(str(name), options, n=1, cutoff=0.5)
    listed = ", ".join(options) if options else "none"
    return (f"did you mean {close[0]!r}? " if close else "") + f"valid: {listed}"


def known(name: Any, valid: Iterable[str], what: str, error: type[Exception] = ConfigError) -> Any:
    """Return a name, such as that of a descriptor, if it is among the valid ones.

    Args:
        name: the name.
        valid: the valid names.
        what: noun for a valid name in the error message, such as "descriptor".
        error: class of the error.

    Raises:
        ConfigError: the name is not valid; or another `error`.

    Example:
        >>> known("hog", ["gist", "hog"], "descriptor")
        'hog'
    """
    options = list(valid)
    if not isinstance(name, str) or name not in options:
        raise error(f"unknown {what} {name!r}: {hint(name, options)}")
    return name


def not_yaml(file: object, error: Exception) -> str:
    """Return the error message about a file that is not YAML: the line, if the parser names one, and what is wrong.

    Example:
        >>> import yaml
        >>> try:
        ...     yaml.safe_load("a: 1\\nb: c: d")
        ... except yaml.YAMLError as error:
        ...     print(not_yaml("own.yaml", error))
        own.yaml, line 2, is not YAML: mapping values are not allowed here
    """
    mark = getattr(error, "problem_mark", None)
    line = f", line {mark.line + 1}," if mark else ""
    return f"{file}{line} is not YAML: {getattr(error, 'problem', None) or ' '.join(str(error).split())}"


def _initials(name: str) -> str:
    """Shorten the last part of a dotted name to the initials of its words."""
    group, dot, last = name.rpartition(".")
    return group + dot + "".join(word[:1] for word in last.split("_"))
