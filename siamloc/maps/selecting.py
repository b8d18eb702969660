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
from siamloc.maps.survey_checks import comparing_descriptor
from siamloc.maps.survey_steps import comparing

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
    key frame, compared by the network or by odometry, where there is any. A frame that shows another place is compared
    as far away as well, mostly. While the robot stands still or turns on the spot, there are none.

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

    def far(row: int, others: NDArray[np.int64]) -> NDArray[np.bool_]:
        # Whether two images show one place is not asked: the network denies it for those that are nearly the same.
        pose = compared(np.full(len(others), row), others)[0].pose
        seen, rolled = np.hypot(pose[:, 0], pose[:, 1]), np.hypot(*(wheels[others] - wheels[row]).T)
        return np.fmax(seen, rolled) >= spacing

    kept = list[int]()
    for rows in readable.rows_by("sequence").values():
        kept.append(int(rows[0]))
        ahead = rows[1:]
        while len(ahead):
            new = np.flatnonzero(far(kept[-1], ahead[:_AHEAD]))
            if len(new):
                kept.append(int(ahead[new[0]]))
            ahead = ahead[int(new[0]) + 1 if len(new) else _AHEAD :]
    return readable.take(kept)
