"""`key_frames`: the frames of a drive that show something new."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from foundation.calls import typed
from foundation.settings import Positive
from siamloc.data.frames import FrameTable
from siamloc.maps.comparing import scaled
from siamloc.maps.describing import build
from siamloc.maps.survey_steps import ODDS, comparing
from siamloc.maps.surveying import comparing_descriptor

if TYPE_CHECKING:
    from torch import nn

    from analytic import Descriptor
    from siamloc.data.library import PanoramaLibrary

_AHEAD = 6  # frames that are compared with the last key frame at once


@typed
def key_frames(
    network: Descriptor | nn.Module | str,
    images: PanoramaLibrary,
    frames: FrameTable,
    *,
    spacing: Positive = 0.3,
    progress: bool = True,
) -> FrameTable:
    """Choose the frames of drives that show something new; positions in `frames` are not used.

    The first frame of a drive is a key frame, and so is each one that was taken at least `spacing` metres from the last
    key frame, compared by the network or by odometry, where there is any. Before a frame that shows another place than
    the last key frame, as after a door, the frame before it is a key frame, so that each can be compared with the next.
    While the robot stands still or turns on the spot, there are none.

    Args:
        network: a network that compares images, built with relative=True; "pretrained" is the shipped one.
        images: panoramas of the frames.
        frames: frames in capture order within each drive (`sequence`); those that cannot be read are left out.
        spacing: distance of two key frames in metres, at least. Without odometry, comparisons measure it, to some
            percent.
        progress: whether to show the progress.

    Raises:
        ConfigError: a network that does not compare.
        DataError: no image can be read.

    Example:
        >>> chosen = siamloc.maps.key_frames("pretrained", images, video)  # doctest: +SKIP
        >>> found = siamloc.maps.survey("pretrained", images, chosen)  # doctest: +SKIP
    """
    described, readable = comparing_descriptor(network, images.circular), images.readable(frames)
    rolled = readable.with_columns(**dict(zip(("x", "y", "theta"), readable.odometry.T, strict=True)))
    parts = build(described, images, rolled, progress=progress).turning().orientation
    assert parts is not None
    compared, wheels = comparing(described.compare, scaled(parts), False), readable.odometry[:, :2]

    def against(row: int, others: NDArray[np.int64]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which other frames were taken far from a frame, and which show another place."""
        pose, _, odds = compared(np.full(len(others), row), others)
        seen, rolled = np.hypot(pose[:, 0], pose[:, 1]), np.hypot(*(wheels[others] - wheels[row]).T)
        return np.fmax(np.where(odds < ODDS, 0, seen), rolled) >= spacing, odds < ODDS

    kept = list[int]()
    for rows in readable.rows_by("sequence").values():
        kept.append(int(rows[0]))
        last, ahead = 0, 1  # places of the last key frame, and of the first frame that was not compared with it
        while ahead < len(rows):
            far, unlike = against(kept[-1], rows[ahead : ahead + _AHEAD])
            new = np.flatnonzero(far | unlike)
            if not len(new):
                ahead += _AHEAD
                continue
            place = ahead + int(new[0])
            last = place - 1 if unlike[new[0]] and place - 1 > last else place
            kept.append(int(rows[last]))
            ahead = last + 1
    return readable.take(kept)
