"""Recipes: the experiments behind a published table or figure, as data (`recipe_book.yaml`), and their jobs.

An experiment is a call of the library with some settings varied; each combination is a job. Values may be given by
scale, as in `{full: [1, 2, 4, 8], short: [2, 8]}`: a scale that is not listed uses the next larger one.
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

from foundation.calls import typed
from siamloc.errors import ConfigError, hint
from siamloc.reproduce.published import Source

SCALES = ("smoke", "short", "full")
"""From seconds on a small building, through minutes to hours, to the published experiments."""

_FILE = Path(__file__).with_name("recipe_book.yaml")


@dataclass(frozen=True)
class Job:
    """One measurement: plain values that determine its records.

    Attributes:
        experiment: the experiment it belongs to.
        kind: a name in `siamloc.reproduce.experiments.KINDS`.
        roles: frames of the map, the queries and so on, as arguments of `siamloc.data.Role`, with `runs` for sequences.
        options: further options of the kind.
        settings: settings that distinguish the records, in siamloc's names.
        dense: whether it needs frames every 5 cm if the data are simulated.
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
        """Return everything that determines the job's records, as plain values."""
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
    """A setting that an experiment varies.

    Attributes:
        sets: the option that it sets, with dots, such as "descriptor.rows".
        to: values, by scale if they differ.
    """

    sets: str
    to: Any


@dataclass(frozen=True)
class Experiment:
    """A measurement with some settings varied.

    Attributes:
        id: name of the experiment.
        kind: what is measured.
        protocol: name of the protocol, which selects the frames.
        over: what is varied, by its name in the documents.
        options: what stays the same.
        settings: settings that all its records have in common.
        dense: as in `Job`.
        beside: whether it is our own, shown next to the published ones: claims do not refer to it.
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
        """Return one job per combination of the varied settings."""
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
        experiments: ids of the required experiments.
        entries: ids of the published numbers shown next to ours.
        claims: ids of the claims the text makes about it.
        join: settings by which published and measured numbers are matched; all common ones if None.
        best: of several records with the same `join`, the one with the largest value of this measure is used.
        where: settings that select the published numbers it measures; all if empty.
        covers: ids of further figures and tables whose numbers are included.
        figure: how it is drawn: `measure`, `x`, `series` and `panels`, or nothing.
        notes: what a reader must know about differences from the published experiment.
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
        """Return a description in words of the frames used as map and queries."""
        says = _contents()["protocols"][experiment(self.experiments[0]).protocol]["says"]
        return MappingProxyType(_resolved(says, scale))


@typed
def recipe(id: str) -> Recipe:
    """Return a recipe by its id, or by that of a figure that it covers.

    Raises:
        ConfigError: an unknown id (the message names similar ones), or one with nothing to measure (with the reason).

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
        raise ConfigError(f"there is no recipe {id!r}; {asked}`siamloc reproduce --list` lists all")
    return known[covering.get(id, id)]


def without_measurement() -> Mapping[str, str]:
    """Return the ids of tables and figures without a measurement to repeat, each with what it shows."""
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
    """Return the approximate time in seconds of a job at a scale, on two processor cores."""
    takes = _contents()["takes"]
    return float(takes["experiment"].get(job.experiment, takes["kind"][job.kind]) * takes["scale"][scale])


def axis(name: str) -> Mapping[str, Any]:
    """Return how a setting is labelled in figures: `says`, `short`, `unit`, `factor`."""
    found: Mapping[str, Any] = _contents()["axes"].get(name, {})
    return found


def data_named(name: str) -> Mapping[str, Any]:
    """Return how to read a data set: `root`, `title`, and its sequences by run name.

    Raises:
        ConfigError: an unknown name.
    """
    known = _contents()["data"]
    if name not in known:
        raise ConfigError(f"recipes run on no data set {name!r}; {hint(name, known)}")
    found: Mapping[str, Any] = known[name]
    return found


def check_scale_and_data(scale: str, data: str) -> None:
    """Check that recipes know a scale and a data set.

    Raises:
        ConfigError: an unknown scale or data set; the message lists the known ones.
    """
    if scale not in SCALES:
        raise ConfigError(f"unknown scale {scale!r}: {hint(str(scale), SCALES)}")
    data_named(data)


def _at(value: Any, scale: str) -> Any:
    """Return the value that applies at a scale."""
    if not isinstance(value, Mapping) or not value or not set(value) <= set(SCALES):
        return value
    return value[next(one for one in SCALES[SCALES.index(scale) :] if one in value)]


def _resolved(values: Any, scale: str) -> Any:
    """Return values with those given by scale resolved, at any depth."""
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
