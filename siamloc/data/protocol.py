"""The protocol: which frames train, validate, form the map and are queried ([T] 5.3.4, 5.3.5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from foundation.settings import Count, Natural, Positive, Rule, Settings
from foundation.words import as_words
from siamloc.data.frames import FrameTable, concatenate, fitting, in_capture_order
from siamloc.data.moves import way_along
from siamloc.errors import ConfigError, DataError

Way = Annotated[float, Rule("a number above 0 and up to 1,000,000", lambda value: 0 < value <= 1e6)]
ROLES = ("train", "validation", "map", "query")


@dataclass(frozen=True)
class Role(Settings):
    """A selection of frames by sequence, lighting, room and spacing, such as the frames of the map.

    Attributes:
        sequences: names or shell patterns such as "*seq2_cloudy3"; None if the role is not filled.
        lightings: keep these lightings; all if None.
        rooms: keep these rooms; all if None.
        every: keep every k-th frame of a sequence; all if None.
        offset: with `every`, the number of frames of a sequence before its first kept frame.
        spacing: keep frames at least this far apart along a sequence, in the unit of the positions; all if None.
        rest: keep instead the frames that `every` or `spacing` would leave out: the queries if the map takes every
            k-th frame of the same drive ([C] 5.1).

    Raises:
        ConfigError: both `every` and `spacing`, `offset` or `rest` without them, or a value of the wrong type.

    Example:
        >>> frames = FrameTable(path=["1.jpg", "2.jpg", "3.jpg"], sequence=["day", "day", "night"])
        >>> Role(sequences="day", every=2).select(frames).path.tolist()
        ['1.jpg']
        >>> Role(sequences="day", every=2, rest=True).select(frames).path.tolist()
        ['2.jpg']
    """

    sequences: tuple[str, ...] | None = None
    lightings: tuple[str, ...] | None = None
    rooms: tuple[str, ...] | None = None
    every: Count | None = None
    offset: Natural = 0
    spacing: Way | None = None
    rest: bool = False

    def __post_init__(self) -> None:
        for name in ("sequences", "lightings", "rooms"):
            if isinstance(getattr(self, name), str):
                object.__setattr__(self, name, (getattr(self, name),))
        super().__post_init__()
        if self.every is not None and self.spacing is not None:
            raise ConfigError("a role takes every k-th frame or frames at a spacing, not both: set one of them to null")
        if self.offset and (self.every is None or self.offset >= self.every):
            every = "null" if self.every is None else self.every
            raise ConfigError(f"offset={self.offset} goes with an every that is larger, got every={every}")
        if self.rest and self.every is None and self.spacing is None:
            raise ConfigError("rest=true keeps what every or spacing leaves out: set one of them")

    def __str__(self) -> str:
        """Describe the selection, such as "sequences a, every 5"; the empty string if nothing is set."""
        given = {name: value for name, value in self.plain().items() if value not in (None, 0, False)}
        return ", ".join(
            f"{name} {' '.join(value) if isinstance(value, list) else value}" for name, value in given.items()
        )

    def select(self, frames: FrameTable) -> FrameTable:
        """Return the role's frames, in the order of the table."""
        for column in ("sequence", "lighting", "room"):
            if (labels := getattr(self, f"{column}s")) is not None:
                frames = frames.select(**{column: labels})
        kept = frames
        if self.every is not None:
            kept = frames.every(self.every, self.offset)
        if self.spacing is not None:
            kept = frames.spaced(self.spacing)
        if self.rest:
            return frames.take(frames.rows_in(kept) < 0)
        return kept


