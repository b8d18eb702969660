"""The settings of `simulate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from foundation.settings import Count, Rule, Seed, Settings, Thousand
from siamloc.data.names import lighting_in
from siamloc.errors import ConfigError
from siamloc.simulate.run import Run

#: The standard benchmark: path 2 under three lightings.
STANDARD_RUNS = ("cloudy1", "cloudy2", "cloudy3", "night1", "night2", "sunny1", "sunny2", "sunny3")

_Location = Annotated[Path, Rule("the name of a file or folder", lambda value: str(value) != ".")]
_Name = Annotated[str, Rule("a name", lambda value: value != "")]
_Runs = Annotated[tuple[str, ...], Rule("a list of runs, such as [cloudy1, night1]", lambda value: True)]
_Spacing = Annotated[float, Rule("a number of metres from 0.005", lambda value: 0.005 <= value < 1e6)]
_Quality = Annotated[int, Rule("a whole number from 1 to 100", lambda value: 1 <= value <= 100)]


@dataclass(frozen=True, kw_only=True)
class SimulateConfig(Settings):
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

    out: _Location = Path("data")
    building: _Name = "freiburg_like"
    seed: Seed = 0
    path: _Name = "path2"
    runs: _Runs = STANDARD_RUNS
    spacing: _Spacing = 0.15
    camera: Literal["omnidirectional", "panorama"] = "omnidirectional"
    trajectory: _Location | None = None
    frames: Count | None = None
    workers: Thousand | None = None
    quality: _Quality = 92
    preview: bool = False
    overwrite: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.runs, str):
            object.__setattr__(self, "runs", (self.runs,))
        for name in ("building", "path"):  # whose names may be numbers, and files
            if isinstance(value := getattr(self, name), (int, Path)) and not isinstance(value, bool):
                object.__setattr__(self, name, str(value))
        super().__post_init__()
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
