"""The files next to the images of an expanded data set: the table of parameters, the settings, and leftovers.

A run that was killed may leave a table with an incomplete last line, and temporary files. Resuming removes both.
"""

from __future__ import annotations

import csv
import json
import os
import re
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Mapping
from contextlib import suppress
from io import StringIO
from pathlib import Path
from typing import Any

from augment.errors import AugmentError

TABLE = "augmentation.csv"
SETTINGS = "augmentation.json"
COLUMNS = ("image", "source", "frame", "variant", "label", "heading", "parameters")
VERSION = 1

Row = dict[str, str]

_HEADER = (",".join(COLUMNS) + "\n").encode()
_TEMPORARY = re.compile(r"\.(.+)\.[a-z0-9_]{8}\.tmp")  # as `write_bytes` names them


def read_table(path: str | Path) -> list[Row]:
    """Return the rows of an expansion's table; a last line cut short by an interruption is left out.

    Raises:
        AugmentError: the file is not such a table.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "augmentation.csv"
        >>> lines = [",".join(COLUMNS), "a.png,in.png,0,0,original,0.0,{}", "b.png,in.p"]
        >>> _ = path.write_text("\\n".join(lines))
        >>> [row["image"] for row in read_table(path)]
        ['a.png']
    """
    path = Path(path)
    content = path.read_bytes()
    if _HEADER.startswith(content):  # killed before the header was written
        return []
    whole = content[: content.rfind(b"\n") + 1].decode("utf-8", errors="replace")
    reader = csv.DictReader(StringIO(whole, newline=""))
    if tuple(reader.fieldnames or ()) != COLUMNS:
        raise AugmentError(f"{path} is not a table of augment.expand: its columns must be {', '.join(COLUMNS)}")
    return [row for row in reader if None not in row.values()]


def prepare(
    folder: Path, sources: list[Path], targets: list[list[Path]], options: dict[str, Any], resume: bool
) -> dict[str, Row]:
    """Prepare the folder and return the rows of the images that an earlier call finished, by image."""
    wanted = json.loads(json.dumps({"schema": VERSION, **options, "frames": len(sources)}))  # as it will be read again
    settings = folder / SETTINGS
    entries = _entries(folder) if folder.exists() else []
    names = _names_by_folder(folder, targets) if entries else {}
    if any(not _is_temporary(entry, names[folder]) for entry in entries):
        if not resume:
            raise AugmentError(f"{folder} is not empty: choose another folder, or go on with resume=true")
        if not settings.is_file():
            raise AugmentError(f"{folder} has no {SETTINGS}, so there is nothing to resume: choose another folder")
        found = _read_settings(settings)
        for key, value in wanted.items():
            if found.get(key) != value:
                raise AugmentError(
                    f"{folder} was expanded with {key}={found.get(key)}, now asked for {value}: "
                    "resume with the same settings, or choose another folder"
                )
    table = folder / TABLE
    rows = read_table(table) if table.is_file() else []
    expected = {
        name_in(target, folder): str(source)
        for source, row in zip(sources, targets, strict=True)
        for target in (row if rows else ())
    }  # fmt: skip
    for row in rows:
        if expected.get(row["image"]) != row["source"]:
            raise AugmentError(
                f"{table} says that {row['image']} was made of {row['source']}, which is not what is asked for now: "
                "resume with the same images and outputs, or choose another folder"
            )
    _remove_temporaries(names)
    write_bytes(settings, (json.dumps(wanted, indent=2) + "\n").encode())
    write_table(table, rows)  # drops an incomplete line, so that further lines can be appended
    return {row["image"]: row for row in rows}


def _names_by_folder(folder: Path, targets: list[list[Path]]) -> Mapping[Path, set[str]]:
    """Return the names of all files that an expansion writes, by folder."""
    names: dict[Path, set[str]] = defaultdict(set)
    names[folder] = {TABLE, SETTINGS}
    for row in targets:
        for target in row:
            names[target.parent].add(target.name)
    return names


def _is_temporary(entry: os.DirEntry[str], names: set[str]) -> bool:
    """Whether a killed run left this file behind while writing one of these names."""
    found = _TEMPORARY.fullmatch(entry.name)
    return found is not None and found[1] in names and entry.is_file(follow_symlinks=False)


def _remove_temporaries(names: Mapping[Path, set[str]]) -> None:
    for folder, own in names.items():
        for entry in _entries(folder) if folder.is_dir() else ():
            if _is_temporary(entry, own):
                Path(entry).unlink()


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    with os.scandir(folder) as entries:
        return list(entries)


def _read_settings(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise AugmentError(f"{path} is incomplete or invalid JSON ({error}): choose another folder") from error
    if not isinstance(found, dict):
        raise AugmentError(f"{path} contains no settings: choose another folder")
    return found


def name_in(path: Path, folder: Path) -> str:
    """Return the name of an image in the table: its path inside the folder."""
    return path.relative_to(folder).as_posix()


def write_table(path: Path, rows: Iterable[Row]) -> None:
    """Write the whole table."""
    text = StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_bytes(path, text.getvalue().encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file, whole or not at all: under a temporary name that is renamed at the end."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
    temporary = Path(name)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        temporary.chmod(0o644)
        temporary.replace(path)
    finally:
        with suppress(FileNotFoundError):
            temporary.unlink()
