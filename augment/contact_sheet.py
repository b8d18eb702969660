"""A labelled contact sheet that shows every effect at several strengths."""

from __future__ import annotations

from dataclasses import dataclass
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

Picture = NDArray[np.uint8]

_GAP = 10
_CAPTION = 26
_MARGIN = 36
_TITLE = 92
_COLUMNS = 6
_DRAW = 4  # seed of the policies' parameters
_CELL = 288
_INK, _PALE, _PAPER = "#1d2733", "#64748b", "#ffffff"


@dataclass(frozen=True)
class _Shot:
    """One cell of the sheet: the settings of an effect, and the caption that describes them."""

    caption: str
    params: dict[str, float]
    options: dict[str, Any]


def preview(batch: Tensor, columns: int = _COLUMNS, cell: int = _CELL) -> Picture:
    """Draw a labelled contact sheet of all effects at several strengths, and of the policies.

    Args:
        batch: panoramas (B, 3, H, W) to show the effects on, in turn; 128 x 512 pixels look best.
        columns: images in a row, a multiple of 3.
        cell: width of an image in pixels; panoramas are resized to it.

    Returns:
        The sheet (rows, columns, 3), RGB, uint8.

    Raises:
        AugmentError: an invalid or empty batch, or a number of columns that is not a multiple of 3.

    Example:
        >>> import torch, augment
        >>> augment.preview(torch.rand(2, 3, 32, 128), columns=6, cell=64).shape
        (898, 520, 3)
    """
    check_batch(batch)
    if len(batch) == 0:
        raise AugmentError("a preview needs at least one panorama, got an empty batch")
    if columns < 3 or columns % 3:
        raise AugmentError(f"columns of a preview must be a multiple of 3, got {columns}")
    frames = batch.cpu() if batch.dtype == torch.uint8 else (batch.cpu() * 255).round().to(torch.uint8)
    cells: list[tuple[str, str, Picture]] = []
    for number, name in enumerate(EFFECTS):
        frame = frames[number % len(frames)][None]
        for shot in _shots(name):
            cells.append((name, shot.caption, _small(_shoot(name, shot, frame), cell)))
    for number, name in enumerate(POLICIES[1:]):
        frame = frames[(len(EFFECTS) + number) % len(frames)][None]
        drawn = policy(name)(frame, torch.Generator().manual_seed(_DRAW))[0]
        cells.append(("policy", name, _small(drawn, cell)))
    return _sheet(cells, [_small(frame, cell) for frame in frames[: columns // 3 * 3]], columns, cell)


def _shots(name: str) -> list[_Shot]:
    """Return the three strengths at which an effect is shown."""
    tables: dict[str, list[_Shot]] = {
        "bulb": _spots({}),
        "square": _spots({}),
        "trapezoid": _spots({"taper": 0.5}),
        "brighten": [_Shot(f"c = {c}", {"amount": c}, {}) for c in (35, 55, 75)],
        "darken": [_Shot(f"c = {c}", {"amount": c}, {}) for c in (35, 55, 75)],
        "sharpen": [_Shot(f"strength {s:g}", {"strength": s}, {}) for s in (0.5, 1.0, 2.0)],
        "blur": [_Shot(f"{n} x {n} box", {}, {"size": n}) for n in (3, 5, 9)],
        "contrast": [_Shot(f"c = {c:g}", {"factor": c}, {}) for c in (0.5, 1.3, 1.8)],
        "equalize": [_Shot(f"strength {s:g}", {"strength": s}, {}) for s in (0.3, 0.6, 1.0)],
        "saturate": [_Shot(f"c = {c:g}", {"factor": c}, {}) for c in (0.2, 1.4, 2.0)],
        "rotate": [_Shot(f"{d}°", {}, {"degrees": d}) for d in (45, 115, 240)],
        "noise": [_Shot(f"variance {v:g}", {"variance": v}, {}) for v in (0.0025, 0.01, 0.05)],
        "occlude": [
            _Shot(f"{100 * s:.0f} % in {n}", {"share": s, "bars": n}, {}) for s, n in ((0.05, 1), (0.2, 3), (0.4, 4))
        ],
        "motion_blur": [_Shot(f"{n} columns", {"length": n}, {}) for n in (5, 9, 15)],
        "gamma": [_Shot(f"γ = {g:g}", {"gamma": g}, {}) for g in (0.5, 1.4, 2.0)],
        "white_balance": [
            _Shot(text, {"temperature": t, "tint": m}, {})
            for text, t, m in (("−0.6 stops", -0.6, 0), ("+0.6 stops", 0.6, 0), ("tint +0.15", 0, 0.15))
        ],
        "exposure": [_Shot(f"{e:+g} stops".replace("-", "−"), {"stops": e}, {}) for e in (-1.5, 0.75, 1.5)],
        "vignette": [_Shot(f"{100 * s:.0f} % lost", {"strength": s, "centre": 0.5}, {}) for s in (0.3, 0.55, 0.8)],
        "shadow": [
            _Shot(f"depth {d:g}", {"depth": d, "softness": s, "tilt": t, "offset": 0.1}, {})
            for d, s, t in ((0.35, 0.3, 20), (0.55, 0.15, -30), (0.75, 0.06, 40))
        ],
        "sun_patch": [
            _Shot(f"gain {g:g}", {"gain": g, "distance": d, "turn": t, "length": 1.7, "breadth": 1.3}, {})
            for g, d, t in ((1.6, 2.2, -35), (2.3, 2.2, 20), (3.0, 2.4, 50))
        ],
        "relight": [
            _Shot(f"{n:g} stops", {"stops": n, "warmth": w, "slope": s, "phase1": p, "phase2": 2 * p, "phase3": -p}, {})
            for n, w, s, p in ((0.6, 0.2, 0.5, 0), (1.2, -0.3, -0.5, 2), (1.8, 0.3, 0.2, -2))
        ],
        "doorway": [_Shot(f"{n:+g} stops".replace("-", "−"), {"stops": n, "share": 0.25}, {}) for n in (-2, 1.2, 2.5)],
        "windows": [
            _Shot(f"level {n}, {100 * share:g} %", {"level": n, "share": share}, {})
            for n, share in ((10, 0.05), (10, 0.15), (255, 0.15))
        ],
        "view": [
            _Shot(f"zoom {z:g}, roll {r:g}", {"zoom": z, "roll": r, "down": 0, "across": 0, "stretch": 1}, {})
            for z, r in ((1.25, 0), (1, 7), (0.8, -7))
        ],
        "jpeg": [_Shot(f"quality {q}", {"quality": q}, {}) for q in (50, 25, 10)],
    }
    return tables[name]


def _spots(form: dict[str, float]) -> list[_Shot]:
    light, dark = {"tone": "light", "radius": 40}, {"tone": "dark", "radius": 40}
    return [
        _Shot("light, 130 levels", {**form, "intensity": 130}, light),
        _Shot("dark, 160 levels", {**form, "intensity": 160}, dark),
        _Shot("across the seam", {**form, "intensity": 160, "column": 0}, dark),
    ]


def _shoot(name: str, shot: _Shot, frame: Tensor) -> Tensor:
    built = effect(name, **shot.options)
    params = built.at(1, frame)
    if "row" in params and "column" in params:
        row, column = _plain_place(frame[0], 110 if shot.options["tone"] == "light" else 170)
        if "column" in shot.params:  # moves the surface to the column where the spot will be
            frame = frame.roll(int(shot.params["column"]) - column, dims=3)
        params["row"][0], params["column"][0] = row, column
    for key, value in shot.params.items():
        params[key] = torch.tensor([value]).to(params[key].dtype)
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


def _sheet(cells: list[tuple[str, str, Picture]], originals: list[Picture], columns: int, cell: int) -> Picture:
    """Lay the cells out row by row, three for each effect, with names and values above them."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    height = cells[0][2].shape[0]
    step = height + _CAPTION + _GAP
    rows = -(-len(cells) // columns)
    block = _GAP + 14  # between neighbouring effects
    width = 2 * _MARGIN + columns * cell + (columns - 1) * _GAP + (columns // 3 - 1) * (block - _GAP)
    first = _TITLE + (height + _GAP + _CAPTION)
    total = first + rows * step + _MARGIN - _GAP
    sheet = np.full((total, width, 3), 255, dtype=np.uint8)
    figure = Figure(figsize=(width / 100, total / 100), dpi=100, facecolor=_PAPER)
    canvas = FigureCanvasAgg(figure)

    def write(text: str, x: float, y: float, size: float, colour: str = _INK, **how: Any) -> None:
        figure.text(x / width, 1 - y / total, text, fontsize=size, color=colour, family="DejaVu Sans", **how)

    def left_of(column: int) -> int:
        return _MARGIN + column * (cell + _GAP) + column // 3 * (block - _GAP)

    write("Effects of augment", _MARGIN, 46, 19, weight="bold")
    write("each at three strengths, on panoramas whose columns wrap around", _MARGIN, 70, 10.5, _PALE)
    placed: list[tuple[int, int, Picture]] = []
    for column in range(columns):
        placed.append((_TITLE + _CAPTION - 8, left_of(column), originals[column % len(originals)]))
    write("originals", _MARGIN, _TITLE + _CAPTION - 14, 10.5, weight="bold")
    for number, (name, caption, picture) in enumerate(cells):
        row, column = divmod(number, columns)
        top, left = first + row * step + _CAPTION, left_of(column)
        placed.append((top, left, picture))
        if number % 3 == 0:
            write(name, left, top - 7, 10.5, weight="bold")
        write(caption, left + cell, top - 7, 9, _PALE, ha="right")
    canvas.draw()
    sheet[:] = np.asarray(canvas.buffer_rgba())[:total, :width, :3]
    for top, left, picture in placed:
        sheet[top : top + height, left : left + cell] = picture
    return sheet
