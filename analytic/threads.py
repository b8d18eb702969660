"""One thread for each image of a batch, instead of several threads for every small operation.

The operations on one image are so small that sharing them among threads costs about as much as it saves, and on a busy
processor, where every thread waits for the last, many times as much.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from threading import Barrier
from typing import Any


def each(function: Callable[[Any], Any], parts: Sequence[Any]) -> list[Any]:
    """Apply a function to parts, with as many threads as torch is set to use, or one without torch; keep the order.

    Every part is computed by one thread, so that results do not depend on the number of threads.

    Example:
        >>> each(abs, [-1, 2, -3])
        [1, 2, 3]
    """
    torch = sys.modules.get("torch")
    threads = 1 if torch is None else torch.get_num_threads()
    if torch is None or threads == 1:
        return [function(part) for part in parts]
    if len(parts) == 1:
        torch.set_num_threads(1)
        try:
            return [function(parts[0])]
        finally:
            torch.set_num_threads(threads)
    return list(_pool(threads, os.getpid()).map(function, parts))


@lru_cache(maxsize=1)
def _pool(threads: int, process: int) -> ThreadPoolExecutor:
    """Return the threads of this process; a forked process has none of its parent's."""
    import torch

    pool = ThreadPoolExecutor(threads, thread_name_prefix="analytic")
    begun = Barrier(threads)
    for future in [pool.submit(_alone, begun) for _ in range(threads)]:
        future.result()
    # The setting applies to this thread and to those that start later; restore the previous one for these.
    torch.set_num_threads(threads)
    return pool


def _alone(begun: Barrier) -> None:
    """Limit one thread of a pool to itself, once all of them have started, so that none is set up twice."""
    import torch

    begun.wait()
    torch.set_num_threads(1)
    torch.get_num_threads()  # a thread adopts the setting when it first queries it
    begun.wait()
