"""`read`: read the frames of a data set, whatever its layout, and the settings that select a data set."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args

from foundation.calls import kinds_of, typed
from foundation.files import plain
from foundation.settings import Settings, Size, Text, checked, defaults_of, fields_of
from siamloc.data.cold import read_cold
from siamloc.data.folder import read_folder
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.loc360 import read_360loc
from siamloc.data.manifest import read_manifest
from siamloc.data.panorama import OmnidirectionalCamera
from siamloc.data.rawseeds import read_rawseeds
from siamloc.data.recorded import read_recorded
from siamloc.errors import ConfigError, Policy, hint

READERS: dict[str, Callable[..., FrameTable]] = {
    "cold": read_cold,
    "manifest": read_manifest,
    "folder": read_folder,
    "trajectory": read_recorded,
    "360loc": read_360loc,
    "rawseeds": read_rawseeds,
}
"""The readers by kind of data. A reader is a function that takes where the data are and returns a `FrameTable`.

An entry is all that a kind of data needs. Its parameters, with their annotations and defaults, are the keys `data.KEY`
on the command line and the keywords of `read`; a relative path becomes absolute if the annotation says `Path`. The
first line of its docstring is its line in the help.
"""

_VIRTUAL = (("proc",), ("sys",))  # folders at the root of Linux that hold no files but the system's state


def parameters_of(kind: str) -> dict[str, inspect.Parameter]:
    """Return the parameters of a reader, by name.

    Raises:
        ConfigError: an unknown kind of data.
    """
    if kind not in READERS:
        raise ConfigError(f"there is no reader for data of kind {kind!r}; {hint(kind, READERS)}")
    return dict(inspect.signature(READERS[kind]).parameters)


def path_keys() -> set[str]:
    """Return the parameters of all readers that are paths."""
    return {key for reader in READERS.values() for key, annotation in kinds_of(reader).items() if _is_path(annotation)}


def _is_path(annotation: Any) -> bool:
    return annotation is Path or Path in get_args(annotation)


@typed
def read(kind: str, *, unit: str = "m", name: str = "", **where: Any) -> FrameTable:
    """Read the frames of a data set.

    Args:
        kind: "manifest" (`siamloc.data.manifest.read_manifest`), "cold" (`siamloc.data.cold.read_cold`), "folder"
            (`siamloc.data.folder.read_folder`), "trajectory" (`siamloc.data.recorded.read_recorded`), "360loc"
            (`siamloc.data.loc360.read_360loc`) or "rawseeds" (`siamloc.data.rawseeds.read_rawseeds`).
        unit: unit of x and y.
        name: name of the data in results and runs; the name of the file or folder if empty.
        **where: arguments of that reader, such as root=FOLDER.

    Returns:
        The frames. Paths are absolute, in `path` and in `source`, which records the arguments of this call:
        `read(**frames.source)` reads the same frames again.

    Raises:
        ConfigError: an unknown or missing kind or keyword; the message lists the valid ones.
        DataError: files that cannot be used as they are.

    Example:
        >>> import pathlib, tempfile
        >>> folder = pathlib.Path(tempfile.mkdtemp())
        >>> for name in ("a.jpg", "b.jpg", "robot.csv"):
        ...     _ = (folder / name).write_text("image,x,y\\na.jpg,0,0\\nb.jpg,1,0\\n")
        >>> read("manifest", manifest=folder / "robot.csv")
        FrameTable(2 frames; sequences: (unnamed) 2; rooms: none; lightings: none; positions: all, in m)
    """
    parameters = parameters_of(kind)
    for key in where:
        if key not in parameters:
            raise ConfigError(f"data of kind {kind!r} are not described by {key!r}; {hint(key, parameters)}")
    for key, parameter in parameters.items():
        if parameter.default is parameter.empty and where.get(key) is None:
            raise ConfigError(f"data of kind {kind!r} need {key}=...; valid: {', '.join(parameters)}")
    checked(where.get("on_error", "skip"), Policy, "on_error")  # readers of one's own may not say what it can be
    given = _fitted(kind, where)
    paths = {key: value.absolute() for key, value in given.items() if isinstance(value, Path)}
    for key, path in paths.items():
        if path.resolve().parts[1:2] in _VIRTUAL:
            raise ConfigError(f"data.{key}={path} lies in a view of the running system, not in a folder of data")
    named = name or next((path.stem for path in paths.values()), kind)
    frames = READERS[kind](**given)
    if not isinstance(frames, FrameTable):
        raise ConfigError(f"the reader of data of kind {kind!r} must return a FrameTable, got {type(frames).__name__}")
    frames = frames.with_columns(path=[str(Path(path).absolute()) for path in frames.path])
    return replace(frames, unit=unit, source={"kind": kind, "name": named, **plain({**given, **paths})})


def _fitted(kind: str, where: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the arguments of a reader that are not None, as its annotations want them; paths become `Path`s."""
    kinds = {key: Path if _is_path(one) else one for key, one in kinds_of(READERS[kind]).items()}
    given = {key: value for key, value in where.items() if value is not None}
    return {key: checked(value, kinds.get(key, Any), f"{prefix}{key}") for key, value in given.items()}


