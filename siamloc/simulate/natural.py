"""Textures of lived-in buildings, which replace plain ones of the same names: grain, laid boards and tiles, wallpaper.

What is laid in pieces is described by labels: an image (SIZE, SIZE) that gives each pixel the number of its piece.
"""

from __future__ import annotations

import cv2
import numpy as np

from siamloc.simulate.layout import Array, Rng, single
from siamloc.simulate.textures import SIZE, Texture, eight_bit, noise

_ROW, _COLUMN = np.mgrid[0:SIZE, 0:SIZE]


def natural_textures(rng: Rng) -> dict[str, Texture]:
    """Draw textures that replace the plain textures of the same names, in their own colours.

    >>> sorted(natural_textures(np.random.default_rng(0)))[:4]
    ['beech', 'brick', 'carpet', 'carpet_gray']
    """
    oak, dark, pale = grain(rng, 0.45, 0.75), grain(rng, 0.2, 0.42), grain(rng, 0.65, 0.92)
    floor = (oak, dark, pale)[rng.integers(3)]
    stone = _stone(rng)
    drawn: dict[str, tuple[Array, float]] = {
        "wood": (oak, 0.9),
        "walnut": (dark, 0.9),
        "beech": (pale, 0.9),
        "parquet": (_parquet(rng, floor), rng.uniform(1.0, 1.8)),
        "planks": (_pieces(rng, floor.transpose(1, 0, 2), bond(rng, 10, 2, None), 0.05), rng.uniform(1.4, 2.6)),
        "panelling": (_pieces(rng, pale, bond(rng, int(rng.integers(4, 12)), 1, 0.0).T, 0.03), 1.2),
        "marble": (stone, 2.4),
        "tiles_floor": (_tiles(rng, stone), rng.uniform(0.9, 2.4)),
        "tiles_wall": (_tiles(rng, _plain(rng, 0.75, 0.97)), rng.uniform(0.5, 1.2)),
        "tiles_blue": (_tiles(rng, _plain(rng, 0.3, 0.9)), rng.uniform(0.4, 1.0)),
        "brick": (_brick(rng), rng.uniform(1.2, 2.0)),
        "stripes": (_wallpaper(rng), rng.uniform(0.5, 1.6)),
        "paint": (_plaster(rng), rng.uniform(1.0, 2.6)),
        "fabric": (_cloth(rng), rng.uniform(0.25, 0.8)),
        **{name: (_carpet(rng), rng.uniform(0.5, 2.0)) for name in ("carpet", "carpet_red", "carpet_gray")},
    }
    return {name: Texture(eight_bit(image), (metres, metres)) for name, (image, metres) in drawn.items()}


def bond(rng: Rng, rows: int, columns: int, shift: float | None) -> Array:
    """Return the labels of pieces in rows; each row is moved by a share of a piece, drawn if `shift` is None."""
    offsets = rng.random(rows) if shift is None else (np.arange(rows) * shift) % 1
    row = _ROW * rows // SIZE
    return row * columns + np.floor(_COLUMN / SIZE * columns + offsets[row]).astype(np.int64) % columns


def herringbone(count: int, long: int) -> Array:
    """Return the labels of pieces `long` times as long as wide, laid in a zigzag; `count` cells a side.

    Even labels are pieces that lie along the rows, odd ones stand. `count` is a multiple of twice `long`.
    """
    i, j = _COLUMN * count // SIZE, _ROW * count // SIZE
    place = (i - j) % (2 * long)
    lies = place < long
    start_i, start_j = np.where(lies, i - place, i), np.where(lies, j, j - (2 * long - 1 - place))
    return 2 * ((start_j % count) * count + start_i % count) + ~lies


def flagstones(rng: Rng, count: int) -> Array:
    """Return the labels of irregular pieces: the nearest of `count` points, across the edges of the image."""
    points = rng.uniform(0, SIZE, (count, 2))
    away = [np.abs(np.stack([_ROW, _COLUMN]) - point[:, None, None]) for point in points]
    return np.argmin([np.square(np.minimum(one, SIZE - one)).sum(axis=0) for one in away], axis=0)


