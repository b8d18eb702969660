"""The settings of `simulate`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from siamloc.data.names import lighting_in
from siamloc.errors import ConfigError, hint
from siamloc.simulate.camera import CAMERAS
from siamloc.simulate.rules import FLAG, TEXT, Rule, must_be, number, one_of, optional, whole
from siamloc.simulate.run import Run

#: The standard benchmark: path 2 under three lightings.
STANDARD_RUNS = ("cloudy1", "cloudy2", "cloudy3", "night1", "night2", "sunny1", "sunny2", "sunny3")

_CLOSEST = 0.005  # metres between frames
_LOCATION = must_be("the name of a file or folder", lambda value: isinstance(value, (str, Path)) and str(value) != "")
_RULES: dict[str, Rule] = {
    "out": _LOCATION,
    "building": must_be("the name of a building or its file", lambda value: not TEXT(value) or isinstance(value, Path)),
    "seed": whole(0, 2**32 - 1),
    "path": must_be("the name of one of the building's paths, such as path2", lambda value: not TEXT(value)),
    "runs": must_be(
        "a list of runs, such as [cloudy1, night1]",
        lambda value: isinstance(value, (list, tuple)) and all(isinstance(run, str) for run in value),
    ),
    "spacing": must_be(
        f"a number of metres from {_CLOSEST:g}", lambda value: not number(above=0)(value) and value >= _CLOSEST
    ),
    "camera": one_of(CAMERAS),
    "trajectory": optional(_LOCATION),
    "frames": optional(whole(1, 10_000_000)),
    "workers": optional(whole(1, 1024)),
    "quality": whole(1, 100),
    "preview": FLAG,
    "overwrite": FLAG,
}


@dataclass(frozen=True, kw_only=True)
class SimulateConfig:
    """The settings of `simulate`; an invalid value raises a ConfigError.

    Attributes:
        out: output folder, which receives `<building>/part_a/seq2_cloudy1/...`.
        building: name of a built-in building, "random", or a YAML file.
        seed: seed of all random draws; equal seeds give equal bytes.
        path: name of one of the building's paths.
        runs: lightings with numbers, such as ("cloudy1", "night2").
        spacing: metres between frames.
        camera: "omnidirectional" (640 x 480 JPEG) or "panorama" (512 x 128 JPEG).
        trajectory: a `places.lst`; one image is rendered for each pose, under its listed name, in one run with the
            lighting that the list's file name contains, unless runs are given. Poses are checked for collisions, but
            not the ways between them.
        frames: largest number of frames per run; all if None.
        workers: number of processes; as many as there are processors (at most 8) if None.
        quality: quality of the JPEG files, 1 to 100.
        preview: write a contact sheet and a floor plan instead of the data set.
        overwrite: replace images in the folder that another configuration rendered; complete images of this
            configuration are kept.

    >>> SimulateConfig(building="mini", runs=("cloudy1", "night1")).drives()[1].name
    'seq2_night1'
    """

    out: Path = Path("data")
    building: str = "freiburg_like"
    seed: int = 0
    path: str = "path2"
    runs: tuple[str, ...] = STANDARD_RUNS
    spacing: float = 0.15
    camera: str = "omnidirectional"
    trajectory: Path | None = None
    frames: int | None = None
    workers: int | None = None
    quality: int = 92
    preview: bool = False
    overwrite: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.runs, str):
            object.__setattr__(self, "runs", (self.runs,))
        for name, rule in _RULES.items():
            if broken := rule(getattr(self, name)):
                raise ConfigError(f"{name} {broken}")
        object.__setattr__(self, "runs", tuple(self.runs))
        for name in ("building", "path"):
            object.__setattr__(self, name, str(getattr(self, name)))
        for name in ("out", "trajectory"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, Path(getattr(self, name)).expanduser())
        if not self.runs:
            raise ConfigError("simulate needs at least one run, such as runs=[cloudy1]")
        names = [run.name for run in self.drives()]
        if len(set(names)) < len(names):
            raise ConfigError(f"a run is listed twice: {', '.join(self.runs)}")

    def drives(self) -> list[Run]:
        """Return the runs to render; for a list of poses, the one in its name, unless other runs are given."""
        if self.trajectory is not None and self.runs == STANDARD_RUNS:
            lighting = lighting_in(Path(self.trajectory).name) or "cloudy"
            return [Run.parse(f"{lighting}1", self.path, self.spacing, self.trajectory)]
        return [Run.parse(name, self.path, self.spacing, self.trajectory) for name in self.runs]

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> SimulateConfig:
        """Make a configuration from settings by name, as given on the command line.

        Raises:
            ConfigError: an unknown key, or an invalid value.

        >>> SimulateConfig.of({"out": "data", "runs": ["night1"], "camera": "panorama"}).runs
        ('night1',)
        """
        known = [field.name for field in fields(cls)]
        for key in values:
            if key not in known:
                raise ConfigError(f"simulate has no setting {key!r}; {hint(str(key), sorted(known))}")
        return cls(**values)
