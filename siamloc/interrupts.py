"""Ctrl-C in a process of its own: the first stops what goes on and cleans up, the second ends the process at once."""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType
from typing import Any

_SOON = 0.02
"""Seconds until an interrupt that Python ignored is raised again, outside of what could not be interrupted."""


def stop_once(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt; from then on the system ends the process, without a word.

    What is then half written is removed by the next command that writes it.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    raise KeyboardInterrupt


def hear_again() -> None:
    """Have an interrupt raised again that came where Python ignores it and goes on, as in a destructor."""
    usual = sys.unraisablehook

    def press() -> None:
        main = threading.main_thread().ident
        if main is not None and signal.getsignal(signal.SIGINT) is stop_once:
            signal.pthread_kill(main, signal.SIGINT)

    def hook(ignored: Any) -> None:
        pressed = issubclass(ignored.exc_type, KeyboardInterrupt)
        if not pressed or threading.current_thread() is not threading.main_thread():
            usual(ignored)
            return
        if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:  # as `stop_once` left it
            signal.signal(signal.SIGINT, stop_once)
            again = threading.Timer(_SOON, press)
            again.daemon = True
            again.start()

    sys.unraisablehook = hook


def follows_from(error: BaseException | None) -> bool:
    """Say whether an error is a KeyboardInterrupt, or what became of one on its way up."""
    seen = set[int]()
    while error is not None and id(error) not in seen:
        if isinstance(error, KeyboardInterrupt):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False
