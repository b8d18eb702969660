"""Progress of long work: a bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")


def track(
    items: Iterable[Item],
    total: int,
    what: str,
    every_seconds: float = 10.0,
    size: Callable[[Item], int] | None = None,
) -> Iterator[Item]:
    """Yield the items and show the progress, the rate and the time left on standard error.

    Args:
        items: what to work through.
        total: how many there are.
        what: the work in words, such as "decoding images".
        every_seconds: time between plain lines when standard error is not a terminal.
        size: how many of the total an item counts for, such as `len` for batches; 1 if None.
    """
    if sys.stderr.isatty():
        yield from _bar(items, total, what, size or _one)
    else:
        yield from _lines(items, total, what, every_seconds, size or _one)


def _one(item: object) -> int:
    return 1


def _bar(items: Iterable[Item], total: int, what: str, size: Callable[[Item], int]) -> Iterator[Item]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    start = time.monotonic()
    done = 0
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task(what, total=total, rate="")
        for item in items:
            yield item
            done += size(item)
            rate = done / max(time.monotonic() - start, 1e-9)
            progress.update(task, completed=done, rate=f"{rate:.1f}/s")


def _lines(
    items: Iterable[Item], total: int, what: str, every_seconds: float, size: Callable[[Item], int]
) -> Iterator[Item]:
    start = last = time.monotonic()
    done = 0
    for item in items:
        yield item
        done += size(item)
        now = time.monotonic()
        if now - last >= every_seconds and done < total:
            rate = done / (now - start)
            left = (total - done) / rate
            print(f"{what}: {done} of {total}, {rate:.1f}/s, {left:.0f} s left", file=sys.stderr, flush=True)
            last = now
    seconds = time.monotonic() - start
    rate_text = f"{done / seconds:.1f}/s" if seconds > 0 and done else "0/s"
    print(f"{what}: {done} of {total} in {seconds:.1f} s ({rate_text})", file=sys.stderr, flush=True)
