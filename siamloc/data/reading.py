"""`read`: read the frames of a data set, whatever its layout, and the settings that select a data set."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

from foundation.calls import typed
from foundation.settings import Settings, Size, checked
from siamloc.data.cold import read_cold
from siamloc.data.folder import read_folder
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.manifest import read_manifest
from siamloc.data.panorama import OmnidirectionalCamera
from siamloc.errors import ConfigError, Policy, hint

READERS: dict[str, Callable[..., FrameTable]] = {"cold": read_cold, "folder": read_folder, "manifest": read_manifest}

_PATHS = ("root", "places", "manifest")
_VIRTUAL = (("proc",), ("sys",))  # folders at the root of Linux that hold no files but the system's state


@typed
def read(kind: str, *, unit: str = "m", name: str = "", **where: Any) -> FrameTable:
    """Read the frames of a data set.

    Args:
        kind: "cold" (`siamloc.data.cold.read_cold`), "manifest" (`siamloc.data.manifest.read_manifest`) or "folder"
            (`siamloc.data.folder.read_folder`).
        unit: unit of x and y.
        name: name of the data in results and runs; the name of the file or folder if empty.
        **where: arguments of that reader, such as root=FOLDER.

    Returns:
        The frames. `source` records the arguments of this call, with absolute paths: `read(**frames.source)` reads the
        same frames again.

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
    if kind not in READERS:
        raise ConfigError(f"there is no reader for data of kind {kind!r}; {hint(kind, READERS)}")
    parameters = inspect.signature(READERS[kind]).parameters
    for key in where:
        if key not in parameters:
            raise ConfigError(f"data of kind {kind!r} are not described by {key!r}; {hint(key, parameters)}")
    for key, parameter in parameters.items():
        if parameter.default is inspect.Parameter.empty and where.get(key) is None:
            raise ConfigError(f"data of kind {kind!r} need {key}=...; valid: {', '.join(parameters)}")
    checked(where.get("on_error", "skip"), Policy, "on_error")
    given = {key: value for key, value in where.items() if value is not None}
    source = {key: str(Path(value).expanduser().absolute()) if key in _PATHS else value for key, value in given.items()}
    for key in _PATHS:
        if key in source and Path(source[key]).resolve().parts[1:2] in _VIRTUAL:
            raise ConfigError(f"data.{key}={source[key]} lies in a view of the running system, not in a folder of data")
    named = name or next((Path(source[key]).stem for key in _PATHS if key in source), kind)
    return replace(READERS[kind](**given), unit=unit, source={"kind": kind, "name": named, **source})


@dataclass(frozen=True)
class DataSettings(Settings):
    """Which frames to read, and how their images become panoramas: the settings in `conf/data`.

    Attributes:
        kind: "cold", "folder" or "manifest".
        name: name of the data in results and runs.
        manifest: CSV table, for kind "manifest".
        root: folder, for kind "cold" or "folder".
        places: one file `places.lst` of poses, for kind "cold", instead of `root`.
        camera: "omni_cam" or "std_cam", for kind "cold".
        unit: unit of x and y; only used in texts.
        image_size: rows and columns of a panorama.
        circular: whether the columns wrap around; False for ordinary cameras.
        on_error: "skip" leaves out and reports unreadable images, "raise" stops at the first.
        cache: folder of the decoded panoramas; see `PanoramaLibrary`.

    Raises:
        ConfigError: a value of the wrong type.

    Example:
        >>> DataSettings.of({"kind": "manifest", "manifest": "robot.csv", "image_size": [64, 256]}).image_size
        (64, 256)
    """

    WHERE: ClassVar[str] = "data"

    kind: Literal["cold", "folder", "manifest"]
    name: str = ""
    manifest: Path | None = None
    root: Path | None = None
    places: Path | None = None
    camera: Literal["omni_cam", "std_cam"] | None = None
    unit: str = "m"
    image_size: Size = (128, 512)
    circular: bool = True
    on_error: Policy = "skip"
    cache: Path | None = None

    def summary(self) -> str:
        """Return the name and location of the data, such as "robot, /data/robot.csv"."""
        where = self.manifest or self.places or self.root
        return self.name or self.kind if where is None else f"{self.name or self.kind}, {where.absolute()}"

    def read(self) -> FrameTable:
        """Read the frames. See `siamloc.data.read`."""
        where = {name: getattr(self, name) for name in (*_PATHS, "camera") if getattr(self, name) is not None}
        return read(self.kind, unit=self.unit, name=self.name, on_error=self.on_error, **where)

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
