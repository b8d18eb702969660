"""Reader of manifests: CSV tables with one row per image, for QuorumV, INNOVA and your own images."""

from __future__ import annotations

import csv
import math
import os
import sys
from collections.abc import Iterator
from glob import glob, has_magic
from pathlib import Path
from typing import Any

import numpy as np

from foundation.files import csv_text, expanded
from foundation.settings import shortened
from siamloc.data.frames import COLUMNS as FRAME_COLUMNS
from siamloc.data.frames import DEVIATIONS, ODOMETRY, TILT, FrameTable, concatenate, in_capture_order
from siamloc.data.moves import euler
from siamloc.data.names import nfc
from siamloc.errors import DataError, Policy, leave_out, logger

COLUMNS = ("image", *FRAME_COLUMNS[1:])

_QUATERNION = ("qw", "qx", "qy", "qz")
_LARGEST = dict.fromkeys(("theta", "time"), sys.float_info.max)
_LARGEST |= dict.fromkeys(("x", "y", *ODOMETRY, *DEVIATIONS, *TILT, *_QUATERNION), 1e7)


def read_manifest(manifest: str | Path, *, on_error: Policy = "skip") -> FrameTable:
    """Read a manifest, a CSV table with a row for each image, or several such tables at once.

    The first line names the columns, in any order and case: `image`, and any of `x, y` (m), `theta` (rad), `room`,
    `sequence`, `lighting`, `time` (s), `building`, `odom_x, odom_y` (m), `odom_theta` (rad), `deviation` (m) and
    `theta_deviation` (rad), `roll`, `pitch` (rad), or `qw, qx, qy, qz`, from which `theta`, `roll` and `pitch` follow;
    others are ignored with a warning. Image paths are relative to the table's folder. An empty number is unknown (NaN);
    blank lines are skipped. The rows of a sequence whose times are all known are sorted by time; the others keep the
    order of the table.

    Args:
        manifest: the CSV file, in UTF-8; or a pattern that fits several, such as "*_frames/frames.csv", each with
            sequences and columns of its own.
        on_error: "skip" or "raise", for images that do not exist.

    Raises:
        DataError: the file is missing or empty, a column or cell cannot be used (with line, column and value), an image
            appears twice in one sequence, or a sequence appears in two files.
    """
    file = expanded(manifest)
    # A name that exists is no pattern; Path.glob takes no absolute patterns.
    fitting = [file]
    if has_magic(str(file)) and not os.path.lexists(file):
        fitting = sorted(map(Path, glob(str(file), recursive=True)))  # noqa: PTH207
    if not fitting:
        raise DataError(f"no file fits the pattern {file}: give the path of a CSV table, or a pattern of several")
    drives: dict[str, Path] = {}
    tables = []
    for one in fitting:
        tables.append(_read_table(one, on_error))
        for name in tables[-1].rows_by("sequence"):
            if (other := drives.setdefault(name, one)) != one:
                raise DataError(
                    f"sequence {name or '(unnamed)'!r} is in {other} and in {one}: give each drive a name of its "
                    "own in the column 'sequence', or give a pattern that fits only one of these tables"
                )
    return tables[0] if len(tables) == 1 else concatenate(tables)


def _read_table(file: Path, on_error: str) -> FrameTable:
    if file.exists() and not file.is_file():
        raise DataError(f"the manifest {file} is not a regular file: give a CSV table with one row for each image")
    frames = list(read_rows(file))
    # Path.is_file raises on names that are too long; os.path.isfile says no.
    exists = [os.path.isfile(frame["path"]) for frame in frames]  # noqa: PTH113
    missing = [frame["path"] for frame, there in zip(frames, exists, strict=True) if not there]
    slash = "; write / for \\ in paths" * (os.sep == "/" and any("\\" in path for path in missing))
    what = f"images of {file} do not exist (they are looked for relative to the table's folder{slash})"
    leave_out(missing, len(frames), what, on_error)
    return in_capture_order(FrameTable.from_rows(frames).take(exists))