@dataclass(frozen=True)
class DataSettings(Settings):
    """Which frames to read, and how their images become panoramas: the settings of the group `data`.

    Attributes:
        kind: a name in `siamloc.data.READERS`, such as "manifest".
        where: arguments of the reader, such as `manifest`; as plain values they are keys next to the others.
        name: name of the data in results and runs.
        unit: unit of x and y; only used in texts.
        image_size: rows and columns of a panorama.
        circular: whether the columns wrap around; False for ordinary cameras.
        on_error: "skip" leaves out and reports unreadable images, "raise" stops at the first.
        cache: folder of the decoded panoramas; see `PanoramaLibrary`.

    Raises:
        ConfigError: an unknown key, or a value of the wrong type.

    Example:
        >>> DataSettings.of({"kind": "manifest", "manifest": "robot.csv", "image_size": [64, 256]}).image_size
        (64, 256)
    """

    WHERE: ClassVar[str] = "data"

    kind: Text
    where: Mapping[str, Any]
    name: str = ""
    unit: str = "m"
    image_size: Size = (128, 512)
    circular: bool = True
    on_error: Policy = "skip"
    cache: Path | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        checked(self.kind, Literal[tuple(READERS)], "data.kind")  # type: ignore[misc]
        object.__setattr__(self, "where", _fitted(self.kind, self.where, "data."))

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> DataSettings:
        """Read the settings and the arguments of the reader from one mapping.

        Raises:
            ConfigError: an unknown key, with the nearest valid one, or a value of the wrong type.
        """
        common = [key for key in fields_of(cls) if key != "where"]
        where = {key: value for key, value in values.items() if key not in common and value is not None}
        if isinstance(kind := values.get("kind"), str) and kind in READERS:
            own = [key for key in parameters_of(kind) if key not in common]
            for key in where:
                if key not in own:
                    raise ConfigError(f"unknown key data.{key}: {hint(key, [*common, *own])}, for data.kind={kind}")
        return super().of({**{key: values[key] for key in common if key in values}, "where": where})

    def plain(self) -> dict[str, Any]:
        """Return the settings and the arguments of the reader in one mapping, which `of` can read."""
        values = super().plain()
        where = values.pop("where")
        return {**values, **where}

    @classmethod
    def options(cls, kind: str) -> dict[str, Any]:
        """Return the keys of a kind of data with their defaults; "???" for what has to be given."""
        common = {"kind": kind, **defaults_of(cls), "name": kind}
        own = {key: one for key, one in parameters_of(kind).items() if key not in common}
        return common | {key: "???" if one.default is one.empty else one.default for key, one in own.items()}

    def summary(self) -> str:
        """Return the name and location of the data, such as "robot, /data/robot.csv"."""
        where = next((value for value in self.where.values() if isinstance(value, Path)), None)
        return self.name or self.kind if where is None else f"{self.name or self.kind}, {where.absolute()}"

    def read(self) -> FrameTable:
        """Read the frames. See `siamloc.data.read`."""
        policy = {"on_error": self.on_error} if "on_error" in parameters_of(self.kind) else {}
        return read(self.kind, unit=self.unit, name=self.name, **policy, **self.where)

    def library(
        self, frames: FrameTable, unwrap: OmnidirectionalCamera | Mapping[str, Any] | None = None
    ) -> PanoramaLibrary:
        """Decode the frames' images, or open them from the cache. See `PanoramaLibrary`."""
        return PanoramaLibrary(
            frames,
            self.cache,
            image_size=self.image_size,
            unwrap=unwrap,
            circular=self.circular,
            on_error=self.on_error,
        )
