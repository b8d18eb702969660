"""What `simulate` is asked to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from siamloc.data.names import lighting_in
from siamloc.errors import ConfigError, hint
from siamloc.simulate.camera import CAMERAS
from siamloc.simulate.run import Run

#: The standard benchmark: path 2 under three lightings.
STANDARD_RUNS = ("cloudy1", "cloudy2", "cloudy3", "night1", "night2", "sunny1", "sunny2", "sunny3")


@dataclass(frozen=True)
class SimulateConfig:
    """A simulated data set.

    Attributes:
        out: folder that receives `<building>/part_a/seq2_cloudy1/...`.
        building: name of a built-in building, "random", or a YAML file.
        seed: draws everything; equal seeds give equal bytes.
        path: name of the building's path.
        runs: lightings with numbers, such as ("cloudy1", "night2").
        spacing: metres between frames.
        camera: "omnidirectional" (640 x 480 JPEG) or "panorama" (512 x 128 JPEG).
        trajectory: a `places.lst`; one image per listed pose is rendered under the listed name, in one run whose
            lighting the list's own name tells, unless runs are given. Poses are checked, ways between them are not.
        frames: at most so many frames of each run; all if None.
        workers: processes; as many as there are processors (at most 8) if None.
        quality: of the JPEG files, 1 to 100.
        preview: write a contact sheet and a floor plan instead of the data set.
        overwrite: replace what another configuration rendered into the folder; whole images of this one stay.
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
        if self.camera not in CAMERAS:
            raise ConfigError(f"camera {self.camera!r} is unknown; {hint(self.camera, CAMERAS)}")
        if not self.runs:
            raise ConfigError("simulate needs at least one run, such as runs=[cloudy1]")
        if not 1 <= self.quality <= 100:
            raise ConfigError(f"JPEG quality lies between 1 and 100, got {self.quality}")
        for name in ("frames", "workers"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ConfigError(f"{name} must be at least 1, got {value}")
        if not self.spacing > 0:
            raise ConfigError(f"the spacing of frames must be a positive number of metres, got {self.spacing}")
        names = [run.name for run in self.drives()]
        if len(set(names)) < len(names):
            raise ConfigError(f"a run is listed twice: {', '.join(self.runs)}")

    def drives(self) -> list[Run]:
        """Return the runs to render; for a list of poses the one that its name tells, unless other runs are given."""
        if self.trajectory is not None and self.runs == STANDARD_RUNS:
            lighting = lighting_in(Path(self.trajectory).name) or "cloudy"
            return [Run.parse(f"{lighting}1", self.path, self.spacing, self.trajectory)]
        return [Run.parse(name, self.path, self.spacing, self.trajectory) for name in self.runs]

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> SimulateConfig:
        """Return a configuration from plain values.

        Raises:
            ConfigError: an unknown key or a value without a meaning.
        """
        known = {field.name for field in fields(cls)}
        for key in values:
            if key not in known:
                raise ConfigError(f"simulate has no parameter {key!r}; {hint(str(key), sorted(known))}")
        plain = dict(values)
        if "runs" in plain:
            runs = plain["runs"]
            plain["runs"] = (runs,) if isinstance(runs, str) else tuple(str(run) for run in runs)
        for key in ("out", "trajectory"):
            if plain.get(key) is not None:
                plain[key] = Path(str(plain[key])).expanduser()
        return cls(**plain)
