"""One thread for each image of a batch, instead of several threads for every small operation.

The operations on one image are so small that sharing them out costs about what it saves, and on a busy processor, where
every thread waits for the last, many times that.
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
    """Return the function's results, in order, by as many threads as torch is set to use, without torch by one.

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
    """Return the threads of this process; one that was forked off has none of its parent's."""
    import torch

    pool = ThreadPoolExecutor(threads, thread_name_prefix="analytic")
    begun = Barrier(threads)
    for future in [pool.submit(_alone, begun) for _ in range(threads)]:
        future.result()
    # The setting holds for the thread that makes it and for those that start later, which get the former one back.
    torch.set_num_threads(threads)
    return pool


def _alone(begun: Barrier) -> None:
    """Let one thread of a pool use itself only, once all of them have begun, so that none is set up twice."""
    import torch

    begun.wait()
    torch.set_num_threads(1)
    torch.get_num_threads()  # a thread takes over the setting when it first asks for it
    begun.wait()
