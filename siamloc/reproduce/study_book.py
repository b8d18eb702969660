"""Studies: the experiments behind a published table or figure, as data (`study_book.yaml`), their jobs, and a list.

An experiment is a call of the library with some settings varied; each combination is a job. Values may be given by
scale, as in `{full: [1, 2, 4, 8], short: [2, 8]}`: a scale that is not listed uses the next larger one.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from difflib import get_close_matches
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, Literal, get_args

from foundation.calls import typed
from foundation.errors import known
from foundation.settings import Settings, Text
from siamloc.errors import ConfigError
from siamloc.reproduce.published import Source, contents

Scale = Literal["smoke", "short", "full"]
"""From seconds on a small building, through minutes to hours, to the published experiments."""
DataName = Literal["cold", "freiburg_sim", "mini"]
"""Data sets of `study_book.yaml`."""

_SCALES = get_args(Scale)


@dataclass(frozen=True)
class Job:
    """One measurement: plain values that determine its records.

    Attributes:
        experiment: the experiment that the job is a part of.
        kind: kind of the experiment, a name in `siamloc.reproduce.experiments.KINDS`.
        roles: frames of the map, the queries and so on, as arguments of `siamloc.data.Role`, with `runs` for sequences.
        options: further options of the kind.
        settings: settings that distinguish the records, in siamloc's names.
        dense: whether the job needs frames every 5 cm if the data are simulated.
        same_run: whether the queries come from the map's own drive.
        at: name of the place whose frames the job needs, a key of the data set's `at`; the data set itself if empty.
    """

    experiment: str
    kind: str
    roles: Mapping[str, Mapping[str, Any]]
    options: Mapping[str, Any]
    settings: Mapping[str, Any]
    dense: bool = False
    same_run: bool = False
    at: str = ""

    def plain(self) -> dict[str, Any]:
        """Return everything that determines the job's records except its frames, as plain values."""
        return {name: value for name, value in asdict(self).items() if name not in ("experiment", "at")}


