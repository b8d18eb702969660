"""`FrameTable`: the table of frames that every reader returns and everything else takes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date, timedelta
from fnmatch import fnmatchcase
from os.path import abspath
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import typed
from foundation.columns import chosen_rows
from foundation.errors import not_yaml
from foundation.files import read_text
from foundation.settings import Count, Natural, Positive, shortened
from siamloc.data.names import nfc
from siamloc.errors import ConfigError, DataError, hint, leave_out

_ADVICE = {  # on formats that are not read
    (".heic", ".heif", ".avif"): "convert them to JPEG, as the telephone or `heif-convert` does",
    (".gif", ".jp2", ".jxl"): "convert them to PNG",
    (".zstd",): "name the folder of the ROS 2 bag, with its metadata.yaml",
    (".dng", ".raw", ".arw", ".cr2", ".nef"): "export them as JPEG",
    (".insv", ".360"): "export a whole 360-degree video (.mp4, unwrap=equirectangular) with the camera's program; an "
    ".insv that is renamed to .mp4 is the video of one lens or of two (unwrap=dual_fisheye)",
    (".insp",): "export whole 360-degree pictures (.jpg) with the camera's program; an .insp that is renamed to .jpg "
    "shows the two lenses (unwrap=dual_fisheye)",
}
BAGS = (".bag", ".db3", ".mcap")
"""Endings of the files of ROS bags."""
METADATA = "metadata.yaml"
"""The file in the folder of a ROS 2 bag that says which files belong to it, and how they are compressed."""
VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".webm", ".mjpeg", ".mpg")
"""Endings of the videos that are read."""
_TEXT = ("path", "room", "sequence", "lighting", "building")
ODOMETRY = ("odom_x", "odom_y", "odom_theta")
DEVIATIONS = ("deviation", "theta_deviation")
TILT = ("roll", "pitch")
_ACCENTS = 0x300  # the first character that may join the one before it
_LISTED = 12  # sequences, rooms or lightings that a description names
_POSED = ("path", "x", "y", "theta", "room", "sequence", "lighting", "time", "building")
COLUMNS = (*_POSED, *ODOMETRY, *DEVIATIONS, *TILT)
_TIMES = (date, timedelta, np.datetime64, np.timedelta64)
_IN_SECONDS = (
    ", so give seconds: t = np.array(times, 'datetime64[us]'), or 'timedelta64[us]' for durations, and then "
    "(t - t.min()) / np.timedelta64(1, 's')"
)
_UNKNOWN = {name: "" if name in _TEXT else np.nan for name in COLUMNS}


@dataclass(frozen=True, eq=False, repr=False)
class FrameTable:
    """Frames as columns of equal length, in capture order inside each sequence.

    Immutable: the arrays are read-only and every method returns another table. A missing pose or time is NaN, a missing
    label is the empty string, also if it is given as None, NaN or `pandas.NA`. Columns left out are filled with missing
    values. Letters with accents are one character each in labels (NFC), however they are given. A frame is identified
    by its sequence and its path; row numbers do not survive a selection.

    Headings run counter-clockwise seen from above, in radians, 0 along +x. The columns of a panorama run clockwise,
    and its middle column looks straight ahead, along theta: as theta grows, the contents of the image move right.

    Attributes:
        path: image files (n,).
        x: positions in `unit` (n,).
        y: positions in `unit` (n,).
        theta: headings in radians (n,), counter-clockwise, 0 along +x.
        room: room labels (n,).
        sequence: names of the drives the frames belong to (n,).
        lighting: "cloudy", "night", "sunny", or "" (n,).
        time: seconds (n,).
        building: name of the building, which distinguishes equal room codes of two buildings (n,).
        odom_x: positions that the robot computes from its wheels, in `unit` (n,), in a frame of each drive's own, from
            which they drift away.
        odom_y: likewise.
        odom_theta: headings in that frame, in radians (n,), counter-clockwise.
        deviation: standard deviations of x, and of y, in `unit` (n,), such as a survey estimates; missing where
            positions are exact. They count as independent from frame to frame.
        theta_deviation: standard deviations of theta, in radians (n,).
        roll: tilt about the robot's axis ahead, in radians (n,), positive where its left side is up.
        pitch: tilt about its axis to the left, in radians (n,), positive where its front is down.
        unit: unit of x and y; only used in texts. Selections keep it, equality ignores it.
        source: the arguments with which `siamloc.data.read(**source)` reads the frames; empty if unknown. Selections
            keep it, equality ignores it.

    Raises:
        DataError: columns of different lengths, a path that is None or NaN, or a deviation below 0.

    Example:
        >>> frames = FrameTable(path=["1.jpg", "2.jpg", "3.jpg"], x=[0, 1, 2], y=[0, 0, 0], room=["A", "A", "B"])
        >>> frames
        FrameTable(3 frames; sequences: (unnamed) 3; rooms: A, B; lightings: none; positions: all, in m)
        >>> frames.select(room="A").path.tolist()
        ['1.jpg', '2.jpg']
        >>> frames.spaced(2).x.tolist()
        [0.0, 2.0]
    """

    path: NDArray[np.str_]
    x: NDArray[np.float64] = None  # type: ignore[assignment]
    y: NDArray[np.float64] = None  # type: ignore[assignment]
    theta: NDArray[np.float64] = None  # type: ignore[assignment]
    room: NDArray[np.str_] = None  # type: ignore[assignment]
    sequence: NDArray[np.str_] = None  # type: ignore[assignment]
    lighting: NDArray[np.str_] = None  # type: ignore[assignment]
    time: NDArray[np.float64] = None  # type: ignore[assignment]
    building: NDArray[np.str_] = None  # type: ignore[assignment]
    odom_x: NDArray[np.float64] = None  # type: ignore[assignment]
    odom_y: NDArray[np.float64] = None  # type: ignore[assignment]
    odom_theta: NDArray[np.float64] = None  # type: ignore[assignment]
    deviation: NDArray[np.float64] = None  # type: ignore[assignment]
    theta_deviation: NDArray[np.float64] = None  # type: ignore[assignment]
    roll: NDArray[np.float64] = None  # type: ignore[assignment]
    pitch: NDArray[np.float64] = None  # type: ignore[assignment]
    unit: str = "m"
    source: Mapping[str, Any] = field(default_factory=dict)

    if TYPE_CHECKING:  # a column is made of anything like an array

        def __init__(
            self,
            path: ArrayLike,
            x: ArrayLike | None = None,
            y: ArrayLike | None = None,
            theta: ArrayLike | None = None,
            room: ArrayLike | None = None,
            sequence: ArrayLike | None = None,
            lighting: ArrayLike | None = None,
            time: ArrayLike | None = None,
            building: ArrayLike | None = None,
            odom_x: ArrayLike | None = None,
            odom_y: ArrayLike | None = None,
            odom_theta: ArrayLike | None = None,
            deviation: ArrayLike | None = None,
            theta_deviation: ArrayLike | None = None,
            roll: ArrayLike | None = None,
            pitch: ArrayLike | None = None,
            unit: str = "m",
            source: Mapping[str, Any] = ...,
        ) -> None: ...

    def __post_init__(self) -> None:
        paths = _as_column("path", self.path)
        if paths.ndim != 1:
            raise DataError(f"column 'path' must be a list of image files, got {shortened(repr(self.path))}")
        n = len(paths)
        for name in COLUMNS:
            value = getattr(self, name)
            value = np.full(n, _UNKNOWN[name]) if value is None else value
            column = paths if name == "path" else _as_column(name, value)
            if column.shape != (n,):
                raise DataError(f"column {name!r} has shape {column.shape}, expected ({n},) like 'path'")
            if name in DEVIATIONS and (column < 0).any():
                raise DataError(f"column {name!r} holds standard deviations, from 0 up, got {column.min():g}")
            column.flags.writeable = False
            object.__setattr__(self, name, column)

    def __len__(self) -> int:
        return len(self.path)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, FrameTable):
            return NotImplemented
        return len(self) == len(other) and all(
            np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
            for a, b in zip(self.columns().values(), other.columns().values(), strict=True)
        )

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__post_init__()  # copies of read-only arrays are writable

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """Yield each frame as a plain dictionary."""
        for row in zip(*(column.tolist() for column in self.columns().values()), strict=True):
            yield dict(zip(COLUMNS, row, strict=True))

    @property
    def xy(self) -> NDArray[np.float64]:
        """Positions (n, 2)."""
        return np.column_stack([self.x, self.y])

    @property
    def odometry(self) -> NDArray[np.float64]:
        """Poses by the robot's wheels (n, 3): x, y in `unit` and heading in rad, each drive in a frame of its own."""
        return np.column_stack([getattr(self, name) for name in ODOMETRY])

    @property
    def tilt(self) -> NDArray[np.float64]:
        """Roll and pitch in rad (n, 2): NaN where both are unknown; where one is known, the other counts as 0."""
        known = np.column_stack([getattr(self, name) for name in TILT])
        return np.where(np.isnan(known).all(axis=1, keepdims=True), np.nan, np.nan_to_num(known))

    @property
    def has_position(self) -> NDArray[np.bool_]:
        """True where a frame's position is known (n,)."""
        return np.isfinite(self.x) & np.isfinite(self.y)

    @property
    def place(self) -> NDArray[np.str_]:
        """Room labels that differ between buildings (n,): "building/room", or the room where there is no building."""
        prefix = np.where(self.building != "", np.char.add(self.building, "/"), "")
        return np.char.add(prefix, self.room)

    def identities(self) -> list[tuple[str, str]]:
        """Return for each frame (n) its sequence and the absolute path of its image, which identify it."""
        paths = [abspath(path) for path in self.path.tolist()]  # noqa: PTH100 (tens of thousands of paths)
        return list(zip(self.sequence.tolist(), paths, strict=True))

    def rows_in(self, other: FrameTable) -> NDArray[np.int64]:
        """Return the row of each frame (n,) in another table, by `identities`; -1 for a frame that the other lacks.

        >>> FrameTable(path=["a.jpg", "b.jpg"]).rows_in(FrameTable(path=["b.jpg"]))
        array([-1,  0])
        """
        rows = {key: row for row, key in enumerate(other.identities())}
        return np.array([rows.get(key, -1) for key in self.identities()], dtype=np.int64)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns (n,) by name."""
        return {name: getattr(self, name) for name in COLUMNS}

    @typed
    def take(self, rows: ArrayLike | slice) -> FrameTable:
        """Return the frames at some rows, given by row numbers, a mask (n,) or a slice, in that order.

        Raises:
            DataError: rows that do not exist.
        """
        key = chosen_rows(rows, len(self))
        return self.with_columns(**{name: column[key] for name, column in self.columns().items()})

    @typed
    def select(self, **wanted: str | Iterable[str]) -> FrameTable:
        """Return the frames with the requested labels.

        Args:
            **wanted: one label or several, by column (`sequence`, `room`, `lighting`, `building`); shell patterns
                such as "*seq2_cloudy?" are understood, but a label that frames carry is no pattern.

        Raises:
            ConfigError: an unknown column, or a label that no frame carries (the message lists the valid ones).
        """
        mask = np.ones(len(self), dtype=bool)
        for column, labels in wanted.items():
            if column not in _TEXT:
                raise ConfigError(f"frames cannot be selected by {column!r}; {hint(column, _TEXT)}")
            values = getattr(self, column)
            present = sorted(set(values.tolist()))
            chosen: set[str] = set()
            if not isinstance(labels, Iterable):
                raise ConfigError(f"{column} must be a label or a list of labels, got {labels!r}")
            for label in [labels] if isinstance(labels, str) else labels:
                if not (matches := fitting(str(label), present)):
                    raise ConfigError(f"no frame has {column} {str(label)!r}; {hint(label, filter(None, present))}")
                chosen.update(matches)
            mask &= np.isin(values, sorted(chosen))
        return self.take(mask)

    @typed
    def every(self, k: Count, offset: Natural = 0) -> FrameTable:
        """Return every k-th frame of each sequence, starting with its first, or `offset` frames later.

        Raises:
            ConfigError: k is not a positive whole number, or the offset is not a whole number from 0 to k - 1.
        """
        if offset >= k:
            raise ConfigError(f"of every {k} frames the first one kept is 0 to {k - 1}, got offset={offset}")
        keep = np.zeros(len(self), dtype=bool)
        for rows in self.rows_by("sequence").values():
            keep[rows[offset::k]] = True
        return self.take(keep)

    @typed
    def spaced(self, metres: Positive) -> FrameTable:
        """Keep the first frame of each sequence, and each frame at least `metres` from the last kept frame.

        Raises:
            ConfigError: the distance is not positive.
            DataError: a frame without a position.
        """
        if not self.has_position.all():
            missing = int((~self.has_position).sum())
            raise DataError(f"{missing} of {len(self)} frames have no position, so they cannot be spaced by distance")
        keep = np.zeros(len(self), dtype=bool)
        xy = self.xy
        for rows in self.rows_by("sequence").values():
            last = None
            for row in rows:
                if last is None or np.hypot(*(xy[row] - xy[last])) >= metres:
                    keep[row] = True
                    last = row
        return self.take(keep)

    def rows_by(self, column: str) -> dict[str, NDArray[np.int64]]:
        """Return the row numbers of each label of a column, labels in order of first appearance."""
        values = getattr(self, column)
        labels, first, inverse = np.unique(values, return_index=True, return_inverse=True)
        return {str(labels[i]): np.flatnonzero(inverse == i) for i in np.argsort(first, kind="stable")}

    def with_columns(self, **columns: ArrayLike) -> FrameTable:
        """Return the table with some columns, or `unit` and `source`, replaced.

        Raises:
            DataError: a name of no column.
        """
        _check_names(name for name in columns if name not in ("unit", "source"))
        return replace(self, **columns)  # type: ignore[arg-type]

    def describe(self) -> str:
        """Summarize in one line the number of frames, their sequences, rooms and lightings, and their positions."""
        sequences = [f"{name or '(unnamed)'} {len(rows)}" for name, rows in self.rows_by("sequence").items()]
        known = int(self.has_position.sum())
        positions = "all" if known == len(self) else f"{known} of {len(self)}"
        return (
            f"{len(self)} frames; sequences: {_listed(sequences)}; rooms: {_listed(_labels(self.room))}; "
            f"lightings: {_listed(_labels(self.lighting))}; "
            f"positions: {f'{positions}, in {self.unit}' if known else 'none'}"
        )

    def __repr__(self) -> str:
        return f"FrameTable({self.describe()})"

    @classmethod
    def from_rows(cls, rows: Iterable[Mapping[str, Any]]) -> FrameTable:
        """Build a table from a dictionary for each frame, such as {"path": "1.jpg", "x": 0.5}.

        The keys are names of columns; missing keys become NaN or the empty string.

        Raises:
            DataError: a key that names no column.
        """
        rows = list(rows)
        _check_names(dict.fromkeys(key for row in rows for key in row))
        return cls(**{name: [row.get(name, _UNKNOWN[name]) for row in rows] for name in COLUMNS})  # type: ignore[arg-type]


@typed
def concatenate(tables: Sequence[FrameTable]) -> FrameTable:
    """Concatenate tables. The `unit`, and a `source` that they all share, are kept.

    Raises:
        DataError: the tables give their positions in different units.
    """
    if not tables:
        return FrameTable(path=np.array([], dtype=np.str_))
    check_units(tables)
    joined = {name: np.concatenate([getattr(table, name) for table in tables]) for name in COLUMNS}
    source = tables[0].source if all(table.source == tables[0].source for table in tables) else {}
    return FrameTable(**joined, unit=tables[0].unit, source=source)


def room_names(*tables: FrameTable) -> list[NDArray[np.str_]]:
    """Return unique names of the rooms of each table, with the building only if there are several.

    If the tables name a single building, frames that state none are taken to be in it.
    """
    named = {name for table in tables for name in np.unique(table.building).tolist()} - {""}
    if len(named) < 2:
        return [table.room for table in tables]
    return [np.where(table.room == "", "", table.place) for table in tables]


def check_units(tables: Iterable[FrameTable]) -> None:
    """Check that tables give their positions in the same unit.

    Raises:
        DataError: they give them in different units.
    """
    units = list(dict.fromkeys(table.unit for table in tables))
    if len(units) > 1:
        raise DataError(
            f"tables whose positions count in {' and '.join(units)} cannot be joined or compared: give them in one unit"
        )


def in_capture_order(frames: FrameTable) -> FrameTable:
    """Sort the frames of each sequence by time; a sequence with an unknown time stays as it is."""
    order = np.arange(len(frames))
    for rows in frames.rows_by("sequence").values():
        if np.isfinite(frames.time[rows]).all():
            order[rows] = rows[np.argsort(frames.time[rows], kind="stable")]
    return frames.take(order)


def placed(frames: FrameTable, what: str, on_error: str) -> FrameTable:
    """Leave out the frames without a position, and report them; see `siamloc.errors.leave_out`."""
    leave_out(frames.path[~frames.has_position].tolist(), len(frames), what, on_error)
    return frames.take(frames.has_position)


def read_file(path: Path, what: str = "the file", most: int = 64_000_000) -> str:
    """Return the text of a file that a user gave, of at most `most` bytes, without a mark of its byte order.

    Raises:
        DataError: the file cannot be read, is too long, or is no text.
    """
    try:
        return read_text(path, most).removeprefix("\ufeff")
    except (OSError, ValueError) as error:
        raise DataError(f"{what} {path} cannot be read: {getattr(error, 'strerror', None) or error}") from error


def parsed_yaml(text: str, file: object) -> Any:
    """Return the values of a YAML file.

    Args:
        text: its text.
        file: what an error calls it.

    Raises:
        DataError: the text is no YAML.
    """
    import yaml

    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise DataError(not_yaml(file, error)) from error


def fitting(label: str, names: Iterable[str]) -> list[str]:
    """Return the names that a label chooses: itself if it is one of them, else those that it fits as a shell pattern.

    Example:
        >>> fitting("Tag [1]", ["Tag 1", "Tag [1]"]), fitting("Tag*", ["Tag 1", "Tag [1]"])
        (['Tag [1]'], ['Tag 1', 'Tag [1]'])
    """
    names = list(names)
    if label in names:
        return [label]
    label = nfc(label)
    return [label] if label in names else [name for name in names if fnmatchcase(nfc(name), label)]


def advice(names: Iterable[str]) -> str:
    """Return what to do with files whose format is not read, as "; .heic: convert ..." for each format among them."""
    there = {Path(name).suffix.lower() for name in names}
    return "".join(
        f"; {', '.join(sorted(there & {*ends}))}: {text}" for ends, text in _ADVICE.items() if there & {*ends}
    )


def _labels(column: NDArray[np.str_]) -> list[str]:
    return sorted(set(column.tolist()) - {""})


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return (", ".join(names[:_LISTED]) or "none") + more


def _check_names(names: Iterable[str]) -> None:
    for name in names:
        if name not in COLUMNS:
            wanted = "path" if name == "image" else name
            raise DataError(f"frames have no column {name!r}; {hint(wanted, COLUMNS)}")


def _as_column(name: str, value: ArrayLike) -> NDArray[Any]:
    try:
        if name not in _TEXT and _is_time(np.asarray(value)):
            raise ValueError(f"got dates or durations{_IN_SECONDS if name == 'time' else ''}")
        if isinstance(value, np.ma.MaskedArray):
            value = np.where(np.ma.getmaskarray(value), np.array(None), value.data)
        column = np.array(value, dtype=np.str_ if name in _TEXT else np.float64)
        if name in _TEXT and column.ndim == 1 and not (isinstance(value, np.ndarray) and value.dtype.kind == "U"):
            missing = [_is_missing(one) for one in np.array(value, dtype=object)]
            if name == "path" and any(missing):
                where = f"{sum(missing)} of {len(missing)} are missing, the first in row {missing.index(True)}"
                raise ValueError(f"{where}: leave these frames out")
            column[missing] = ""
        if name in _TEXT and name != "path" and column.ndim == 1 and (column.view(np.uint32) >= _ACCENTS).any():
            forms = {label: nfc(label) for label in set(column.tolist())}
            column = np.array([forms[label] for label in column.tolist()])
        return column
    except (TypeError, ValueError) as error:
        what = "texts" if name in _TEXT else "numbers"
        raise DataError(f"column {name!r} must hold {what}, one for each frame: {error}") from error


def _is_time(values: NDArray[Any]) -> bool:
    """Return whether an array holds dates or durations, which numpy would turn into counts of some unit."""
    return values.dtype.kind in "mM" or (values.dtype == object and any(isinstance(one, _TIMES) for one in values.flat))


def _is_missing(label: Any) -> bool:
    """Return whether a label is None, NaN or, as `pandas.NA`, neither equal to itself nor different."""
    try:
        return label is None or bool(label != label)
    except TypeError:
        return True
