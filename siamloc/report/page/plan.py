"""Data for the interactive floor plan: positions, errors and image numbers, in compact form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from foundation.columns import spread_rows
from siamloc.data.occupancy import OccupancyMap
from siamloc.report.draw.floor_plan import along
from siamloc.report.draw.look import series_1_2_5
from siamloc.report.page.gathered import Evaluation
from siamloc.results import Columns, finest, rows_by_label
from siamloc.tables import short_names

WORST = 20
_CLASSES = 6
_LENGTHS = {"x": "x", "y": "y", "ex": "est_x", "ey": "est_y", "error": "error", "floor": "floor"}
"""The columns of the queries that are lengths, by their names in the page's script."""


@dataclass(frozen=True, eq=False)
class Plan:
    """The queries that a floor plan shows.

    Attributes:
        queries: columns of `queries.csv`, only the rows that are shown.
        known: columns of `map.csv`.
        rows: indices in the whole table of the rows that are shown (n,).
        total: number of rows in the whole table.
        nearest: the map frame nearest to each query's true position (n,): the right answer.
        unit: unit of the positions.
        estimate: source of the estimates and errors in `queries`, see `siamloc.results.finest`; None for the nearest
            map frame by descriptor.
        occupancy: the map of the building to draw behind the plan, if there is one.
        truth: what the positions of the queries are, "true" or "surveyed".
    """

    queries: Columns
    known: Columns
    rows: NDArray[np.int64]
    total: int
    nearest: NDArray[np.int64]
    unit: str
    estimate: str | None = None
    occupancy: OccupancyMap | None = None
    truth: str = "true"

    @property
    def along(self) -> str | None:
        """The axis, "x" or "y", along which all frames lie; None if they spread over a plan."""
        return along(self.queries, self.known)

    @property
    def worst(self) -> NDArray[np.int64]:
        """Rows of the queries with the largest errors, the largest first."""
        return np.argsort(-self.queries["error"], kind="stable")[:WORST]

    @property
    def worst_pictures(self) -> list[str]:
        """The paths of the images of the worst queries, with their matches and right answers."""
        return [path for row in self.worst.tolist() for path in self.triple(row)]

    def picture_order(self) -> list[str]:
        """Return the paths of all images: first of the worst queries, then of queries in ever denser spacing.

        Each query comes with its match and the right answer, so that the beginning of the list shows some queries
        completely rather than all of them in part.
        """
        order = dict.fromkeys([*self.worst.tolist(), *spread(len(self.rows)).tolist()])
        return list(dict.fromkeys(path for row in order for path in self.triple(row)))

    def triple(self, row: int) -> tuple[str, str, str]:
        """Return the paths of the images of a query, its match and the right answer."""
        known = self.known["path"]
        return str(self.queries["path"][row]), str(known[self.queries["match"][row]]), str(known[self.nearest[row]])

    def plain(self, place: Mapping[str, int], sheets: int) -> dict[str, Any]:
        """Return the plan as plain values, for the page's script.

        Args:
            place: index of each file's image, by path; files without an image are not shown.
            sheets: number of the set of sheets that holds these images.
        """
        queries, known = self.queries, self.known
        digits = _digits(queries, known)
        xy = np.column_stack([np.concatenate([queries[axis], known[axis]]) for axis in "xy"])
        lightings, lighting = _numbered(queries["lighting"])
        rooms, both = _numbered(np.concatenate([queries["room"], known["room"]]))
        lengths = partial(_short, digits=digits)
        heading = queries.get("heading_error")
        shown = {*queries["match"].tolist(), *self.nearest.tolist()}  # the names of other map frames are never read
        return {
            "unit": self.unit,
            "digits": digits,
            "along": self.along,
            "truth": self.truth,
            "finer": self.estimate is not None,
            "around": None if self.occupancy is None else self.occupancy.around(xy).T.round(digits).tolist(),
            "classes": error_classes(queries["error"]),
            "lightings": lightings,
            "rooms": rooms,
            "sheets": sheets,
            "query": {
                **{name: lengths(queries[column]) for name, column in _LENGTHS.items()},
                "match": queries["match"].tolist(),
                "nearest": self.nearest.tolist(),
                "lighting": lighting.tolist(),
                "room": both[: len(self.rows)].tolist(),
                "heading": None if heading is None else _short(heading, 1),
                "row": self.rows.tolist(),
                "name": [PurePath(path).name for path in queries["path"].tolist()],
                "picture": [place.get(path, -2) for path in queries["path"].tolist()],
            },
            "map": {
                "x": lengths(known["x"]),
                "y": lengths(known["y"]),
                "room": both[len(self.rows) :].tolist(),
                "name": [PurePath(path).name if i in shown else "" for i, path in enumerate(known["path"].tolist())],
                "picture": [place.get(path, -2) for path in known["path"].tolist()],
            },
            "labels": _room_labels(known),
        }