@dataclass(frozen=True)
class Experiment(Settings):
    """A measurement with some settings varied.

    Attributes:
        id: name of the experiment, unique in `study_book.yaml`.
        kind: kind of the experiment, a name in `siamloc.reproduce.experiments.KINDS`.
        protocol: a key of `protocols` in `study_book.yaml`, which selects the frames of the map and the queries.
        over: what is varied, by its name in the documents: the option that it `sets`, with dots, such as
            "descriptor.rows", and the values that the option is set `to`, by scale if they differ. Numbers that differ
            in their `seed` alone become their mean, with a spread.
        options: options that stay the same.
        settings: settings that all its records have in common.
        elsewhere: options that differ in other places, by the name of the place, which is the `data` of the records.
        dense: whether the jobs need frames every 5 cm if the data are simulated.
        beside: whether the experiment is our own addition, shown next to the published ones; no claim refers to it.
    """

    id: Text
    kind: Text
    protocol: Text
    over: dict[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    elsewhere: dict[str, Any] = field(default_factory=dict)
    dense: bool = False
    beside: bool = False

    def jobs(self, scale: str) -> list[Job]:
        """Return one job per combination of the varied settings; `scale` is "smoke", "short" or "full"."""
        protocol = contents("study_book")["protocols"][self.protocol]
        axes = {name: _resolved(varied["to"], scale) for name, varied in self.over.items()}
        numeric = {name: values for name, values in axes.items() if all(type(one) in (int, float) for one in values)}
        ends = {name: min if axis(name).get("largest") == "min" else max for name in numeric}
        largest = {name: ends[name](values) for name, values in numeric.items()}
        made = []
        places = {"": {}, **self.elsewhere}
        for (at, own), combination in product(places.items(), product(*axes.values())):
            chosen = dict(zip(axes, combination, strict=True))
            options: dict[str, Any] = _resolved({**self.options, **own}, scale)
            for name, value in chosen.items():
                *path, last = self.over[name]["sets"].split(".")
                place = options
                for part in path:
                    place = place.setdefault(part, {})
                place[last] = value
            settings = {**self.settings, **({"data": at} if at else {}), **chosen}
            if largest and largest.items() <= chosen.items():
                settings["size"] = "largest"
            roles, same_run = _resolved(protocol["roles"], scale), bool(protocol.get("same_run"))
            where = self.dense, same_run, at or protocol.get("at", "")
            made.append(Job(self.id, self.kind, roles, options, settings, *where))
        return made

    def protocol_in_words(self, scale: str) -> Mapping[str, str]:
        """Describe the frames of each role at a scale."""
        protocol = _resolved(contents("study_book")["protocols"][self.protocol], scale)
        words: dict[str, str] = dict(protocol["says"])
        for role, says in words.items():
            chosen = protocol["roles"].get(role, {})
            share = max(chosen.get("every", 1), chosen.get("one_in", 1))
            if share > 1 and says != "none" and "one frame" not in says:
                words[role] = f"{says}, one frame in {share}"
        return words


@dataclass(frozen=True)
class Study(Settings):
    """How a published table or figure is measured again.

    Attributes:
        id: id of the table or figure, such as "table_5_7" or "figure_3_11".
        title: what the table or figure shows.
        source: where the table or figure was published.
        experiments: ids of the required experiments.
        entries: ids of the published numbers shown next to ours.
        claims: ids of the document's claims about the table or figure.
        join: settings by which published and measured numbers are matched; all common ones if None.
        best: of several records with the same `join`, the one with the largest value of this measure is used.
        also: measures that the table shows although none of their values was printed.
        where: settings that select the published numbers that are measured again; all if empty.
        covers: ids of further figures and tables whose numbers are included.
        figure: `measure`, `x`, `series` and `panels` of each panel of the figure; empty for none.
        notes: what a reader must know about differences from the published experiment.
    """

    id: Text
    title: Text
    source: Source
    experiments: tuple[Text, ...]
    entries: tuple[Text, ...] = ()
    claims: tuple[Text, ...] = ()
    join: tuple[Text, ...] | None = None
    best: Text | None = None
    also: tuple[Text, ...] = ()
    where: dict[str, Any] = field(default_factory=dict)
    covers: tuple[Text, ...] = ()
    figure: tuple[dict[str, Any], ...] = ()
    notes: tuple[Text, ...] = ()

    def jobs(self, scale: str, data: str) -> list[Job]:
        """Return the jobs of all experiments for whose place a data set has frames, each once.

        Args:
            scale: "smoke", "short" or "full".
            data: "cold", "freiburg_sim" or "mini".
        """
        places = {"", *data_named(data)["at"]}
        return [job for name in self.experiments for job in experiment(name).jobs(scale) if job.at in places]


@typed
def study(id: str) -> Study:
    """Return a study by its id, or by the id of a figure that the study covers.

    Raises:
        ConfigError: an unknown id (the message names similar ones), or one with nothing to measure (with the reason).

    Example:
        >>> study("figure_3_11").title
        'Hit rate of HOG, by its parameters and the distance'
        >>> study("figure_3_19").id
        'figure_3_17'
    """
    every, nothing = {one.id: one for one in studies()}, without_measurement()
    covering = {covered: one.id for one in every.values() for covered in one.covers}
    if id in nothing:
        raise ConfigError(f"there is nothing to measure for {id}: it {nothing[id]}")
    if id not in every and id not in covering:
        near = [repr(one) for one in get_close_matches(str(id), [*every, *covering, *nothing], n=3, cutoff=0.5)]
        asked = f"did you mean {' or '.join(near)}? " if near else ""
        raise ConfigError(f"there is no study {id!r}; {asked}`siamloc reproduce --list` lists all")
    return every[covering.get(id, id)]


def without_measurement() -> Mapping[str, str]:
    """Return the ids of tables and figures that contain no measurement, each with what it shows."""
    return dict(contents("study_book")["nothing"])


@cache
def studies() -> tuple[Study, ...]:
    """Return all studies, in the order of the documents."""
    return tuple(map(Study.of, contents("study_book")["studies"]))


@cache
def experiment(id: str) -> Experiment:
    """Return an experiment by its id.

    Raises:
        ConfigError: an unknown id.
    """
    every = {one["id"]: one for one in contents("study_book")["experiments"]}
    return Experiment.of(every[known(id, every, "experiment")])


def seconds_of(job: Job, scale: str) -> float:
    """Return the approximate time in seconds of a job at a scale, on two processor cores."""
    takes = contents("study_book")["takes"]
    return float(takes["experiment"].get(job.experiment, takes["kind"][job.kind]) * takes["scale"][scale])


def axis(name: str) -> Mapping[str, Any]:
    """Return the labels of a setting in figures: `says`, `short`, `unit`, `factor`, and the axis's `largest` value.

    Args:
        name: name of the setting in siamloc, as in `Record.settings`; a setting without labels gives an empty mapping.
    """
    found: Mapping[str, Any] = contents("study_book")["axes"].get(name, {})
    return found


def data_named(name: str) -> Mapping[str, Any]:
    """Return what `study_book.yaml` says of a data set: `root`, `title`, its sequences by run name, and so on.

    Args:
        name: "cold", "freiburg_sim" or "mini".
    """
    found: Mapping[str, Any] = contents("study_book")["data"][name]
    return found


def folder_of(name: str, folder: Path) -> Path:
    """Return the folder of a building under the name that it has on disk, such as "cold-freiburg" for "freiburg".

    Args:
        name: "cold", "freiburg_sim" or "mini".
        folder: the folder under its usual name, which is returned if there is none under any.
    """
    names = data_named(name).get("names", ["{}"])
    found = (folder.parent / one.format(folder.name) for one in names)
    return next((one for one in found if one.is_dir()), folder)


@typed
def listing(data: DataName = "freiburg_sim", scale: Scale = "short") -> str:
    """Return a list of what can be reproduced: for each id, what it is, what it needs, and roughly how long it takes.

    Args:
        data: "cold", "freiburg_sim" or "mini".
        scale: "smoke", "short" or "full".

    Raises:
        ConfigError: an unknown data set or scale.
    """
    about = data_named(data)
    lines = [f"{one.id:<14} {one.title}\n{'':<14} {_needs(one, data, scale)}" for one in studies()]
    covered = [f"{id:<14} is measured by {one.id}" for one in studies() for id in one.covers]
    nothing = [f"{id:<14} {reason}" for id, reason in without_measurement().items()]
    return "\n".join(
        [
            f"What can be reproduced, what it needs, and about how long it takes alone at scale={scale} on two cores:",
            *("", *lines, ""),
            *("Panels of these, or the same numbers drawn differently:", "", *covered, ""),
            *("Nothing to measure:", "", *nothing, ""),
            *textwrap.wrap(f"data={data} is {about['title']}: {about['how']}", 118, break_on_hyphens=False),
        ]
    )


def _needs(one: Study, data: str, scale: str) -> str:
    jobs, about = one.jobs(scale, data), data_named(data)
    runs = sorted({run for job in jobs for role in job.roles.values() for run in role["runs"]})
    own = Path(about["root"] or "").name
    places = {about["at"][job.at].format(own) for job in jobs if about["at"].get(job.at, "{}") != "{}"}
    trained = sum(job.kind in ("trained", "named_rooms") for job in jobs)
    seconds = sum(seconds_of(job, scale) for job in jobs)
    lasting = "seconds" if seconds < 30 else "a minute" if seconds < 90 else f"{seconds / 60:.0f} minutes"
    lasting = lasting if seconds < 5400 else f"{seconds / 3600:.0f} hours"
    parts = {
        f"[{one.source.document}] {one.source.place or 'section ' + one.source.section}": True,
        f"drives {' '.join(runs)}": True,
        "frames every 5 cm": bool(about.get("dense")) and any(job.dense for job in jobs),
        f"folder {' '.join(sorted(places))}": bool(places),
        f"the same drive of {about['other']['folder']}": any(job.kind == "buildings" for job in jobs),
        f"{trained} training{'s' if trained > 1 else ''}": trained,
        "hours each on a graphics card" if trained and scale == "full" else lasting: True,
    }
    return "; ".join(part for part, needed in parts.items() if needed)


def _resolved(value: Any, scale: str) -> Any:
    """Return a value at one scale; parts of it, at any depth, may be given by scale."""
    if isinstance(value, Mapping) and value and set(value) <= set(_SCALES):
        value = value[next(one for one in _SCALES[_SCALES.index(scale) :] if one in value)]
    if isinstance(value, Mapping):
        return {key: _resolved(inner, scale) for key, inner in value.items()}
    return list(value) if isinstance(value, list | tuple) else value
