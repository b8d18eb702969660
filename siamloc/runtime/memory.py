"""Memory that a robot frees while it starts goes back to the system at once."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager

_TRIM, _MAPPED = -1, -3  # M_TRIM_THRESHOLD and M_MMAP_THRESHOLD of glibc's mallopt
_WHILE_STARTING = 1 << 17  # bytes, with which glibc begins
_AFTERWARDS = 1 << 25  # bytes, the most that glibc comes to by itself


@contextmanager
def given_back() -> Iterator[None]:
    """Give large blocks back to the system as soon as they are freed.

    glibc keeps freed blocks as large as the largest one that was freed before, up to 32 MB, since such a size often
    comes again. The weights of a network are read, put in another order and freed once, and never again: what is kept
    of them is half of what a robot would hold. Afterwards glibc keeps what it comes to by itself, so that images find
    their memory where the last one left it. With another library than glibc nothing changes.
    """
    try:
        adjust = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):
        yield
        return
    adjust(_MAPPED, _WHILE_STARTING)
    adjust(_TRIM, _WHILE_STARTING)
    try:
        yield
    finally:
        adjust(_MAPPED, _AFTERWARDS)
        adjust(_TRIM, 2 * _AFTERWARDS)
