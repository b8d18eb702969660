"""Writing files whole or not at all, and reading them back with clear errors."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from siamloc.errors import ConfigError, FormatError, StorageError


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder that becomes `path` when the block ends without an error.

    The parent folders are made. After an error nothing is left behind and an older file stays as it was.

    Raises:
        StorageError: the disk is full or refuses.
    """
    path = Path(path)
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=f".tmp{path.suffix}", dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            with temporary.open("rb") as file:
                os.fsync(file.fileno())
            temporary.chmod(0o666 & ~_umask())
            temporary.replace(path)
        finally:
            with suppress(FileNotFoundError):
                temporary.unlink()


def temporary_of(path: str | Path) -> str:
    """Return the name of the file that a temporary one of `atomic_path` was to become, "" for any other file.

    A killed process leaves its temporary files behind; this is how to recognize them.

    >>> temporary_of("data/.camera.json.k3x_0a9z.tmp.json"), temporary_of("data/camera.json")
    ('camera.json', '')
    """
    match = re.fullmatch(r"\.(.+)\.[a-z0-9_]{8}\.tmp(\.[^.]+)?", Path(path).name)
    return match[1] if match and Path(match[1]).suffix == (match[2] or "") else ""


def clear_temporaries(paths: Iterable[str | Path]) -> None:
    """Remove what killed processes had half written of these files; all other files stay.

    Raises:
        StorageError: removing is not permitted.
    """
    for path in map(Path, paths):
        for leftover in path.parent.glob(f".{escape(path.name)}.*"):
            if temporary_of(leftover) == path.name:
                with storage_errors(leftover):
                    leftover.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: str | Path) -> Iterator[Path]:
    """Yield a temporary folder next to `path` that becomes `path` when the block ends without an error.

    What was there before is replaced as a whole. After an error nothing is left behind and the older folder stays as
    it was; after a kill a folder `.<name>.<letters>.tmp` is left.

    Raises:
        StorageError: the disk is full or refuses.
    """
    path = Path(path)
    with storage_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent))
        try:
            temporary.chmod(0o777 & ~_umask())
            yield temporary
            if path.exists():
                with tempfile.TemporaryDirectory(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent) as old:
                    path.rename(Path(old, "old"))
                    temporary.rename(path)
            else:
                temporary.rename(path)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def storage_errors(path: str | Path) -> Iterator[None]:
    """Turn the operating system's refusals while writing `path` into one clear sentence."""
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        if error.errno is None:  # such as that of a time limit
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
    """Write a value as indented JSON, atomically; numpy scalars and arrays become plain, NaN becomes null."""
    text = json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def write_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_picture(path: str | Path, picture: NDArray[np.uint8]) -> None:
    """Write a picture (rows, columns, 3), uint8, RGB, atomically, in the format that the name's ending says.

    Raises:
        ConfigError: another ending than those of JPEG, PNG or WebP.
        StorageError: the disk is full or refuses.
    """
    import cv2

    path, endings = Path(path), (".jpg", ".jpeg", ".png", ".webp")
    if path.suffix.lower() not in endings:
        raise ConfigError(f"{path} must be a picture, with one of the endings {' '.join(endings)}")
    quality = [cv2.IMWRITE_JPEG_QUALITY, 88] if path.suffix.lower() in (".jpg", ".jpeg") else []
    encoded = cv2.imencode(path.suffix.lower(), np.ascontiguousarray(picture[:, :, ::-1]), quality)[1]
    with atomic_path(path) as temporary:
        temporary.write_bytes(encoded.tobytes())


def read_json(path: str | Path) -> Any:
    """Read a JSON file.

    Raises:
        FormatError: the file is missing, cut short, or not JSON.
    """
    path = Path(path)
    if not path.is_file() and path.exists():
        raise FormatError(f"{path} is no regular file: give a JSON file")
    try:
        return parsed_json(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise FormatError(f"{path} does not exist") from error
    except OSError as error:
        raise FormatError(f"{path} cannot be read ({error.strerror})") from error
    except ValueError as error:
        raise FormatError(f"{path} is not whole JSON ({error}): write it again") from error


def parsed_json(text: str) -> Any:
    """Return the values of a JSON text that nobody vouches for.

    Raises:
        ValueError: it is not JSON, or nested deeper than can be read.
    """
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def plain(value: Any) -> Any:
    """Return a value made of dictionaries, lists, text, numbers, booleans and None only."""
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


def file_hash(path: str | Path) -> str:
    """Return the SHA-256 of a file's contents in hexadecimal."""
    with Path(path).open("rb") as file:
        digest = hashlib.sha256()
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
