"""Writing files whole or not at all, and reading them back with clear errors."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from glob import escape
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from siamloc.errors import ConfigError, FormatError, StorageError
from siamloc.locks import held, is_at, lock, release

_FILE = os.O_RDWR | getattr(os, "O_NOFOLLOW", 0)
PICTURES = (".jpg", ".jpeg", ".png", ".webp")
"""Endings of the pictures that are written."""
_NEW_FILE = os.O_RDWR | os.O_CREAT | os.O_EXCL
_FOLDER = os.O_RDONLY


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder that becomes `path` when the block ends without an error.

    Parent folders are created. After an error nothing is left behind and an older file stays as it was. Leftovers of a
    killed process are reused when the file is written again.

    Raises:
        StorageError: the disk is full or refuses.
    """
    path = Path(path)
    if not path.name:
        raise StorageError(f"{str(path)!r} names no file: give it a name")
    if path.exists() and not path.is_file() and not path.is_dir():
        raise StorageError(f"{path} is a device or a pipe, which a file must not take the place of: name a file")
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary, handle = _taken(path)
        try:
            yield temporary
            with temporary.open("rb") as file:
                os.fsync(file.fileno())
            temporary.replace(path)
        except BaseException:
            with suppress(FileNotFoundError):
                temporary.unlink()
            raise
        finally:
            release(handle)


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Yield an empty temporary folder next to `path` that becomes `path` when the block ends without an error.

    An older folder is replaced as a whole. After an error nothing is left behind and the older folder stays as it was.

    Raises:
        StorageError: the disk is full or refuses.
    """
    path = Path(path)
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary, handle = _taken(path, folder=True)
        try:
            yield temporary
            if path.exists():
                _exchange(path, temporary)
            else:
                temporary.replace(path)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise
        finally:
            release(handle)
        clear_temporaries([path])


@contextmanager
def atomic_files(folder: str | Path) -> Iterator[Path]:
    """Yield an empty temporary folder whose files move into `folder` together when the block ends without an error.

    They replace older files of the same names; all other files in the folder stay. After an error the folder is as it
    was.

    Raises:
        StorageError: the disk is full or refuses.
    """
    folder = Path(folder)
    with storage_errors(folder), scratch_folder(folder / "files") as scratch:
        yield scratch
        for path in sorted(scratch.iterdir()):
            path.replace(folder / path.name)


@contextmanager
def scratch_folder(path: str | Path) -> Iterator[Path]:
    """Yield an empty temporary folder next to `path` and remove it afterwards; parent folders are created.

    Raises:
        StorageError: the disk is full or refuses.
    """
    path = Path(path)
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary, handle = _taken(path, folder=True)
        try:
            yield temporary
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
            release(handle)


def _exchange(path: Path, temporary: Path) -> None:
    """Put a temporary folder in the place of `path`, or leave `path` as it was."""
    older, handle = _taken(path, folder=True)
    try:
        path.replace(older)  # which is empty
        try:
            temporary.replace(path)
        except BaseException:
            older.replace(path)
            raise
    finally:
        release(handle)


def _taken(path: Path, *, folder: bool = False) -> tuple[Path, int]:
    """Make an empty temporary file or folder for `path`, or take over one left by a killed process, and hold it.

    The names are numbered 0, 1, ...: the first one that no living process holds is used. So the leftovers of a killed
    process are gone as soon as the same file is written again, and two processes writing the same file do not collide.
    """
    for number in count():
        temporary = path.with_name(f".{path.name}.{number}.tmp{path.suffix}")
        fresh = True
        try:
            if folder:
                temporary.mkdir()
            handle = os.open(temporary, _FOLDER if folder else _NEW_FILE, 0o666)
        except FileExistsError:
            fresh = False
            try:
                handle = os.open(temporary, _FOLDER if folder else _FILE)
            except OSError:  # gone by now, or somebody else's
                continue
        got = lock(handle)
        if got is False or not is_at(handle, temporary) or (got is None and not fresh):
            release(handle)
        else:
            if not folder:
                os.ftruncate(handle, 0)
            for item in temporary.iterdir() if folder else ():
                _remove(item)
            return temporary, handle
    raise AssertionError("there are always more numbers")


def temporary_of(path: str | Path) -> str:
    """Return the final name of a temporary file or folder of this module, "" for any other path.

    >>> temporary_of("data/.camera.json.0.tmp.json"), temporary_of("data/camera.json")
    ('camera.json', '')
    """
    match = re.fullmatch(r"\.(.+)\.\d+\.tmp(\.[^.]+)?", Path(path).name)
    return match[1] if match and Path(match[1]).suffix == (match[2] or "") else ""


def clear_temporaries(paths: Iterable[str | Path]) -> None:
    """Remove the half-written temporaries that killed processes left of these files; all other files stay.

    Raises:
        StorageError: removing is not permitted.
    """
    for path in map(Path, paths):
        for leftover in path.parent.glob(f".{escape(path.name)}.*"):
            if temporary_of(leftover) == path.name:
                remove_leftover(leftover)


def remove_leftover(temporary: Path) -> None:
    """Remove a temporary file or folder unless a living process is writing it.

    Raises:
        StorageError: removing is not permitted.
    """
    with storage_errors(temporary), suppress(FileNotFoundError), held(temporary) as free:
        if free:
            _remove(temporary)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink()


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Keep other callers of this function out of a folder, which is created, and removed if an error leaves it empty.

    Raises:
        ConfigError: another process is using the folder.
        StorageError: the disk refuses.
    """
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with held(folder) as free:
        if not free:
            raise ConfigError(f"another process is writing into {folder}: wait for its end, or choose another folder")
        try:
            yield
        except BaseException:
            with suppress(OSError):  # it is not empty
                folder.rmdir()
            raise


