"""Writing files whole or not at all, and reading them back with clear errors.

A file is written under a temporary name that contains the number of its process. When a process first writes into a
folder, it removes the temporary files there that killed processes on this machine left, and the folders that those
replaced.
"""

from __future__ import annotations

import csv
import errno
import hashlib
import io
import json
import os
import platform
import re
import shutil
import stat
import threading
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.errors import ConfigError, FormatError, OldFormatError, StorageError

PICTURES = (".jpg", ".jpeg", ".png", ".webp")
"""Endings of the pictures that are written."""
_NUMBERS = Path("/proc/self/ns/pid")  # containers may share a host's name, but not the numbers of their processes
_SPACE = str(_NUMBERS.readlink()) if _NUMBERS.is_symlink() else ""
_HOST = f"{zlib.crc32(f'{platform.node()}{_SPACE}'.encode()):08x}"  # may share a folder with other machines
_TEMPORARY = re.compile(r"\..+\.(?P<host>[0-9a-f]{8})-(?P<process>\d+)-\d+\.tmp(?:\.[^.]+)?")
_OLDER = re.compile(r"\.(?P<name>.+)\.(?P<host>[0-9a-f]{8})-(?P<process>\d+)-\d+\.old")
_numbers, _clearing, _cleared = count(), threading.Lock(), set[Path]()


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder that becomes `path` when the block ends without an error.

    Parent folders are created. After an error nothing is left behind and an older file stays as it was.

    Raises:
        StorageError: the disk is full or refuses.
    """
    path = Path(path)
    if not path.name:
        raise StorageError(f"{str(path)!r} names no file: give it a name")
    if path.exists() and not path.is_file() and not path.is_dir():
        raise StorageError(f"{path} is a device or a pipe, which a file must not take the place of: name a file")
    with storage_errors(path):
        temporary = _temporary(path)
        temporary.touch(exist_ok=False)
        try:
            yield temporary
            _flush(temporary)
            temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise


@contextmanager
def scratch_folder(path: str | Path) -> Iterator[Path]:
    """Yield an empty temporary folder next to `path` and remove it afterwards; parent folders are created.

    Raises:
        StorageError: the disk is full or refuses.
    """
    with storage_errors(path):
        temporary = _temporary(Path(path))
        temporary.mkdir()
        try:
            yield temporary
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


@contextmanager
def atomic_folder(path: str | Path, check: Callable[[Path], object] | None = None) -> Iterator[Path]:
    """Yield an empty temporary folder next to `path` that becomes `path` when the block ends without an error.

    An older folder is replaced as a whole. After an error nothing is left behind, and the older folder stays as it was
    unless somebody else has written `path` meanwhile. A kill in the instant between the two leaves the older folder
    beside `path`, see `older_folder`, for as long as `path` does not exist.

    Args:
        path: the folder.
        check: called with the older folder, moved to where nobody else replaces it, or with a path that does not exist
            if there is none; if it raises an error, the older folder stays.

    Raises:
        StorageError: the disk is full or refuses.
    """
    path = real_path(path)
    with scratch_folder(path) as fresh:
        yield fresh
        for file in fresh.rglob("*"):
            if file.is_file():
                _flush(file)
        if path.exists() and not path.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "not a folder")
        older = fresh.with_name(f"{fresh.name.rpartition('.tmp')[0]}.old")
        with suppress(FileNotFoundError):
            path.replace(older)
        try:
            if check is not None:
                check(older)
            fresh.replace(path)
        except BaseException:
            if older.exists():
                with suppress(OSError):
                    older.replace(path)
                if path.exists():  # put there by somebody else meanwhile, who would have replaced it
                    shutil.rmtree(older, ignore_errors=True)
            raise
        if older.exists():
            older.replace(fresh)  # which is removed


def older_folder(path: str | Path) -> Path | None:
    """Return the newest folder that kills left beside `path` while `atomic_folder` replaced it; None without any."""
    path = real_path(path)
    older = ((entry, _OLDER.fullmatch(entry.name)) for entry in path.parent.glob(".*.old"))
    left = (entry for entry, match in older if match is not None and match["name"] == path.name)
    return max(left, key=lambda entry: entry.stat().st_mtime, default=None)


@contextmanager
def atomic_files(folder: str | Path) -> Iterator[Path]:
    """Yield an empty temporary folder whose files move into `folder` together when the block ends without an error.

    They replace older files of the same names; all other files in the folder stay. After an error the folder is as it
    was.

    Raises:
        StorageError: the disk is full or refuses.
    """
    folder = Path(folder)
    with scratch_folder(folder / "files") as scratch:
        yield scratch
        for path in sorted(scratch.iterdir()):
            path.replace(folder / path.name)


def is_temporary(path: str | Path) -> bool:
    """Return whether a path is a temporary file or folder of this module."""
    return _TEMPORARY.fullmatch(Path(path).name) is not None


def _flush(path: Path) -> None:
    """Let the disk have the content of a file, so that a power cut leaves no empty file under its name."""
    with path.open("r+b") as file:  # Windows flushes only what can be written
        os.fsync(file.fileno())


def _temporary(path: Path) -> Path:
    """Return an unused name next to `path`, in a folder without leftovers of killed processes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    folder = real_path(path.parent)
    with _clearing:
        if folder not in _cleared:
            _cleared.add(folder)
            for entry in folder.iterdir():
                if _is_left(entry):
                    with suppress(OSError):  # somebody else's, or gone
                        shutil.rmtree(entry) if entry.is_dir() and not entry.is_symlink() else entry.unlink()
    return path.with_name(f".{path.name}.{_HOST}-{os.getpid()}-{next(_numbers)}.tmp{path.suffix}")


