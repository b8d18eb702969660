"""`PanoramaStore`: the panoramas of a frame table, decoded once and memory-mapped from then on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.data.decoding import Preprocessing
from siamloc.data.frames import FrameTable
from siamloc.data.panorama import OmnidirectionalCamera, PanoramaView
from siamloc.data.policy import check_policy, logger
from siamloc.data.store_files import StoreContents, build_store, load_store, store_key
from siamloc.errors import ConfigError, DataError


class PanoramaStore:
    """Decoded panoramas on disk, one row for each frame whose image could be read.

    Attributes:
        frames: the frames of the rows; row i of the store shows frame i.
        panoramas: (N, 3, H, W), uint8, RGB, memory-mapped and read-only.
        rejected: images that could not be read, each as {"path": ..., "reason": ...}.
        key: name of the store in its cache: a hash of the images' names, sizes and times and of the preprocessing.
            Poses and labels are not part of it.
    """

    def __init__(self, folder: Path, contents: StoreContents, frames: FrameTable) -> None:
        self.folder = folder
        self.key = folder.name
        self.rejected: list[dict[str, str]] = contents.rejected
        self.frames = frames
        self.panoramas: NDArray[np.uint8] = contents.panoramas
        order = np.argsort(frames.index, kind="stable")
        self._sorted_index = frames.index[order]
        self._row_of_sorted = order

    @classmethod
    def open_or_build(
        cls,
        frames: FrameTable,
        cache: str | Path,
        *,
        image_size: tuple[int, int] = (128, 512),
        unwrap: OmnidirectionalCamera | None = None,
        view: PanoramaView | None = None,
        workers: int | None = None,
        on_error: str = "skip",
    ) -> PanoramaStore:
        """Open the store of these frames in a cache folder, or decode the images and make it first.

        Two processes that ask for the same store build it once: the second one waits. What an interrupted build
        leaves behind is never taken for a store, and the next build removes it.

        Args:
            frames: whose images to decode.
            cache: folder of the stores, made if need be.
            image_size: rows and columns (H, W) of a panorama.
            unwrap: camera of omnidirectional images; None if the images are panoramas or ordinary pictures, which
                are resized by area.
            view: what the unwrapped panorama shows; the default elevations if None. Its size has to be `image_size`.
            workers: decoding threads; one for each core, up to 16, if None.
            on_error: "skip" leaves unreadable images out and reports them, "raise" stops at the first.

        Raises:
            ConfigError: a size, view, camera, number of workers or policy that makes no sense.
            DataError: no frames, none readable, or an unreadable one and `on_error` is "raise".
            FormatError: the store was written by a newer version.
            StorageError: the disk is full or refuses.
        """
        check_policy(on_error)
        if len(frames) == 0:
            raise DataError("there are no frames to decode: the table is empty")
        if workers is not None and workers < 1:
            raise ConfigError(f"decoding needs at least one worker, got {workers}")
        preprocessing = Preprocessing.checked(image_size, unwrap, view)
        folder = Path(cache).expanduser().absolute() / store_key(frames.path.tolist(), preprocessing)
        contents = load_store(folder, len(frames))
        if contents is None:
            contents = build_store(folder, frames.path.tolist(), preprocessing, workers, on_error)
        if contents.rejected:
            first = contents.rejected[0]
            text = f"{len(contents.rejected)} of {len(frames)} images cannot be read, the first: "
            text += f"{first['path']} ({first['reason']})"
            if on_error == "raise":
                raise DataError(f"{text}; on_error=skip leaves them out")
            logger.warning("%s; left out", text)
        return cls(folder, contents, frames.take(contents.kept))

    def __len__(self) -> int:
        return len(self.panoramas)

    def __repr__(self) -> str:
        _, _, height, width = self.panoramas.shape
        return f"PanoramaStore({len(self)} panoramas of {height} x {width}, {self.folder})"

    def __reduce__(self) -> tuple[Any, ...]:
        # A memory map would be pickled as all its bytes; another process opens the file instead.
        return _reopened, (self.folder, self.frames, len(self) + len(self.rejected))

    def batch(self, rows: ArrayLike, out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
        """Gather panoramas.

        Args:
            rows: row numbers (B,), in any order, repeated or not.
            out: where to put them (B, 3, H, W), uint8 and C-contiguous; a new array if None.

        Returns:
            (B, 3, H, W), uint8, RGB.

        Raises:
            IndexError: a row outside 0 ... N - 1, or rows that are no whole numbers.
            ValueError: `out` of another shape or type.
        """
        wanted = np.asarray(rows)
        if wanted.size == 0:
            wanted = wanted.astype(np.intp)
        if wanted.ndim != 1 or wanted.dtype.kind not in "iu":
            raise IndexError(f"rows must be whole numbers (B,), got shape {wanted.shape} of {wanted.dtype}")
        if wanted.size and (wanted.min() < 0 or wanted.max() >= len(self)):
            wrong = wanted[(wanted < 0) | (wanted >= len(self))][0]
            raise IndexError(f"row {wrong} is outside the store, whose rows are 0 ... {len(self) - 1}")
        shape = (len(wanted), *self.panoramas.shape[1:])
        if out is None:
            out = np.empty(shape, dtype=np.uint8)
        elif out.shape != shape or out.dtype != np.uint8 or not out.flags.c_contiguous:
            raise ValueError(f"out must be contiguous uint8 {shape}, got {out.dtype} {out.shape}")
        # With mode="raise" numpy would gather into a buffer first and copy; the rows are checked already.
        np.take(self.panoramas, wanted, axis=0, out=out, mode="clip")
        return out

    def rows_of(self, frames: FrameTable) -> NDArray[np.int64]:
        """Return the store's rows (n,) that show the frames of a sub-table of `frames`, matched by `index`.

        Raises:
            DataError: a frame that the store does not hold, or a table of other frames.
        """
        at = np.searchsorted(self._sorted_index, frames.index).clip(max=len(self) - 1)
        rows = self._row_of_sorted[at]
        wrong = np.flatnonzero((self.frames.index[rows] != frames.index) | (self.frames.path[rows] != frames.path))
        if wrong.size:
            path = str(frames.path[wrong[0]])
            reason = next((f": {item['reason']}" for item in self.rejected if item["path"] == path), "")
            raise DataError(
                f"{wrong.size} of {len(frames)} frames are not in the store {self.folder}, the first {path}{reason}; "
                "take the frames from the store's own table (store.frames)"
            )
        return rows


def _reopened(folder: Path, frames: FrameTable, total: int) -> PanoramaStore:
    contents = load_store(folder, total)
    if contents is None:
        raise DataError(f"the store {folder} is gone or cut short: build it anew")
    return PanoramaStore(folder, contents, frames)
