"""The tasks of `siamloc evaluate`: the settings of a call of `siamloc.evaluation`, and further keys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, TypeVar

from foundation.errors import known
from foundation.settings import Rule, Settings, Text, checked, fields_of
from siamloc.errors import ConfigError
from siamloc.evaluation.compact_maps import Compact
from siamloc.evaluation.disturbed import Robustness
from siamloc.evaluation.hierarchy import Hierarchical
from siamloc.evaluation.layers import MapMeasures
from siamloc.evaluation.localize import Localization
from siamloc.maps.hierarchy import CoarseRanking

Kind = TypeVar("Kind", bound=Settings)
Maps = Annotated[
    tuple[Text, ...],
    Rule("a list of two or more run folders or map files, such as [runs/a,runs/b]", lambda value: len(value) > 1),
]
_COMPARED = ("thumbnail", "untrained")


@dataclass(frozen=True, kw_only=True)
class Task(Settings):
    """Base of the tasks of `siamloc evaluate`.

    Attributes:
        names: names of the tasks that are measured.
        plots: whether to draw plots as well.
    """

    WHERE = "task"
    names: tuple[Any, ...]
    plots: bool = True

    @classmethod
    def of(cls: type[Kind], values: Mapping[str, Any]) -> Kind:
        """Read the settings of a task, whose class follows from its `names`.

        Raises:
            ConfigError: an unknown task or key, a value of the wrong type or out of range, or tasks that cannot be
                measured together.
        """
        return super().of(values) if cls is not Task else kind_of(values).of(values)  # type: ignore[misc, return-value]


@dataclass(frozen=True)
class LocalizationTask(Localization, Task):
    """Measure the poses and rooms of the queries.

    Attributes:
        baselines: descriptors by name, to measure on the same frames.
    """

    baselines: tuple[str, ...] = _COMPARED


@dataclass(frozen=True)
class AbsoluteTask(LocalizationTask):
    """Measure only the poses of the queries."""

    names: tuple[str, ...] = ("absolute",)  # type: ignore[assignment]


@dataclass(frozen=True)
class RoomTask(LocalizationTask):
    """Measure only the rooms of the queries."""

    names: tuple[str, ...] = ("room_retrieval",)  # type: ignore[assignment]


@dataclass(frozen=True)
class CoarseTask(CoarseRanking):
    """How task=hierarchical makes and ranks the nodes.

    Attributes:
        descriptor: builds and ranks the nodes: a descriptor's name or a run folder; the fine descriptor if None.
    """

    descriptor: str | None = None


@dataclass(frozen=True)
class HierarchicalTask(Hierarchical, Task):
    """Locate queries in two layers: the nodes of build=... first, then the map frames inside the nearest nodes."""

    names: tuple[str, ...] = ("hierarchical",)
    coarse: CoarseTask = field(default_factory=CoarseTask)


@dataclass(frozen=True)
class MappingTask(MapMeasures, Task):
    """Measure the quality of a coarse layer: silhouettes, rooms, loop closures, time and bytes."""

    names: tuple[str, ...] = ("mapping",)


@dataclass(frozen=True)
class CompactTask(Compact, Task):
    """Measure localization in maps of fewer and fewer nodes, next to plain sampling ([C] 5.2-5.4).

    Attributes:
        clusters: name of the descriptor for grouping frames; None for the descriptor that locates.
    """

    names: tuple[str, ...] = ("compact",)
    clusters: str | None = None


@dataclass(frozen=True)
class RobustnessTask(Task):
    """Measure how errors grow when the query images are disturbed; the map stays clean ([T] 3.4.2).

    Attributes:
        robustness: how the images are disturbed.
        baselines: descriptors by name, to measure on the same frames.
    """

    names: tuple[str, ...] = ("robustness",)
    robustness: Robustness = field(default_factory=Robustness)
    baselines: tuple[str, ...] = _COMPARED


@dataclass(frozen=True)
class BuildingsTask(Task):
    """Choose which of several buildings a query is in ([C] 5.3.3, which uses distance=cosine).

    Attributes:
        maps: run folders with a map of one building each, or map files; if None, protocol.map split by building.
    """

    names: tuple[str, ...] = ("buildings",)
    maps: Maps | None = None


TASKS: dict[str, type[Task]] = {
    "localization": LocalizationTask,
    "absolute": AbsoluteTask,
    "room_retrieval": RoomTask,
    "hierarchical": HierarchicalTask,
    "mapping": MappingTask,
    "compact": CompactTask,
    "robustness": RobustnessTask,
    "buildings": BuildingsTask,
}
"""The tasks by the names of task=NAME."""


def kind_of(values: Mapping[str, Any]) -> type[Task]:
    """Return the class of the task with the given `names`.

    Raises:
        ConfigError: an unknown task, or tasks that cannot be measured together.
    """
    names = checked(values.get("names", LocalizationTask.names), tuple[str, ...], "task.names")
    singles = [name for name in TASKS if name != "localization"]
    for name in names:
        known(name, singles, "task")
    if len(names) != 1 and set(names) != {"absolute", "room_retrieval"}:
        raise ConfigError(f"task.names must be one of {', '.join(singles)}, or [absolute, room_retrieval], got {names}")
    kind = LocalizationTask if len(names) > 1 else TASKS[names[0]]
    if "lost_above" in values and "lost_above" not in fields_of(kind):
        raise ConfigError(f"{names[0]} has its own settings: choose it with task={names[0]}")
    return kind
