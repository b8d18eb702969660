"""`Stopwatch`: the time per image that each step takes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from statistics import median


@dataclass
class Stopwatch:
    """Measure the time per image that each step, such as "search", takes, batch by batch.

    Example:
        >>> clock = Stopwatch()
        >>> with clock.of("search", images=4):
        ...     _ = sum(range(1000))
        >>> 0 < clock.ms("search") < 1000
        True
    """

    batches: dict[str, list[tuple[float, int]]] = field(default_factory=dict)

    @contextmanager
    def of(self, step: str, images: int) -> Iterator[None]:
        """Measure the time of a `with` block as the step's time for this number of images."""
        start = time.perf_counter()
        yield
        if images:
            self.batches.setdefault(step, []).append((time.perf_counter() - start, images))

    def ms(self, step: str) -> float | None:
        """Return the milliseconds per image of a step; None if the step did not run.

        This is the median over the batches; the first of several, in which everything is loaded, does not count.
        """
        batches = self.batches.get(step, [])
        return median(1000 * seconds / images for seconds, images in batches[1:] or batches) if batches else None
