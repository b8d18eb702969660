"""`expand`: write an augmented data set in the layout of the one it is made from ([T] 5.3.2, table 5.18)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from augment.errors import AugmentError
from augment.expand import expand as write_variants
from augment.expand import headings
from foundation.calls import typed
from foundation.files import real_path, storage_errors
from foundation.locks import alone
from siamloc.data.decoding import Preprocessing, UnreadableImageError
from siamloc.data.expansion import outputs, write_lists
from siamloc.data.frames import FrameTable
from siamloc.data.panorama import OmnidirectionalCamera
from siamloc.errors import ConfigError, DataError
from siamloc.progress import track


@dataclass(frozen=True)
class Expanded:
    """An expanded data set on disk.

    Attributes:
        folder: folder of the data set.
        kind: kind of data for `siamloc.data.read`.
        frames: number of frames expanded.
        depth: number of images per frame.
        written: number of images written by this call.
        kept: number of images that were already there.
        failed: why images were left out, one sentence each.
    """

    folder: Path
    kind: str
    frames: int
    depth: int
    written: int
    kept: int
    failed: tuple[str, ...]

    @property
    def source(self) -> dict[str, Any]:
        """Arguments with which `siamloc.data.read` reads it: `read(**expanded.source)`."""
        where = {"manifest": self.folder / "manifest.csv"} if self.kind == "manifest" else {"root": self.folder}
        return {"kind": self.kind, **{key: str(path) for key, path in where.items()}}

    def summary(self) -> str:
        """Report what was written, what was left out, and how to train with it."""
        lines = []
        if self.failed:
            total = self.frames + len(self.failed)
            lines.append(f"left out: {len(self.failed)} of {total} images, the first: {self.failed[0]}")
        before = f", {self.kept} were there" if self.kept else ""
        count = self.written + self.kept
        lines.append(f"{self.folder}: {count} images of {self.frames} frames, {self.depth} each{before}")
        where = next(f"data.{key}={value}" for key, value in self.source.items() if key != "kind")
        unwrap = " unwrap=none" if self.kind == "cold" else ""
        lines.append(f"train with: siamloc train data={self.kind} {where}{unwrap}")
        return "\n".join(lines)


@typed
def expand(
    frames: FrameTable,
    out: str | Path,
    *,
    depth: int = 16,
    image_size: Sequence[int] = (128, 512),
    unwrap: OmnidirectionalCamera | Mapping[str, Any] | None = None,
    circular: bool = True,
    seed: int = 0,
    resume: bool = False,
    workers: int = 2,
    on_error: str = "skip",
) -> Expanded:
    """Write several images of every frame: the original, spots, global light, blur, rotations and their combinations.

    Args:
        frames: the frames to expand, as returned by a reader: the layout is that of the data set they were read from.
        out: folder of the expanded data set, outside the data.
        depth: number of images per frame; 16, 44, 128, 129 and 246 in the thesis.
        image_size: rows and columns of the images, which are panoramas.
        unwrap: camera of omnidirectional images; see `PanoramaLibrary`.
        circular: whether the columns wrap around.
        seed: seed of all random draws.
        resume: continue an interrupted expansion in the same folder; only what is missing is made.
        workers: number of images processed at once.
        on_error: "skip" leaves unreadable images out and reports them, "raise" stops at the first.

    Raises:
        ConfigError: frames that do not come from a reader, a folder inside the data, or another process that writes
            there.
        DataError: no image can be read.
        AugmentError: a depth below 1, a folder in use, or a folder to resume that holds another expansion.
        StorageError: the disk is full or cannot be written to.
    """
    folder, kind = Path(out), str(frames.source.get("kind", ""))
    if kind not in ("cold", "folder", "manifest"):
        raise ConfigError("an expanded data set keeps the layout of its source: give frames from siamloc.data.read")
    root = Path(frames.source["manifest"]).parent if kind == "manifest" else Path(frames.source["root"])
    _check_apart(folder, root, kind, frames)
    decode = Preprocessing.checked(image_size, unwrap)
    turns = headings(len(frames), depth, seed, (decode.view.height, decode.view.width), circular)
    pictures = outputs(kind, frames, root, folder, turns)

    def read(path: Path) -> NDArray[np.uint8]:
        try:
            return decode.panorama(path)
        except UnreadableImageError as error:
            raise AugmentError(f"{path}: {error}") from error

    with alone(folder), storage_errors(folder):
        done = write_variants(
            frames.path.tolist(),
            pictures,
            folder,
            seed=seed,
            circular=circular,
            resume=resume,
            threads=workers,
            on_error=on_error,  # type: ignore[arg-type]
            progress=track,
            read=read,
            reading=decode.parameters(),
        )
    lost = {str(source) for source, _ in done.failed}
    made = np.array([path not in lost for path in frames.path.tolist()])
    if not made.any():
        raise DataError(f"none of the {len(frames)} images could be read, the first: {done.failed[0][1]}")
    left = [row for row, there in zip(pictures, made, strict=True) if there]
    write_lists(kind, frames.take(made), left, folder, turns[made])
    reasons = tuple(reason for _, reason in done.failed)
    return Expanded(folder, kind, int(made.sum()), depth, done.written, done.kept, reasons)


def _check_apart(folder: Path, root: Path, kind: str, frames: FrameTable) -> None:
    """Raise ConfigError if the images would end up where they would be read as frames again."""
    inside = real_path(folder)
    if kind != "manifest" and inside.is_relative_to(real_path(root)):
        raise ConfigError(f"out={folder} lies in the data set {root} itself: choose a folder outside it")
    if any(parent.is_relative_to(inside) for parent in {real_path(path).parent for path in frames.path.tolist()}):
        raise ConfigError(f"out={folder} holds images that are to be expanded: choose a folder outside the data")
