"""`siamloc` and `python -m siamloc`: the process around `siamloc.cli.main`."""

import os
import signal
import sys
from pathlib import Path
from typing import NoReturn

from siamloc.interrupts import hear_again, stop_once


def entry() -> NoReturn:
    """Run the command given by this process's arguments, and exit."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # closed by the shell, as by >&-
            setattr(sys, name, Path(os.devnull).open("w", encoding="utf-8"))  # noqa: SIM115 (until the end)
        if getattr(stream := getattr(sys, name), "errors", "") == "strict":  # for letters that a terminal lacks
            stream.reconfigure(errors="backslashreplace")
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, stop_once)
        hear_again()
    try:
        from siamloc.cli import main

        status = main()
    except KeyboardInterrupt:  # while loading it
        status = 130
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # exiting is quick, and needs no message when interrupted
    sys.exit(status)


if __name__ == "__main__":
    entry()
