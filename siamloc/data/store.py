"""Decoded panoramas on disk: `<cache>/<key>/{panoramas.npy, store.json}`, made once, completely or not at all."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.files import atomic_folder, content_key, expanded, parsed_json, storage_errors, write_json
from foundation.locks import locked
from foundation.threads import in_order, processors
from siamloc.data.decoding import Preprocessing
from siamloc.data.image_files import UnreadableImageError, bits_by_folder, spread
from siamloc.errors import ConfigError, DataError, leave_out, logger
from siamloc.progress import track

VERSION = 1
_FITTING = 10  # pictures: if neither the first ones nor as many others fit the camera, the rest is not decoded
_SAMPLING = 5  # version of how panoramas are sampled from the images of cameras


@dataclass(frozen=True)
class Store:
    """The panoramas of a list of images.

    Attributes:
        folder: folder of the store. Its name is the store's key: a hash of the images' names, sizes and times, of how
            many of 16 bits they use, and of the preprocessing.
        panoramas: (N, 3, H, W), uint8, RGB, memory-mapped and read-only.
        kept: positions in the list of the images that the panoramas show (N,).
        rejected: images that could not be read, each as {"path": ..., "reason": ...}.
    """

    folder: Path
    panoramas: NDArray[np.uint8]
    kept: NDArray[np.int64]
    rejected: list[dict[str, str]]

    def __reduce__(self) -> tuple[Any, ...]:
        # A memory map would be pickled as all its bytes; another process opens the file instead.
        return _reopened, (self.folder, len(self.kept) + len(self.rejected))


def open_store(
    paths: Sequence[str],
    cache: str | Path,
    preprocessing: Preprocessing,
    *,
    tilts: NDArray[np.float64] | None = None,
    on_error: str = "skip",
    workers: int | None = None,
) -> Store:
    """Open the store of several images in a cache folder; decode the images first if there is no store.

    If two processes ask for the same store, the second waits until the first has built it. The remains of an
    interrupted build are never taken for a store, and the next build removes them.

    Args:
        paths: images to decode.
        cache: folder of the stores, created if necessary.
        preprocessing: how an image becomes a panorama.
        tilts: roll and pitch of the robot in rad in each image (n, 2), which are taken out; NaN or None if unknown.
        on_error: "skip" leaves unreadable images out and reports them, "raise" stops at the first.
        workers: decoding threads; one per core, up to 16, if None.

    Raises:
        ConfigError: a camera that does not fit the images.
        DataError: no readable image, or an unreadable image if `on_error` is "raise".
        StorageError: the disk is full or cannot be written to.
    """
    folder = expanded(cache).absolute() / store_key(paths, preprocessing, tilts)
    store = _load(folder, len(paths))
    if store is None:
        where = f"{folder} (SIAMLOC_CACHE=FOLDER, in Python cache=FOLDER, takes another folder)"
        with storage_errors(where), ExitStack() as stack:
            folder.parent.mkdir(parents=True, exist_ok=True)
            lock = folder.with_name(f".{folder.name}.lock")
            if not stack.enter_context(locked(lock, wait=False)):
                logger.warning("another process is building the store %s; waiting for it", folder)
                stack.enter_context(locked(lock))
            store = _load(folder, len(paths))
            if store is None:
                with atomic_folder(folder) as temporary:
                    _write(temporary, paths, preprocessing, tilts, workers or min(processors(), 16), on_error)
        store = store or _reopened(folder, len(paths))
    faults = [f"{item['path']} ({item['reason']})" for item in store.rejected]
    leave_out(faults, len(paths), "images cannot be read", on_error)
    return store


def store_key(paths: Sequence[str], preprocessing: Preprocessing, tilts: NDArray[np.float64] | None = None) -> str:
    """Return the name of a store: a hash of the images' names, sizes, times, bits, tilts, and of the preprocessing."""
    files: list[list[Any]] = []
    listed = [file for one in paths for file in preprocessing.files(one)]
    for path in listed:
        size_and_time: list[int | None] = [None, None]
        with suppress(OSError, ValueError):
            status = os.stat(path)  # noqa: PTH116 (tens of thousands of paths)
            size_and_time = [status.st_size, status.st_mtime_ns]
        files.append([os.path.abspath(path), *size_and_time])  # noqa: PTH100
    made_of: dict[str, Any] = {"version": VERSION, "preprocessing": preprocessing.parameters(), "files": files}
    if preprocessing.camera is not None:
        made_of |= {"sampling": _SAMPLING, "tilts": None if tilts is None else tilts.tolist()}
        made_of |= {} if preprocessing.size is None else {"size": preprocessing.size}
    if deep := bits_by_folder(listed) if preprocessing.bits is None else {"": preprocessing.bits}:
        made_of["bits"] = deep
    return content_key(made_of)


