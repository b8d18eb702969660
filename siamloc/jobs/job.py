"""`Job`: what a command does, as an object of checked settings with `run()`.

    >>> from siamloc.jobs import Report
    >>> Report.of({"run": "runs/robot"})
    Report(folder='runs/robot', runs=None, out=None, plan=None)

On the command line Hydra composes the settings; in Python a mapping gives them, with the names of options for groups:
`Train.of({"data": {"manifest": "robot.csv"}, "loss": "triplet", "pairs": "in_batch"}).run()`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from importlib import import_module
from typing import Any, ClassVar, TypeVar

from foundation.settings import Settings, Text, checked, defaults_of, fields_of, leaves, merged
from siamloc.errors import ConfigError, check_known, in_one_line

Kind = TypeVar("Kind", bound="Job")
Say = Callable[[str], None]
"""Receives each line about what a job does."""


_KEY = {"folder": "run"}  # a job has a method `run`
_FIELD = {key: name for name, key in _KEY.items()}


def quiet(line: str) -> None:
    """Ignore a line of output; the default `say` of `run`."""


@dataclass(frozen=True)
class Given:
    """Which settings the user gave, as opposed to defaults: they win over the settings of a run.

    Attributes:
        keys: keys with dots, such as "protocol.map.every".
        groups: the keys that choose an option, with dots, such as "data" or "model.branch".
    """

    keys: Sequence[str] = ()
    groups: Sequence[str] = ()


def at(values: Any, key: str, missing: Any = None) -> Any:
    """Return the value at a key such as "model.branch" or "model/branch" in nested mappings, if there is one.

    >>> at({"model": {"branch": "vgg16"}}, "model.branch")
    'vgg16'
    """
    for part in key.replace("/", ".").split("."):
        values = values.get(part, missing) if isinstance(values, Mapping) else missing
    return values


class Job(Settings):
    """Base of the jobs. The docstring of a job is the help of its command, and its fields are the keys.

    Attributes:
        GROUPS: the groups of options, each with the option that is chosen by default.
        MORE: values that replace the values of options and defaults.
        SHARED: whether the job takes experiments, which may also set keys of other jobs; those are ignored.
        ALONE: the key that a word without "=" sets, such as `file` in `siamloc walk drive.mp4`.
        BY_HYDRA: whether Hydra composes the settings; the robot runs without it.
    """

    GROUPS: ClassVar[Mapping[str, str]] = {}
    MORE: ClassVar[Mapping[str, Any]] = {}
    SHARED: ClassVar[bool] = False
    ALONE: ClassVar[str | None] = None
    BY_HYDRA: ClassVar[bool] = True

    def run(self, say: Say = quiet) -> Any:
        """Do the work of the job.

        Args:
            say: receives each line that the command line prints.
        """
        raise NotImplementedError

    @classmethod
    def of(cls: type[Kind], values: Mapping[str, Any], given: Given | None = None) -> Kind:
        """Make a job from plain values; a group is the name of an option, or a mapping of its keys.

        Args:
            values: values of the fields; missing fields get their defaults.
            given: the keys whose values win over the settings of a run; all if None.

        Raises:
            ConfigError: an unknown key, a missing key without a default, or a value of the wrong type or out of range.
        """
        for name, key in _KEY.items():
            if name in values and key in cls.key_names():
                raise ConfigError(f"unknown configuration key {name!r}: did you mean {key!r}?")
        check_known(values, [*cls.key_names(), *(["experiment"] if cls.SHARED else [])], "")
        whole = cls.completed(with_options(cls, values), given or given_by(cls, values))
        if missing := sorted(key for key, value in leaves(whole) if isinstance(value, str) and value == "???"):
            raise ConfigError(f"{missing[0]} is not set: give it as {missing[0]}=VALUE")
        return super().of({_FIELD.get(key, key): value for key, value in whole.items()})

    @classmethod
    def key_names(cls) -> list[str]:
        """Return the keys of the job: its fields, with `run` for the field `folder`."""
        return [_KEY.get(name, name) for name in fields_of(cls)]

    def plain(self) -> dict[str, Any]:
        """Return the settings as plain values, which `of` can read."""
        return {_KEY.get(name, name): value for name, value in super().plain().items()}

    @classmethod
    def completed(cls, values: dict[str, Any], given: Given) -> dict[str, Any]:
        """Return the values together with the values that follow from them, such as the settings of a run.

        The module of a camera class or a network of the user's own is imported if it was given, and not only stored.
        """
        for key in ("unwrap.kind", "model.branch", "descriptor.branch"):
            named = "model.branch.name" if key == "model.branch" else key
            own = at(values, named)
            if {key, named} & {*given.keys, *given.groups} and isinstance(own, str) and ":" in own:
                import_own(key, own)
        return values

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """Return the defaults of the fields that belong to no group of options, as plain values."""
        values = {_KEY.get(name, name): value for name, value in defaults_of(cls).items()}
        for name, kind in fields_of(cls).items():
            if name not in values and isinstance(kind, type) and issubclass(kind, Settings) and is_dataclass(kind):
                values[name] = defaults_of(kind)
        values = merged(values, cls.MORE)
        return {key: value for key, value in values.items() if key not in cls.GROUPS or key in cls.MORE}

    @classmethod
    def _key(cls, name: str) -> str:  # the name of a field in the sentences of `Settings`
        return _KEY.get(name, name)


def import_own(key: str, name: str) -> None:
    """Import the module of something of the user's own, which a key names, such as my_module:factory.

    Raises:
        ConfigError: the module cannot be imported.
    """
    try:
        import_module(name.partition(":")[0])
    except Exception as error:  # a module may raise anything
        raise ConfigError(
            f"{key}={name} cannot be imported ({in_one_line(error)}): check the module, and PYTHONPATH"
        ) from error


def given_by(kind: type[Job], values: Mapping[str, Any]) -> Given:
    """Return which keys and groups of a job a mapping of values sets."""
    groups = [group for group in (*kind.GROUPS, "experiment") if isinstance(at(values, group), str)]
    return Given([key for key, _ in leaves(values)], [group.replace("/", ".") for group in groups])


def with_options(kind: type[Job], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values of a job on top of its defaults and of the options that they name or that are chosen by default.

    A mapping of keys in place of an option's name changes the option that its `kind` or `name` says, or else the one
    that is chosen by default. Options and experiments choose options of other groups, as in their files.

    Raises:
        ConfigError: an unknown option, or another value in place of a group.
    """
    if not kind.GROUPS:
        return merged(kind.defaults(), values)
    from siamloc.jobs.options import Option, choices, option  # the robot has no YAML

    own = dict(values)
    name = checked(own.pop("experiment", None), Text | None, "experiment")
    experiment = Option({}, "") if name is None else option("experiment", name)
    picked = {group: one for group, one in experiment.chooses.items() if group in kind.GROUPS}
    chosen = _with_choices(kind.GROUPS, picked)
    for group in kind.GROUPS:
        above, given = group.partition("/")[0], at(own, group)
        if above != group:
            _check_group(own.get(above, {}), above)
        if isinstance(given, str):
            picked[group] = given
            own = merged(own, _nested(group, {}))
        elif given is not None:
            _check_group(given, group)
            tag = next((given[key] for key in ("kind", "name") if key in given), None)
            if isinstance(tag, str) and tag in choices(group) and not _fits(group, given, chosen[group]):
                picked[group] = tag
    chosen = _with_choices(kind.GROUPS, picked)
    whole: dict[str, Any] = {}
    for group in kind.GROUPS:
        if _fits(group, at(own, group) or {}, chosen[group]):
            whole = merged(whole, _nested(group, option(group, chosen[group]).values))
    whole = merged(whole, kind.defaults())
    whole = merged(whole, {key: value for key, value in experiment.values.items() if key in kind.key_names()})
    return merged(whole, own)


def _with_choices(usual: Mapping[str, str], picked: Mapping[str, str]) -> dict[str, str]:
    """Return the option of each group: the picked one, else the one that an option chooses, else the usual one."""
    from siamloc.jobs.options import option

    followed: dict[str, str] = {}
    for group, name in {**usual, **picked}.items():
        followed |= option(group, name).chooses
    return {**usual, **followed, **picked}


def _fits(group: str, given: Mapping[str, Any], name: str) -> bool:
    """Return whether the given keys belong to an option, by its `kind`, `name` or `names`, or else by all its keys."""
    from siamloc.jobs.options import choices, option

    values = option(group, name).values
    tag = next((key for key in ("kind", "name") if values.get(key) in choices(group)), None)
    tag = "names" if "names" in values else tag
    return set(given) <= set(values) if tag is None else given.get(tag, values[tag]) == values[tag]


def _nested(group: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a group such as "model/branch" inside the mappings of a job."""
    for name in reversed(group.split("/")):
        values = {name: values}
    return dict(values)


def _check_group(values: Any, group: str) -> None:
    if not isinstance(values, Mapping):
        raise ConfigError(f"{group} is a group of keys: set them one by one, such as {group}.KEY=VALUE")
