"""The files of a bundle, in a folder or an archive from an untrusted source: read, but never unpacked."""

from __future__ import annotations

import hashlib
import os
import re
import stat
import threading
import zipfile
import zlib
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, cast

from siamloc.errors import FormatError
from siamloc.files import file_hash

_SPARE, _DENSEST = 64_000_000, 100  # bytes that any part may have, and for each of its bytes in the archive
_DAMAGE = (OSError, ValueError, KeyError, EOFError, RuntimeError, NotImplementedError, zipfile.BadZipFile, zlib.error)
_AT_ONCE = 1 << 20
_IN_MEMORY = 1_000_000_000  # largest part in bytes that is read as a whole
_PIPES = Path("/proc/self/fd")  # where open files have a path
_FOLDER = re.compile(r"(?!\.{1,2}/)[^/\\:]+/|")  # the top of an archive, or one folder with a plain name


class Parts(ABC):
    """The files of a bundle by name.

    Args:
        path: folder or archive of the bundle.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @abstractmethod
    def holds(self, name: str) -> bool:
        """Return whether there is such a regular file."""

    @abstractmethod
    def read(self, name: str) -> bytes:
        """Return the content of a file.

        Raises:
            FormatError: it is missing or damaged.
        """

    @abstractmethod
    def digest(self, name: str) -> str:
        """Return the SHA-256 of a file in hexadecimal.

        Raises:
            FormatError: it is missing or damaged.
        """

    @abstractmethod
    def size(self, name: str) -> int:
        """Return the size of a file in bytes."""

    @abstractmethod
    def blocks(self, name: str) -> Iterator[bytes]:
        """Yield the content of a file block by block.

        Raises:
            FormatError: it is missing or damaged.
        """

    @abstractmethod
    def opened(self, name: str) -> AbstractContextManager[BinaryIO]:
        """Open a file for reading, seekable.

        Raises:
            FormatError: it is missing or damaged.
        """

    @abstractmethod
    def streamed(self, name: str) -> AbstractContextManager[Path]:
        """Yield a path from which a file can be read once, so that no second copy of it is in memory.

        Raises:
            FormatError: it is missing or damaged.
            OSError: this system has no such paths.
        """


class Folder(Parts):
    """Files in a folder; links among them are refused."""

    def holds(self, name: str) -> bool:
        """Return whether there is such a regular file."""
        path = self.path / name
        if path.is_symlink():
            raise FormatError(f"{path} is a link, which could lead anywhere: copy the file itself into the bundle")
        if not path.is_file():
            return False
        about = path.stat()
        if about.st_size > _SPARE + _DENSEST * 512 * getattr(about, "st_blocks", about.st_size):
            raise FormatError(f"{path} claims to be far longer than what it holds: export again")
        return True

    def read(self, name: str) -> bytes:
        """Return the content of a file."""
        if (self.path / name).is_file() and self.size(name) > _IN_MEMORY:
            raise FormatError(f"{self.path / name} has {self.size(name):,} bytes, more than a bundle's: export again")
        try:
            return (self.path / name).read_bytes()
        except OSError as error:
            raise FormatError(f"{self.path / name} cannot be read ({error.strerror}): export again") from error

    def digest(self, name: str) -> str:
        """Return the SHA-256 of a file in hexadecimal."""
        return file_hash(self.path / name)

    def size(self, name: str) -> int:
        """Return the size of a file in bytes."""
        return (self.path / name).stat().st_size

    def blocks(self, name: str) -> Iterator[bytes]:
        """Yield the content of a file block by block."""
        with self.opened(name) as file:
            while block := file.read(_AT_ONCE):
                yield block

    @contextmanager
    def opened(self, name: str) -> Iterator[BinaryIO]:
        """Open a file."""
        try:
            file = (self.path / name).open("rb")
        except OSError as error:
            raise FormatError(f"{self.path / name} cannot be read ({error.strerror}): export again") from error
        with file:
            yield file

    @contextmanager
    def streamed(self, name: str) -> Iterator[Path]:
        """Yield its own path; weights of more than 2 GB are in a file next to the model."""
        yield self.path / name


class Archive(Parts):
    """Files in a zip archive, at its top level or in a single folder.

    Args:
        path: of the archive.
        allowed: names that a bundle may hold.
        marker: the name that every bundle holds.

    Raises:
        FormatError: not an archive, cut short, or with files that no bundle has.
    """

    def __init__(self, path: Path, allowed: Collection[str], marker: str) -> None:
        super().__init__(path)
        try:
            with zipfile.ZipFile(path) as archive:
                members = [member for member in archive.infolist() if not member.is_dir()]
        except _DAMAGE as error:
            raise FormatError(f"{path} is not a zip archive, or is incomplete ({error}): export again") from error
        tops = [member.filename[: -len(marker)] for member in members if member.filename.endswith(marker)]
        top = next((top for top in tops if _FOLDER.fullmatch(top)), "")
        self._members: dict[str, zipfile.ZipInfo] = {}
        for member in members:
            name = member.filename.removeprefix(top)
            linked = stat.S_ISLNK(member.external_attr >> 16)
            if name not in allowed or name in self._members or linked or member.flag_bits & 1:
                what = "a link" if linked else "encrypted" if member.flag_bits & 1 else "not part of a bundle"
                raise FormatError(f"{path} holds {member.filename!r}, which is {what}, or appears twice: export again")
            if member.file_size > _SPARE + _DENSEST * member.compress_size:
                raise FormatError(f"{path} holds {name}, which claims to be far too long: export again")
            self._members[name] = member

    def holds(self, name: str) -> bool:
        """Return whether there is such a file."""
        return name in self._members

    def read(self, name: str) -> bytes:
        """Return the content of a file; a wrong checksum in the archive counts as damage."""
        return b"".join(self.blocks(name))

    def digest(self, name: str) -> str:
        """Return the SHA-256 of a file in hexadecimal."""
        digest = hashlib.sha256()
        for block in self.blocks(name):
            digest.update(block)
        return digest.hexdigest()

    def size(self, name: str) -> int:
        """Return the size of a file in the archive in bytes."""
        return self._members[name].compress_size

    @contextmanager
    def opened(self, name: str) -> Iterator[BinaryIO]:
        """Open a file in place; a compressed one is read into memory first."""
        if self._members[name].compress_type != zipfile.ZIP_STORED:
            yield BytesIO(self.read(name))
            return
        try:
            archive = zipfile.ZipFile(self.path)
        except _DAMAGE as error:
            raise FormatError(f"{self.path} is damaged or cut short ({error}): export again") from error
        with archive, archive.open(self._members[name]) as held:
            yield cast(BinaryIO, held)

    @contextmanager
    def streamed(self, name: str) -> Iterator[Path]:
        """Yield the path of a pipe that delivers a file block by block."""
        if not _PIPES.is_dir():
            raise OSError(f"there is no {_PIPES}")
        reading, writing = os.pipe()

        def written() -> None:
            with (
                suppress(OSError, FormatError),
                os.fdopen(writing, "wb") as pipe,
            ):  # the reader may stop, and reports why
                for block in self.blocks(name):
                    pipe.write(block)

        writer = threading.Thread(target=written, name=f"{name} of {self.path.name}", daemon=True)
        writer.start()
        try:
            yield _PIPES / str(reading)
        finally:
            os.close(reading)
            writer.join()

    def blocks(self, name: str) -> Iterator[bytes]:
        """Yield the content of a file block by block; a wrong checksum in the archive counts as damage."""
        try:
            with zipfile.ZipFile(self.path) as archive, archive.open(self._members[name]) as held:
                left = self._members[name].file_size
                while left > 0 and (block := held.read(min(_AT_ONCE, left))):
                    yield block
                    left -= len(block)
                held.read(1)  # at the end the checksum is compared
        except _DAMAGE as error:
            raise FormatError(f"{name} in {self.path} is damaged or cut short ({error}): export again") from error
