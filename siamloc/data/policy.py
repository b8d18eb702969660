"""What becomes of files that cannot be used: they are left out, counted and reported, or they stop the run."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from siamloc.errors import ConfigError, DataError, hint

logger = logging.getLogger("siamloc")

POLICIES = ("skip", "raise")


def check_policy(on_error: str) -> None:
    """Raise ConfigError unless `on_error` is "skip" or "raise"."""
    if on_error not in POLICIES:
        raise ConfigError(f"on_error={on_error!r} is not a policy; {hint(on_error, POLICIES)}")


def leave_out(problems: Sequence[str], total: int, what: str, on_error: str) -> None:
    """Report the things that had to be left out: one warning line, or an error for the strict.

    Args:
        problems: one text for each thing left out.
        total: how many things there were.
        what: the things and their fault in words, such as "images listed in FILE do not exist".
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
