"""A labelled contact sheet that shows every effect at several strengths."""

from __future__ import annotations

from itertools import zip_longest

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from augment.base import check_batch
from augment.errors import AugmentError
from augment.policies import policy
from augment.registry import EFFECTS, POLICIES, effect

Picture = NDArray[np.uint8]

_STRENGTHS = (0.3, 0.6, 1.0)
_COLUMNS = 2 * len(_STRENGTHS)
_SEED = 4  # of the policies' parameters
_WIDTH = 19.0  # inches of the sheet, 100 pixels each


def preview(batch: Tensor) -> Picture:
    """Draw a labelled contact sheet of all effects at several strengths, and of the policies.

    Args:
        batch: panoramas (B, 3, H, W) to show the effects on, in turn; 128 x 512 pixels look best.

    Returns:
        The sheet (rows, columns, 3), RGB, uint8.

    Raises:
        AugmentError: an invalid or empty batch.

    Example:
        >>> import torch, augment
        >>> augment.preview(torch.rand(2, 3, 32, 128)).shape[1:]
        (1900, 3)
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    check_batch(batch)
    if len(batch) == 0:
        raise AugmentError("a preview needs at least one panorama, got an empty batch")
    cells = [("original" if not number else "", "", batch[number % len(batch)]) for number in range(_COLUMNS)]
    for number, name in enumerate(EFFECTS):
        shown, frame = effect(name), batch[number % len(batch)][None]
        cells += [(name, f"{one:g}", shown.apply(frame, shown.at(one, frame))[0]) for one in _STRENGTHS]
    for number, name in enumerate(POLICIES[1:], len(EFFECTS)):
        drawn = policy(name)(batch[number % len(batch)][None], torch.Generator().manual_seed(_SEED))
        cells.append((f"policy {name}", "", drawn[0]))
    rows = -(-len(cells) // _COLUMNS)
    height = rows * (_WIDTH / _COLUMNS * batch.shape[2] / batch.shape[3] + 0.3)
    figure = Figure(figsize=(_WIDTH, height), dpi=100)
    margins = {"left": 0.01, "right": 0.99, "bottom": 0.1 / height, "top": 1 - 0.3 / height}
    places = figure.subplots(rows, _COLUMNS, gridspec_kw={**margins, "wspace": 0.03, "hspace": 0.05}).ravel()
    for axes, cell in zip_longest(places, cells):
        axes.axis("off")
        if cell is not None:
            axes.imshow(cell[2].cpu().permute(1, 2, 0).numpy())
            axes.set_title(cell[0], loc="left", fontsize=10, fontweight="bold", pad=3)
            axes.set_title(cell[1], loc="right", fontsize=9, pad=3)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.array(canvas.buffer_rgba())[..., :3]
