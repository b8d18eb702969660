"""`Job`: what a command does, as an object of checked settings with `run()`.

    >>> from siamloc.jobs import Report
    >>> Report.of({"run": "runs/robot"})
    Report(folder='runs/robot', runs=None, out=None)

On the command line Hydra composes the settings; in Python a mapping gives them, with the names of options for groups:
`Train.of({"data": {"manifest": "robot.csv"}, "loss": "triplet", "pairs": "in_batch"}).run()`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from foundation.settings import Settings, defaults_of, fields_of
from siamloc.errors import ConfigError, check_known

Kind = TypeVar("Kind", bound="Job")
Say = Callable[[str], None]
"""Receives each line about what a job does."""


_KEY = {"folder": "run"}  # a job has a method `run`
_FIELD = {key: name for name, key in _KEY.items()}


def quiet(line: str) -> None:
    """Receive a line and do nothing."""


@dataclass(frozen=True)
class Given:
    """What a user has set, as opposed to defaults: it wins over the settings of a run.

    Attributes:
        keys: with dots, such as "protocol.map.every".
        groups: those of the keys that choose an option, with dots, such as "data" or "model.branch".
    """

    keys: Sequence[str] = ()
    groups: Sequence[str] = ()


class Job(Settings):
    """Base of the jobs. The docstring of a job is the help of its command, and its fields are the keys.

    Attributes:
        GROUPS: the groups of options, each with the option that is chosen by default.
        MORE: values on top of the options and defaults.
        SHARED: other jobs whose keys are accepted and ignored, as experiments set keys for all of them.
        ALONE: the key whose value a word without "=" is.
        BY_HYDRA: whether Hydra composes the settings; the robot runs without it.
    """

    GROUPS: ClassVar[Mapping[str, str]] = {}
    MORE: ClassVar[Mapping[str, Any]] = {}
    SHARED: ClassVar[bool] = False
    ALONE: ClassVar[str | None] = None
    BY_HYDRA: ClassVar[bool] = True

    def run(self, say: Say = quiet) -> Any:
        """Do the work.

        Args:
            say: receives each line that the command line prints.
        """
        raise NotImplementedError

    @classmethod
    def of(cls: type[Kind], values: Mapping[str, Any], given: Given | None = None) -> Kind:
        """Make a job from plain values; a group is the name of an option, or a mapping of its keys.

        Args:
            values: of the fields; missing ones get their defaults.
            given: the values that win over the settings of a run; all if None.

        Raises:
            ConfigError: an unknown key, a missing key without a default, or a value of the wrong type or out of range.
        """
        check_known(values, cls.key_names(), "")
        whole = with_options(cls, values)
        whole = cls.completed(whole, given or Given([key for key, _ in leaves(values)]))
        if missing := sorted(key for key, value in leaves(whole) if value == "???"):
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
        """Return values together with those that follow from others, such as the settings of a run."""
        return values

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """Return the defaults of the fields that belong to no group of options, as plain values."""
        held = {_KEY.get(name, name): value for name, value in defaults_of(cls).items()}
        for name, kind in fields_of(cls).items():
            if name not in held and isinstance(kind, type) and issubclass(kind, Settings) and is_dataclass(kind):
                held[name] = defaults_of(kind)
        values = merged(held, cls.MORE)
        for group in cls.GROUPS:
            *above, last = group.split("/")
            part = values
            for name in above:
                part = part.get(name, {})
            if group not in cls.MORE:
                part.pop(last, None)
        return values

    @classmethod
    def _key(cls, name: str) -> str:
        return _KEY.get(name, name)


def with_options(kind: type[Job], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values of a job with the values of the options that they name, and of those that are chosen by default.

    A mapping that does not say of which option its keys are, by `kind` or `name`, changes the option chosen by default.

    Raises:
        ConfigError: an unknown option, or another value in place of a group.
    """
    whole = merged({}, values)
    if not kind.GROUPS:
        return whole
    from siamloc.jobs.options import values_of  # the robot has no YAML

    for group, usual in kind.GROUPS.items():
        *above, last = group.split("/")
        part = whole
        for name in above:
            part = part.setdefault(name, {})
            _check_group(part, name)
        chosen = part.get(last, usual)
        if isinstance(chosen, str):
            part[last] = merged(values_of(group, chosen), kind.MORE.get(group, {}))
        _check_group(part[last], group)
        option = values_of(group, usual)
        tag = "kind" if "kind" in option else "name"
        if tag in option and part[last].get(tag, option[tag]) == option[tag]:
            part[last] = merged(option, part[last])
    return whole


def _check_group(values: Any, group: str) -> None:
    if not isinstance(values, Mapping):
        raise ConfigError(f"{group} is a group of keys: set them one by one, such as {group}.KEY=VALUE")


def merged(values: Mapping[str, Any], others: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested values with others on top of them, paths as texts."""
    result = dict(values)
    for key, value in others.items():
        if isinstance(value, Mapping):
            before = result.get(key)
            result[key] = merged(before if isinstance(before, Mapping) else {}, value)
        else:
            result[key] = str(value) if isinstance(value, Path) else value
    return result


def leaves(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the keys of nested values, with dots, and the values."""
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            yield from leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
