"""One thread for each image of a batch, instead of several threads for every small operation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import cv2

from foundation.threads import in_order


def each(function: Callable[[Any], Any], parts: Sequence[Any]) -> list[Any]:
    """Apply a function to each item of a batch in threads, as many as `cv2.setNumThreads` allows; keep the order.

    Every part is computed by one thread, so that results do not depend on the number of threads.

    Example:
        >>> each(abs, [-1, 2, -3])
        [1, 2, 3]
    """
    threads = min(len(parts), cv2.getNumThreads())
    return list(in_order(function, parts, threads)) if threads > 1 else [function(part) for part in parts]