def _is_left(path: Path) -> bool:
    """Return whether a path is temporary, or a folder that was replaced, and its process on this machine has ended."""
    older = _OLDER.fullmatch(path.name)
    match = older or _TEMPORARY.fullmatch(path.name)
    if match is None or match["host"] != _HOST or (older and not path.with_name(older["name"]).exists()):
        return False
    if int(match["process"]) == os.getpid():  # an earlier process had the same number
        return True
    if os.name == "nt":  # signal 0 is Ctrl-C there
        return False
    try:
        os.kill(int(match["process"]), 0)  # sends nothing
    except OSError as error:
        return isinstance(error, ProcessLookupError)
    return False


_FULL = "no space left on the disk while writing {path}: free some space or write elsewhere"
_FORBIDDEN = "writing {path} is not permitted: write elsewhere or change the permissions"
_A_FILE = "{path} cannot be written: a file stands where a folder is needed"
_REFUSALS = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT), _FULL),
    **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), _FORBIDDEN),
    **dict.fromkeys((errno.ENOTDIR, errno.EEXIST), _A_FILE),
    errno.EISDIR: "{path} cannot be written: a folder stands where the file is to be",
    errno.ENOENT: "{path} cannot be written: its folder is gone, or cannot be made there",
}
"""What the disk refuses, in words, by the number of the error."""


@contextmanager
def storage_errors(path: str | Path) -> Iterator[None]:
    """Turn errors of the operating system while writing `path` into a StorageError of one clear sentence."""
    try:
        yield
    except StorageError:
        raise
    except OSError as error:
        if error.errno is None:  # such as a time limit
            raise
        refusal = _REFUSALS.get(error.errno, f"{{path}} cannot be written ({error.strerror or error}): write elsewhere")
        raise StorageError(refusal.replace("{path}", str(path))) from error


def check_writable(path: str | Path) -> None:
    """Make sure, before long work, that a file can be written at `path`; nothing is created.

    Raises:
        StorageError: a file stands where a folder is needed, or the folder must not be written to.
    """
    with storage_errors(path):
        folder = next(parent for parent in Path(path).absolute().parents if parent.exists())
        if not folder.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "not a folder")
        if not os.access(folder, os.W_OK):
            raise PermissionError(errno.EACCES, "not permitted")