@dataclass(frozen=True, repr=False)
class Protocol(Settings):
    """The roles of a data set, and which map frames a query may not be compared with.

    There are two kinds, whose results are never compared with each other: in "cross_run", map and queries come from
    different sequences, and no query was trained on; in "same_run", queries may come from the map's own sequence, and
    even be map frames. With `leave_one_out`, `apart_seconds` or `apart_metres`, queries of a cross_run protocol may
    also come from the map's sequences, since each is then only compared with other frames.

    Attributes:
        kind: "cross_run" or "same_run".
        train: frames whose pairs the network learns from.
        validation: frames by which the checkpoint is chosen; never used for training or testing.
        map: frames that the robot knows; the training frames if not filled.
        query: frames to be located.
        leave_one_out: a query is never compared with its own image.
        apart_seconds: a query is not compared with frames of its own drive taken less than this time before or after.
        apart_metres: a query is not compared with frames of its own drive that are less than this distance away,
            measured along the drive, in the unit of the positions.

    Raises:
        ConfigError: an unknown kind, or a value of the wrong type or out of range.

    Example:
        >>> frames = FrameTable(path=["1.jpg", "2.jpg", "3.jpg"], time=[0, 1, 5], sequence=["day"] * 3)
        >>> Protocol(apart_seconds=2).excluded(frames, frames).astype(int)
        array([[1, 1, 0],
               [1, 1, 0],
               [0, 0, 1]])
    """

    WHERE: ClassVar[str] = "protocol"

    kind: Literal["cross_run", "same_run"] = "cross_run"
    train: Role = field(default_factory=Role)
    validation: Role = field(default_factory=Role)
    map: Role = field(default_factory=Role)
    query: Role = field(default_factory=Role)
    leave_one_out: bool = False
    apart_seconds: Positive | None = None
    apart_metres: Positive | None = None

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Protocol:
        """Make a protocol from plain values; missing keys take their defaults.

        Raises:
            ConfigError: an unknown key (the message names the nearest valid one), or a value of the wrong type or out
                of range.
        """
        roles = {}
        for name in ROLES:
            if isinstance(values.get(name), Mapping):
                try:
                    roles[name] = Role.of(values[name])
                except ConfigError as error:
                    raise ConfigError(f"protocol.{name}: {error}") from error
        return super().of({**values, **roles})

    def __repr__(self) -> str:
        roles = [f"{name}: {words}" for name in ROLES if (words := str(getattr(self, name)))]
        apart = {"apart_seconds": self.apart_seconds, "apart_metres": self.apart_metres}
        distances = [f"{name} {value:g}" for name, value in apart.items() if value is not None]
        return f"Protocol({'; '.join([self.kind, *roles, *['leave_one_out'] * self.leave_one_out, *distances])})"

    @property
    def excludes(self) -> bool:
        """Whether some map frames are excluded for a query of the same drive."""
        return self.leave_one_out or self.apart_seconds is not None or self.apart_metres is not None

    def frames(self, role: str, table: FrameTable) -> FrameTable:
        """Return the frames of a role.

        Raises:
            ConfigError: the role is not filled, names a label that no frame carries, or shares a sequence with a role
                that it must not overlap.
        """
        selection: Role = getattr(self, role)
        if role == "map" and selection.sequences is None:
            selection = replace(selection, sequences=self.train.sequences)
        if selection.sequences is None:
            example = as_words({f"protocol.{role}.sequences": (self.without_role(table) or ["NAME"])[:1]})
            raise ConfigError(
                f"protocol.{role}.sequences is not set; the data holds {table.describe()}. "
                f"Set it, for instance {example}, or ['*'] for all"
            )
        try:
            frames = selection.select(table)
        except ConfigError as error:
            raise ConfigError(f"protocol.{role}: {error}") from error
        self._check_apart(role, frames, table)
        return frames

    def without_role(self, table: FrameTable) -> list[str]:
        """Return the sequences of a table that no role names, in the order of the table."""
        names = dict.fromkeys(table.sequence.tolist())
        labels = [label for role in ROLES for label in getattr(self, role).sequences or ()]
        taken = {name for label in labels for name in fitting(label, names)}
        return [name for name in names if name not in taken]

    def roles(self, table: FrameTable, *names: str) -> dict[str, FrameTable]:
        """Return the frames of several roles by name; each has at least one.

        Raises:
            ConfigError: as for `frames`, or a role that selects no frame.
        """
        found = {name: self.frames(name, table) for name in names}
        for name, frames in found.items():
            if not len(frames):
                raise ConfigError(
                    f"protocol.{name} selects none of the {len(table)} frames; the data holds {table.describe()}: "
                    f"choose others with protocol.{name}.sequences, lightings or rooms"
                )
        return found

    def excluded(
        self, queries: FrameTable, known: FrameTable, drives: FrameTable | None = None
    ) -> NDArray[np.bool_] | None:
        """Return which map frames each query may not be compared with, or None if all comparisons are allowed.

        Args:
            queries: n frames.
            known: the map's m frames.
            drives: frames in capture order along which `apart_metres` measures the distance, such as the whole data
                set. If None, the queries and the map's frames, in order of time; a drive with an unknown time stays
                as it is.

        Returns:
            (n, m), True where the two must not be compared.

        Raises:
            DataError: times, positions or a capture order that the setting needs are unknown.
        """
        if not self.excludes:
            return None
        excluded = np.zeros((len(queries), len(known)), dtype=bool)
        if self.leave_one_out:
            _, picture = np.unique([path for _, path in queries.identities() + known.identities()], return_inverse=True)
            excluded |= picture[: len(queries), None] == picture[len(queries) :]
        if self.apart_seconds is not None:
            lack = "time, which protocol.apart_seconds needs: give times, or use apart_metres or leave_one_out"
            _exclude_near(excluded, queries, known, (queries.time, known.time), self.apart_seconds, lack)
        if self.apart_metres is not None:
            remedy = "give x and y, or use apart_seconds or leave_one_out"
            lack = f"position along a drive, which protocol.apart_metres needs: {remedy}"
            _exclude_near(excluded, queries, known, _travelled(queries, known, drives), self.apart_metres, lack)
        return excluded

    def _check_apart(self, role: str, frames: FrameTable, table: FrameTable) -> None:
        from_map = self.kind == "same_run" or self.excludes
        apart = {
            "validation": ["train", "query"],
            "query": ["validation", *["train"] * (self.kind != "same_run"), *["map"] * (not from_map)],
        }
        for other in apart.get(role, ()):
            if (names := getattr(self, other).sequences) is None:
                continue
            if shared := sorted({*frames.sequence.tolist()} & {*table.select(sequence=names).sequence.tolist()}):
                raise ConfigError(
                    f"sequence {shared[0]!r} is in protocol.{role} and in protocol.{other}, so the result would "
                    f"not be honest: take it out of one of them{_WAY_OUT.get((role, other), '')}"
                )


