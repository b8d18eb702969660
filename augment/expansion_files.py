"""The files next to the images of an expanded data set: the table of parameters, the settings, and leftovers.

A run that was killed may leave a table with an incomplete last line. Resuming removes it.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable
from io import StringIO
from pathlib import Path
from typing import Any

from augment.errors import AugmentError
from foundation.files import is_temporary, write_json, write_text
from foundation.locks import LOCK

TABLE = "augmentation.csv"
SETTINGS = "augmentation.json"
COLUMNS = ("image", "source", "frame", "variant", "label", "heading", "parameters")
VERSION = 1

Row = dict[str, str]

_HEADER = (",".join(COLUMNS) + "\n").encode()


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
    if folder.exists() and not all(is_temporary(path) or path.name == LOCK for path in folder.iterdir()):
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
    write_json(settings, wanted)
    write_table(table, rows)  # drops an incomplete line, so that further lines can be appended
    return {row["image"]: row for row in rows}


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
    write_text(path, text.getvalue())
