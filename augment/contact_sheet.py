"""A labelled contact sheet that shows every effect at several strengths."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from augment.base import check_batch
from augment.errors import AugmentError
from augment.policies import policy
from augment.registry import EFFECTS, POLICIES, effect
from foundation.settings import Count, checked

Picture = NDArray[np.uint8]
Shot = tuple[str, dict[str, Any]]
"""A caption, and the ranges, options and parameters of an effect."""

_GAP = 10
_CAPTION = 26
_MARGIN = 36
_TITLE = 92
_COLUMNS = 6  # a multiple of the three pictures of an effect
_CAPTIONED = 220  # pixels: captions overlap the names above narrower pictures
_DRAW = 4  # seed of the policies' parameters
_INK, _PALE, _PAPER = "#1d2733", "#64748b", "#ffffff"


def _series(caption: str, key: str, *values: float) -> list[Shot]:
    """Return shots that differ in one parameter."""
    return [(caption.format(value).replace("-", "−"), {key: value}) for value in values]


_LIGHT, _DARK = {"tone": "light", "radius": 40, "intensity": 130}, {"tone": "dark", "radius": 40, "intensity": 160}
_SPOTS: list[Shot] = [
    ("light, 130 levels", _LIGHT),
    ("dark, 160 levels", _DARK),
    ("across the seam", {**_DARK, "column": 0}),
]
_LEVEL = {"down": 0, "across": 0, "stretch": 1}
_SHOTS: dict[str, list[Shot]] = {
    "bulb": _SPOTS,
    "square": _SPOTS,
    "trapezoid": [(caption, {**values, "taper": 0.5}) for caption, values in _SPOTS],
    "brighten": _series("c = {:g}", "amount", 35, 55, 75),
    "darken": _series("c = {:g}", "amount", 35, 55, 75),
    "sharpen": _series("strength {:g}", "strength", 0.5, 1.0, 2.0),
    "blur": _series("{0} x {0} box", "size", 3, 5, 9),
    "contrast": _series("c = {:g}", "factor", 0.5, 1.3, 1.8),
    "saturate": _series("c = {:g}", "factor", 0.2, 1.4, 2.0),
    "rotate": _series("{}°", "degrees", 45, 115, 240),
    "noise": _series("variance {:g}", "variance", 0.0025, 0.01, 0.05),
    "occlude": [(f"{100 * s:.0f} % in {n}", {"share": s, "bars": n}) for s, n in ((0.05, 1), (0.2, 3), (0.4, 4))],
    "motion_blur": _series("{} columns", "length", 5, 9, 15),
    "gamma": _series("γ = {:g}", "gamma", 0.5, 1.4, 2.0),
    "white_balance": [
        ("−0.6 stops", {"temperature": -0.6, "tint": 0}),
        ("+0.6 stops", {"temperature": 0.6, "tint": 0}),
        ("tint +0.15", {"temperature": 0, "tint": 0.15}),
    ],
    "exposure": _series("{:+g} stops", "stops", -1.5, 0.75, 1.5),
    "vignette": [(f"{100 * s:.0f} % lost", {"strength": s, "centre": 0.5}) for s in (0.3, 0.55, 0.8)],
    "shadow": [
        (f"depth {d:g}", {"depth": d, "softness": s, "tilt": t, "offset": 0.1})
        for d, s, t in ((0.35, 0.3, 20), (0.55, 0.15, -30), (0.75, 0.06, 40))
    ],
    "sun_patch": [
        (f"gain {g:g}", {"gain": g, "distance": d, "turn": t, "length": 1.7, "breadth": 1.3})
        for g, d, t in ((1.6, 2.2, -35), (2.3, 2.2, 20), (3.0, 2.4, 50))
    ],
    "relight": [
        (f"{n:g} stops", {"stops": n, "warmth": w, "slope": s, "phase1": p, "phase2": 2 * p, "phase3": -p})
        for n, w, s, p in ((0.6, 0.2, 0.5, 0), (1.2, -0.3, -0.5, 2), (1.8, 0.3, 0.2, -2))
    ],
    "doorway": [(f"{n:+g} stops".replace("-", "−"), {"stops": n, "share": 0.25}) for n in (-2, 1.2, 2.5)],
    "windows": [
        (f"level {n}, {100 * s:g} %", {"level": n, "share": s}) for n, s in ((10, 0.05), (10, 0.15), (255, 0.15))
    ],
    "view": [(f"zoom {z:g}, roll {r:g}", {**_LEVEL, "zoom": z, "roll": r}) for z, r in ((1.25, 0), (1, 7), (0.8, -7))],
    "jpeg": _series("quality {}", "quality", 50, 25, 10),
}


def preview(batch: Tensor, cell: int = 288, circular: bool = True) -> Picture:
    """Draw a labelled contact sheet of all effects at several strengths, and of the policies.

    Args:
        batch: panoramas (B, 3, H, W) to show the effects on, in turn; 128 x 512 pixels look best.
        cell: width of an image in pixels; panoramas are resized to it. Images below 220 pixels have no captions.
        circular: whether the columns wrap around; if not, no image is turned, and `rotate` is left out.

    Returns:
        The sheet (rows, columns, 3), RGB, uint8.

    Raises:
        AugmentError: an invalid or empty batch, or a cell without pixels.

    Example:
        >>> import torch, augment
        >>> augment.preview(torch.rand(2, 3, 32, 128), cell=64).shape
        (898, 520, 3)
    """
    check_batch(batch)
    checked(cell, Count, "cell", AugmentError)
    checked(circular, bool, "circular", AugmentError)
    if len(batch) == 0:
        raise AugmentError("a preview needs at least one panorama, got an empty batch")
    frames = batch.cpu() if batch.dtype == torch.uint8 else (batch.cpu() * 255).round().to(torch.uint8)
    cells: list[tuple[str, str, Picture]] = []
    for number, name in enumerate(names := [name for name in EFFECTS if circular or name != "rotate"]):
        frame = frames[number % len(frames)][None]
        for caption, values in _SHOTS.get(name) or _series("strength {:g}", "at", 0.3, 0.6, 1.0):
            caption = caption if circular else caption.replace("across the seam", "at the edge")
            cells.append((name, caption, _small(_shoot(name, {**values, "circular": circular}, frame), cell)))
    for number, name in enumerate(POLICIES[1:]):
        frame = frames[(len(names) + number) % len(frames)][None]
        drawn = policy(name, circular=circular)(frame, torch.Generator().manual_seed(_DRAW))[0]
        cells.append(("policy", name, _small(drawn, cell)))
    shown = "panoramas whose columns wrap around" if circular else "images whose columns do not wrap around"
    return _sheet(cells, [_small(frame, cell) for frame in frames[:_COLUMNS]], cell, shown)


def _shoot(name: str, values: Mapping[str, Any], frame: Tensor) -> Tensor:
    """Apply an effect with the given ranges, options and parameters, and with the middle of all other ranges."""
    known = effect(name)
    built = effect(name, **{key: value for key, value in values.items() if key in {**known.ranges, **known.options}})
    params = built.at(values.get("at", 1), frame)
    if "row" in params:
        row, column = _plain_place(frame[0], 110 if values["tone"] == "light" else 170)
        if "column" in values and built.circular:  # moves the surface to the column where the spot will be
            frame = frame.roll(values["column"] - column, dims=3)
        params["row"][0], params["column"][0] = row, column
    for key in values.keys() & params.keys():
        params[key] = torch.tensor([values[key]]).to(params[key].dtype)
    return built.apply(frame, params)[0]


def _plain_place(frame: Tensor, level: float) -> tuple[int, int]:
    """Return row and column of an even surface near a grey level, on which a spot shows well."""
    grey = frame.float().mean(0).numpy()
    height, width = grey.shape
    size = max(height // 2, 1)
    wide = np.hstack([grey, grey, grey])
    mean, square = cv2.blur(wide, (size, size)), cv2.blur(wide * wide, (size, size))
    unlike = np.abs(mean - level) + np.sqrt(np.maximum(square - mean**2, 0))
    top, bottom = height // 4, max(3 * height // 4, height // 4 + 1)
    unlike = unlike[top:bottom, width : 2 * width]
    row, column = np.unravel_index(int(unlike.argmin()), unlike.shape)
    return top + int(row), int(column)


def _small(frame: Tensor, cell: int) -> Picture:
    picture = frame.permute(1, 2, 0).contiguous().numpy()
    height = max(round(cell * picture.shape[0] / picture.shape[1]), 1)
    way = cv2.INTER_AREA if cell <= picture.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(picture, (cell, height), interpolation=way), dtype=np.uint8)


def _sheet(cells: list[tuple[str, str, Picture]], originals: list[Picture], cell: int, shown: str) -> Picture:
    """Lay the cells out row by row, three for each effect, with names and values above them."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    def left_of(column: int) -> int:
        return _MARGIN + column * (cell + _GAP) + column // 3 * (block - _GAP)

    height = cells[0][2].shape[0]
    step = height + _CAPTION + _GAP
    rows = -(-len(cells) // _COLUMNS)
    block = _GAP + 14  # between neighbouring effects
    first = _TITLE + (height + _GAP + _CAPTION)
    width, total = left_of(_COLUMNS - 1) + cell + _MARGIN, first + rows * step + _MARGIN - _GAP
    figure = Figure(figsize=(width / 100, total / 100), dpi=100, facecolor=_PAPER)
    canvas = FigureCanvasAgg(figure)

    def write(text: str, x: float, y: float, size: float, colour: str = _INK, **how: Any) -> None:
        figure.text(x / width, 1 - y / total, text, fontsize=size, color=colour, family="DejaVu Sans", **how)

    write("Effects of augment", _MARGIN, 46, 19, weight="bold")
    if cell >= _CAPTIONED:
        write(f"each at three strengths, on {shown}", _MARGIN, 70, 10.5, _PALE)
    top = _TITLE + _CAPTION - 8
    placed = [(top, left_of(column), originals[column % len(originals)]) for column in range(_COLUMNS)]
    write("originals", _MARGIN, _TITLE + _CAPTION - 14, 10.5, weight="bold")
    for number, (name, caption, picture) in enumerate(cells):
        row, column = divmod(number, _COLUMNS)
        top, left = first + row * step + _CAPTION, left_of(column)
        placed.append((top, left, picture))
        if number % 3 == 0:
            write(name, left, top - 7, 10.5, weight="bold")
        if cell >= _CAPTIONED:
            write(caption, left + cell, top - 7, 9, _PALE, ha="right")
    canvas.draw()
    sheet = np.array(canvas.buffer_rgba())[:total, :width, :3]
    for top, left, picture in placed:
        sheet[top : top + height, left : left + cell] = picture
    return sheet
