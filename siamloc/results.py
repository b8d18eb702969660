"""Result files: `results.json` with the measures and everything they are based on, and tables with a row per query.

A table is a dictionary of columns of equal length (`Columns`).
"""

from __future__ import annotations

import csv
import datetime
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.calls import typed
from foundation.files import check_version, csv_text, read_json, write_json, write_text
from siamloc.errors import ConfigError, DataError, FormatError, hint
from siamloc.versions import versions as versions_of

Columns = dict[str, NDArray[Any]]
UNLABELLED = "(unlabelled)"
RESERVED = frozenset({UNLABELLED, "all", "all queries"})
"""Names of groups of queries in tables and pictures, which no lighting and no room can have."""
FURTHER: dict[str, str] = {
    "filtered": "filter",
    "interpolated": "interpolation",
    "refined": "refinement",
    "tracked": "filter between frames",
}
"""Estimates of a query's pose besides the pose of the nearest map frame, and how each is made."""
FINEST = ("tracked", "refined")
"""Estimates that represent a whole evaluation: the first of them that was made, if any was."""

REMARKS = ("rooms", "positions", "buildings")
"""Keys of `skipped` in a result whose texts are remarks on what was measured, and no reasons why something was not."""

DEPTH = 100
"""Number of nearest map frames of a query over which the average precision of rooms is taken."""

_OF_ESTIMATES = ("est_x", "est_y", "est_theta", "error", "heading_error", "match")
_SCHEMA = "siamloc-results"
_VERSION = 1
_PICTURES = (".png", ".gif")
_KINDS = {"U": "text", "b": "bool", "i": "int", "u": "int", "f": "float"}
_PARSERS: dict[str, tuple[Any, Callable[[str], Any]]] = {
    "text": (np.str_, str),
    "bool": (np.bool_, {"True": True, "False": False}.__getitem__),
    "int": (np.int64, int),
    "float": (np.float64, lambda cell: float(cell) if cell else np.nan),
}


def finest(columns: Columns) -> tuple[Columns, str | None]:
    """Return a table of queries with the finest estimates and errors as its own, and the estimate's name.

    The finest are tracked poses, then poses by comparison with map frames; without either, the table and None.
    """
    for name in FINEST:
        if f"{name}_error" in columns:
            own = {key: columns[f"{name}_{key}"] for key in _OF_ESTIMATES if f"{name}_{key}" in columns}
            return {**columns, **own}, name
    return columns, None


def truth(columns: Mapping[str, Any]) -> str:
    """Return what the poses in a table of queries are: "surveyed", if they have standard deviations, or "true"."""
    return "surveyed" if "deviation" in columns else "true"


def write_results(
    folder: str | Path, results: Mapping[str, Any], tables: Mapping[str, Mapping[str, NDArray]] | None = None
) -> Path:
    """Write `results.json` and its tables, such as `queries.csv`; return the path of the first.

    Each file is written whole or not at all, `results.json` last: it names the tables that belong to it. Numbers keep
    full precision.

    Args:
        folder: created if it is missing.
        results: plain values, with `config` (complete), `measures` and `denominators`.
        tables: columns of equal length by table name: "queries" becomes `queries.csv`, "map" `map.csv`.

    Raises:
        DataError: columns of different lengths.
        StorageError: the disk refuses.
    """
    folder = Path(folder)
    header = {
        "schema": {"name": _SCHEMA, "version": _VERSION},
        "created": datetime.datetime.now(datetime.timezone.utc).isoformat(timespec="seconds"),
        "versions": versions(),
    }
    checked = {name: _as_table(name, columns) for name, columns in (tables or {}).items()}
    for name, columns in checked.items():
        lines = zip(*(column.tolist() for column in columns.values()), strict=True)
        write_text(folder / f"{name}.csv", csv_text([columns, *lines]))
    described = {
        name: {
            "file": f"{name}.csv",
            "rows": _length(columns),
            "columns": {key: _KINDS[column.dtype.kind] for key, column in columns.items()},
        }
        for name, columns in checked.items()
    }
    path = folder / "results.json"
    write_json(path, {**header, **results, "tables": described})
    return path


@typed
def read_results(folder: str | Path) -> dict[str, Any]:
    """Read `results.json`. NaN was written as null and comes back as None.

    Raises:
        FormatError: the file is missing, cut short, something else, or of another version.
    """
    path = Path(folder) / "results.json"
    results = read_json(path, "evaluate again")
    schema = results.get("schema") if isinstance(results, dict) else None
    if not isinstance(schema, dict) or schema.get("name") != _SCHEMA:
        raise FormatError(f"{path} is not a siamloc result file: give the folder that `siamloc evaluate` wrote")
    check_version(schema.get("version"), _VERSION, f"the result {path}", "evaluate again")
    if wrong := next(_altered(results), None):
        raise FormatError(f"{path} was altered in {wrong}: evaluate again")
    return results


_GROUPS = {"measures": 2, "baselines": 2, "cost": 2, "tables": 2, "denominators": 1, "skipped": 1, "config": 1}
"""Keys of `results.json`, and the minimum number of levels of names under each."""
_NEEDED = ("config", "measures", "denominators")