_WAY_OUT = {
    ("query", "map"): (
        ". For queries from the map's own run either keep near frames out with protocol.leave_one_out=true, "
        "protocol.apart_seconds=T or protocol.apart_metres=D, or set protocol.kind=same_run"
    ),
    ("query", "train"): "; for queries from a run that was trained on set protocol.kind=same_run",
}


def _exclude_near(
    excluded: NDArray[np.bool_],
    queries: FrameTable,
    known: FrameTable,
    at: tuple[NDArray[np.float64], NDArray[np.float64]],
    apart: float,
    lack: str,
) -> None:
    """Mark the pairs of frames of a drive that are less than `apart` away from each other on a scale, such as time."""
    query_at, known_at = at
    for sequence, rows in queries.rows_by("sequence").items():
        columns = np.flatnonzero(known.sequence == sequence)
        sides = (queries, rows, query_at), (known, columns, known_at)
        unknown = {key for table, own, at in sides for key in table.take(own[np.isnan(at[own])]).identities()}
        if len(columns) and unknown:
            raise DataError(f"{len(unknown)} frames of sequence {sequence!r} have no {lack}")
        for row in rows:
            excluded[row, columns] |= np.abs(known_at[columns] - query_at[row]) < apart


def _travelled(
    queries: FrameTable, known: FrameTable, drives: FrameTable | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how far the robot had driven on its drive at each query (n,) and each map frame (m,); NaN if unknown."""
    drives = _in_order(queries, known) if drives is None else drives
    drives = drives.take(drives.has_position)
    way = np.full(len(drives) + 1, np.nan)  # the last is that of all frames that the drives lack, in row -1
    for rows in drives.rows_by("sequence").values():
        way[rows] = way_along(drives.xy[rows])
    return way[queries.rows_in(drives)], way[known.rows_in(drives)]


def _in_order(queries: FrameTable, known: FrameTable) -> FrameTable:
    """Return the frames of both tables in capture order.

    Raises:
        DataError: the order is unknown, since some frames have no time.
    """
    if (known.rows_in(queries) >= 0).all():
        return in_capture_order(queries)
    new = queries.rows_in(known) < 0
    both = concatenate([known, queries.take(new)])
    if new.any() and np.isnan(both.time).any():
        raise DataError(
            "protocol.apart_metres needs the order in which the frames were taken: give times, or the whole drives"
        )
    return in_capture_order(both)
