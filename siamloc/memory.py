"""Memory that the process keeps between the steps of a training, instead of asking the system for it again."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

# Names and numbers of malloc.h.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_MMAP_MAX = -1, -3, -4
_USUAL = {_M_MMAP_MAX: 65_536, _M_MMAP_THRESHOLD: 2**25, _M_TRIM_THRESHOLD: 2**26}
"""What glibc begins with; the two thresholds are those that it reaches by itself as large blocks come and go."""


@contextmanager
def kept_memory() -> Iterator[None]:
    """Keep freed memory in the process until the block ends.

    glibc gives each block above 32 MB back to the system as soon as it is freed. A network on a CPU asks for the same
    large blocks at every step, and the system clears them page by page each time, which can take as long as the
    arithmetic. Values do not change. Where the C library is another one, nothing happens.

    Example:
        >>> with kept_memory():
        ...     total = sum(range(4))
        >>> total
        6
    """
    library = _glibc()
    if library is None:
        yield
        return
    library.mallopt(_M_MMAP_MAX, 0)  # no block is mapped on its own,
    library.mallopt(_M_TRIM_THRESHOLD, 2**31 - 1)  # and the heap does not shrink
    try:
        yield
    finally:
        for option, value in _USUAL.items():
            library.mallopt(option, value)
        library.malloc_trim(0)


@cache
def _glibc() -> Any:
    """Return the C library, or None where it is not glibc."""
    if not sys.platform.startswith("linux"):
        return None
    library = ctypes.CDLL(None)
    return library if hasattr(library, "gnu_get_libc_version") and hasattr(library, "mallopt") else None
