"""Exceptions of siamloc, and its warning about what it leaves out."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Literal

from foundation.errors import ConfigError, DataError, FormatError, OldFormatError, SiamlocError, StorageError, hint

__all__ = ["ConfigError", "DataError", "FormatError", "OldFormatError", "SiamlocError", "StorageError", "hint"]

logger = logging.getLogger("siamloc")

Policy = Literal["skip", "raise"]
"""What happens to images that cannot be read: they are left out and reported, or the first one is an error."""


@cache
def say_once(text: str) -> None:
    """Warn, unless the same was said before in this process."""
    logger.warning("%s", text)


def in_one_line(error: Exception) -> str:
    """Return an exception of a user's own code in one line: its type, and the start of what it says."""
    return ": ".join(filter(None, [type(error).__name__, " ".join(str(error).split())[:300]]))


@contextmanager
def explained(what: str, kind: type[SiamlocError] = ConfigError) -> Iterator[None]:
    """Turn whatever the code of others raises into an error of siamloc that says what failed, and what the code says.

    Args:
        what: the beginning of the sentence, such as "the network cannot take these images".
        kind: class of the error. Errors of siamloc stay as they are.
    """
    try:
        yield
    except SiamlocError:
        raise
    except Exception as error:
        raise kind(f"{what}: {in_one_line(error)}") from error


def leave_out(problems: Sequence[str], total: int, what: str, on_error: str) -> None:
    """Report files or frames that are left out: one warning line, or an error if `on_error` is "raise".

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


def check_known(values: Iterable[str], names: Iterable[str], where: str) -> None:
    """Refuse a mapping with a key that is not among the valid names.

    Args:
        values: the keys of the mapping.
        names: the valid names.
        where: the mapping's own key, which precedes the names in the message, such as "task.filter_settings".

    Raises:
        ConfigError: an unknown key, with the nearest valid one.
    """
    before = f"{where}." if where else ""
    valid = sorted(f"{before}{name}" for name in names)
    for key in (f"{before}{value}" for value in values):
        if key not in valid:
            raise ConfigError(f"unknown configuration key {key!r}: {hint(key, valid)}")
