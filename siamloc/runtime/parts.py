"""The files of a bundle, in a folder or an archive from an untrusted source: read, but never unpacked."""

from __future__ import annotations

import hashlib
import re
import stat
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path

from foundation.files import file_hash
from siamloc.errors import FormatError

_SPARE, _DENSEST = 64_000_000, 100  # bytes that any part may have, and for each of its bytes in the archive
_DAMAGE = (OSError, ValueError, KeyError, EOFError, RuntimeError, NotImplementedError, zipfile.BadZipFile, zlib.error)
_IN_MEMORY = 1_000_000_000  # bytes of the largest part that is read as a whole
_FOLDER = re.compile(r"(?!\.{1,2}/)[^/\\:]+/|")  # the top of an archive, or one folder with a plain name


class Folder:
    """The files of a bundle in a folder; links among them are refused.

    Args:
        path: of the folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

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

    def source(self, name: str) -> Path:
        """Return the path of a file."""
        return self.path / name

    def read(self, name: str) -> bytes:
        """Return the content of a file.

        Raises:
            FormatError: it cannot be read, or is longer than a bundle's.
        """
        try:
            if (size := self.size(name)) > _IN_MEMORY:
                raise FormatError(f"{self.path / name} has {size:,} bytes, more than a bundle's: export again")
            return (self.path / name).read_bytes()
        except OSError as error:
            raise FormatError(f"{self.path / name} cannot be read ({error.strerror}): export again") from error

    def digest(self, name: str) -> str:
        """Return the SHA-256 of a file in hexadecimal."""
        return file_hash(self.path / name)

    def size(self, name: str) -> int:
        """Return the size of a file in bytes."""
        return (self.path / name).stat().st_size


class Archive:
    """The files of a bundle in a zip archive, at its top level or in a single folder.

    Args:
        path: of the archive.
        allowed: names that a bundle may hold.
        marker: the name that every bundle holds.

    Raises:
        FormatError: not an archive, cut short, or with files that no bundle has.
    """

    def __init__(self, path: Path, allowed: Collection[str], marker: str) -> None:
        self.path = path
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

    def source(self, name: str) -> bytes:
        """Return the content of a file.

        Raises:
            FormatError: it is damaged; a wrong checksum in the archive counts as damage.
        """
        member = self._members[name]
        try:
            with zipfile.ZipFile(self.path) as archive, archive.open(member) as file:
                content = file.read(member.file_size)
                file.read(1)  # at the end the checksum is compared
        except _DAMAGE as error:
            raise FormatError(f"{name} in {self.path} is damaged or cut short ({error}): export again") from error
        return content

    read = source

    def digest(self, name: str) -> str:
        """Return the SHA-256 of a file in hexadecimal."""
        return hashlib.sha256(self.source(name)).hexdigest()

    def size(self, name: str) -> int:
        """Return the size of a file in the archive in bytes."""
        return self._members[name].compress_size
