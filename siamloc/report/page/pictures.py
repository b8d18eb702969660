"""The images of a report: many small ones on a few sheets and some larger ones, all within a byte budget."""

from __future__ import annotations

import base64
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from siamloc.data.decoding import Preprocessing, UnreadableImageError, read_image
from siamloc.data.panorama import CAMERAS
from siamloc.errors import SiamlocError
from siamloc.progress import track

Picture = NDArray[np.uint8]

TILES_PER_SHEET = 64
_SHEET_COLUMNS = 8
_DEFAULT_SIZE = (128, 512)
# Pixels and JPEG quality of the small images, from the preferred to the smallest.
_LEVELS = (
    (256 * 64, 62),
    (256 * 64, 45),
    (192 * 48, 64),
    (192 * 48, 50),
    (192 * 48, 38),
    (128 * 32, 50),
    (128 * 32, 36),
)
_LARGE_LEVELS = ((448 * 112, 72), (384 * 96, 66), (320 * 80, 60), (256 * 64, 50), (192 * 48, 40))
_SAMPLES = 24
_GUESS = 3000  # bytes per image if no sample could be read


class Decoder:
    """Reads images as the network or descriptor saw them, and records those that could not be read.

    Args:
        settings: settings of an evaluation; `data.image_size` and `data.unwrap` are used. A custom camera cannot be
            restored from them: its images are shown as they are.
    """

    def __init__(self, settings: Mapping[str, Any]) -> None:
        data = settings.get("data") or {}
        size, unwrap = data.get("image_size"), data.get("unwrap") or {}
        self.size = (int(size[0]), int(size[1])) if size else _DEFAULT_SIZE
        self._preprocessing = Preprocessing.checked(self.size, unwrap if unwrap.get("kind") in CAMERAS else None)
        self.missing: dict[str, str] = {}

    @property
    def parameters(self) -> dict[str, Any]:
        """All that determines the pixels: decoders with equal parameters give equal images."""
        return self._preprocessing.parameters()

    def read(self, path: str, pixels: int) -> Picture | None:
        """Return the image of a file (rows, columns, 3), BGR, with about `pixels` pixels; None if it cannot be read."""
        try:
            if self._preprocessing.camera is None:
                picture = read_image(path)
            else:
                picture = np.ascontiguousarray(self._preprocessing.panorama(path).transpose(1, 2, 0)[..., ::-1])
        except (UnreadableImageError, SiamlocError) as error:
            self.missing[path] = str(error)
            return None
        rows, columns = self.fitted(pixels)
        return np.asarray(cv2.resize(picture, (columns, rows), interpolation=cv2.INTER_AREA), dtype=np.uint8)

    def fitted(self, pixels: int) -> tuple[int, int]:
        """Return rows and columns of about `pixels` pixels, in the images' aspect ratio; unwrapped ones never grow.

        Both are multiples of 16, the size of JPEG's colour blocks, so that neighbours on a sheet do not bleed.
        """
        rows, columns = self.size
        scale = math.sqrt(pixels / (rows * columns))
        if self._preprocessing.camera is not None:
            scale = min(1.0, scale)
        return max(16, round(rows * scale / 16) * 16), max(16, round(columns * scale / 16) * 16)


@dataclass(frozen=True)
class Sheets:
    """Small images, 64 to a sheet.

    Attributes:
        size: rows and columns of an image.
        place: number of a file's image, counted through all sheets; -1 for a file that could not be read.
        wanted: number of requested files; those without a place were left out to save space.
        images: sheets with 8 images per row, as base64-encoded JPEG.
    """

    size: tuple[int, int]
    place: dict[str, int]
    wanted: int
    images: list[str]

    @property
    def left_out(self) -> int:
        """Number of files whose images did not fit."""
        return self.wanted - len(self.place)

    def plain(self) -> dict[str, Any]:
        """Return what the page's script needs."""
        rows, columns = self.size
        return {"rows": rows, "columns": columns, "across": _SHEET_COLUMNS, "images": self.images}


def make_sheets(decoder: Decoder, paths: Sequence[str], budget: int) -> Sheets:
    """Put images on sheets: as large as the budget allows, and only the first ones if not all fit at any size.

    Args:
        decoder: reads the images.
        paths: files, the most important first.
        budget: maximum total length of `Sheets.images`.
    """
    unique = list(dict.fromkeys(paths))
    sample = [unique[i] for i in np.unique(np.linspace(0, len(unique) - 1, _SAMPLES).astype(int))] if unique else []
    for pixels, quality in _LEVELS:
        tiles = [tile for path in sample if (tile := decoder.read(path, pixels)) is not None]
        each = len(_encoded_sheet(tiles, quality)) / len(tiles) if tiles else _GUESS
        room = max(0, int(budget / (1.04 * each)))
        if room >= len(unique):
            break
    place: dict[str, int] = {}
    tiles = []
    for path in track(unique, min(room, len(unique)), "reading pictures"):
        if len(tiles) >= room:
            break
        tile = decoder.read(path, pixels)
        place[path] = -1 if tile is None else len(tiles)
        if tile is not None:
            tiles.append(tile)
    images = [_encoded_sheet(tiles[i : i + TILES_PER_SHEET], quality) for i in range(0, len(tiles), TILES_PER_SHEET)]
    while images and sum(map(len, images)) > budget:
        # The sample was smaller than the rest: the last sheet holds the least important images.
        images.pop()
        kept = len(images) * TILES_PER_SHEET
        place = {path: number for path, number in place.items() if number < kept}
    return Sheets(decoder.fitted(pixels), place, len(unique), images)


def make_large(wanted: Sequence[tuple[Decoder, str]], budget: int) -> dict[tuple[int, str], str]:
    """Return data URIs of images by the decoder's id and the path, as large as the budget allows for all together.

    Args:
        wanted: files, each with its decoder, the most important first. A file is left out if it cannot be read, or
            does not fit even at the smallest size.
        budget: maximum total length of all URIs, each file counted as often as it is listed.
    """
    times = Counter((id(decoder), path) for decoder, path in wanted)
    first = {(id(decoder), path): decoder for decoder, path in wanted}
    for pixels, quality in _LARGE_LEVELS:
        pictures = {
            key: picture for key, decoder in first.items() if (picture := decoder.read(key[1], pixels)) is not None
        }
        uris = {key: "data:image/jpeg;base64," + _jpeg(picture, quality) for key, picture in pictures.items()}
        lengths = np.cumsum([len(uri) * times[key] for key, uri in uris.items()])
        if not len(lengths) or lengths[-1] <= budget:
            return uris
    return {key: uri for (key, uri), length in zip(uris.items(), lengths, strict=True) if length <= budget}


def _encoded_sheet(tiles: Sequence[Picture], quality: int) -> str:
    rows, columns = tiles[0].shape[:2]
    across = min(_SHEET_COLUMNS, len(tiles))
    sheet = np.full((math.ceil(len(tiles) / across) * rows, across * columns, 3), 128, dtype=np.uint8)
    for i, tile in enumerate(tiles):
        top, left = i // across * rows, i % across * columns
        sheet[top : top + rows, left : left + columns] = tile
    return _jpeg(sheet, quality)


def _jpeg(picture: Picture, quality: int) -> str:
    flags = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1, cv2.IMWRITE_JPEG_PROGRESSIVE, 1]
    return base64.b64encode(cv2.imencode(".jpg", picture, flags)[1].tobytes()).decode()
