"""Progress of long work: a bar on a terminal, plain lines elsewhere, and nothing where it is `hidden`."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from typing import Any, TypeVar

Item = TypeVar("Item")
_PAUSE = 10.0  # seconds between plain lines when standard error is not a terminal
_shown = ContextVar("shown", default=True)


@contextmanager
def hidden() -> Iterator[None]:
    """Hide the progress of all work of this thread in a block, or in a function that this decorates; notes stay.

    Example:
        >>> import siamloc
        >>> images = siamloc.data.example()
        >>> with siamloc.progress.hidden():
        ...     known = siamloc.maps.build("hog", images, images.frames)
    """
    before = _shown.set(False)
    try:
        yield
    finally:
        _shown.reset(before)


def shown() -> bool:
    """Whether progress is shown here, and not `hidden`."""
    return _shown.get()


def track(items: Iterable[Item], total: int, what: str, size: Callable[[Item], int] | None = None) -> Iterator[Item]:
    """Yield the items and show the progress, the rate and the time left on standard error.

    Args:
        items: what to work through.
        total: number of items.
        what: the work in words, such as "decoding images".
        size: how many of the total an item counts for, such as `len` for batches; 1 if None.
    """
    if not shown():
        yield from items
        return
    bar = _bar(what, total) if sys.stderr.isatty() else None
    start = last = time.monotonic()
    done, rate = 0, 0.0
    with bar or nullcontext():
        for item in items:
            yield item
            done += 1 if size is None else size(item)
            now = time.monotonic()
            rate = done / max(now - start, 1e-9)
            if bar is not None:
                bar.update(bar.task_ids[0], completed=done, rate=f"{rate:.1f}/s")
            elif now - last >= _PAUSE and 0 < done < total:
                left = (total - done) / rate
                print(f"{what}: {done} of {total}, {rate:.1f}/s, {left:.0f} s left", file=sys.stderr, flush=True)
                last = now
    if bar is None:
        seconds = time.monotonic() - start
        print(f"{what}: {done} of {total} in {seconds:.1f} s ({rate:.1f}/s)", file=sys.stderr, flush=True)


def _bar(what: str, total: int) -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    texts = TextColumn("{task.description}"), TextColumn("{task.fields[rate]}")
    columns = texts[0], BarColumn(), MofNCompleteColumn(), texts[1], TimeRemainingColumn()
    bar = Progress(*columns, console=Console(stderr=True))
    bar.add_task(what, total=total, rate="")
    return bar
