"""Who does what: which frames train, validate, form the map and are queried ([T] 5.3.4, 5.3.5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, hint

ROLES = ("train", "validation", "map", "query")
KINDS = ("cross_run", "same_run")


@dataclass(frozen=True)
class Role:
    """A selection of frames.

    Attributes:
        sequences: names or shell patterns such as "*seq2_cloudy3"; None where the role is not filled.
        lightings: keep these lightings; all if None.
        rooms: keep these rooms; all if None.
        every: keep every k-th frame of a sequence; all if None.
        spacing: keep frames at least this far apart along a sequence, in the unit of the positions; all if None.
    """

    sequences: Sequence[str] | None = None
    lightings: Sequence[str] | None = None
    rooms: Sequence[str] | None = None
    every: int | None = None
    spacing: float | None = None

    def __post_init__(self) -> None:
        if self.every is not None and self.spacing is not None:
            raise ConfigError("a role takes every k-th frame or frames at a spacing, not both: set one of them to null")

    def select(self, frames: FrameTable) -> FrameTable:
        """Return the role's frames, in the order of the table."""
        if self.sequences is not None:
            frames = frames.select(sequence=self.sequences)
        if self.lightings is not None:
            frames = frames.select(lighting=self.lightings)
        if self.rooms is not None:
            frames = frames.select(room=self.rooms)
        if self.every is not None:
            frames = frames.every(self.every)
        if self.spacing is not None:
            frames = frames.spaced(self.spacing)
        return frames


@dataclass(frozen=True)
class Protocol:
    """The roles of a data set.

    Two kinds are never compared with each other: in "cross_run" map and queries come from different sequences, and
    no query was trained on; in "same_run" queries may come from the map's own sequence, map frames among them.

    Attributes:
        kind: "cross_run" or "same_run".
        train: frames whose pairs the network learns from.
        validation: frames by which the checkpoint is chosen; never trained on, never tested on.
        map: frames that the robot knows; the training frames if not filled.
        query: frames to be located.
    """

    kind: str = "cross_run"
    train: Role = field(default_factory=Role)
    validation: Role = field(default_factory=Role)
    map: Role = field(default_factory=Role)
    query: Role = field(default_factory=Role)

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ConfigError(f"unknown protocol kind {self.kind!r}: {hint(self.kind, KINDS)}")

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> Protocol:
        """Build from plain values; keys that are missing keep their defaults.

        Raises:
            ConfigError: an unknown key, with the nearest valid one.
        """
        valid = {item.name for item in fields(cls)}
        role_keys = [item.name for item in fields(Role)]
        values: dict[str, Any] = {}
        for key, value in config.items():
            if key not in valid:
                raise ConfigError(f"unknown protocol key {key!r}: {hint(key, sorted(valid))}")
            if key in ROLES:
                value = dict(value or {})
                for name in value:
                    if name not in role_keys:
                        raise ConfigError(f"unknown key protocol.{key}.{name}: {hint(name, role_keys)}")
                if isinstance(value.get("sequences"), str):
                    value["sequences"] = [value["sequences"]]
                value = Role(**value)
            values[key] = value
        return cls(**values)

    def frames(self, role: str, table: FrameTable) -> FrameTable:
        """Return the frames of a role.

        Raises:
            ConfigError: the role is not filled, names something that no frame carries, or shares a sequence with a
                role that it must stay apart from.
        """
        selection: Role = getattr(self, role)
        if role == "map" and selection.sequences is None:
            selection = Role(self.train.sequences, *(getattr(selection, item.name) for item in fields(Role)[1:]))
        if selection.sequences is None:
            raise ConfigError(
                f"protocol.{role}.sequences is not set; the data holds {table.describe()}. "
                f"Set it, for instance protocol.{role}.sequences=[{table.sequence[0] if len(table) else 'NAME'}], "
                "or ['*'] for all"
            )
        try:
            frames = selection.select(table)
        except ConfigError as error:
            raise ConfigError(f"protocol.{role}: {error}") from error
        self._check_apart(role, frames, table)
        return frames

    def _check_apart(self, role: str, frames: FrameTable, table: FrameTable) -> None:
        apart = {
            "validation": ("train", "query"),
            "query": ("validation",) if self.kind == "same_run" else ("validation", "train", "map"),
        }
        for other in apart.get(role, ()):
            names = getattr(self, other).sequences
            if names is None:
                continue
            shared = sorted(set(frames.sequence.tolist()) & set(table.select(sequence=names).sequence.tolist()))
            if shared:
                hint = "; for queries from the map's own run set protocol.kind=same_run" if role == "query" else ""
                raise ConfigError(
                    f"sequence {shared[0]!r} is in protocol.{role} and in protocol.{other}, so that the result would "
                    f"not be honest: take it out of one of them{hint if other != 'validation' else ''}"
                )
