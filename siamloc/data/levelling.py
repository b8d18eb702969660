"""Find how far a camera was tilted when it took a panorama, by the edges that stand upright in a building.

Corners, doors and cupboards stand upright, and so do their edges in a panorama whose rows are even in the tangent t of
the elevation, as those of `PanoramaView` are. If the robot is tilted by small angles, the edges lean: an edge in the
direction a moves sideways by t (roll cos a + pitch sin a), so that edges all around show both angles at once.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from siamloc.data.panorama import PanoramaView, column_azimuth

SIZE = 128, 512
"""Rows and columns of the panoramas that show tilts well: to some 0.3 degrees, and half their size to some 0.6."""
_DARK = 8.0  # grey levels: noise is no edge
_BLUR = 0.8  # pixels: a sharp edge that leans shows a few steps, and upright pieces between them
_AROUND = 4  # pixels beyond the seam, and between what is looked at and what the camera does not see
_CLEAR = 0.2  # change of the logarithm of the brightness, in a pixel, from which on every edge counts alike
_STEEPEST = 0.5  # sideways over up: edges that lean more are not upright ones
# Standard deviation, in each round, of the lean of the edges that count.
_WIDTHS = [max(0.35 * 0.75**step, 0.05) for step in range(12)]
_FEW = 10.0  # clear pixels: with so few, the tilt that they show is halved


def tilt_of(
    panorama: NDArray[np.uint8], view: PanoramaView, sees: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    """Return the roll and pitch of the robot in rad (2,), with the signs of `PanoramaView.tilted`.

    Args:
        panorama: (H, W, 3), uint8.
        view: its elevations.
        sees: (H, W) which pixels the camera sees; all if None. What fills the others shows edges that never lean.

    Example:
        >>> upright = np.tile(np.repeat(np.uint8([[0], [200]]), 16, axis=0), (128, 16, 3))
        >>> bool(np.abs(tilt_of(upright, PanoramaView())).max() < 1e-6)
        True
    """
    rows, columns = panorama.shape[:2]
    wide = np.pad(panorama.mean(axis=-1, dtype=np.float32), ((0, 0), (_AROUND, _AROUND)), mode="wrap")
    grey = np.log(cv2.GaussianBlur(wide, (0, 0), _BLUR) + _DARK)
    inside = np.s_[1:-1, _AROUND:-_AROUND]
    across, down = (cv2.Scharr(grey, cv2.CV_32F, *order, scale=1 / 32)[inside] for order in ((1, 0), (0, 1)))
    high, low = np.tan(np.radians([view.top, view.bottom]))
    clear = np.minimum(np.hypot(across, down) / _CLEAR, 1.0)
    upright = np.abs(down) * 2 * np.pi * rows < _STEEPEST * np.abs(across) * columns * (high - low)
    if sees is not None and not sees.all():
        hidden = np.pad(~sees, ((0, 0), (_AROUND, _AROUND)), mode="wrap").astype(np.uint8)
        upright &= cv2.dilate(hidden, np.ones((2 * _AROUND + 1, 2 * _AROUND + 1)))[inside] == 0
    lean = down[upright] / across[upright] * (2 * np.pi * rows / (columns * (high - low)))
    azimuth = np.broadcast_to(column_azimuth(columns), upright.shape)[upright]
    by: NDArray[Any] = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    tilt = np.zeros(2)
    for width in _WIDTHS:
        weight = (clear[upright] * np.exp(-(((lean - by @ tilt) / width) ** 2) / 2))[:, None] * by
        tilt = np.linalg.solve(weight.T @ by + _FEW / 2 * np.eye(2), weight.T @ lean)
    return -tilt
