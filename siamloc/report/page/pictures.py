"""The images of a report: many thumbnails on a few sheets, and some larger images."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from siamloc.data.decoding import Preprocessing
from siamloc.data.image_files import UnreadableImageError, read_image
from siamloc.errors import ConfigError, SiamlocError, logger
from siamloc.progress import track

Picture = NDArray[np.uint8]

TILES_PER_SHEET = 64
_SHEET_COLUMNS = 8
_DEFAULT_SIZE = (128, 512)
_SMALL, _LARGE = (192 * 48, 50), (384 * 96, 66)  # pixels and JPEG quality
_MOST_LARGE = 180


class Decoder:
    """Reads images as the network or descriptor saw them, and keeps them for the page.

    Args:
        settings: settings of an evaluation; `data.image_size` and `data.unwrap` are used. If a camera of the user's own
            cannot be made from them, its images are shown as they are.

    Attributes:
        missing: what is wrong with each file that could not be read.
        large: larger images as data URIs, by path.
        place: index of each file's small image on the sheets, by path; -1 for a file that could not be read.
    """

    def __init__(self, settings: Mapping[str, Any]) -> None:
        data = settings.get("data") or {}
        size, unwrap = data.get("image_size"), data.get("unwrap") or {}
        self.size = (int(size[0]), int(size[1])) if size else _DEFAULT_SIZE
        try:
            self._preprocessing = Preprocessing.checked(self.size, unwrap or None)
        except ConfigError:
            self._preprocessing = Preprocessing.checked(self.size)
        self.missing: dict[str, str] = {}
        self.large: dict[str, str] = {}
        self.place: dict[str, int] = {}
        self._sheets: list[str] = []

    @property
    def parameters(self) -> dict[str, Any]:
        """Everything that determines the images' pixels: decoders with equal parameters give equal images."""
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

    def fill_sheets(self, paths: Sequence[str], most: int) -> None:
        """Read small images of files and put them on sheets of 8 by 8, which `plain` returns.

        `place` then holds the index of each file's image, counted over all sheets row by row.

        Args:
            paths: paths of image files, each once, the most important file first.
            most: largest number of files that are read; the rest of `paths` is left out.
        """
        pixels, quality = _SMALL
        tiles: list[Picture] = []
        for path in track(paths[:most], min(most, len(paths)), "reading pictures"):
            tile = self.read(path, pixels)
            self.place[path] = -1 if tile is None else len(tiles)
            if tile is not None:
                tiles.append(tile)
        if missing := [path for path in self.place if path in self.missing]:
            first = missing[0], self.missing[missing[0]]
            logger.warning(
                "%d of %d pictures could not be read, the first: %s (%s)", len(missing), len(self.place), *first
            )
        starts = range(0, len(tiles), TILES_PER_SHEET)
        self._sheets = [_encoded_sheet(tiles[i : i + TILES_PER_SHEET], quality) for i in starts]

    def plain(self) -> dict[str, Any]:
        """Return the sheets as plain values for the page's script."""
        rows, columns = self.fitted(_SMALL[0])
        return {"rows": rows, "columns": columns, "across": _SHEET_COLUMNS, "images": self._sheets}


def read_large(wanted: Iterable[tuple[Decoder, str]]) -> None:
    """Read larger images of the first 180 files that can be read; each decoder keeps the images of its files.

    Args:
        wanted: decoder and path of each file, the most important file first.
    """
    count = 0
    for decoder, path in dict.fromkeys(wanted):
        if count < _MOST_LARGE and (picture := decoder.read(path, _LARGE[0])) is not None:
            decoder.large[path] = "data:image/jpeg;base64," + _jpeg(picture, _LARGE[1])
            count += 1


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
