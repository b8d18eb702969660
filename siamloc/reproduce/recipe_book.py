"""Recipes: which experiments a published table or figure takes, as data (`recipe_book.yaml`), and their jobs.

An experiment is a call of the library with some settings varied; each combination is a job. Values may be given by
scale, as in `{full: [1, 2, 4, 8], short: [2, 8]}`: a scale that is not named has what the next larger one has.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from functools import cache
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

from siamloc.calls import typed
from siamloc.errors import ConfigError, hint
from siamloc.reproduce.published import Source

SCALES = ("smoke", "short", "full")
"""From seconds on a small building, over minutes to hours, to what was published."""

_FILE = Path(__file__).with_name("recipe_book.yaml")


@dataclass(frozen=True)
class Job:
    """One measurement: plain values, from which its records follow.

    Attributes:
        experiment: which it belongs to.
        kind: a name in `siamloc.reproduce.experiments.KINDS`.
        roles: frames of the map, the queries and so on, as `siamloc.data.Role` takes them, with `runs` for sequences.
        options: what the kind takes besides.
        settings: what the records are told apart by, in siamloc's names.
        dense: whether it needs frames every 5 cm where the data are simulated.
        same_run: whether the queries come from the map's own drive.
    """

    experiment: str
    kind: str
    roles: Mapping[str, Mapping[str, Any]]
    options: Mapping[str, Any]
    settings: Mapping[str, Any]
    dense: bool = False
    same_run: bool = False

    def plain(self) -> dict[str, Any]:
        """Return what the job's records follow from, as plain values."""
        return {
            "kind": self.kind,
            "roles": {name: dict(role) for name, role in self.roles.items()},
            "options": dict(self.options),
            "settings": dict(self.settings),
            "dense": self.dense,
            "same_run": self.same_run,
        }


@dataclass(frozen=True)
class Axis:
    """Something that an experiment varies.

    Attributes:
        sets: the option that it sets, with dots, such as "descriptor.rows".
        to: values, by scale where they differ.
    """

    sets: str
    to: Any


@dataclass(frozen=True)
class Experiment:
    """A measurement with some settings varied.

    Attributes:
        id: its name.
        kind: what is measured.
        protocol: name of the frames that it takes.
        over: what is varied, by the name that the documents give it.
        options: what stays the same.
        settings: what all its records carry.
        dense: as of `Job`.
        beside: whether it is ours, to stand beside the published ones: claims do not speak of it.
    """

    id: str
    kind: str
    protocol: str
    over: Mapping[str, Axis] = field(default_factory=dict)
    options: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    dense: bool = False
    beside: bool = False

    def jobs(self, scale: str) -> list[Job]:
        """Return one job for each combination of what is varied."""
        protocol = _contents()["protocols"][self.protocol]
        roles, same_run = protocol["roles"], bool(protocol.get("same_run"))
        axes = {name: _at(axis.to, scale) for name, axis in self.over.items()}
        largest = {
            name: max(values) for name, values in axes.items() if all(isinstance(v, int | float) for v in values)
        }
        made = []
        for combination in product(*axes.values()):
            chosen = dict(zip(axes, combination, strict=True))
            options: dict[str, Any] = _resolved(self.options, scale)
            for name, value in chosen.items():
                _put(options, self.over[name].sets, value)
            settings = {**self.settings, **chosen}
            if largest and all(chosen[name] == value for name, value in largest.items()):
                settings["size"] = "largest"
            made.append(Job(self.id, self.kind, _resolved(roles, scale), options, settings, self.dense, same_run))
        return made


@dataclass(frozen=True)
class Recipe:
    """How a published table or figure is measured again.

    Attributes:
        id: such as "table_5_7" or "figure_3_11".
        title: what it shows.
        source: where it was published.
        experiments: ids of the experiments that it takes.
        entries: ids of the published numbers that stand beside ours.
        claims: ids of what the text says of it.
        join: settings by which published and measured numbers belong together; all that both have if None.
        best: of several records with the same `join`, that with the largest value of this measure is taken.
        where: which of the published numbers it measures, by their settings; all if empty.
        covers: ids of further figures and tables whose numbers are among these.
        figure: how it is drawn: `measure`, `x`, `series` and `panels`, or nothing.
        notes: what a reader has to know of the difference to the published experiment.
    """

    id: str
    title: str
    source: Source
    experiments: tuple[str, ...]
    entries: tuple[str, ...] = ()
    claims: tuple[str, ...] = ()
    join: tuple[str, ...] | None = None
    best: str | None = None
    where: Mapping[str, Any] = field(default_factory=dict)
    covers: tuple[str, ...] = ()
    figure: tuple[Mapping[str, Any], ...] = ()
    notes: tuple[str, ...] = ()

    def jobs(self, scale: str) -> list[Job]:
        """Return the jobs of all experiments, each once."""
        return [job for name in self.experiments for job in experiment(name).jobs(scale)]

    def protocol(self, scale: str = "full") -> Mapping[str, str]:
        """Return which frames are map and queries, in words."""
        says = _contents()["protocols"][experiment(self.experiments[0]).protocol]["says"]
        return MappingProxyType(_resolved(says, scale))