def _pieces(rng: Rng, image: Array, labels: Array, spread: float, joint: float | None = None) -> Array:
    """Cut every piece out of another place of an image, shade it, and draw the joints, by default dark ones."""
    count = int(labels.max()) + 1
    down, across = rng.integers(0, SIZE, (2, count))
    laid = image[(_ROW + down[labels]) % SIZE, (_COLUMN + across[labels]) % SIZE]
    laid = laid * single(rng.normal(1, spread, count))[labels][..., None]
    edge = (labels != np.roll(labels, 1, axis=0)) | (labels != np.roll(labels, 1, axis=1))
    if joint is None:
        laid[edge] *= np.float32(0.55)
    else:
        edge |= np.roll(edge, 1, axis=0) | np.roll(edge, 1, axis=1)
        laid[edge] = joint
    return laid


def grain(rng: Rng, low: float, high: float) -> Array:
    """Draw upright wood grain with knots: wavy rings and fibres; its red channel lies between `low` and `high`."""
    green = rng.uniform(0.76, 0.9)
    colour = single(rng.uniform(low, high) * np.array((1.0, green, green * rng.uniform(0.66, 0.88))))
    bend = cv2.blur(np.tile(noise(rng, 8, 3), (3, 1)), (1, 95))[SIZE : 2 * SIZE] * np.float32(rng.uniform(0.4, 1.2))
    for x, y in rng.integers(0, SIZE, (int(rng.integers(0, 4)), 2)):
        across = ((_COLUMN - x + SIZE // 2) % SIZE - SIZE // 2) / 14
        along = ((_ROW - y + SIZE // 2) % SIZE - SIZE // 2) / 40
        bend = bend + single(1.2 * np.exp(-(across**2) - along**2))
    rings = np.sin(2 * np.pi * (int(rng.integers(8, 22)) * _COLUMN / SIZE + bend)).astype(np.float32)
    fibre = cv2.blur(np.tile(rng.standard_normal((SIZE, SIZE)).astype(np.float32), (3, 1)), (1, 31))[SIZE : 2 * SIZE]
    return colour * (1 + rng.uniform(0.02, 0.12) * rings + 0.35 * fibre)[..., None].astype(np.float32)


def _parquet(rng: Rng, wood: Array) -> Array:
    if rng.random() < 0.5:
        return _pieces(rng, wood.transpose(1, 0, 2), bond(rng, 12, 2, None), 0.07)
    labels = herringbone(*((16, 4), (12, 3), (24, 4))[rng.integers(3)])
    lying, standing = (_pieces(rng, image, labels, 0.08) for image in (wood.transpose(1, 0, 2), wood))
    return np.where((labels % 2 == 0)[..., None], lying, standing)


def _tiles(rng: Rng, image: Array) -> Array:
    side = int(rng.integers(2, 7))
    kind = int(rng.choice(4, p=[0.5, 0.25, 0.1, 0.15]))
    if kind < 2:
        labels = bond(rng, side * (kind + 1), side, 0.5 * kind)
    else:
        labels = herringbone(16, 2) if kind == 2 else flagstones(rng, 24)
    return _pieces(rng, image, labels, rng.uniform(0.0, 0.08), rng.uniform(0.3, 0.85))


def _brick(rng: Rng) -> Array:
    green = rng.uniform(0.5, 0.95)
    stone = _plain(rng, 0.35, 0.9) * single((1.0, green, green * rng.uniform(0.7, 1.0)))
    rough = stone * (1 + 0.15 * noise(rng, 32, 3))[..., None]
    return _pieces(rng, rough, bond(rng, 14, 5, 0.5), 0.14, rng.uniform(0.4, 0.85))


def _plain(rng: Rng, low: float, high: float) -> Array:
    colour = single(rng.uniform(low, high) * rng.uniform(0.93, 1.07, 3))
    return colour * (1 + 0.02 * noise(rng, 16, 3))[..., None]


def _stone(rng: Rng) -> Array:
    """Draw marble: veins along the zero crossings of noise that other noise has bent."""
    bend = np.rint(18 * noise(rng, 4, 3)).astype(np.int64)
    field = noise(rng, 4, 5)[(_ROW + bend) % SIZE, (_COLUMN + np.roll(bend, 77, axis=0)) % SIZE]
    veins = np.exp(-np.abs(field) / rng.uniform(0.04, 0.2))[..., None]
    return _plain(rng, 0.4, 0.95) * (1 - veins * single(rng.uniform(0.2, 0.7) * rng.uniform(0.8, 1.2, 3)))


def _plaster(rng: Rng) -> Array:
    """Draw rough plaster that light grazes; nearly white, since the colour of a wall multiplies it."""
    relief = noise(rng, int(rng.choice([8, 16, 32])), 4)
    shade = relief - np.roll(relief, (1, 2), axis=(0, 1))
    return single((0.93, 0.925, 0.90)) * (1 + rng.uniform(0.02, 0.25) * shade)[..., None].astype(np.float32)


def _wallpaper(rng: Rng) -> Array:
    """Draw stripes of several widths, a damask, flowers or a lattice."""
    ground, motif, other = (single(rng.uniform(*span, 3)) for span in ((0.55, 0.95), (0.2, 0.9), (0.1, 0.9)))
    image = np.broadcast_to(ground, (SIZE, SIZE, 3)).copy()
    kind = int(rng.integers(4))
    if kind == 0:
        across = (_COLUMN * int(rng.integers(2, 7)) / SIZE) % 1
        image[across < 0.45], image[(across > 0.6) & (across < 0.68)] = motif, other
    elif kind == 1:  # one shape and its mirror image, again and again
        half = cv2.resize(noise(rng, 8, 3), (64, 128))
        shape = np.tile(np.concatenate([half, half[:, ::-1]], axis=1), (2, 2))
        image[shape > 0.15], image[shape > 0.6] = 0.6 * ground + 0.4 * motif, motif
    elif kind == 2:
        for x, y in rng.integers(12, SIZE - 12, (int(rng.integers(15, 50)), 2)):
            for petal in range(5):
                turn = 2 * np.pi * petal / 5
                cv2.circle(image, (int(x + 6 * np.cos(turn)), int(y + 6 * np.sin(turn))), 4, motif.tolist(), -1)
            cv2.circle(image, (int(x), int(y)), 3, other.tolist(), -1)
    else:
        step = SIZE // int(rng.choice([4, 8]))
        image[((_ROW + _COLUMN) % step < 4) | ((_ROW - _COLUMN) % step < 4)] = motif
    return image * (1 + 0.02 * noise(rng, 64, 2))[..., None]


def _carpet(rng: Rng) -> Array:
    pile = _plain(rng, 0.15, 0.8) * (1 + 0.12 * noise(rng, 128, 1))[..., None] * single(rng.uniform(0.7, 1.15, 3))
    kind = int(rng.integers(4))
    if kind == 1:  # squares of carpet, laid crosswise
        return _pieces(rng, pile, bond(rng, 2, 2, 0.0), 0.05)
    if kind == 2:
        pile = pile * np.where(noise(rng, 16, 2) > 0.2, 1.0, rng.uniform(0.6, 0.9))[..., None]
    if kind == 3:
        pile = pile * (1 + 0.15 * np.sign(np.sin(2 * np.pi * 8 * _COLUMN / SIZE)))[..., None]
    return pile


def _cloth(rng: Rng) -> Array:
    """Draw a light weave, plain or with stripes, checks or a print; the colour of an item multiplies it."""
    across, down = (np.sin(2 * np.pi * int(rng.integers(2, 7)) * axis / SIZE) > 0.3 for axis in (_COLUMN, _ROW))
    print_ = noise(rng, 8, 2) > 0.3
    pattern = (np.zeros_like(across), across, across * 0.5 + down * 0.5, print_)[rng.integers(4)]
    weave = 0.08 * np.sin(2 * np.pi * 64 * (_COLUMN + _ROW) / SIZE) + 0.08 * noise(rng, 128, 1)
    return single((0.88, 0.88, 0.88)) * (1 + weave - rng.uniform(0.1, 0.5) * pattern)[..., None].astype(np.float32)