def _altered(results: Mapping[str, Any]) -> Iterator[str]:
    """Yield the parts of `results.json` that are not as `write_results` writes them."""
    for key, depth in _GROUPS.items():
        group = results.get(key, None if key in _NEEDED else {})
        if not isinstance(group, Mapping) or (
            depth == 2 and not all(isinstance(one, Mapping) for one in group.values())
        ):
            yield key
    if not isinstance(results.get("name", ""), str):
        yield "name"
    yield from (
        f"the table {name}" for name, table in results.get("tables", {}).items() if not _is_name(table.get("file"))
    )
    pictures = results.get("pictures", [])
    if not isinstance(pictures, list) or not all(map(_is_name, pictures)):
        yield "pictures"


def _is_name(value: Any) -> bool:
    """Whether a value is the name of a file, without a folder."""
    return isinstance(value, str) and Path(value).name == value


def add_pictures(folder: str | Path, names: Iterable[str]) -> None:
    """Add the names of pictures that are drawn from a result folder to its `results.json`.

    Raises:
        FormatError: as `read_results`.
        StorageError: the disk refuses.
    """
    results = read_results(folder)
    write_json(Path(folder) / "results.json", {**results, "pictures": sorted({*results.get("pictures", []), *names})})


@typed
def read_rows(folder: str | Path, table: str = "queries") -> Columns:
    """Read one table of a result folder as columns, with the types and the full precision that were written.

    Raises:
        ConfigError: the results have no such table.
        FormatError: a file is missing, cut short, altered, or of another version.
    """
    tables = read_results(folder).get("tables", {})
    if table not in tables:
        raise ConfigError(f"the results in {folder} have no table {table!r}; {hint(table, tables)}")
    described = tables[table]
    path = Path(folder) / described["file"]
    if not path.is_file():
        raise FormatError(f"{path} does not exist, though results.json names it: evaluate again")
    try:
        with path.open(encoding="utf-8", newline="") as file:
            names, *rows = csv.reader(file)
        kinds = described["columns"]
        if names != list(kinds) or len(rows) != described["rows"]:
            raise ValueError(f"{len(rows)} rows of {len(names)} columns for {described['rows']} of {len(kinds)}")
        parsed = {}
        for name, column in zip(names, zip(*rows, strict=True) if rows else [()] * len(names), strict=True):
            dtype, parse = _PARSERS[kinds[name]]
            parsed[name] = np.array([parse(cell) for cell in column], dtype=dtype)
    except (ValueError, KeyError, TypeError, OverflowError, csv.Error) as error:
        raise FormatError(f"{path} is not what results.json describes ({error}): evaluate again") from error
    return parsed


def rows_by_label(labels: NDArray) -> dict[str, NDArray[np.int64]]:
    """Return the row numbers of each label, labels in alphabetical order.

    Rows without a label are listed under "(unlabelled)"; if no row has a label, there are no groups.

    >>> rows_by_label(np.array(["night", "cloudy", "night"]))
    {'cloudy': array([1]), 'night': array([0, 2])}
    """
    names, inverse = np.unique(labels, return_inverse=True)
    if names.tolist() == [""]:
        return {}
    return {str(name) or UNLABELLED: np.flatnonzero(inverse == i) for i, name in enumerate(names)}


def by_label(
    columns: Mapping[str, NDArray], measure: Callable[[NDArray[np.int64]], Any], *names: str
) -> dict[str, Any]:
    """Return a measure over all rows of a table, and over the rows with each label.

    Args:
        columns: columns of equal length.
        measure: returns the measure of some rows.
        names: columns of labels.

    Returns:
        "overall", and for each of the names the measures by label.
    """
    groups = {name: {label: measure(rows) for label, rows in rows_by_label(columns[name]).items()} for name in names}
    return {"overall": measure(np.arange(_length(columns))), **groups}


def versions() -> dict[str, str]:
    """Return the software versions that results depend on; torch only if it is loaded."""
    return versions_of(["numpy", "opencv", *(["torch"] if "torch" in sys.modules else [])])


def files_of(folder: str | Path) -> set[str]:
    """Return the names of the tables and pictures in a result folder's `results.json`; empty if there is no result."""
    try:
        results = read_results(folder)
    except FormatError:
        return set()
    tables = [table["file"] for table in results.get("tables", {}).values()]
    pictures = results.get("pictures", [])
    return {*(name for name in tables if name.endswith(".csv")), *(one for one in pictures if one.endswith(_PICTURES))}


def _as_table(name: str, columns: Mapping[str, NDArray]) -> Columns:
    table = {str(key): np.asarray(column) for key, column in columns.items()}
    if not table:
        raise DataError(f"the table {name!r} has no columns")
    for key, column in table.items():
        if column.ndim != 1 or len(column) != _length(table):
            raise DataError(f"column {key!r} of {name!r} has shape {column.shape}, expected ({_length(table)},)")
        if column.dtype.kind not in _KINDS:
            raise DataError(f"column {key!r} of {name!r} holds {column.dtype}, expected text, bool, int or float")
    return table


def _length(columns: Mapping[str, NDArray]) -> int:
    return len(next(iter(columns.values())))
