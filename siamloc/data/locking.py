"""Locks between processes, by `flock` on a file; where there is no `flock`, work goes on without."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from siamloc.data.policy import logger

try:
    import fcntl
except ImportError:  # pragma: no cover (not on POSIX)
    fcntl = None  # type: ignore[assignment]

_BUSY = (errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES)
_UNSUPPORTED = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL)


@contextmanager
def exclusive(path: Path, message: str) -> Iterator[bool]:
    """Hold the lock file `path` during the block; the operating system frees it if the process dies.

    Args:
        path: the lock file; it is removed at the end.
        message: logged as a warning when another process holds the lock and this one has to wait.

    Yields:
        True, or False where the file system has no locks, so that others may be at the same work.
    """
    handle = _acquire(path, message)
    try:
        yield handle is not None
    finally:
        if handle is not None:
            # Removed while held: who waits for it finds that its file is gone, and opens another.
            with suppress(OSError):
                path.unlink()
            os.close(handle)


def is_locked(path: Path) -> bool:
    """Tell whether a process holds the lock file `path`."""
    if fcntl is None:
        return False
    try:
        handle = os.open(path, os.O_RDWR)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno in _BUSY
    else:
        return False
    finally:
        os.close(handle)


def _acquire(path: Path, message: str) -> int | None:
    if fcntl is None:
        return None
    told = False
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                if error.errno not in _BUSY:
                    raise
                if not told:
                    logger.warning("%s", message)
                    told = True
                fcntl.flock(handle, fcntl.LOCK_EX)
            with suppress(FileNotFoundError):
                if os.path.samestat(path.stat(), os.fstat(handle)):
                    return handle
        except OSError as error:
            os.close(handle)
            if error.errno in _UNSUPPORTED:
                logger.warning("no locks on the file system of %s: start one build at a time there", path.parent)
                return None
            raise
        os.close(handle)