def read_rows(file: Path) -> Iterator[dict[str, Any]]:
    """Yield each row of a table of images: the `path` of its image, and the other columns that the table has.

    Raises:
        DataError: as for `read_manifest`; the images need not exist.
    """
    lines = _lines(file)
    header = next(lines, None)
    if header is None:
        raise DataError(f"{file} is empty: expected a first line with the columns {', '.join(COLUMNS)}")
    names = _column_names(file, header[1])
    seen: dict[tuple[str, str], int] = {}
    for number, cells in lines:
        if any(cell.strip() for cell in cells[len(header[1]) :]):
            raise DataError(
                f"{file}, line {number}: {len(cells)} cells under {len(header[1])} columns; "
                "quote the cells that contain a comma"
            )
        frame = _frame(file, number, names, cells)
        image = (os.path.normpath(frame["path"]), nfc(frame.get("sequence", "")))
        if image in seen:
            raise DataError(
                f"{file}, line {number}: image {cells[names['image']]!r} is already in line {seen[image]} "
                "with the same sequence: remove one of the rows, or give them different sequences"
            )
        seen[image] = number
        yield frame
    if not seen:
        raise DataError(f"{file} has a header but no rows: expected one row for each image")


def _lines(file: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the line number and cells of each line that is not blank."""
    try:
        with file.open(encoding="utf-8-sig", newline="") as stream:
            reader = csv.reader(stream, strict=True)
            for cells in reader:
                if any("\0" in cell for cell in cells):
                    raise DataError(f"{file}, line {reader.line_num}: the row has a NUL character, so it is not text")
                if any(cell.strip() for cell in cells):
                    yield reader.line_num, cells
    except csv.Error as error:
        raise DataError(f"{file}, line {reader.line_num}: not a CSV row ({error})") from error
    except UnicodeDecodeError as error:
        raise DataError(f"{file} is not a CSV table in UTF-8 ({error}): save it as UTF-8") from error
    except OSError as error:
        raise DataError(f"the table {file} cannot be read: {error.strerror or error}") from error


def _column_names(file: Path, header: list[str]) -> dict[str, int]:
    """Return the positions of the known columns."""
    found = [name.strip().lower() for name in header]
    if "image" not in found:
        raise DataError(
            f"{file} has no column 'image', only {shortened(', '.join(found))}: name the columns in the first line, "
            f"separated by commas; valid: {', '.join(COLUMNS)}"
        )
    for name in (*COLUMNS, *_QUATERNION):
        if found.count(name) > 1:
            raise DataError(f"{file} has {found.count(name)} columns named {name!r}: keep one")
    ignored = [name for name in found if name and name not in (*COLUMNS, *_QUATERNION)]
    if ignored:
        logger.warning("%s: unused columns: %s; valid: %s", file, shortened(", ".join(ignored)), ", ".join(COLUMNS))
    return {name: found.index(name) for name in (*COLUMNS, *_QUATERNION) if name in found}


def _frame(file: Path, line: int, names: dict[str, int], cells: list[str]) -> dict[str, Any]:
    last = max(names.values())
    if len(cells) <= last:
        missing = next(name for name, at in names.items() if at >= len(cells))
        raise DataError(f"{file}, line {line}: {len(cells)} cells, so there is none for column {missing!r}")
    frame: dict[str, Any] = {name: cells[at].strip() for name, at in names.items()}
    image = frame.pop("image")
    if not image:
        raise DataError(f"{file}, line {line}, column 'image': empty, expected the name of an image file")
    for name, largest in _LARGEST.items():
        if name in frame:
            cell = frame[name]
            try:
                frame[name] = float(cell or math.nan)
            except ValueError:
                frame[name] = math.inf
            if abs(frame[name]) > largest or "_" in cell:
                kind = {"time": "of seconds", "theta": "of rad"}.get(name, f"up to {largest:.3g}")
                point = "write it with a decimal point, or " * ("," in cell)
                point += "convert dates to seconds since some start, or " * (name == "time")
                raise DataError(
                    f"{file}, line {line}, column {name!r}: {cell!r} is not a number {kind}; {point}leave the cell "
                    "empty where the value is unknown"
                )
    turned = [frame.pop(name, math.nan) for name in _QUATERNION]
    if not any(map(math.isnan, turned)):
        if not 0.99 < (length := math.hypot(*turned)) < 1.01:
            raise DataError(
                f"{file}, line {line}: the quaternion {', '.join(_QUATERNION)} has the length {length:.3g}, expected 1"
            )
        frame = {**dict(zip((*TILT, "theta"), euler(turned).tolist(), strict=True)), **frame}
    return {"path": str(file.parent / image), **frame}


def manifest_of(frames: FrameTable, folder: Path) -> str:
    """Return frames as a manifest for a folder: image paths are relative to it, and empty columns left out."""
    columns: dict[str, Any] = {"image": [os.path.relpath(path, folder) for path in frames.path.tolist()]}
    for name in COLUMNS[1:]:
        values = getattr(frames, name)
        if (values != "").any() if values.dtype.kind == "U" else np.isfinite(values).any():
            columns[name] = values.tolist()
    return csv_text([columns, *zip(*columns.values(), strict=True)])
