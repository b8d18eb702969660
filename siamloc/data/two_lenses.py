"""Tell the pictures of two fisheye lenses side by side from whole equirectangular ones: both are 2 : 1."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from siamloc.data.cameras import DualFisheyeCamera, EquirectangularCamera, twice_as_wide
from siamloc.data.panorama import Array, OmnidirectionalCamera

_DARK, _AROUND = 24, 1.05  # grey value of what a lens does not show, and radii from its centre on
_FLARE = 0.5  # of the brightness in the circles, by which light may stray around them
_ROWS = 64  # that are looked at
_LEAST = 0.05  # share of a picture that lenses do not show


def two_circles(picture: Array) -> bool:
    """Return whether a picture (rows, columns, 3) is dark around the largest circles in its halves, and not in them.

    Compared are the upper and lower quarters: a whole picture without ceiling and floor is dark there throughout.
    """
    outside = _around(*picture.shape[:2])
    grey = _few(picture).mean(axis=2)
    ends = np.abs(np.linspace(-1, 1, len(grey))) > 0.5
    around, inside = grey[outside], np.median(grey[ends][~outside[ends]])
    return bool(np.median(around) < _DARK < inside and np.percentile(around, 95) < _FLARE * inside)


def rearranged(picture: Array) -> str | None:
    """Return how a picture (rows, columns, 3) of another shape gets two lenses side by side; None if it shows none."""
    rows, columns = picture.shape[:2]
    if twice_as_wide(columns, rows) and two_circles(picture.swapaxes(0, 1)):
        return (
            "the pictures show two lenses one above the other: put them side by side for unwrap=dual_fisheye, as "
            "`ffmpeg -i IN -lavfi '[0:v]crop=iw:ih/2:0:0[a];[0:v]crop=iw:ih/2:0:ih/2[b];[a][b]hstack' OUT` does"
        )
    if rows < columns < 2 * rows and two_circles(picture):
        return (
            "the pictures show two lenses side by side between borders: cut those off for unwrap=dual_fisheye, as "
            "`ffmpeg -i IN -vf crop=iw:iw/2 OUT` does"
        )
    return None


def wrong_lenses(picture: Array, camera: OmnidirectionalCamera) -> str | None:
    """Return why a picture (rows, columns, 3) is of two lenses, or whole, although the camera is not; None if it fits.

    The two lenses are told from a whole picture by what they do not show. In the dark nobody can tell.
    """
    rows, columns = picture.shape[:2]
    if isinstance(camera, EquirectangularCamera) and camera.whole and rows < columns and two_circles(picture):
        return (
            "it shows the circles of two fisheye lenses, and is no whole equirectangular picture: take "
            "unwrap=dual_fisheye, or join the two with the camera's program"
        )
    if isinstance(camera, DualFisheyeCamera):
        unseen, few = _unseen(camera, rows, columns), _few(picture)
        if unseen.mean() > _LEAST and np.median(few[unseen]) > max(_DARK, _FLARE * np.median(few[~unseen])):
            return (
                "it is not dark where two fisheye lenses show nothing, as if it were a whole equirectangular picture: "
                "for such take unwrap=equirectangular"
            )
    return None


def _few(picture: Array) -> Array:
    """Return every k-th row and column of a picture, so that about 64 rows remain."""
    step = max(picture.shape[0] // _ROWS, 1)
    return picture[::step, ::step]


@lru_cache(maxsize=8)
def _around(rows: int, columns: int) -> Array:
    """Return which pixels of `_few` lie around the largest circles in the halves of a picture."""
    down, right = np.mgrid[:rows, :columns] + 0.5
    side = columns / 2
    return _few(np.hypot(right % side - side / 2, down - rows / 2) > _AROUND * min(rows, side) / 2)


@lru_cache(maxsize=8)
def _unseen(camera: DualFisheyeCamera, rows: int, columns: int) -> Array:
    """Return which pixels of `_few` the lenses do not show."""
    down, right = np.mgrid[:rows, :columns]
    pixels = _few(np.stack([right, down], axis=-1)).astype(np.float64)
    return ~camera.shows(pixels, (rows, columns))
