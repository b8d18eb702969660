"""Paint on 8-bit frames in main memory: each frame in place, several frames at once in threads.

A brush is a function that alters one frame (3, H, W) uint8. Working frame by frame keeps the data in the
processor's cache, and a frame costs only the effects applied to it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
import torch
from numpy.typing import NDArray

Frame = NDArray[np.uint8]
Brush = Callable[[Frame], None]


def paint(frames: Frame, brushes: Sequence[Sequence[Brush]]) -> None:
    """Alter frames (B, 3, H, W) in place, each with its own brushes, in order; uses torch's number of threads."""
    threads = max(min(torch.get_num_threads(), len(frames)), 1)
    work = [_threads().submit(_paint_some, frames, brushes, first, threads) for first in range(1, threads)]
    _paint_some(frames, brushes, 0, threads)
    for future in work:
        future.result()


def flat(frame: Frame) -> Frame:
    """Return a view (3 H, W) of a frame, for operations that treat every pixel alike."""
    return frame.reshape(-1, frame.shape[2])


def _paint_some(frames: Frame, brushes: Sequence[Sequence[Brush]], first: int, step: int) -> None:
    for index in range(first, len(frames), step):
        for brush in brushes[index]:
            brush(frames[index])


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_name_prefix="augment")


# A forked loader process inherits the object but not its threads.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_threads.cache_clear)
