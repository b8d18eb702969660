"""Threads: work whose results come in order, and values of the whole process that a block changes for a while."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from threading import RLock
from typing import Any, TypeVar

_LOCK = RLock()
_BEFORE: dict[int, list[Any]] = {}  # by the id of an owner: its value, and how many blocks have to end

Item = TypeVar("Item")
Result = TypeVar("Result")


def processors() -> int:
    """Count the processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else (os.cpu_count() or 1)


def in_order(work: Callable[[Item], Result], items: Iterable[Item], threads: int) -> Iterator[Result]:
    """Yield what a function returns for each item, in order; only a few results wait in memory.

    Args:
        work: function of one item, called from several threads.
        items: arguments of the calls, one each.
        threads: number of threads, at least 1.

    Example:
        >>> list(in_order(abs, [-1, 2, -3], threads=2))
        [1, 2, 3]
    """
    waiting: deque[Future[Result]] = deque()
    pool = ThreadPoolExecutor(threads)
    try:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > 4 * threads:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def each(work: Callable[[Item], Result], items: Sequence[Item], threads: int) -> list[Result]:
    """Return what a function returns for each item, in order, from at most that many threads; with one, from this one.

    Example:
        >>> each(abs, [-1, 2, -3], threads=2)
        [1, 2, 3]
    """
    threads = min(len(items), threads)
    return list(in_order(work, items, threads)) if threads > 1 else [work(item) for item in items]


@contextmanager
def restored(
    owners: Iterable[Item], read: Callable[[Item], Result], write: Callable[[Item, Result], None]
) -> Iterator[None]:
    """Restore values that a `with` block changes and all threads see; an owner has one such value.

    Of blocks that overlap, in any threads, the last to end restores what the first one found.

    Args:
        owners: the objects with a value each.
        read: returns the value of an owner.
        write: sets it.
    """
    with _LOCK:
        found = {id(owner): (owner, read(owner)) for owner in owners}
        for key, (_, value) in found.items():
            _BEFORE.setdefault(key, [value, 0])[1] += 1
    try:
        yield
    finally:
        with _LOCK:
            for key in found:
                _BEFORE[key][1] -= 1
            ended = [(owner, _BEFORE.pop(key)[0]) for key, (owner, _) in found.items() if not _BEFORE[key][1]]
            for owner, value in ended:
                write(owner, value)
