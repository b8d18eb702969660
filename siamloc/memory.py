"""Control what the C library does with freed memory: keep it, or give it back to the system.

If the C library is not glibc, nothing changes.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from typing import Any

# Names and numbers of malloc.h.
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_MMAP_MAX = -1, -3, -4
_KEEP = {_M_MMAP_MAX: 0, _M_TRIM_THRESHOLD: -1}  # no block is mapped on its own, and the heap never shrinks
_GIVE_BACK = {_M_MMAP_THRESHOLD: 2**17, _M_TRIM_THRESHOLD: 2**17}  # bytes; the initial values of glibc
_USUAL = {_M_MMAP_MAX: 65_536, _M_MMAP_THRESHOLD: 2**25, _M_TRIM_THRESHOLD: 2**26}
"""The defaults of glibc; the two thresholds are those that it reaches by itself as large blocks come and go."""


@contextmanager
def kept_memory() -> Iterator[None]:
    """Keep freed memory in the process until the `with` block ends, for the steps of a training.

    glibc gives each block above 32 MB back to the system as soon as it is freed. A network on a CPU asks for the same
    large blocks at every step, and the system clears them page by page each time, which can take as long as the
    arithmetic. Values do not change.

    Example:
        >>> with kept_memory():
        ...     total = sum(range(4))
        >>> total
        6
    """
    with _adjusted(_KEEP):
        yield
    if (library := _glibc()) is not None:
        library.malloc_trim(0)


@contextmanager
def returned_memory() -> Iterator[None]:
    """Return large freed blocks to the system at once until the `with` block ends, for the start of a robot.

    glibc keeps freed blocks up to the size of the largest one freed before, at most 32 MB, since such a size often
    comes again. The weights of a network are read, reordered and freed once, and never again: keeping their memory
    would be half of what a robot holds. Afterwards each image reuses the memory of the one before.

    Example:
        >>> with returned_memory():
        ...     total = sum(range(4))
        >>> total
        6
    """
    with _adjusted(_GIVE_BACK):
        yield


@contextmanager
def _adjusted(options: Mapping[int, int]) -> Iterator[None]:
    _adjust(options)
    try:
        yield
    finally:
        _adjust(_USUAL)


def _adjust(options: Mapping[int, int]) -> None:
    if (library := _glibc()) is not None:
        for option, value in options.items():
            library.mallopt(option, value)


@cache
def _glibc() -> Any:
    """Return the C library, or None if it is not glibc."""
    if not sys.platform.startswith("linux"):
        return None
    library = ctypes.CDLL(None)
    return library if hasattr(library, "gnu_get_libc_version") and hasattr(library, "mallopt") else None
