"""How a panorama store lies on disk: `<cache>/<key>/{panoramas.npy, store.json}`, whole or not at all."""

from __future__ import annotations

import errno
import json
import os
import secrets
import shutil
import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from siamloc.data.decoding import Preprocessing, UnreadableImageError
from siamloc.data.locking import exclusive, is_locked
from siamloc.data.policy import logger
from siamloc.errors import DataError, FormatError
from siamloc.files import content_key, storage_errors, write_json
from siamloc.progress import track

VERSION = 1

_HEADER_BYTES = 192
_DAY = 24 * 3600


@dataclass(frozen=True)
class StoreContents:
    """What a store holds: the panoramas, which of the table's rows they show, and the images left out."""

    panoramas: NDArray[np.uint8]
    kept: NDArray[np.int64]
    rejected: list[dict[str, str]]


def store_key(paths: Sequence[str], preprocessing: Preprocessing) -> str:
    """Return the name of a store: a hash of the images' names, sizes and times, and of the preprocessing."""
    files: list[list[Any]] = []
    for path in paths:
        try:
            status = os.stat(path)  # noqa: PTH116 (ten thousands of paths)
            files.append([os.path.abspath(path), status.st_size, status.st_mtime_ns])  # noqa: PTH100
        except (OSError, ValueError):
            files.append([os.path.abspath(path), None, None])  # noqa: PTH100
    return content_key({"version": VERSION, "preprocessing": preprocessing.parameters(), "files": files})


def load_store(folder: Path, total: int) -> StoreContents | None:
    """Open a store of `total` images, or return None if there is none that is whole.

    Raises:
        FormatError: the store was written by a newer version.
    """
    try:
        record = json.loads((folder / "store.json").read_text(encoding="utf-8"))
        version = record["version"]
        if isinstance(version, int) and version > VERSION:
            raise FormatError(
                f"the store {folder} has format version {version}, this siamloc reads up to {VERSION}: "
                "update siamloc, or use another cache folder"
            )
        rejected = record["rejected"]
        gone = np.array([item["row"] for item in rejected], dtype=np.int64)
        kept = np.delete(np.arange(total), gone)
        panoramas = np.load(folder / "panoramas.npy", mmap_mode="r", allow_pickle=False)
        whole = (
            version == VERSION
            and record["images"] == total
            and panoramas.dtype == np.uint8
            and panoramas.shape == (len(kept), 3, *record["image_size"])
            and len(kept) > 0
        )
    except (FileNotFoundError, NotADirectoryError):
        return None
    except FormatError:
        raise
    except (OSError, ValueError, KeyError, TypeError, IndexError, EOFError):
        whole = False
    if not whole:
        logger.warning("the store %s is damaged or cut short; it is built anew", folder)
        return None
    return StoreContents(panoramas, kept, [{"path": item["path"], "reason": item["reason"]} for item in rejected])