def write_json(path: str | Path, value: Any) -> None:
    """Write a value as indented JSON, atomically; numpy values become plain ones, NaN becomes null."""
    text = json.dumps(plain(value), indent=2, ensure_ascii=False, allow_nan=False)
    write_text(path, text + "\n")


def write_text(path: str | Path, text: str) -> None:
    """Write a text file in UTF-8, atomically."""
    write_bytes(path, text.encode())


def csv_text(rows: Iterable[Iterable[Any]]) -> str:
    """Return rows of plain values as CSV: numbers with full precision, None and NaN as empty cells.

    >>> csv_text([["x", "room"], [0.1 + 0.2, "a, b"], [float("nan"), None]])
    'x,room\\n0.30000000000000004,"a, b"\\n,\\n'
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerows(["" if cell is None or cell != cell else cell for cell in row] for row in rows)
    return text.getvalue()


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file, atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def is_picture(path: str | Path) -> bool:
    """Whether a file name has the ending of an image."""
    return Path(path).suffix.lower() in PICTURES


def first_names(folder: Path) -> str:
    """Return the names of the first five files and folders in a folder, for a message; "" if it is empty."""
    return ", ".join(sorted(path.name for path in folder.iterdir())[:5])


def write_picture(path: str | Path, picture: NDArray[np.uint8], quality: int = 88) -> None:
    """Write an image (rows, columns, 3), uint8, RGB, atomically, in the format given by the file name's ending.

    `quality` is that of a JPEG, 0 to 100.

    Raises:
        ConfigError: an ending other than those of JPEG, PNG or WebP.
        StorageError: the disk is full or refuses.
    """
    import cv2

    path = Path(path)
    if not is_picture(path):
        raise ConfigError(f"{path} must be a picture, with one of the endings {' '.join(PICTURES)}")
    how = [cv2.IMWRITE_JPEG_QUALITY, quality] if path.suffix.lower() in (".jpg", ".jpeg") else []
    encoded = cv2.imencode(path.suffix.lower(), np.ascontiguousarray(picture[:, :, ::-1]), how)[1]
    write_bytes(path, encoded.tobytes())


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
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"it is not text in UTF-8 (at byte {error.start}): save it as UTF-8") from error


def read_json(path: str | Path, remedy: str = "write it again") -> Any:
    """Read a JSON file.

    Args:
        path: the file.
        remedy: what to do if it is cut short, for the error.

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
        raise FormatError(f"{path} is incomplete or invalid JSON ({error}): {remedy}") from error


def parsed_json(text: str) -> Any:
    """Parse JSON text from an untrusted source.

    Raises:
        ValueError: it is not JSON, or nested deeper than can be read.
    """
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error


def check_version(found: Any, present: int, what: str, again: str) -> None:
    """Refuse a file of another version of its format.

    Args:
        found: version in the file.
        present: the version that this code writes.
        what: the file in words, for the message.
        again: how to make the file again, such as "build it again".

    Raises:
        OldFormatError: an older version.
        FormatError: a newer version, or none.
    """
    if type(found) is not int or found != present:
        advice = "update siamloc" if type(found) is int and found > present else again
        kind = OldFormatError if type(found) is int and found < present else FormatError
        raise kind(f"{what} has format version {found!r}, this siamloc reads version {present}: {advice}")


def plain(value: Any) -> Any:
    """Convert a value to dictionaries, lists, text, numbers, booleans and None only; settings become their fields."""
    if hasattr(value, "plain"):
        return value.plain()
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if isinstance(value, Path):
        return str(value)
    return value


def content_key(value: Any, length: int = 16) -> str:
    """Return a short hash of a plain value; equal values give equal keys on every machine."""
    text = json.dumps(plain(value), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()[:length]


def expanded(path: str | os.PathLike[str]) -> Path:
    """Return a path with the home folder in place of `~`; names that begin with ~ and are no user's stay."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        return Path(path)


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
