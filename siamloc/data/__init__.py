"""Data sets: readers, unwrapping, the decoded-panorama store, pairs, and the Lightning data module."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from siamloc.data.cold import read_cold
from siamloc.data.folder import read_folder
from siamloc.data.frames import FrameTable, concatenate
from siamloc.data.manifest import read_manifest
from siamloc.data.panorama import (
    HyperbolicMirror,
    OmnidirectionalCamera,
    PanoramaView,
    PolarRing,
    azimuth_column,
    column_azimuth,
    unwrap,
)
from siamloc.data.store import PanoramaStore
from siamloc.errors import ConfigError, hint

__all__ = [
    "READERS",
    "FrameTable",
    "HyperbolicMirror",
    "OmnidirectionalCamera",
    "PanoramaStore",
    "PanoramaView",
    "PolarRing",
    "azimuth_column",
    "column_azimuth",
    "concatenate",
    "read",
    "unwrap",
]

READERS: dict[str, Callable[..., FrameTable]] = {"cold": read_cold, "folder": read_folder, "manifest": read_manifest}


def read(kind: str, **where: Any) -> FrameTable:
    """Read the frames of a data set.

    Args:
        kind: "cold" (`siamloc.data.cold.read_cold`), "manifest" (`siamloc.data.manifest.read_manifest`) or "folder"
            (`siamloc.data.folder.read_folder`).
        **where: what that reader takes, such as root=FOLDER.

    Raises:
        ConfigError: an unknown kind or keyword, or one that is lacking; the valid ones are named.
        DataError: files that cannot be used as they are.
    """
    if kind not in READERS:
        raise ConfigError(f"there is no reader for data of kind {kind!r}; {hint(kind, READERS)}")
    parameters = inspect.signature(READERS[kind]).parameters
    for name in where:
        if name not in parameters:
            raise ConfigError(f"data of kind {kind!r} are not described by {name!r}; {hint(name, parameters)}")
    for name, parameter in parameters.items():
        if parameter.default is inspect.Parameter.empty and where.get(name) is None:
            raise ConfigError(f"data of kind {kind!r} need {name}=...; {hint(name, parameters)}")
    return READERS[kind](**where)
