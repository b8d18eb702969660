"""Exceptions of siamloc, and its warning about what it leaves out."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from difflib import get_close_matches

logger = logging.getLogger("siamloc")

ON_ERROR = ("skip", "raise")


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


class StorageError(SiamlocError, OSError):
    """The disk refused: full, read-only, or gone."""


_OURS = ("siamloc", "analytic", "augment")
_EXTRAS = {"embreex": "simulate", "hydra_plugins": "sweeps", "aiohttp": "live"}


def lacking(error: ModuleNotFoundError) -> str | None:
    """Return a sentence naming the extra that installs a missing package; None for our own modules."""
    package = (error.name or "").partition(".")[0]
    if package in _OURS:
        return None
    return f"this needs {package}, which is not installed here: {installing(_EXTRAS.get(package, 'train'))}"


def installing(extra: str) -> str:
    """Return how to install an extra: from the folder of the source, since no index holds the package.

    >>> installing("live")
    "run pip install '.[live]' in the folder of siamloc's source"
    """
    return f"run pip install '.[{extra}]' in the folder of siamloc's source"


def hint(name: str, valid: Iterable[str]) -> str:
    """Return a hint with the valid spellings, the nearest one first, for the end of an error message."""
    options = [str(option) for option in valid]
    close = get_close_matches(str(name), options, n=1, cutoff=0.5)
    listed = ", ".join(options) if options else "none"
    return (f"did you mean {close[0]!r}? " if close else "") + f"valid: {listed}"


def check_policy(on_error: str) -> None:
    """Raise ConfigError unless `on_error` is "skip" or "raise"."""
    if on_error not in ON_ERROR:
        raise ConfigError(f"on_error={on_error!r} is not a policy; {hint(on_error, ON_ERROR)}")


def leave_out(problems: Sequence[str], total: int, what: str, on_error: str) -> None:
    """Report what had to be left out: one warning line, or an error if `on_error` is "raise".

    Args:
        problems: one text for each thing left out.
        total: how many things there were.
        what: the things and what is wrong with them in words, such as "images listed in FILE do not exist".
        on_error: "skip" or "raise".

    Raises:
        DataError: something was left out and `on_error` is "raise", or nothing remains.
    """
    if not problems:
        return
    message = f"{len(problems)} of {total} {what}, the first: {problems[0]}"
    if len(problems) == total:
        raise DataError(f"{message}; nothing remains")
    if on_error == "raise":
        raise DataError(f"{message} (on_error=skip leaves them out)")
    logger.warning("%s; left out", message)
