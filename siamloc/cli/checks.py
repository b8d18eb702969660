"""What a composed configuration must hold before a command works with it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from omegaconf import DictConfig, OmegaConf

from siamloc.errors import ConfigError

_Test = tuple[Callable[[Any], bool], str]


def check(config: DictConfig) -> None:
    """Look at the keys that have one type only, and for keys that are not set.

    Raises:
        ConfigError: naming the key, what it should be, and what it is.
    """
    missing = sorted(OmegaConf.missing_keys(config))
    if missing:
        raise ConfigError(f"{missing[0]} is not set: give it as {missing[0]}=VALUE")
    for key, (holds, expected) in _EXPECTED.items():
        if not _present(config, key):
            continue
        value = OmegaConf.select(config, key)
        if isinstance(value, DictConfig) or OmegaConf.is_list(value):
            value = OmegaConf.to_container(value, resolve=True)
        if not holds(value):
            raise ConfigError(f"{key} must be {expected}, got {value!r}")


def _present(config: DictConfig, key: str) -> bool:
    node: Any = config
    for part in key.split("."):
        if not isinstance(node, DictConfig) or part not in node:
            return False
        node = node[part]
    return True


def _whole(least: int) -> _Test:
    return (
        lambda value: isinstance(value, int) and not isinstance(value, bool) and value >= least,
        f"a whole number from {least}",
    )


def _number(low: float, strictly: bool = True) -> _Test:
    def holds(value: Any) -> bool:
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            return False
        return value > low if strictly else value >= low

    return holds, f"a number {'above' if strictly else 'from'} {low:g}"


def _list_of(test: _Test) -> _Test:
    holds, expected = test
    return (
        lambda value: isinstance(value, list) and bool(value) and all(map(holds, value)),
        f"a list, each item {expected}, such as [{'1' if 'number' in expected else 'a'}]",
    )


def _group(name: str) -> _Test:
    return lambda value: isinstance(value, dict), f"chosen as a group: {name}=NAME, with a slash"


def _one_of(*values: Any) -> _Test:
    return lambda value: value in values, " or ".join(map(str, values))


def _or_none(test: _Test) -> _Test:
    holds, expected = test
    return lambda value: value is None or holds(value), f"{expected}, or null"


_TEXT: _Test = (lambda value: isinstance(value, str), "a text")
_FLAG: _Test = (lambda value: isinstance(value, bool), "true or false")

_EXPECTED: dict[str, _Test] = {
    "model.branch": _group("model/branch"),
    "model.head": _group("model/head"),
    "seed": _whole(0),
    "epochs": _whole(1),
    "batch_size": _whole(1),
    "resume": _FLAG,
    "overwrite": _FLAG,
    "loss.margin": _number(0),
    "loader.workers": _whole(0),
    "optimizer.learning_rate": _number(0),
    "optimizer.momentum": _number(0, strictly=False),
    "optimizer.weight_decay": _number(0, strictly=False),
    "data.circular": _FLAG,
    "data.on_error": _one_of("skip", "raise"),
    "task.names": _list_of(_TEXT),
    "task.radii": _list_of(_number(0, strictly=False)),
    "task.ks": _list_of(_whole(1)),
    "task.pairs.count": _whole(1),
    "task.plots": _FLAG,
    "task.filter": _FLAG,
    "task.filter_settings.temperature": _or_none(_number(0)),
    "task.filter_settings.kidnapping": (lambda value: _number(0)[0](value) and value < 1, "a number between 0 and 1"),
    "task.filter_tune": _FLAG,
    "task.interpolate": _or_none(_whole(1)),
    "task.error_model": _FLAG,
    "task.lost_above": _number(0),
    "task.place_radius": _number(0, strictly=False),
    "task.candidates": _whole(1),
    "task.coarse.by": _one_of("representatives", "vote"),
    "task.coarse.neighbours": _whole(1),
    "task.coarse.descriptor": _or_none(_TEXT),
    "top": _whole(1),
    "depth": _whole(1),
    "workers": (lambda value: value is None or _whole(1)[0](value), "a whole number from 1"),
    "count": _whole(1),
    "out": (lambda value: value is None or isinstance(value, str), "a text"),
    "sequences": (lambda value: isinstance(value, list), "a list, such as ['*cloudy3']"),
}
