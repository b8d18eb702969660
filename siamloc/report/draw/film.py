"""Write films of plots as GIF files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb, to_rgba_array
from numpy.typing import NDArray

from foundation.files import atomic_path
from siamloc.report.draw.look import INK

PICTURES = 80
"""Number of pictures of a film, at most."""
DOTS_PER_INCH = 110
_EACH, _LAST = 110, 4000  # milliseconds that each picture and the last one are shown


def moments(last: int) -> list[int]:
    """Return the moments from 1 to the last, evenly spread, of which a film has pictures."""
    return [int(at) for at in np.unique(np.linspace(1, last, PICTURES).round())]


def picture_of(canvas: FigureCanvasAgg) -> NDArray[np.uint8]:
    """Draw a canvas, and return the picture (H, W, 3)."""
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def write_film(pictures: Sequence[NDArray[np.uint8]], path: str | Path, colours: Sequence[str]) -> Path:
    """Write pictures (H, W, 3) as a GIF with a pause on the last one, and return its path.

    Args:
        pictures: the pictures in order.
        path: the file to write.
        colours: the colours drawn with, about 40 at most, besides greys: they are kept exactly.

    Raises:
        StorageError: the disk is full or cannot be written to.
    """
    path, indexed = Path(path), _indexed(pictures, colours)
    stays = [_EACH] * (len(indexed) - 1) + [_LAST]
    more: dict[str, Any] = {"append_images": indexed[1:], "duration": stays, "loop": 0, "disposal": 1}
    with atomic_path(path) as temporary:
        indexed[0].save(temporary, "GIF", save_all=True, **more)
    return path


def _indexed(pictures: Sequence[NDArray[np.uint8]], colours: Sequence[str]) -> list[Any]:
    """Return pictures in one common palette, for small files and steady, exact colours."""
    from PIL import Image

    # The colours used, and shades between each of them and white and ink.
    greys = np.linspace(0, 1, 24)[1:, None] * np.ones(3)
    drawn = to_rgba_array(list(colours))[:, :3]
    shades = [drawn + share * (1 - drawn) for share in (0, 0.25, 0.5, 0.75)]
    shades += [drawn + share * (np.array(to_rgb(INK)) - drawn) for share in (0.33, 0.67)]
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.round(255 * np.concatenate([greys, *shades])).astype(np.uint8).ravel().tolist())
    none = Image.Dither.NONE
    return [Image.fromarray(picture).quantize(palette=palette, dither=none) for picture in pictures]
