"""Rendering processes, which end together with the process that started them."""

from __future__ import annotations

import os
import signal
import threading
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context, parent_process

import cv2


def rendering_processes(count: int) -> ProcessPoolExecutor:
    """Start rendering processes; they are spawned, so a script needs `if __name__ == "__main__":`."""
    return ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_prepare)


def _prepare() -> None:
    """Limit the process to one thread, since all share the processors; the parent process handles interrupts."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    cv2.setNumThreads(1)


def _end_with_parent() -> None:
    """Stop this process when its parent is killed: nobody would collect its work."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