def _load(folder: Path, total: int) -> Store | None:
    """Open a store of `total` images, or return None if there is no complete one."""
    try:
        record = parsed_json((folder / "store.json").read_text(encoding="utf-8"))
        rejected = record["rejected"]
        kept = np.delete(np.arange(total), np.array([item["row"] for item in rejected], dtype=np.int64))
        panoramas = np.asarray(np.load(folder / "panoramas.npy", mmap_mode="r", allow_pickle=False))
        whole = (
            record["version"] == VERSION
            and record["images"] == total
            and panoramas.dtype == np.uint8
            and panoramas.shape == (len(kept), 3, *record["image_size"])
            and len(kept) > 0
        )
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, KeyError, TypeError, IndexError, EOFError):
        whole = False
    if not whole:
        logger.warning("the store %s is damaged or cut short; it is built again", folder)
        return None
    faults = [{"path": item["path"], "reason": item["reason"]} for item in rejected]
    return Store(folder, panoramas, kept, faults)


def _reopened(folder: Path, total: int) -> Store:
    store = _load(folder, total)
    if store is None:
        raise DataError(f"the store {folder} is gone or cut short: open its library again to rebuild it")
    return store


def _write(
    folder: Path,
    paths: Sequence[str],
    preprocessing: Preprocessing,
    tilts: NDArray[np.float64] | None,
    workers: int,
    on_error: str,
) -> None:
    """Fill a folder with panoramas.npy and store.json."""
    size = [preprocessing.view.height, preprocessing.view.width]
    rejected: list[dict[str, Any]] = []
    kept = 0
    misfits = list[str]()

    def decode(row: int) -> NDArray[np.uint8] | UnreadableImageError | ConfigError:
        try:
            return preprocessing.panorama(paths[row], None if tilts is None else tilts[row])
        except (UnreadableImageError, ConfigError) as error:
            return error

    with (folder / "panoramas.npy").open("wb") as file:
        header = {"descr": "|u1", "fortran_order": False, "shape": (len(paths), 3, *size)}
        np.lib.format.write_array_header_1_0(file, header)
        decoded = in_order(decode, range(len(paths)), workers)
        for row, result in enumerate(track(decoded, len(paths), "decoding images")):
            if isinstance(result, np.ndarray):
                file.write(result.data)
                kept += 1
                continue
            if isinstance(result, ConfigError):  # a picture of another shape, or, if most do not fit, another camera
                misfits.append(f"{paths[row]}: {result}")
                enough = 1 if on_error == "raise" else _FITTING
                if kept == 0 and len(misfits) == enough:
                    others = map(decode, spread(range(len(paths)), _FITTING))
                    if not any(isinstance(one, np.ndarray) for one in others):
                        break
            if on_error == "raise":
                raise DataError(f"{paths[row]} cannot be read: {result} (on_error=skip leaves it out)")
            rejected.append({"row": row, "path": paths[row], "reason": str(result)})
        if len(misfits) > kept:
            raise ConfigError(misfits[0])
        if kept == 0:
            first = "{path} ({reason})".format(**rejected[0])
            raise DataError(f"none of the {len(paths)} images can be read, the first: {first}")
        file.seek(0)  # numpy leaves room in a header for any number of rows
        np.lib.format.write_array_header_1_0(file, {**header, "shape": (kept, 3, *size)})
        file.flush()
        os.fsync(file.fileno())
    record = {
        "version": VERSION,
        "images": len(paths),
        "image_size": size,
        "preprocessing": preprocessing.parameters(),
        "rejected": rejected,
    }
    write_json(folder / "store.json", record)
