"""One thread for linear algebra on small matrices.

The matrices of the mapper's nodes and the steps of k-means are so small that sharing them among threads saves about as
much as it costs, and on a busy processor, where every thread waits for the last, it costs ten times as much. With a
single thread the last digits of the results also do not depend on the number of threads. The setting applies to the
whole process, so callers in different threads take turns; otherwise the first to finish would reset it for the others,
and the last would leave it set.
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
    """Limit numpy and scipy to one thread inside a `with` block, and restore the setting afterwards.

    Args:
        openmp: also limit libraries with threads of their own, such as scikit-learn. This takes longer to enter, since
            the loaded libraries are looked up each time.
    """
    from threadpoolctl import threadpool_limits

    with _LOCK, threadpool_limits(1) if openmp else _controller().limit(limits=1, user_api="blas"):
        yield


@lru_cache(maxsize=1)
def _controller() -> Any:
    """Return the controller of the threads of the loaded libraries, including those of scipy."""
    import scipy.linalg.blas  # noqa: F401 - loads the library of scipy
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
