"""`expand`: write an augmented data set in the layout of the one it is made of ([T] 5.3.2, table 5.18)."""

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
from siamloc.calls import typed
from siamloc.data.decoding import Preprocessing, UnreadableImageError
from siamloc.data.expansion import outputs, write_lists
from siamloc.data.frames import FrameTable
from siamloc.data.panorama import OmnidirectionalCamera
from siamloc.errors import ConfigError, DataError
from siamloc.files import alone, real_path, storage_errors
from siamloc.progress import track


@dataclass(frozen=True)
class Expanded:
    """An expanded data set on disk.

    Attributes:
        folder: where it lies.
        kind: what `siamloc.data.read` calls it.
        frames: how many frames were expanded.
        depth: pictures of each frame.
        written: pictures written now.
        kept: pictures that were there already.
        failed: why images were left out, a sentence each.
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
        """What `siamloc.data.read` reads it with: `read(**expanded.source)`."""
        where = {"manifest": self.folder / "manifest.csv"} if self.kind == "manifest" else {"root": self.folder}
        return {"kind": self.kind, **{key: str(path) for key, path in where.items()}}

    def summary(self) -> str:
        """Return what was written, what was left out, and how to train with it."""
        lines = []
        if self.failed:
            total = self.frames + len(self.failed)
            lines.append(f"left out: {len(self.failed)} of {total} images, the first: {self.failed[0]}")
        before = f", {self.kept} were there" if self.kept else ""
        count = self.written + self.kept
        lines.append(f"{self.folder}: {count} pictures of {self.frames} frames, {self.depth} each{before}")
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
    """Write several pictures of every frame: the original, spots, global light, blur, rotations and their combinations.

    Args:
        frames: what to expand, as a reader gave them: the layout is that of the data set they were read from.
        out: folder of the expanded data set, outside of the data.
        depth: pictures of every frame; 16, 44, 128, 129 and 246 in the thesis.
        image_size: rows and columns of the pictures, which are panoramas.
        unwrap: camera of omnidirectional images; see `PanoramaLibrary`.
        circular: the columns wrap around.
        seed: of all draws.
        resume: go on in a folder that was interrupted; only what is missing is made.
        workers: pictures in work at once.
        on_error: "skip" leaves unreadable images out and reports them, "raise" stops at the first.

    Raises:
        ConfigError: frames that no reader gave, a folder inside the data, or another process that writes there.
        DataError: no image can be read.
        AugmentError: a depth below 1, a folder in use, or another expansion to resume.
        StorageError: the disk is full or refuses.
    """
    folder, kind = Path(out), str(frames.source.get("kind", ""))
    if kind not in ("cold", "folder", "manifest"):
        raise ConfigError("an expanded data set has the layout of its own: give frames that siamloc.data.read gave")
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
    """Raise ConfigError if the pictures would come to lie where they would be read as frames again."""
    inside = real_path(folder)
    if kind != "manifest" and inside.is_relative_to(real_path(root)):
        raise ConfigError(f"out={folder} lies in the data set {root} itself: choose a folder outside of it")
    if any(parent.is_relative_to(inside) for parent in {real_path(path).parent for path in frames.path.tolist()}):
        raise ConfigError(f"out={folder} holds images that are to be expanded: choose a folder outside of the data")