@typed
def recipe(id: str) -> Recipe:
    """Return a recipe by its id, or by that of a figure that it covers.

    Raises:
        ConfigError: an unknown id, with the nearest ones; one that shows nothing to measure, with the reason.

    Example:
        >>> recipe("figure_3_11").title
        'Hit rate of HOG, by its parameters and the distance'
        >>> recipe("figure_3_19").id
        'figure_3_17'
    """
    known, nothing = _recipes(), without_measurement()
    covering = {covered: one.id for one in known.values() for covered in one.covers}
    if id in nothing:
        raise ConfigError(f"there is nothing to measure for {id}: it {nothing[id]}")
    if id not in known and id not in covering:
        near = [repr(one) for one in get_close_matches(str(id), [*known, *covering, *nothing], n=3, cutoff=0.5)]
        asked = f"did you mean {' or '.join(near)}? " if near else ""
        raise ConfigError(f"there is no recipe {id!r}; {asked}`siamloc reproduce --list` names all")
    return known[covering.get(id, id)]


def without_measurement() -> Mapping[str, str]:
    """Return the ids of tables and figures that show no measurement to repeat, each with what it shows."""
    return MappingProxyType(_contents()["nothing"])


def recipes() -> tuple[Recipe, ...]:
    """Return all recipes, in the order of the documents."""
    return tuple(_recipes().values())


def experiment(id: str) -> Experiment:
    """Return an experiment by its id.

    Raises:
        ConfigError: an unknown id.
    """
    known = _experiments()
    if id not in known:
        raise ConfigError(f"there is no experiment {id!r}; {hint(id, known)}")
    return known[id]


def seconds_of(job: Job, scale: str) -> float:
    """Return about how long a job takes at a scale, on two processor cores."""
    takes = _contents()["takes"]
    return float(takes["experiment"].get(job.experiment, takes["kind"][job.kind]) * takes["scale"][scale])


def axis(name: str) -> Mapping[str, Any]:
    """Return what a setting is called where a figure is drawn over it: `says`, `short`, `unit`, `factor`."""
    found: Mapping[str, Any] = _contents()["axes"].get(name, {})
    return found


def data_named(name: str) -> Mapping[str, Any]:
    """Return how a data set is read: `root`, `title`, and its sequences by the names of runs.

    Raises:
        ConfigError: an unknown name.
    """
    known = _contents()["data"]
    if name not in known:
        raise ConfigError(f"recipes run on no data set {name!r}; {hint(name, known)}")
    found: Mapping[str, Any] = known[name]
    return found


def data_names() -> tuple[str, ...]:
    """Return the names of the data sets that recipes run on."""
    return tuple(_contents()["data"])


def check_scale_and_data(scale: str, data: str) -> None:
    """Refuse a scale or a data set that recipes do not know.

    Raises:
        ConfigError: an unknown one, with those that there are.
    """
    if scale not in SCALES:
        raise ConfigError(f"unknown scale {scale!r}: {hint(str(scale), SCALES)}")
    data_named(data)


def _at(value: Any, scale: str) -> Any:
    """Return what a value is at a scale."""
    if not isinstance(value, Mapping) or not value or not set(value) <= set(SCALES):
        return value
    return value[next(one for one in SCALES[SCALES.index(scale) :] if one in value)]


def _resolved(values: Any, scale: str) -> Any:
    """Return values with those by scale resolved, whatever they lie in."""
    values = _at(values, scale)
    if isinstance(values, Mapping):
        return {key: _resolved(value, scale) for key, value in values.items()}
    return list(values) if isinstance(values, list | tuple) else values


def _put(options: dict[str, Any], key: str, value: Any) -> None:
    *path, last = key.split(".")
    for part in path:
        options = options.setdefault(part, {})
    options[last] = value


@cache
def _contents() -> dict[str, Any]:
    contents: dict[str, Any] = yaml.safe_load(_FILE.read_text(encoding="utf-8"))
    return contents


@cache
def _experiments() -> dict[str, Experiment]:
    found = {}
    for one in _contents()["experiments"]:
        over = {name: Axis(**axis) for name, axis in one.get("over", {}).items()}
        found[one["id"]] = Experiment(**{**one, "over": over})
    return found


@cache
def _recipes() -> dict[str, Recipe]:
    return {entry["id"]: _of_entry(entry) for entry in _contents()["recipes"]}


def _of_entry(entry: Mapping[str, Any]) -> Recipe:
    lists = ("experiments", "entries", "claims", "covers", "notes", "figure", "join")
    values = {**entry, **{key: tuple(entry[key]) for key in lists if key in entry}}
    return Recipe(**{**values, "source": Source(**entry["source"])})
