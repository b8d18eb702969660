"""`siamloc augment expand`: write an augmented data set in the layout of the one it is made of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from omegaconf import DictConfig

from augment.errors import AugmentError
from augment.expand import expand, headings
from siamloc.cli.steps import preprocessing, read_frames
from siamloc.data.decoding import UnreadableImageError
from siamloc.data.expansion import outputs, write_lists
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError
from siamloc.files import storage_errors
from siamloc.progress import track


def main(config: DictConfig) -> None:
    """Expand the frames, write the lists that a reader needs, and say what there is."""
    folder = Path(config.out)
    frames = _chosen(config)
    _check_apart(folder, _root(config), config.data.kind, frames)
    decode = preprocessing(config)
    size = (decode.view.height, decode.view.width)
    turns = headings(len(frames), config.depth, config.seed, size, config.data.circular)
    pictures = outputs(config.data.kind, frames, _root(config), folder, turns)

    def read(path: Path) -> NDArray[np.uint8]:
        try:
            return decode.panorama(path)
        except UnreadableImageError as error:
            raise AugmentError(f"{path}: {error}") from error

    with storage_errors(folder):
        done = expand(
            frames.path.tolist(),
            pictures,
            folder,
            seed=config.seed,
            circular=config.data.circular,
            resume=config.resume,
            threads=config.workers,
            on_error=config.data.on_error,
            progress=track,
            read=read,
            reading=decode.parameters(),
        )
    lost = {str(source) for source, _ in done.failed}
    made = np.array([path not in lost for path in frames.path.tolist()])
    if not made.any():
        raise DataError(f"none of the {len(frames)} images could be read, the first: {done.failed[0][1]}")
    kept = [row for row, there in zip(pictures, made, strict=True) if there]
    write_lists(config.data.kind, frames.take(made), kept, folder, turns[made])
    _report(config, folder, frames, done.written, done.kept, [reason for _, reason in done.failed])


def _chosen(config: DictConfig) -> FrameTable:
    frames = read_frames(config)
    if not config.sequences:
        return frames
    return frames.select(sequence=[str(name) for name in config.sequences])


def _root(config: DictConfig) -> Path:
    return Path(config.data.manifest).parent if config.data.kind == "manifest" else Path(config.data.root)


def _check_apart(folder: Path, root: Path, kind: str, frames: FrameTable) -> None:
    """Raise ConfigError if the pictures would come to lie where they would be read as frames again."""
    inside = folder.resolve()
    if kind != "manifest" and inside.is_relative_to(root.resolve()):
        raise ConfigError(f"out={folder} lies in the data set {root} itself: choose a folder outside of it")
    if any(parent.is_relative_to(inside) for parent in {Path(path).resolve().parent for path in frames.path.tolist()}):
        raise ConfigError(f"out={folder} holds images that are to be expanded: choose a folder outside of the data")


def _report(config: DictConfig, folder: Path, frames: FrameTable, written: int, kept: int, failed: list[str]) -> None:
    for reason in failed[:1]:
        print(f"left out: {len(failed)} of {len(frames)} images, the first: {reason}")
    before = f", {kept} were there" if kept else ""
    print(f"{folder}: {written + kept} pictures of {len(frames) - len(failed)} frames, {config.depth} each{before}")
    where = f"data.manifest={folder}/manifest.csv" if config.data.kind == "manifest" else f"data.root={folder}"
    unwrap = " unwrap=none" if config.data.kind == "cold" else ""
    print(f"train with: siamloc train data={config.data.kind} {where}{unwrap}")
