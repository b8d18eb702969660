"""All textures of a building in one image with smaller copies of each, for lookups without flicker."""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np

from siamloc.simulate.textures import SIZE, Array, Texture

LEVELS = 6
_PAD = 2
_COLUMNS = 8
_DECODE = (np.arange(256, dtype=np.float32) / 255) ** np.float32(2.2)


def sample(image: Array, x: Array, y: Array) -> Array:
    """Sample an image (rows, columns[, channels]) bilinearly at n positions; edges are repeated."""
    n = len(x)
    if n == 0:
        return np.zeros((0, *image.shape[2:]), dtype=image.dtype)
    width = 512
    rows = -(-n // width)
    padded = np.zeros((2, rows * width), dtype=np.float32)
    padded[0, :n], padded[1, :n] = x, y
    across, down = padded.reshape(2, rows, width)
    found = cv2.remap(image, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return found.reshape(rows * width, *image.shape[2:])[:n]


class TextureAtlas:
    """Textures side by side, each at LEVELS sizes.

    Attributes:
        texel: metres that one texel of the largest copy covers, by texture (T,); NaN for stretched textures.
        mean: mean linear colour by texture (T, 3).
    """

    def __init__(self, textures: Iterable[Texture]) -> None:
        textures = list(textures)
        count = len(textures)
        rows = -(-count // _COLUMNS)
        sizes = [SIZE >> level for level in range(LEVELS)]
        starts = np.concatenate([[0], np.cumsum([_COLUMNS * (size + 2 * _PAD) for size in sizes])])
        self.image = np.zeros((rows * (SIZE + 2 * _PAD), starts[-1], 3), dtype=np.uint8)
        self._corner = np.zeros((LEVELS, count, 2), dtype=np.float32)
        self.mean = np.zeros((count, 3), dtype=np.float32)
        self.texel = np.full(count, np.nan)
        for index, texture in enumerate(textures):
            mode = "edge" if texture.tile is None else "wrap"
            if texture.tile is not None:
                self.texel[index] = texture.tile[0] / SIZE
            self.mean[index] = _DECODE[texture.image].mean(axis=(0, 1))
            for level, size in enumerate(sizes):
                small = cv2.resize(texture.image, (size, size), interpolation=cv2.INTER_AREA)
                padded = np.pad(small, ((_PAD, _PAD), (_PAD, _PAD), (0, 0)), mode=mode)  # type: ignore[call-overload]
                cell = size + 2 * _PAD
                x = int(starts[level]) + (index % _COLUMNS) * cell
                y = (index // _COLUMNS) * cell
                self.image[y : y + cell, x : x + cell] = padded
                self._corner[level, index] = (x + _PAD - 0.5, y + _PAD - 0.5)

    def lookup(self, texture: Array, u: Array, v: Array, level: Array) -> Array:
        """Return linear colours (n, 3).

        Args:
            texture: indices (n,).
            u: to the right (n,); whole parts are dropped.
            v: upwards (n,).
            level: wanted size as the binary logarithm of the reduction (n,), between two copies too.
        """
        u = u - np.floor(u)
        v = 1 - (v - np.floor(v))
        level = np.clip(level, 0, LEVELS - 1.001).astype(np.float32)
        whole = level.astype(np.int32)
        share = (level - whole)[:, None]
        near = self._level(texture, u, v, whole).astype(np.float32)
        far = self._level(texture, u, v, whole + 1).astype(np.float32)
        mixed = near + share * (far - near)
        return np.power(mixed * np.float32(1 / 255), np.float32(2.2))

    def _level(self, texture: Array, u: Array, v: Array, level: Array) -> Array:
        corner = self._corner[level, texture]
        size = np.ldexp(np.float32(SIZE), -level)
        return sample(self.image, corner[:, 0] + u * size, corner[:, 1] + v * size)
