"""One thread for linear algebra on small matrices.

The matrices of a node, and short steps of k-means, are so small that sharing them out among threads costs about what it
saves, and on a busy processor, where every thread waits for the last, many times that. It also keeps the number of
threads out of the last digits of what is computed. The setting is one for the whole process, so that of several that
ask for it in threads of their own one works at a time; otherwise the first to finish would take it from the others, and
the last would leave it behind.
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
    """Return a context in which numpy and scipy use one thread; afterwards as many as before.

    Args:
        openmp: also for what shares out its own loops, such as scikit-learn. It takes longer to enter, since what is
            loaded is looked up anew.
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
