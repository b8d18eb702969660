"""`PanoramaLibrary`: the panoramas of a table of frames, decoded once and gathered in batches."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import typed
from foundation.files import expanded, read_json
from foundation.settings import Thousand, shortened
from siamloc.data.cameras import twice_as_wide
from siamloc.data.decoding import Preprocessing
from siamloc.data.frames import FrameTable
from siamloc.data.panorama import OmnidirectionalCamera, seen
from siamloc.data.photo_sphere import is_equirectangular, stated
from siamloc.data.ring import fitted
from siamloc.data.store import Store, open_store
from siamloc.errors import ConfigError, DataError, FormatError, Policy, logger

CACHE = ".siamloc/panoramas"


class PanoramaLibrary:
    """The panoramas of a table of frames: (B, 3, rows, columns), uint8, RGB.

    Images are decoded when the library is first created, and opened from the cache from then on. Each sequence has
    its own store, so that a library of whole sequences serves every selection of them: changing which sequences
    train, form the map or are queried never decodes an image twice.

    Args:
        frames: the requested frames.
        cache: folder of the decoded panoramas; the environment variable SIAMLOC_CACHE or `.siamloc/panoramas` if None.
        image_size: rows and columns (H, W) of a panorama.
        unwrap: camera of omnidirectional images, or plain values, such as
            {"kind": "polar", "inner": 60}. None for panoramas and ordinary images, which are resized by area. The tilt
            of the robot, where frames have it, is taken out.
        elevations: elevations of a panorama's upper and lower edge in degrees, 30 and -45 if None;
            `PanoramaLibrary(frames, unwrap=camera, **network.view)` makes the panoramas that a network was trained on.
        level: whether pictures whose tilt is unknown are levelled by the edges that stand upright in them.
        circular: whether the columns wrap around; False for ordinary cameras.
        on_error: "skip" leaves unreadable images out and reports them, "raise" stops at the first.
        workers: decoding threads; one per core, up to 16, if None.

    Attributes:
        frames: the frames whose image could be read, in the given order; row i of the library shows frame i.
        rejected: images that were left out, each as {"path": ..., "reason": ...}.
        image_size: rows and columns (H, W).
        circular: whether the columns wrap around.
        preprocessing: reads an image and makes a panorama of it, with image size and camera.
        cameras: the camera of each drive, by sequence: of an `AutoRing`, the ring that its pictures show.
        sizes: `Preprocessing.size` of each drive: that of most pictures, of an `AutoRing` of most of the drive's.
        simulated: whether siamloc simulated all images, so that panoramas show the elevations that they should.

    Raises:
        ConfigError: a size, camera, number of workers or policy that makes no sense, or an `unwrap` that does not fit
            simulated images.
        DataError: no frames, no readable image, or an unreadable image if `on_error` is "raise".
        StorageError: the disk is full or cannot be written to.

    Example:
        >>> import cv2, tempfile
        >>> folder = Path(tempfile.mkdtemp())
        >>> _ = cv2.imwrite(str(folder / "1.png"), np.full((20, 80, 3), 7, np.uint8))
        >>> library = PanoramaLibrary(FrameTable(path=[folder / "1.png"]), folder / "cache", image_size=(8, 32))
        >>> library.batch([0, 0]).shape
        (2, 3, 8, 32)
    """

    @typed
    def __init__(
        self,
        frames: FrameTable,
        cache: str | Path | None = None,
        *,
        image_size: Sequence[int] = (128, 512),
        unwrap: OmnidirectionalCamera | Mapping[str, Any] | None = None,
        elevations: tuple[float, float] | None = None,
        level: bool = False,
        circular: bool = True,
        on_error: Policy = "skip",
        workers: Thousand | None = None,
    ) -> None:
        if len(frames) == 0:
            raise DataError("there are no frames to decode: the table is empty")
        made = Preprocessing.checked(image_size, unwrap, elevations, level)
        self.preprocessing = made.sized_by(frames.path.tolist())
        self.image_size = (self.preprocessing.view.height, self.preprocessing.view.width)
        self.circular = circular
        self._on_error = on_error
        self._cache = expanded(cache or os.environ.get("SIAMLOC_CACHE") or CACHE).absolute()
        self.simulated = _all_simulated(frames, self.preprocessing)
        _warn_of_equirectangular(frames, self.preprocessing, circular)
        tilt = frames.tilt
        self.cameras: dict[str, OmnidirectionalCamera | None] = {}
        self.sizes: dict[str, tuple[int, int] | None] = {}
        self.rejected: list[dict[str, str]] = []
        places: dict[int, tuple[Store, int]] = {}
        for sequence, rows in frames.rows_by("sequence").items():
            paths = frames.path[rows].tolist()
            tilts = tilt[rows] if self.preprocessing.camera is not None and np.isfinite(tilt[rows]).any() else None
            own = fitted(self.preprocessing, paths, self._cache)
            self.cameras[sequence], self.sizes[sequence] = own.camera, own.size
            store = open_store(paths, self._cache, own, tilts=tilts, on_error=on_error, workers=workers)
            self.rejected += store.rejected
            places |= {row: (store, at) for at, row in enumerate(rows[store.kept].tolist())}
        self.frames = frames.take(sorted(places))
        self._places = [places[row] for row in sorted(places)]
        self._row_of = dict.fromkeys(frames.identities(), -1)
        self._row_of.update({key: row for row, key in reversed(list(enumerate(self.frames.identities())))})

    def __len__(self) -> int:
        return len(self.frames)

    def __repr__(self) -> str:
        rows, columns = self.image_size
        left_out = f", {len(self.rejected)} images left out" if self.rejected else ""
        panoramas = f"{len(self)} panoramas of {rows} x {columns} px in {self._cache}{left_out}"
        return f"PanoramaLibrary({panoramas}; {self.frames.describe()})"

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """Shape (3, H, W) of a panorama."""
        return (3, *self.image_size)

    def settings(self) -> dict[str, Any]:
        """Return plain values that recreate this library: `PanoramaLibrary(frames, **settings)`."""
        return {
            "cache": str(self._cache),
            "image_size": list(self.image_size),
            "unwrap": self.preprocessing.unwrap_settings(),
            "circular": self.circular,
            "on_error": self._on_error,
        }

    def rows(self, frames: FrameTable) -> NDArray[np.int64]:
        """Return the row of each frame's panorama in the library (n,), as `batch` takes it.

        A frame's panorama is the panorama of the library's frame with the same sequence and path.

        Args:
            frames: n frames among those of the library, in any order.

        Raises:
            DataError: a frame without a panorama in the library.
        """
        rows = self._found(frames)
        if (rows < 0).any():
            wrong = np.flatnonzero(rows < 0)
            path = str(frames.path[wrong[0]])
            reason = next((item["reason"] for item in self.rejected if item["path"] == path), "unreadable")
            raise DataError(
                f"{len(wrong)} of {len(frames)} frames have no panorama, the first is {path} ({reason}): "
                "leave them out with library.readable(frames)"
            )
        return rows

    def readable(self, frames: FrameTable) -> FrameTable:
        """Leave out the frames whose image could not be read; the others stay in order.

        Raises:
            DataError: a frame that the library was not made from.
        """
        return frames.take(self._found(frames) >= 0)

    def seen(self, sequence: str) -> NDArray[np.bool_] | None:
        """Return which pixels (H, W) of its panoramas the camera of a drive sees, by the drive's first picture.

        Returns:
            None without a camera, or if the picture cannot be read any more or does not fit the camera.
        """
        path = str(self.frames.path[self.frames.sequence == sequence][0])
        camera, size = self.cameras[sequence], self.sizes[sequence] or self.preprocessing.usual_size([path])
        if camera is not None and size is not None:
            with suppress(ConfigError):  # a picture of another shape
                return seen(stated(camera, path, size), self.preprocessing.view, size)
        return None

    def batch(self, rows: ArrayLike) -> NDArray[np.uint8]:
        """Return panoramas (B, 3, H, W), uint8, RGB, by row numbers (B,) in any order, repeated or not.

        Raises:
            IndexError: a row outside 0 ... N - 1, or rows that are not whole numbers.
        """
        wanted = np.asarray(rows)
        if wanted.size == 0:
            wanted = wanted.astype(np.intp)
        if wanted.ndim != 1 or wanted.dtype.kind not in "iu" or ((wanted < 0) | (wanted >= len(self))).any():
            got = shortened(repr(wanted.tolist()))
            raise IndexError(f"rows must be whole numbers (B,), of the library's 0 ... {len(self) - 1}, got {got}")
        images = np.empty((len(wanted), *self.image_shape), dtype=np.uint8)
        for image, row in zip(images, wanted.tolist(), strict=True):
            store, at = self._places[row]
            image[...] = store.panoramas[at]
        return images

    def batches(self, frames: FrameTable, size: int = 64) -> Iterator[NDArray[np.uint8]]:
        """Yield the panoramas of frames in batches of at most `size`, in order.

        Raises:
            DataError: a frame without a panorama in the library.
        """
        rows = self.rows(frames)
        for start in range(0, len(rows), size):
            yield self.batch(rows[start : start + size])

    def _found(self, frames: FrameTable) -> NDArray[np.int64]:
        """Return the row of each frame, -1 for unreadable ones."""
        keys = frames.identities()
        unknown = [key for key in keys if key not in self._row_of]
        if unknown:
            raise DataError(
                f"{len(unknown)} of {len(frames)} frames are not among those that the library was made from, the "
                f"first is {unknown[0][1]} of sequence {unknown[0][0]!r}: make the library from all needed frames"
            )
        return np.array([self._row_of[key] for key in keys], dtype=np.int64)


def _all_simulated(frames: FrameTable, preprocessing: Preprocessing) -> bool:
    """Return whether `siamloc simulate` made all images, as `camera.json` next to them says.

    Raises:
        ConfigError: it asks for other unwrapping.
        FormatError: it is no mapping.
    """
    kind, simulated = preprocessing.unwrap_settings()["kind"], True
    for folder in sorted({Path(path).absolute().parents[1] for path in frames.path.tolist()}):
        if not (folder / "camera.json").is_file():
            simulated = False
            continue
        about = read_json(folder / "camera.json")
        if not isinstance(about, dict) or not isinstance(images := about.get("images"), str | None):
            raise FormatError(
                f"{folder / 'camera.json'} must be a mapping as `siamloc simulate` writes it next to images, got "
                f"{shortened(repr(about))}: simulate again, or rename the file if it is your own"
            )
        mirrors = ("polar", "auto", "unified", "hyperbolic")
        fitting = {"panorama": ("none",), "omnidirectional": mirrors}.get(images or "")
        if fitting is not None and kind not in fitting:
            raise ConfigError(
                f"{folder} holds simulated images of kind {images}, which unwrap={kind} does not fit: "
                f"use unwrap={fitting[-1]}" + (", or simulate with camera=panorama" if images != "panorama" else "")
            )
        simulated &= fitting is not None
    return simulated


def _warn_of_equirectangular(frames: FrameTable, preprocessing: Preprocessing, circular: bool) -> None:
    """Warn if equirectangular pictures, ceiling and floor included, are squeezed into panoramas."""
    view = preprocessing.view
    size = preprocessing.size
    if size is None or not circular or preprocessing.camera is not None:
        return
    shaped = twice_as_wide(*size) and size[0] >= 256 and view.width > 3 * view.height
    if shaped or is_equirectangular(frames.path[0]):
        logger.warning(
            "images of %d x %d px look like equirectangular pictures, squeezed into panoramas of %d x %d: "
            "use unwrap=equirectangular (in Python unwrap=EquirectangularCamera()), which shows %g to %g degrees",
            *(size[1], size[0], view.width, view.height, view.top, view.bottom),
        )
