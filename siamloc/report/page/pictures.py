"""The images of a report: many thumbnails on a few sheets, and some larger images."""

from __future__ import annotations

import base64
import math
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
_SMALL, _LARGE = (192 * 48, 50), (384 * 96, 66)  # pixels and JPEG quality
_MOST_LARGE = 180


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
        """Return the rows and columns of an image of about `pixels` pixels, in its aspect ratio.

        Unwrapped images are not enlarged. Both numbers are multiples of 16, the size of JPEG's colour blocks, so that
        neighbours on a sheet do not bleed.
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
        images: sheets with 8 images per row, as base64-encoded JPEG.
    """

    size: tuple[int, int]
    place: dict[str, int]
    images: list[str]

    def plain(self) -> dict[str, Any]:
        """Return what the page's script needs."""
        rows, columns = self.size
        return {"rows": rows, "columns": columns, "across": _SHEET_COLUMNS, "images": self.images}


def make_sheets(decoder: Decoder, paths: Sequence[str], most: int) -> Sheets:
    """Put the images of the first files on sheets.

    Args:
        decoder: reads the images.
        paths: files, the most important first.
        most: number of images.
    """
    unique = list(dict.fromkeys(paths))
    pixels, quality = _SMALL
    place: dict[str, int] = {}
    tiles: list[Picture] = []
    for path in track(unique[:most], min(most, len(unique)), "reading pictures"):
        tile = decoder.read(path, pixels)
        place[path] = -1 if tile is None else len(tiles)
        if tile is not None:
            tiles.append(tile)
    images = [_encoded_sheet(tiles[i : i + TILES_PER_SHEET], quality) for i in range(0, len(tiles), TILES_PER_SHEET)]
    return Sheets(decoder.fitted(pixels), place, images)


def make_large(wanted: Sequence[tuple[Decoder, str]]) -> dict[tuple[int, str], str]:
    """Return data URIs of images by the decoder's id and the path.

    Args:
        wanted: files, each with its decoder, the most important first: the first 180 that can be read are included.
    """
    uris: dict[tuple[int, str], str] = {}
    for decoder, path in dict.fromkeys(wanted):
        if len(uris) < _MOST_LARGE and (picture := decoder.read(path, _LARGE[0])) is not None:
            uris[id(decoder), path] = "data:image/jpeg;base64," + _jpeg(picture, _LARGE[1])
    return uris


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
