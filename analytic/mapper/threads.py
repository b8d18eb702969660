"""One thread for linear algebra while a frame is worked in.

The matrices of a node are so small that sharing them out among threads costs about what it saves, and on a busy
processor, where every thread waits for the last, many times that. It also keeps the number of threads out of the last
digits of what is computed.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any


def one_thread() -> AbstractContextManager[Any]:
    """Return a context in which numpy and scipy use one thread; afterwards as many as before."""
    limited: AbstractContextManager[Any] = _controller().limit(limits=1, user_api="blas")
    return limited


@lru_cache(maxsize=1)
def _controller() -> Any:
    """Return what sets the threads of the libraries that are loaded, those of scipy among them."""
    import scipy.linalg.blas  # noqa: F401 - loads the library of scipy
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
