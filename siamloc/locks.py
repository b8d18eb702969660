"""Keep other processes away from a file or a folder for as long as this process lives.

The operating system's locks end with the process that holds them, however it ends, so none has to be removed after a
kill. If a file system or an operating system has no such locks, everything counts as free.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_BUSY = (errno.EACCES, errno.EAGAIN)
_handles: set[int] = set()


@contextmanager
def held(path: str | Path, *, wait: bool = False) -> Iterator[bool]:
    """Lock an existing file or folder against other callers of this function; yield whether that succeeded.

    Args:
        path: what to lock; it may be replaced or removed in the meantime.
        wait: wait until it is free, instead of yielding False at once.

    Raises:
        OSError: it does not exist, or may not be opened.
    """
    while True:
        handle = os.open(path, os.O_RDONLY)
        try:
            free = lock(handle, wait=wait) is not False
            current = not free or is_at(handle, path)
        except BaseException:
            release(handle)
            raise
        if current:
            break
        release(handle)  # it was replaced while this process waited for it
    try:
        yield free
    finally:
        release(handle)


def lock(handle: int, *, wait: bool = False) -> bool | None:
    """Lock an open file or folder, and return whether that succeeded; None if the system has no locks."""
    if fcntl is None:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return False if error.errno in _BUSY else None
    _handles.add(handle)
    return True


def is_at(handle: int, path: str | Path) -> bool:
    """Whether an open file or folder is the one that currently has this name."""
    try:
        return os.path.samestat(os.fstat(handle), Path(path).lstat())
    except FileNotFoundError:
        return False


def release(handle: int) -> None:
    """Close an open file or folder, which unlocks it."""
    _handles.discard(handle)
    with suppress(OSError):
        os.close(handle)


def _leave_to_parent() -> None:
    """Close, in a forked process, what its parent holds: otherwise it would stay locked after the parent ends."""
    for handle in list(_handles):
        release(handle)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_leave_to_parent)
