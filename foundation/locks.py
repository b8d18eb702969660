"""Locks against other processes; one ends with the process that holds it, even by a kill."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from foundation.errors import ConfigError
from foundation.files import storage_errors

LOCK = ".lock"
"""Name of the lock file in a folder that only one process may write into."""


@contextmanager
def locked(file: Path, *, wait: bool = True) -> Iterator[bool]:
    """Hold a lock file inside a `with` block, remove it at the end, and yield whether it could be locked.

    Where the file system has no locks, as in some network folders, nothing is locked, and it yields True.

    Args:
        file: the lock file, in an existing folder.
        wait: wait until no other process holds it; otherwise yield False if one does.

    Raises:
        StorageError: the disk refuses.
    """
    lock = FileLock(file, mode=0o666)
    lockable = True
    with storage_errors(file), suppress(Timeout):
        try:
            lock.acquire(timeout=-1 if wait else 0)
        except OSError as error:
            if error.errno not in (errno.ENOLCK, errno.ENOTSUP):
                raise
            lockable = False
    try:
        yield lock.is_locked or not lockable
    finally:
        if lock.is_locked or not lockable:
            file.unlink(missing_ok=True)  # a process that waits for it makes a new one
        lock.release()


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Keep other callers of this function out of a folder, which is created, and removed if an error leaves it empty.

    Raises:
        ConfigError: another process is using the folder.
        StorageError: the disk refuses.
    """
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    try:
        with locked(folder / LOCK, wait=False) as free:
            if not free:
                raise ConfigError(f"another process is writing into {folder}: wait for it, or choose another folder")
            yield
    except BaseException:
        with suppress(OSError):  # it is not empty
            folder.rmdir()
        raise
