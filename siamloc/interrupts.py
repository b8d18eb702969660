"""Ctrl-C in a process of its own: the first stops what goes on and cleans up, the second ends the process at once."""

from __future__ import annotations

import signal
from types import FrameType


def stop_once(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt; from then on the system ends the process, without a word.

    What is then half written is removed by the next command that writes it.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    raise KeyboardInterrupt


def follows_from(error: BaseException | None) -> bool:
    """Say whether an error is a KeyboardInterrupt, or what became of one on its way up."""
    seen = set[int]()
    while error is not None and id(error) not in seen:
        if isinstance(error, KeyboardInterrupt):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False