def build_store(
    folder: Path, paths: Sequence[str], preprocessing: Preprocessing, workers: int | None, on_error: str
) -> StoreContents:
    """Decode the images into a new store, or take the one that another process makes meanwhile.

    Raises:
        ConfigError: a camera that does not fit the images.
        DataError: no image readable, or an unreadable one and `on_error` is "raise"; all images' folders missing.
        StorageError: the disk is full or refuses.
    """
    _require_a_folder(paths)
    with storage_errors(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        with exclusive(_lock_of(folder), f"another process is building the store {folder}; waiting for it") as locked:
            contents = load_store(folder, len(paths))
            if contents is not None:
                return contents
            _remove_stale(folder.parent, folder.name, locked)
            temporary = _temporary_beside(folder)
            try:
                _write(temporary, paths, preprocessing, workers or _default_workers(), on_error)
                _put_in_place(temporary, folder, len(paths))
            finally:
                shutil.rmtree(temporary, ignore_errors=True)
    contents = load_store(folder, len(paths))
    if contents is None:
        raise FormatError(f"the store {folder} was damaged right after it was built: check the disk")
    return contents


def _require_a_folder(paths: Sequence[str]) -> None:
    """Tell lists that came without their images from images that cannot be read.

    Raises:
        DataError: there are paths, and none of their folders exists.
    """
    folders = list(dict.fromkeys(Path(path).parent for path in paths))
    if folders and not any(folder.exists() for folder in folders):
        others = f" (nor do {len(folders) - 1} others)" if len(folders) > 1 else ""
        raise DataError(
            f"the images' folder {folders[0]} does not exist{others}: these lists come without images; "
            "add the images, or name the folder that holds them"
        )


def _write(folder: Path, paths: Sequence[str], preprocessing: Preprocessing, workers: int, on_error: str) -> None:
    """Fill a folder with panoramas.npy and store.json."""
    height, width = preprocessing.view.height, preprocessing.view.width
    rejected: list[dict[str, Any]] = []
    kept = 0
    with (folder / "panoramas.npy").open("wb", buffering=0) as file:
        _reserve(file, _HEADER_BYTES + len(paths) * 3 * height * width)
        file.seek(_HEADER_BYTES)
        decoded = _decoded(paths, preprocessing, workers)
        for row, result in enumerate(track(decoded, len(paths), "decoding images")):
            if isinstance(result, UnreadableImageError):
                if on_error == "raise":
                    raise DataError(f"{paths[row]} cannot be read: {result} (on_error=skip leaves it out)")
                rejected.append({"row": row, "path": paths[row], "reason": str(result)})
            else:
                _write_all(file, result)
                kept += 1
        if kept == 0:
            first = rejected[0]
            raise DataError(
                f"none of the {len(paths)} images can be read, the first: {first['path']} ({first['reason']})"
            )
        file.truncate()
        file.seek(0)
        _write_all(file, np.frombuffer(_header((kept, 3, height, width)), dtype=np.uint8))
        os.fsync(file.fileno())
    record = {
        "version": VERSION,
        "images": len(paths),
        "image_size": [height, width],
        "preprocessing": preprocessing.parameters(),
        "rejected": rejected,
    }
    write_json(folder / "store.json", record)


def _decoded(
    paths: Sequence[str], preprocessing: Preprocessing, workers: int
) -> Iterator[NDArray[np.uint8] | UnreadableImageError]:
    """Yield the panoramas in order, decoded by threads that run only a little ahead."""

    def decode(path: str) -> NDArray[np.uint8] | UnreadableImageError:
        try:
            return preprocessing.panorama(path)
        except UnreadableImageError as error:
            return error

    pool = ThreadPoolExecutor(workers, thread_name_prefix="decode")
    try:
        ahead: deque[Future[NDArray[np.uint8] | UnreadableImageError]] = deque()
        for path in paths:
            ahead.append(pool.submit(decode, path))
            if len(ahead) > 4 * workers:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def _reserve(file: BinaryIO, size: int) -> None:
    """Ask the disk for all the space at once, so that a full one refuses before the work is done."""
    if hasattr(os, "posix_fallocate"):
        try:
            os.posix_fallocate(file.fileno(), 0, size)
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS, errno.ENODEV):
                raise


def _write_all(file: BinaryIO, array: NDArray[np.uint8]) -> None:
    data = array.reshape(-1).data
    while len(data):
        data = data[file.write(data) :]


def _header(shape: tuple[int, ...]) -> bytes:
    """Return the header of a .npy file of version 1.0, padded to a size that does not depend on the shape."""
    text = repr({"descr": "|u1", "fortran_order": False, "shape": shape})
    room = _HEADER_BYTES - 10
    return b"\x93NUMPY\x01\x00" + room.to_bytes(2, "little") + f"{text:<{room - 1}}\n".encode("latin1")


def _put_in_place(temporary: Path, folder: Path, total: int) -> None:
    if folder.exists():
        if load_store(folder, total) is not None:
            return  # Without locks another process may have been faster; its store is as good.
        old = _temporary_beside(folder)
        folder.rename(old / "old")
        shutil.rmtree(old, ignore_errors=True)
    try:
        temporary.rename(folder)
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
            raise
        return
    with suppress(OSError):
        handle = os.open(folder.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _remove_stale(cache: Path, key: str, locked: bool) -> None:
    """Remove what interrupted builds left: of this store, and of others that nobody builds any more."""
    for path in cache.glob(".*.tmp"):
        owner = path.name[1:].split(".", 1)[0]
        with suppress(FileNotFoundError):
            if not locked:
                stale = path.stat().st_mtime < time.time() - _DAY
            else:
                stale = owner == key or not is_locked(_lock_of(cache / owner))
            if stale:
                shutil.rmtree(path, ignore_errors=True)


def _temporary_beside(folder: Path) -> Path:
    temporary = folder.with_name(f".{folder.name}.{secrets.token_hex(4)}.tmp")
    temporary.mkdir()
    return temporary


def _lock_of(folder: Path) -> Path:
    return folder.with_name(f".{folder.name}.lock")


def _default_workers() -> int:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, 16)
