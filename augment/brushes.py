"""Paint on 8-bit frames in main memory: each frame in place, several frames at once in threads.

A brush is a function that alters one frame (3, H, W) uint8. Working frame by frame keeps the data in the
processor's cache, and a frame costs only the effects applied to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from foundation.threads import each

Frame = NDArray[np.uint8]
Brush = Callable[[Frame], None]


def paint(frames: Frame, brushes: Sequence[Sequence[Brush]]) -> None:
    """Alter frames (B, 3, H, W) in place, each with its own brushes, in order; uses torch's number of threads."""

    def alter(number: int) -> None:
        for brush in brushes[number]:
            brush(frames[number])

    each(alter, range(len(frames)), torch.get_num_threads())


def flat(frame: Frame) -> Frame:
    """Return a view (3 H, W) of a frame, for operations that treat every pixel alike."""
    return frame.reshape(-1, frame.shape[2])
