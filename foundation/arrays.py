"""Arrays in an `npz` file with a header in JSON: written atomically, and read from an untrusted source."""

from __future__ import annotations

import json
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.errors import FormatError, OldFormatError
from foundation.files import atomic_path, check_version, parsed_json, plain

DAMAGE = (
    OSError,
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    EOFError,
    RuntimeError,
    SyntaxError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
"""The exceptions that reading a damaged file can raise: a changed byte may also claim an encryption or a compression
that does not exist, or corrupt the header of an array."""

_SPARE, _DENSEST = 64_000_000, 100  # bytes that arrays may always take, and that they may take per byte of the file


def write_arrays(path: str | Path, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write a header of plain values and arrays to one file, atomically; equal contents give equal files.

    Raises:
        StorageError: the disk is full or cannot be written to.
    """
    every = {**arrays, "header": np.array(json.dumps(plain(dict(header)), ensure_ascii=False))}
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, array in every.items():
            # With a fixed date, the file depends only on its contents. Text compresses well, descriptors do not.
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED if array.dtype.kind == "U" else zipfile.ZIP_STORED
            with archive.open(entry, "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)


def read_headed(
    path: str | Path, what: str, version: int, again: str, former: str | None = None
) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read the header and the arrays that `write_arrays` wrote.

    Args:
        path: the file.
        what: expected `format` in the header, such as "siamloc map".
        version: expected `version` in the header.
        again: how to make the file again, for the error message.
        former: `format` in the headers of an older siamloc.

    Raises:
        OldFormatError: a file of an older siamloc.
        FormatError: no such file, a damaged file, another format, or a newer version of it.
    """
    if not Path(path).is_file():
        raise FormatError(f"{path} does not exist: {again}")
    try:
        arrays = read_arrays(path)
        header = parsed_json(str(arrays.pop("header")[()]))
    except DAMAGE as error:
        raise FormatError(f"{path} is not a {what}, or not a whole one: {again}") from error
    if former is not None and isinstance(header, dict) and header.get("format") == former:
        raise OldFormatError(f"the {what} {path} was written by an older siamloc: {again}")
    if not isinstance(header, dict) or header.get("format") != what:
        raise FormatError(f"{path} is not a {what}: {again}")
    check_version(header.get("version"), version, f"the {what} {path}", again)
    return header, arrays


def read_arrays(path: str | Path) -> dict[str, NDArray[Any]]:
    """Read all arrays of a file in the format of `numpy.savez`.

    Nothing in the file is executed, each array must be as long as its header says, and all arrays together may take at
    most a hundred times the length of the file plus 64 MB, however well they were compressed.

    Raises:
        OSError, ValueError, ...: one of the exceptions in `DAMAGE`, saying what is wrong.
    """
    found: dict[str, NDArray[Any]] = {}
    with zipfile.ZipFile(path) as archive:
        left = _SPARE + _DENSEST * Path(path).stat().st_size
        for member in archive.infolist():
            name = member.filename.removesuffix(".npy")
            if name == member.filename or name in found:
                raise ValueError(f"{member.filename!r} is not an array, or appears twice")
            left -= member.file_size
            if left < 0:
                raise ValueError("its arrays are far too long for a file of its length")
            found[name] = _read(archive, member, name)
    return found


def _read(archive: zipfile.ZipFile, member: zipfile.ZipInfo, name: str) -> NDArray[Any]:
    with archive.open(member) as held:
        version = np.lib.format.read_magic(held)
        if version not in ((1, 0), (2, 0)):
            raise ValueError(f"{name} has version {version} of numpy's format")
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read_header(held)
        if dtype.hasobject:
            raise ValueError(f"{name} holds objects, which may be programs")
        there, claimed = member.file_size - held.tell(), prod(shape) * dtype.itemsize
        if claimed != there or any(size < 0 for size in shape):
            raise ValueError(f"{name} claims {claimed} bytes, but there are {there}")
    with archive.open(member) as held:
        values: NDArray[Any] = np.lib.format.read_array(held, allow_pickle=False)
        held.read(1)  # reaching the end verifies the checksum of the bytes
    return values
