"""`siamloc` and `python -m siamloc`: the process around `siamloc.cli.main`."""

import signal
import sys
from typing import NoReturn

from siamloc.interrupts import hear_again, stop_once


def entry() -> NoReturn:
    """Run the command of this process's arguments, and leave."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, stop_once)
        hear_again()
    try:
        from siamloc.cli import main

        status = main()
    except KeyboardInterrupt:  # while it was loaded
        status = 130
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # leaving is quick, and has nothing to say when it is interrupted
    sys.exit(status)


if __name__ == "__main__":
    entry()
