"""Ctrl-C and SIGTERM: the first one stops the work and cleans up, the second ends the process at once."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_SOON = 0.02
"""Seconds until an interrupt that Python ignored is raised again, outside the code that could not be interrupted."""


def stop_once(number: int, frame: FrameType | None) -> None:
    """Handle Ctrl-C or SIGTERM: raise KeyboardInterrupt, and let the system end the process at the next one.

    Half-written files are then removed by the next command that writes them.
    """
    signal.signal(number, signal.SIG_DFL)
    raise KeyboardInterrupt


@contextmanager
def handled(number: int, handler: Callable[..., None], *usual: Any) -> Iterator[bool]:
    """Let a function handle a signal inside a `with` block, if one of the usual handlers would have handled it.

    Yields whether the function handles the signal: outside of the main thread Python takes no handlers.
    """
    before = signal.getsignal(number)
    if before not in usual or threading.current_thread() is not threading.main_thread():
        yield False
        return
    signal.signal(number, handler)
    try:
        yield True
    finally:
        signal.signal(number, before)


@contextmanager
def sigterm_stops() -> Iterator[None]:
    """Stop the work inside at SIGTERM, as `systemctl stop` and `docker stop` send it, as at Ctrl-C.

    Trainings have a way of their own, see `siamloc.training.stopping`.

    Raises:
        SystemExit: with 143, once the work has stopped by SIGTERM.
    """
    with handled(signal.SIGTERM, stop_once, signal.SIG_DFL) as heard:
        try:
            yield
        except KeyboardInterrupt:
            if heard and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:  # as `stop_once` left it
                raise SystemExit(143) from None
            raise


def hear_again() -> None:
    """Raise KeyboardInterrupt again if it came where Python ignores it, such as in a destructor."""
    usual = sys.unraisablehook

    def press() -> None:
        main = threading.main_thread().ident
        if main is not None and signal.getsignal(signal.SIGINT) is stop_once:
            if hasattr(signal, "pthread_kill"):  # ends a wait of the system, too
                signal.pthread_kill(main, signal.SIGINT)
            else:
                _thread.interrupt_main()

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
    """Whether an error is a KeyboardInterrupt, or was raised while handling one."""
    seen = set[int]()
    while error is not None and id(error) not in seen:
        if isinstance(error, KeyboardInterrupt):
            return True
        seen.add(id(error))
        error = error.__cause__ or error.__context__
    return False
