"""The files of an expanded data set besides its pictures: the table of parameters, and the settings."""

from __future__ import annotations

import csv
import json
import os
import tempfile
from collections.abc import Iterable
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


def read_table(path: str | Path) -> list[Row]:
    """Return the rows of an expansion's table; a last line cut short by an interruption is left out.

    Raises:
        AugmentError: the file is no such table.
    """
    path = Path(path)
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if tuple(reader.fieldnames or ()) != COLUMNS:
            raise AugmentError(f"{path} is not a table of augment.expand: its columns must be {', '.join(COLUMNS)}")
        rows = list(reader)
    return [row for row in rows if None not in row.values() and _is_json(row["parameters"])]


def prepare(
    folder: Path, sources: list[Path], targets: list[list[Path]], options: dict[str, Any], resume: bool
) -> dict[str, Row]:
    """Make the folder ready and return the rows of the pictures that an earlier call finished."""
    wanted = json.loads(json.dumps({"schema": VERSION, **options, "frames": len(sources)}))  # as it will be read again
    settings = folder / SETTINGS
    if folder.exists() and any(folder.iterdir()):
        if not resume:
            raise AugmentError(f"{folder} is not empty: choose another folder, or go on with resume=true")
        if not settings.is_file():
            raise AugmentError(f"{folder} holds no {SETTINGS}, so it is no expansion to resume: choose another folder")
        found = _read_settings(settings)
        for key, value in wanted.items():
            if found.get(key) != value:
                raise AugmentError(
                    f"{folder} was expanded with {key}={found.get(key)}, now asked for {value}: "
                    "resume with the same settings, or choose another folder"
                )
    write_bytes(settings, (json.dumps(wanted, indent=2) + "\n").encode())
    table = folder / TABLE
    if not table.is_file():
        return {}
    expected = {
        name_in(target, folder): str(source)
        for source, row in zip(sources, targets, strict=True)
        for target in row
    }  # fmt: skip
    rows = read_table(table)
    for row in rows:
        if expected.get(row["image"]) != row["source"]:
            raise AugmentError(
                f"{table} says that {row['image']} was made of {row['source']}, which is not what is asked for now: "
                "resume with the same images and outputs, or choose another folder"
            )
    write_table(table, rows)  # drops a line cut short, so that further lines can be appended
    return {row["image"]: row for row in rows}


def _read_settings(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise AugmentError(f"{path} is not whole JSON ({error}): choose another folder") from error
    if not isinstance(found, dict):
        raise AugmentError(f"{path} holds no settings: choose another folder")
    return found


def name_in(path: Path, folder: Path) -> str:
    """Return the name of a picture in the table: its path inside the folder."""
    return path.relative_to(folder).as_posix()


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except json.JSONDecodeError:
        return False
    return True


def write_table(path: Path, rows: Iterable[Row]) -> None:
    """Write the table anew, whole or not at all."""
    text = StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_bytes(path, text.getvalue().encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file under a temporary name and rename it when it is whole."""
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
