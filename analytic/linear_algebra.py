"""One thread for linear algebra on small matrices.

The matrices of the mapper's nodes and the steps of k-means are so small that sharing them among threads saves about as
much as it costs, and on a busy processor, where every thread waits for the last, it costs ten times as much. A single
thread also keeps the number of threads out of the last digits of the results. The setting holds for the whole process,
so callers in different threads take turns; otherwise the first to finish would end it for the others, and the last
would leave it behind.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from threading import RLock
from typing import Any

_LOCK = RLock()


@contextmanager
def one_thread(*, openmp: bool = False) -> Iterator[None]:
    """Let numpy and scipy use one thread inside a `with` block; afterwards as many as before.

    Args:
        openmp: also limit libraries with threads of their own, such as scikit-learn. This takes longer to enter, since
            the loaded libraries are looked up each time.
    """
    with _LOCK:
        if openmp:
            from threadpoolctl import threadpool_limits

            with threadpool_limits(1):
                yield
        else:
            with _controller().limit(limits=1, user_api="blas"):
                yield


@lru_cache(maxsize=1)
def _controller() -> Any:
    """Return what sets the threads of the libraries that are loaded, those of scipy among them."""
    import scipy.linalg.blas  # noqa: F401 - loads the library of scipy
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