@contextmanager
def storage_errors(path: str | Path) -> Iterator[None]:
    """Turn the operating system's refusals while writing `path` into one clear sentence."""
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        if error.errno is None:  # such as a time limit
            raise
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            message = f"no space left on the disk while writing {path}: free some space or write elsewhere"
        elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
            message = f"writing {path} is not permitted: write elsewhere or change the permissions"
        elif error.errno in (errno.ENOTDIR, errno.EEXIST):
            message = f"{path} cannot be written: a file stands where a folder is needed"
        elif error.errno == errno.EISDIR:
            message = f"{path} cannot be written: a folder stands where the file is to be"
        elif error.errno == errno.ENOENT:
            message = f"{path} cannot be written: its folder is gone, or cannot be made there"
        else:
            message = f"{path} cannot be written ({error.strerror or error}): write elsewhere"
        raise StorageError(message) from error


def write_json(path: str | Path, value: Any) -> None:
    """Write a value as indented JSON, atomically; numpy values become plain ones, NaN becomes null."""
    text = json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def write_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def is_picture(path: str | Path) -> bool:
    """Whether a file name has the ending of an image."""
    return Path(path).suffix.lower() in PICTURES


def write_picture(path: str | Path, picture: NDArray[np.uint8]) -> None:
    """Write an image (rows, columns, 3), uint8, RGB, atomically, in the format given by the file name's ending.

    Raises:
        ConfigError: an ending other than those of JPEG, PNG or WebP.
        StorageError: the disk is full or refuses.
    """
    import cv2

    path = Path(path)
    if not is_picture(path):
        raise ConfigError(f"{path} must be a picture, with one of the endings {' '.join(PICTURES)}")
    quality = [cv2.IMWRITE_JPEG_QUALITY, 88] if path.suffix.lower() in (".jpg", ".jpeg") else []
    encoded = cv2.imencode(path.suffix.lower(), np.ascontiguousarray(picture[:, :, ::-1]), quality)[1]
    with atomic_path(path) as temporary:
        temporary.write_bytes(encoded.tobytes())


def read_text(path: str | Path, most: int = 64_000_000) -> str:
    """Read a text file that somebody else may have made: a regular file of at most `most` bytes.

    Raises:
        OSError: it is missing, or cannot be read.
        ValueError: it is a device or a pipe, which might never end, or is too long or not text.
    """
    path = Path(path)
    about = path.stat()
    if not stat.S_ISREG(about.st_mode):
        raise ValueError("it is not a regular file")
    if about.st_size > most:
        raise ValueError(f"it has {about.st_size:,} bytes, more than {most:,}")
    return path.read_text(encoding="utf-8")


def read_json(path: str | Path) -> Any:
    """Read a JSON file.

    Raises:
        FormatError: the file is missing, cut short, or not JSON.
    """
    path = Path(path)
    if not path.is_file() and path.exists():
        raise FormatError(f"{path} is not a regular file: give a JSON file")
    try:
        return parsed_json(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise FormatError(f"{path} does not exist") from error
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise FormatError(f"{path} is incomplete or invalid JSON ({error}): write it again") from error


def parsed_json(text: str) -> Any:
    """Parse JSON text from an untrusted source.

    Raises:
        ValueError: it is not JSON, or nested deeper than can be read.
    """
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def plain(value: Any) -> Any:
    """Convert a value to dictionaries, lists, text, numbers, booleans and None only."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value


def content_key(value: Any, length: int = 16) -> str:
    """Return a short hash of a plain value; equal values give equal keys on every machine."""
    text = json.dumps(plain(value), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:length]


def real_path(path: str | Path) -> Path:
    """Return an absolute path with all links resolved; circular links stay as they are."""
    return Path(os.path.realpath(path))


def file_hash(path: str | Path) -> str:
    """Return the SHA-256 of a file's contents in hexadecimal."""
    with Path(path).open("rb") as file:
        digest = hashlib.sha256()
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