def make_plan(evaluation: Evaluation, most: int, occupancy: OccupancyMap | None = None) -> Plan | None:
    """Return the plan of an evaluation with at most `most` queries; None if nothing was localized.

    If there are more, it keeps those with the largest errors, and others evenly spread over the table.
    """
    queries, known = evaluation.queries, evaluation.tables.get("map")
    if queries is None or known is None or not len(queries["error"]) or not len(known["x"]):
        return None
    queries, estimate = finest(queries)
    total = len(queries["error"])
    rows = np.arange(total)
    if total > most:
        worst = np.argsort(-queries["error"], kind="stable")[:WORST]
        even = spread_rows(total, max(most - WORST, 1))
        rows = np.unique(np.concatenate([worst, even]))
    shown = {name: column[rows] for name, column in queries.items()}
    tree = cKDTree(np.column_stack([known["x"], known["y"]]))
    nearest = np.asarray(tree.query(np.column_stack([shown["x"], shown["y"]]))[1], dtype=np.int64)
    return Plan(shown, known, rows, total, nearest, evaluation.unit, estimate, occupancy, evaluation.truth)


def spread(n: int) -> NDArray[np.int64]:
    """Return 0 ... n-1 in an order whose every beginning is evenly spread over all n."""
    bits = int(n - 1).bit_length()
    order = np.zeros(1, dtype=np.int64)
    for bit in range(bits):
        order = np.concatenate([order, order + (1 << (bits - 1 - bit))])
    return order[order < n]


def error_classes(error: NDArray) -> list[float]:
    """Return the limits between classes of errors, in the series 1, 2, 5: the last class holds about 2 %."""
    high = float(np.percentile(error, 98))
    if high <= 0:
        high = float(error.max()) or 1.0
    series = series_1_2_5(high / 1e4, high)
    series = series if series[-1] <= high * (1 + 1e-9) or len(series) == 1 else series[:-1]
    return series[-(_CLASSES - 1) :]


def _room_labels(known: Columns) -> list[list[Any]]:
    """Return where to write each room's name: at its map frame nearest to the room's centre."""
    labels = []
    rooms = {room: rows for room, rows in rows_by_label(known["room"]).items() if known["room"][rows[0]] != ""}
    for room, rows in zip(short_names(rooms), rooms.values(), strict=True):
        x, y = known["x"][rows], known["y"][rows]
        at = rows[np.argmin(np.hypot(x - x.mean(), y - y.mean()))]
        labels.append([room, int(at), len(rows)])
    return labels


def _digits(queries: Columns, known: Columns) -> int:
    """Return a sufficient number of decimals: a hundred-thousandth of the extent, normally at most three."""
    extent = max(float(np.ptp(np.concatenate([queries[name], known[name]]))) for name in ("x", "y"))
    return int(np.clip(np.ceil(5 - np.log10(extent)) if extent > 0 else 3, 0, 3 if extent >= 1 else 9))


def _short(values: NDArray, digits: int) -> list[float | None]:
    """Return rounded numbers: whole numbers without a decimal point, and None for NaN."""
    rounded = np.round(values.astype(np.float64), digits).tolist()
    return [None if value != value else int(value) if value == int(value) else value for value in rounded]


def _numbered(labels: NDArray) -> tuple[list[str], NDArray[np.int64]]:
    names, numbers = np.unique(labels, return_inverse=True)
    return names.tolist(), numbers.reshape(-1)
