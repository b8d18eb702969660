"""Textures of items with a picture of their own: posters, screens, rows of books, keyboards, signs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import pairwise
from typing import Any

import cv2
import numpy as np

from siamloc.simulate.layout import Array, Rng, single
from siamloc.simulate.mesh import Point
from siamloc.simulate.textures import SIZE, Texture, eight_bit, noise

POSTERS = 14
BOOK_ROWS = 8
SCREENS = 5
BOARDS = 4
NOTICES = 4

_BRIGHT = np.array(
    [
        (0.80, 0.16, 0.14), (0.10, 0.32, 0.62), (0.95, 0.76, 0.16), (0.12, 0.50, 0.30), (0.92, 0.48, 0.14),
        (0.45, 0.20, 0.50), (0.12, 0.60, 0.65), (0.20, 0.20, 0.24), (0.88, 0.86, 0.80), (0.55, 0.30, 0.18),
    ],
    dtype=np.float32,
)  # fmt: skip


def print_textures(rng: Rng) -> dict[str, Texture]:
    """Return the textures of posters, screens, signs and so on of one building, by name.

    Textures of which a building has several are numbered from 0, such as "poster0", "poster1", "screen0" and "sign0".

    Args:
        rng: draws the pictures.
    """
    several: dict[str, tuple[int, Callable[[int], Array]]] = {
        "poster": (POSTERS, lambda i: _poster(rng, i)),
        "books": (BOOK_ROWS, lambda i: _books(rng, empty=0.06 + 0.05 * (i % 4))),
        "binders": (BOOK_ROWS, lambda _: _binders(rng)),
        "screen": (SCREENS, lambda i: _screen(rng, i)),
        "board": (BOARDS, lambda _: _whiteboard(rng)),
        "notices": (NOTICES, lambda _: _notices(rng)),
        "sheet": (4, lambda _: _sheet(rng)),
        "sign": (8, lambda _: _room_sign(rng)),
    }
    drawn = {f"{name}{i}": draw(i) for name, (count, draw) in several.items() for i in range(count)}
    drawn["keyboard"] = _flat((0.16, 0.16, 0.17), [
        (0.03 + column * 0.063, 0.08 + row * 0.18, 0.08 + column * 0.063, 0.22 + row * 0.18, 0.33)
        for row in range(5) for column in range(15)
    ])  # fmt: skip
    drawn["clock"] = _clock(rng)
    drawn["exit"] = _exit_sign()
    drawn["drawers"] = _fronts(rng, [1 / 3, 2 / 3], columns=1)
    drawn["cabinet_doors"] = _fronts(rng, [], columns=2)
    drawn["lockers"] = _fronts(rng, [1 / 2], columns=3)
    drawn["kitchen_fronts"] = _fronts(rng, [], columns=4)
    drawn["copier"] = _flat((0.80, 0.81, 0.80), [
        (0, 0.0, 1, 0.07, 0.25), (0.05, 0.12, 0.95, 0.26, 0.16), (0.62, 0.03, 0.93, 0.10, (0.35, 0.55, 0.75)),
        *((0.04, y, 0.96, y + 0.012, 0.30) for y in (0.36 + 0.155 * i for i in range(4))),
        *((0.38, y + 0.04, 0.62, y + 0.07, 0.30) for y in (0.36 + 0.155 * i for i in range(4))),
    ])  # fmt: skip
    drawn["fridge"] = _fronts(rng, [0.7], columns=1)
    drawn["radiator"] = _flat((0.93, 0.93, 0.92), [(i / 16, 0.06, i / 16 + 0.018, 0.94, 0.62) for i in range(16)])
    drawn["pigeonholes"] = _pigeonholes(rng)
    drawn["machine"] = _vending(rng)
    return {name: Texture(eight_bit(image), None) for name, image in drawn.items()}


def _flat(ground: Any, rectangles: Iterable[tuple[Any, ...]]) -> Array:
    """Return a picture of rectangles, each given as for `_rectangle`, on a ground of one colour."""
    image = _blank(ground)
    for rectangle in rectangles:
        _rectangle(image, *rectangle)
    return image


def _blank(colour: Any) -> Array:
    return np.ones((SIZE, SIZE, 3), dtype=np.float32) * single(colour)


def _pick(rng: Rng) -> list[float]:
    return (_BRIGHT[rng.integers(len(_BRIGHT))] * rng.uniform(0.8, 1.1)).tolist()  # type: ignore[no-any-return]


def _rectangle(image: Array, x0: float, y0: float, x1: float, y1: float, colour: object) -> None:
    """Fill a rectangle given in fractions of the image size."""
    a, b, c, d = (round(v * SIZE) for v in (x0, y0, x1, y1))
    image[max(b, 0) : max(d, b + 1), max(a, 0) : max(c, a + 1)] = colour


def _text_lines(image: Array, rng: Rng, box: Point, lines: int, ink: float = 0.25) -> None:
    """Fill a box (x0, y0, x1, y1) with lines that look like text from afar."""
    x0, y0, x1, y1 = box
    step = (y1 - y0) / lines
    for line in range(lines):
        x = x0
        end = x1 - (x1 - x0) * rng.uniform(0, 0.3)
        while x < end:
            width = rng.uniform(0.02, 0.08)
            _rectangle(image, x, y0 + line * step, min(x + width, end), y0 + (line + 0.55) * step, ink)
            x += width + 0.015


def _poster(rng: Rng, kind: int) -> Array:
    paper = _blank(rng.uniform(0.86, 0.97)) if kind % 3 else _blank(single(_pick(rng)) * 0.9)
    if kind % 4 == 0:  # a landscape
        horizon = rng.uniform(0.4, 0.7)
        sky = np.linspace(0.0, 1.0, SIZE, dtype=np.float32)[:, None, None]
        paper[:] = single((0.30, 0.52, 0.80)) * (1 - sky) + single((0.90, 0.85, 0.75)) * sky
        ridge = horizon + 0.12 * noise(rng, 4)[0] + 0.05 * noise(rng, 16)[0]
        below = np.arange(SIZE)[:, None] / SIZE > ridge[None]
        paper[below] = single(rng.uniform(0.1, 0.45, 3))
        cv2.circle(paper, tuple(int(v) for v in rng.integers(40, 180, 2)), 22, (0.99, 0.93, 0.70), -1, cv2.LINE_AA)
    elif kind % 4 == 1:  # a scientific poster: title bar, two columns, figures
        _rectangle(paper, 0, 0, 1, 0.14, _pick(rng))
        _text_lines(paper, rng, (0.08, 0.04, 0.92, 0.12), 1, 0.95)
        for x0 in (0.05, 0.53):
            y = 0.19
            while y < 0.9:
                _text_lines(paper, rng, (x0, y, x0 + 0.42, y + 0.1), 4)
                _rectangle(paper, x0 + 0.03, y + 0.12, x0 + 0.39, y + 0.25, single(_pick(rng)) * 0.5 + 0.45)
                y += 0.28
    elif kind % 4 == 2:  # an abstract print
        for _ in range(9):
            x, y = rng.uniform(0, 0.8, 2)
            if rng.random() < 0.5:
                _rectangle(paper, x, y, x + rng.uniform(0.1, 0.5), y + rng.uniform(0.1, 0.5), _pick(rng))
            else:
                centre = (int(x * SIZE), int(y * SIZE))
                cv2.circle(paper, centre, int(rng.uniform(15, 70)), _pick(rng), -1, cv2.LINE_AA)
    else:  # a map or a calendar
        for x, y in ((0.18 * column, 0.13 * row) for row in range(6) for column in range(5)):
            _rectangle(paper, 0.06 + x, 0.2 + y, 0.21 + x, 0.3 + y, single(_pick(rng)) * 0.25 + 0.7)
        _rectangle(paper, 0.06, 0.05, 0.94, 0.16, _pick(rng))
    cv2.rectangle(paper, (0, 0), (SIZE - 1, SIZE - 1), (0.15, 0.15, 0.15), 5)
    return paper


def _books(rng: Rng, empty: float) -> Array:
    image = _blank((0.16, 0.12, 0.09))
    x = 0.0
    while x < 1:
        width = rng.uniform(0.025, 0.07)
        if rng.random() > empty:
            top = rng.uniform(0.08, 0.35)
            colour = single(_pick(rng)) * rng.uniform(0.7, 1.0)
            _rectangle(image, x, top, min(x + width - 0.006, 1), 1, colour)
            _rectangle(image, x + 0.004, top + 0.1, min(x + width - 0.012, 1), top + 0.2, colour * 0.4 + 0.5)
        x += width
    return image


def _binders(rng: Rng) -> Array:
    image = _blank((0.18, 0.15, 0.12))
    hue = [_pick(rng) for _ in range(3)]
    for i in range(11):
        if rng.random() < 0.13:
            continue
        x0, x1 = i / 11 + 0.006, (i + 1) / 11 - 0.006
        _rectangle(image, x0, 0.1, x1, 1, hue[rng.integers(3)])
        _rectangle(image, x0 + 0.012, 0.25, x1 - 0.012, 0.6, 0.92)
        _rectangle(image, (x0 + x1) / 2 - 0.012, 0.75, (x0 + x1) / 2 + 0.012, 0.82, 0.1)
    return image


def _screen(rng: Rng, kind: int) -> Array:
    back = (0.96, 0.96, 0.97) if kind % 2 else (0.10, 0.14, 0.22)
    bar, side = (0.03, 0.04, 0.97, 0.11, (0.25, 0.40, 0.62)), (0.03, 0.11, 0.2, 0.95, (0.55, 0.60, 0.68))
    image = _flat((0.05, 0.05, 0.06), [(0.03, 0.04, 0.97, 0.95, back), bar, side])
    _text_lines(image, rng, (0.24, 0.17, 0.9, 0.9), 15, 0.3 if kind % 2 else 0.75)
    return image


def _whiteboard(rng: Rng) -> Array:
    image = _blank((0.95, 0.95, 0.96))
    for _ in range(7):
        colour = [(0.1, 0.15, 0.5), (0.6, 0.1, 0.1), (0.1, 0.1, 0.1), (0.1, 0.4, 0.2)][rng.integers(4)]
        points = np.cumsum(rng.normal(0, 16, (14, 2)), axis=0) + rng.uniform(40, 215, 2)
        cv2.polylines(image, [points.astype(np.int32)], bool(rng.random() < 0.3), colour, 3, cv2.LINE_AA)
    for _ in range(3):
        x, y = rng.uniform(0.08, 0.6, 2)
        _text_lines(image, rng, (x, y, x + 0.3, y + 0.15), 4, 0.3)
    cv2.rectangle(image, (0, 0), (SIZE - 1, SIZE - 1), (0.55, 0.56, 0.58), 8)
    return image


def _notices(rng: Rng) -> Array:
    image = _blank((0.68, 0.52, 0.36)) + 0.05 * noise(rng, 64, 2)[..., None]
    for _ in range(16):
        x, y = rng.uniform(0.03, 0.82, 2)
        width, height = rng.uniform(0.1, 0.18), rng.uniform(0.14, 0.24)
        paper = 0.93 if rng.random() < 0.6 else single(_pick(rng)) * 0.4 + 0.55
        _rectangle(image, x, y, x + width, y + height, paper)
        _text_lines(image, rng, (x + 0.015, y + 0.03, x + width - 0.01, y + height - 0.02), 6, 0.4)
    cv2.rectangle(image, (0, 0), (SIZE - 1, SIZE - 1), (0.45, 0.34, 0.24), 10)
    return image


def _sheet(rng: Rng) -> Array:
    image = _blank((0.95, 0.95, 0.93))
    _text_lines(image, rng, (0.1, 0.08, 0.9, 0.93), 18, 0.45)
    return image


def _room_sign(rng: Rng) -> Array:
    image = _blank((0.90, 0.91, 0.92))
    _rectangle(image, 0, 0, 1, 0.35, (0.12, 0.25, 0.50))
    for digit in range(3):  # strokes of a number
        x = 0.28 + 0.16 * digit
        for y0, y1 in ((0.06, 0.1), (0.155, 0.195), (0.25, 0.29)):
            if rng.random() < 0.7:
                _rectangle(image, x, y0, x + 0.1, y1, 1.0)
        for x0 in (x, x + 0.08):
            if rng.random() < 0.8:
                _rectangle(image, x0, 0.06, x0 + 0.02, 0.29, 1.0)
    _text_lines(image, rng, (0.1, 0.45, 0.9, 0.9), 4)
    return image


def _clock(rng: Rng) -> Array:
    image = _blank((0.15, 0.15, 0.16))
    cv2.circle(image, (128, 128), 112, (0.95, 0.95, 0.93), -1, cv2.LINE_AA)
    for hand, length in ((rng.uniform(0, 6.28), 60), (rng.uniform(0, 6.28), 92)):
        tip = (int(128 + length * np.cos(hand)), int(128 + length * np.sin(hand)))
        cv2.line(image, (128, 128), tip, (0.1, 0.1, 0.1), 9, cv2.LINE_AA)
    return image


def _exit_sign() -> Array:
    image = _blank((0.05, 0.55, 0.25))
    _rectangle(image, 0.62, 0.15, 0.85, 0.85, 0.95)
    cv2.arrowedLine(image, (30, 128), (145, 128), (0.95, 0.95, 0.95), 22, cv2.LINE_AA, tipLength=0.4)
    return image


def _fronts(rng: Rng, gaps: list[float], columns: int) -> Array:
    """Draw the doors or drawers of a cabinet, with level gaps at some shares of its height, and their handles."""
    image = _blank((0.86, 0.86, 0.85)) + 0.01 * noise(rng, 8)[..., None]
    for y0, y1 in pairwise([0.0, *gaps, 1.0]):
        for i in range(columns):
            x0, x1 = i / columns, (i + 1) / columns
            a, b = (int(x0 * SIZE), int(y0 * SIZE)), (int(x1 * SIZE) - 1, int(y1 * SIZE) - 1)
            cv2.rectangle(image, a, b, (0.30, 0.30, 0.30), 4)
            if columns == 1:
                _rectangle(image, 0.35, y0 + 0.08, 0.65, y0 + 0.12, 0.25)
            else:
                x = x1 - 0.06 if i % 2 == 0 else x0 + 0.03
                _rectangle(image, x, (y0 + y1) / 2 - 0.09, x + 0.03, (y0 + y1) / 2 + 0.09, 0.25)
    return image


def _pigeonholes(rng: Rng) -> Array:
    image = _blank((0.82, 0.70, 0.54))
    for row in range(6):
        for column in range(5):
            x, y = 0.02 + column * 0.196, 0.02 + row * 0.163
            _rectangle(image, x, y, x + 0.176, y + 0.14, 0.14)
            fill = rng.uniform(0, 0.09)
            _rectangle(image, x + 0.01, y + 0.14 - fill, x + 0.166, y + 0.14, 0.85)
    return image


def _vending(rng: Rng) -> Array:
    places = [(0.1 + 0.12 * column, 0.09 + 0.16 * row) for row in range(4) for column in range(5)]
    wares = [(x, y, x + 0.07, y + 0.12, _pick(rng)) for x, y in places]
    window, slot, tray = (0.08, 0.06, 0.7, 0.72, 0.12), (0.76, 0.2, 0.93, 0.5, 0.85), (0.12, 0.8, 0.68, 0.92, 0.08)
    return _flat((0.70, 0.12, 0.12), [window, *wares, slot, tray])
