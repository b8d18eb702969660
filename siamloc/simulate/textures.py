"""Procedural textures: small images of surfaces, and an atlas of all of them for lookups without flicker."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from siamloc.simulate.layout import Array, Colour, Rng, single

SIZE = 256


@dataclass(frozen=True)
class Texture:
    """An image of a surface.

    Attributes:
        image: (SIZE, SIZE, 3) uint8, RGB, gamma-encoded; the first row is the top.
        tile: metres that one copy covers in width and height; None stretches one copy over the whole quad.
    """

    image: Array
    tile: tuple[float, float] | None


def eight_bit(image: Array) -> Array:
    """Convert an image with values in [0, 1] to uint8, 0 to 255."""
    return np.clip(image * 255 + 0.5, 0, 255).astype(np.uint8)


def noise(rng: Rng, cells: int, octaves: int = 3) -> Array:
    """Return tileable smooth noise (SIZE, SIZE) in about [-1, 1]; the coarsest octave has `cells` x `cells` cells."""
    total = np.zeros((SIZE, SIZE), dtype=np.float32)
    for octave in range(octaves):
        n = min(cells << octave, SIZE)
        grid = rng.standard_normal((n, n)).astype(np.float32)
        grid = np.pad(grid, 2, mode="wrap")
        scale = SIZE // n
        big = cv2.resize(grid, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
        total += big[2 * scale : 2 * scale + SIZE, 2 * scale : 2 * scale + SIZE] * 0.5**octave
    return total / 2


def base_textures(rng: Rng) -> dict[str, Texture]:
    """Return the textures that every building has, by name: plain ones, woods, floors, tiles.

    Names that a building file may give a floor, wall or ceiling are listed in `SURFACES`; others, such as "plain",
    "plastic", "metal" and "fabric", are for items only.

    Args:
        rng: draws grain, speckles and the like.

    Example:
        >>> base_textures(np.random.default_rng(0))["carpet"].tile
        (1.5, 1.5)
    """

    def carpet(colour: Colour) -> Array:
        return _tinted(colour, 0.05 * noise(rng, 128, 1) + 0.035 * noise(rng, 16, 3))

    return _square({
        "plain": (_tinted((0.93, 0.93, 0.93), np.zeros((SIZE, SIZE), dtype=np.float32)), 1.0),
        "paint": (_tinted((0.93, 0.92, 0.89), 0.012 * noise(rng, 4) + 0.006 * noise(rng, 64, 2)), 2.6),
        "concrete": (_tinted((0.66, 0.65, 0.63), 0.05 * noise(rng, 4, 5)), 2.0),
        "plastic": (_tinted((0.92, 0.92, 0.92), 0.008 * noise(rng, 16)), 0.5),
        "metal": (_tinted((0.80, 0.81, 0.83), 0.03 * _brushed(noise(rng, 16, 4))), 0.6),
        "fabric": (_tinted((0.88, 0.88, 0.88), 0.10 * noise(rng, 128, 1)), 0.25),
        "leaf": (_leaves(rng), 0.5),
        "carpet": (carpet((0.42, 0.46, 0.55)), 1.5),
        "carpet_red": (carpet((0.55, 0.36, 0.33)), 1.5),
        "carpet_gray": (carpet((0.50, 0.50, 0.49)), 1.5),
        "linoleum": (_speckled(rng, (0.62, 0.60, 0.53)), 1.2),
        "linoleum_green": (_speckled(rng, (0.47, 0.55, 0.47)), 1.2),
        "parquet": (_parquet(rng), 1.2),
        "tiles_floor": (_tiles(rng, (0.70, 0.69, 0.66), 0.03, (0.48, 0.47, 0.45)), 1.2),
        "tiles_wall": (_tiles(rng, (0.92, 0.93, 0.93), 0.012, (0.70, 0.70, 0.70)), 0.8),
        "tiles_blue": (_tiles(rng, (0.62, 0.76, 0.84), 0.02, (0.86, 0.88, 0.88)), 0.8),
        "ceiling_panels": (_ceiling(rng), 1.2),
        "wood": (_wood(rng, (0.78, 0.62, 0.43), 0.07), 0.9),
        "beech": (_wood(rng, (0.86, 0.73, 0.56), 0.04), 0.9),
        "walnut": (_wood(rng, (0.45, 0.32, 0.23), 0.06), 0.9),
        "cork": (_tinted((0.70, 0.53, 0.36), 0.10 * noise(rng, 64, 2)), 0.5),
    })  # fmt: skip


def pattern_textures(rng: Rng) -> dict[str, Texture]:
    """Return further textures with drawn colours, by name: bricks, wallpaper, panelling, stone, planks."""
    return _square({
        "brick": (_bricks(rng), 1.6),
        "stripes": (_stripes(rng), rng.uniform(0.5, 1.6)),
        "panelling": (_planks(rng, 6, 0.05), 1.2),
        "planks": (np.ascontiguousarray(_planks(rng, 5, 0.04).transpose(1, 0, 2)), 1.3),
        "checker": (_checker(rng), rng.uniform(0.6, 1.6)),
        "terrazzo": (_terrazzo(rng), 1.0),
        "marble": (_marble(rng), 2.4),
    })  # fmt: skip


def _square(drawn: dict[str, tuple[Array, float]]) -> dict[str, Texture]:
    """Return textures, given their images and the metres that each covers in width and height."""
    return {name: Texture(eight_bit(image), (metres, metres)) for name, (image, metres) in drawn.items()}


def recoloured(textures: dict[str, Texture], rng: Rng) -> dict[str, Texture]:
    """Return textures in other colours: the channels of all that are not nearly white are scaled by drawn factors."""
    changed = {}
    for name, texture in textures.items():
        shade, tint = rng.uniform(0.6, 1.15), rng.uniform(0.75, 1.25, 3)
        if name in SURFACES and texture.image.mean() < 215:
            if name in ("parquet", "wood", "beech", "walnut", "planks", "panelling"):  # there is no green wood
                tint = tint**0.3
            image = texture.image * single(shade * tint / tint.mean())
            texture = Texture(np.clip(image, 0, 255).astype(np.uint8), texture.tile)
        changed[name] = texture
    return changed


#: Floors, walls and ceilings that a room of a building file may name.
SURFACES = (
    "paint", "concrete", "carpet", "carpet_red", "carpet_gray", "linoleum", "linoleum_green", "parquet",
    "tiles_floor", "tiles_wall", "tiles_blue", "ceiling_panels", "wood", "beech", "walnut",
    "brick", "stripes", "panelling", "planks", "checker", "terrazzo", "marble",
)  # fmt: skip


def _drawn_colour(rng: Rng, low: float, high: float) -> Array:
    return single(rng.uniform(low, high) * rng.uniform(0.75, 1.15, 3))


def _bricks(rng: Rng) -> Array:
    stone, joint = single(rng.uniform(0.35, 0.8)) * single((1.0, rng.uniform(0.45, 1.0), rng.uniform(0.35, 0.95))), 0.72
    image = np.full((SIZE, SIZE, 3), joint, dtype=np.float32)
    rows, columns = 16, 6
    height = SIZE // rows
    for row in range(rows):
        edges = np.rint(np.arange(columns + 1) * SIZE / columns).astype(int) + (row % 2) * (SIZE // columns // 2)
        for left, right in pairwise(edges):
            across = np.arange(left + 2, right - 1) % SIZE
            image[row * height + 2 : (row + 1) * height, across] = stone * single(rng.uniform(0.8, 1.15))
    return image + 0.03 * noise(rng, 32, 3)[..., None]


def _stripes(rng: Rng) -> Array:
    ground, stripe = _drawn_colour(rng, 0.6, 0.95), _drawn_colour(rng, 0.3, 0.9)
    image = np.broadcast_to(ground, (SIZE, SIZE, 3)).copy()
    count = int(rng.integers(2, 9))
    across = (np.arange(SIZE) * count / SIZE) % 1 < rng.uniform(0.15, 0.5)
    image[:, across] = stripe
    return image


def _planks(rng: Rng, count: int, spread: float) -> Array:
    colour = rng.uniform(0.35, 0.9) * np.array((1.0, rng.uniform(0.75, 0.95), rng.uniform(0.5, 0.85)))
    image = _wood(rng, (float(colour[0]), float(colour[1]), float(colour[2])), 0.05)
    edges = np.rint(np.arange(count + 1) * SIZE / count).astype(int)
    for left, right in pairwise(edges):
        image[:, left:right] += single(rng.normal(0, spread))
        image[:, left : left + 2] *= 0.6
        image[int(rng.integers(0, SIZE)), left:right] *= 0.6
    return image


def _checker(rng: Rng) -> Array:
    dark, light = _drawn_colour(rng, 0.08, 0.6), _drawn_colour(rng, 0.6, 0.95)
    step = SIZE // 4
    odd = (np.arange(SIZE)[:, None] // step + np.arange(SIZE)[None] // step) % 2
    return np.where(odd[..., None] > 0, light, dark) + 0.02 * noise(rng, 16, 3)[..., None]


def _terrazzo(rng: Rng) -> Array:
    image = _tinted((1.0, 1.0, 1.0), 0.02 * noise(rng, 8, 3)) * _drawn_colour(rng, 0.45, 0.8)
    for _ in range(3):
        image[noise(rng, 64, 2) > 0.8] = _drawn_colour(rng, 0.2, 0.9)
    return image


def _marble(rng: Rng) -> Array:
    veins = np.exp(-((noise(rng, 4, 5) / rng.uniform(0.05, 0.15)) ** 2))
    colour, vein = _drawn_colour(rng, 0.5, 0.95), _drawn_colour(rng, 0.3, 0.7)
    return colour + (0.5 * veins)[..., None] * (vein - colour) + 0.02 * noise(rng, 16, 3)[..., None]


def _tinted(colour: Colour, change: Array) -> Array:
    return single(colour) + change[..., None]


def _brushed(field: Array) -> Array:
    """Stretch tileable noise along the rows eightfold, keeping it tileable."""
    return 3 * cv2.blur(np.tile(field, (1, 3)), (65, 1))[:, SIZE : 2 * SIZE]


def _speckled(rng: Rng, colour: Colour) -> Array:
    image = _tinted(colour, 0.025 * noise(rng, 8, 3))
    grains = noise(rng, 64, 2)
    image[grains > 0.85] += 0.09
    image[grains < -0.85] -= 0.09
    return image


def _wood(rng: Rng, colour: Colour, contrast: float) -> Array:
    """Draw upright grain: slow bands and fine fibres."""
    x = np.arange(SIZE, dtype=np.float32)[None, :] / SIZE
    bend = np.roll(noise(rng, 2, 2), 31, axis=1)
    bands = 0.35 * np.sin(2 * np.pi * (6 * x + 0.12 * bend)) + 0.2 * np.sin(2 * np.pi * (17 * x + 0.2 * bend))
    grain = np.tile(rng.standard_normal((SIZE, SIZE)).astype(np.float32), (3, 1))
    fibre = cv2.blur(grain, (1, 41))[SIZE : 2 * SIZE]
    image = _tinted(colour, contrast * (bands + 1.8 * fibre))
    image[..., 2] -= 0.2 * contrast * bands
    return image


def _parquet(rng: Rng) -> Array:
    image = np.ascontiguousarray(_wood(rng, (0.70, 0.52, 0.34), 0.06).transpose(1, 0, 2))
    height = SIZE // 8
    for row in range(8):
        shift = int(rng.integers(0, SIZE))
        image[row * height : (row + 1) * height] += single(rng.normal(0, 0.035))
        image[row * height] *= 0.72
        image[row * height : (row + 1) * height, [shift, (shift + SIZE // 2) % SIZE]] *= 0.72
    return image


def _tiles(rng: Rng, colour: Colour, spread: float, joint: Colour) -> Array:
    step = SIZE // 4
    shade = np.kron(rng.normal(0, spread, (4, 4)), np.ones((step, step))).astype(np.float32)
    image = _tinted(colour, shade + 0.012 * noise(rng, 16, 3))
    for offset in range(3):
        image[offset::step] = joint
        image[:, offset::step] = joint
    return image


def _ceiling(rng: Rng) -> Array:
    image = _tinted((0.90, 0.90, 0.88), 0.03 * noise(rng, 128, 1))
    for offset in range(4):
        image[offset :: SIZE // 2] = (0.70, 0.70, 0.69)
        image[:, offset :: SIZE // 2] = (0.70, 0.70, 0.69)
    return image


def _leaves(rng: Rng) -> Array:
    image = np.full((SIZE, SIZE, 3), (0.10, 0.20, 0.08), dtype=np.float32)
    for _ in range(260):
        centre = tuple(int(v) for v in rng.integers(0, SIZE, 2))
        axes = (int(rng.integers(8, 26)), int(rng.integers(4, 9)))
        shade = rng.uniform(0.6, 1.25)
        colour = (0.22 * shade, 0.46 * shade, 0.16 * shade)
        cv2.ellipse(image, centre, axes, rng.uniform(0, 360), 0, 360, colour, -1, cv2.LINE_AA)
    return image


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
    """Textures side by side, each in LEVELS sizes.

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
            border = cv2.BORDER_REPLICATE if texture.tile is None else cv2.BORDER_WRAP
            if texture.tile is not None:
                self.texel[index] = texture.tile[0] / SIZE
            self.mean[index] = cv2.LUT(texture.image, _DECODE).mean(axis=(0, 1))
            for level, size in enumerate(sizes):
                small = cv2.resize(texture.image, (size, size), interpolation=cv2.INTER_AREA)
                padded = cv2.copyMakeBorder(small, _PAD, _PAD, _PAD, _PAD, border)
                cell = size + 2 * _PAD
                x = int(starts[level]) + (index % _COLUMNS) * cell
                y = (index // _COLUMNS) * cell
                self.image[y : y + cell, x : x + cell] = padded
                self._corner[level, index] = (x + _PAD - 0.5, y + _PAD - 0.5)

    def lookup(self, texture: Array, u: Array, v: Array, level: Array) -> Array:
        """Return the linear colours (n, 3) of textures at n positions.

        Args:
            texture: indices of the textures (n,).
            u: position to the right, in widths of the texture (n,); integer parts are dropped.
            v: position upwards, in heights of the texture (n,); integer parts are dropped.
            level: requested size, as the binary logarithm of the reduction (n,); may lie between two copies.
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

    def nearest(self, texture: Array, u: Array, v: Array, level: Array) -> Array:
        """Return the linear colours (n, 3) of the nearest texels, in the copy of the nearest size; see `lookup`."""
        level = np.clip(np.rint(level), 0, LEVELS - 1).astype(np.int32)
        corner = self._corner.reshape(-1, 2).take(level * len(self.texel) + texture, axis=0)
        size = np.ldexp(np.float32(SIZE), -level)
        x = np.rint(corner[:, 0] + (u - np.floor(u)) * size).astype(np.int32)
        y = np.rint(corner[:, 1] + (1 - (v - np.floor(v))) * size).astype(np.int32)
        texels = self.image.reshape(-1, 3).take(y * self.image.shape[1] + x, axis=0)
        return _DECODE.take(texels)

    def _level(self, texture: Array, u: Array, v: Array, level: Array) -> Array:
        corner = self._corner[level, texture]
        size = np.ldexp(np.float32(SIZE), -level)
        return sample(self.image, corner[:, 0] + u * size, corner[:, 1] + v * size)
