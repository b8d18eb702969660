"""Write a simulated data set in COLD's layout with several processes, or resume an interrupted one."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np

from foundation.calls import OF_FIELDS, takes
from foundation.files import content_key, csv_text, read_json, storage_errors, write_json, write_picture, write_text
from foundation.settings import Count, Natural, Rule, Seed, Settings, Text, Thousand
from foundation.threads import processors
from siamloc.data.cold import ODOMETRY_FILE
from siamloc.data.frames import ODOMETRY
from siamloc.data.image_files import cut_short
from siamloc.data.names import lighting_in, name_sequence, parse_name
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.progress import track
from siamloc.simulate.buildings import load_building
from siamloc.simulate.camera import CAMERAS, HEIGHT, CameraName, Exposure
from siamloc.simulate.layout import Array, Building
from siamloc.simulate.mesh import embree
from siamloc.simulate.overlap import changed_share
from siamloc.simulate.preview import write_preview
from siamloc.simulate.rendering import frames, meter
from siamloc.simulate.run import Hour, Run, RunState, draw_odometry, draw_run
from siamloc.simulate.scene import Scene, build_scene, built
from siamloc.simulate.trajectory import Track

#: The standard benchmark: path 2 under three lightings.
STANDARD_RUNS = ("cloudy1", "cloudy2", "cloudy3", "night1", "night2", "sunny1", "sunny2", "sunny3")
#: What months have changed, next to `places.lst`: the share of the surfaces in view, and a list of the changes.
CHANGES_FILE = "changes.json"
_SCHEMA = 1
_OPTIONAL = ("hour", "headings", "positions", "month")
_BATCH = 16
_QUALITY = 92  # of the JPEG files, 1 to 100
_Spacing = Annotated[float, Rule("a number of metres from 0.005", lambda value: 0.005 <= value < 1e6)]


@dataclass(frozen=True, kw_only=True)
class SimulateConfig(Settings):
    """The settings of `simulate`; an invalid value raises a ConfigError.

    Attributes:
        out: output folder, which receives `<building>/part_a/seq2_cloudy1/...`.
        building: name of a built-in building, "random", or a YAML file (docs/howto/building.md).
        seed: seed of all random draws; equal seeds give equal bytes.
        path: name of one of the building's paths; or "grid", a grid of positions over the free floor, or "halfway", the
            middles of its squares.
        runs: lightings with numbers, such as ("cloudy1", "night2").
        spacing: metres after which the robot takes the next frame, or one earlier after 20 degrees of turning; or
            metres between the positions of the grid.
        hours: solar time of each run, which also dims a cloudy sky, 7 to 17 but for nights; drawn around a usual
            hour if empty.
        headings: frames at each position of a grid, evenly turned.
        positions: number of positions of a grid in each run, spread over the rooms; all that are free if None.
        months: number of months after the first, in each of which the runs are driven again; furniture, pictures and
            lamps are moved, exchanged, added and taken from month to month. The folders of later months end in
            `_month1`, `_month2`, ...; the folders of the first month are the same as without months.
        camera: "omnidirectional" (640 x 480 JPEG) or "panorama" (512 x 128 JPEG).
        trajectory: a `places.lst`; one image is rendered for each pose, under its listed name, in one run with the
            lighting that the list's file name contains, unless runs are given. Poses are checked for collisions, but
            not the ways between them.
        frames: largest number of frames per run; all if None.
        workers: number of processes; as many as there are processors (at most 8) if None.
        preview: write a contact sheet and a floor plan instead of the data set.
        overwrite: replace images in the folder that another configuration rendered; complete images of this
            configuration are kept.

    >>> SimulateConfig(building="mini", runs=("cloudy1", "night1")).drives()[1].name
    'seq2_night1'
    """

    out: Path = Path("data")
    building: Text = "freiburg_like"
    seed: Seed = 0
    path: Text = "path2"
    runs: tuple[str, ...] = STANDARD_RUNS
    spacing: _Spacing = 0.15
    hours: tuple[Hour, ...] = ()
    headings: Count = 1
    positions: Count | None = None
    months: Natural = 0
    camera: CameraName = "omnidirectional"
    trajectory: Path | None = None
    frames: Count | None = None
    workers: Thousand | None = None
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
        """Return the runs to render, month by month; for a list of poses, the run in the list's name by default."""
        names = self.runs
        if self.trajectory is not None and names == STANDARD_RUNS:
            names = (f"{lighting_in(Path(self.trajectory).name) or 'cloudy'}1",)
        if self.hours and len(self.hours) != len(names):
            raise ConfigError(f"hours needs one hour for each run ({', '.join(names)}), got {len(self.hours)}")
        hours = self.hours or (None,) * len(names)
        still = {"headings": self.headings, "positions": self.positions}
        return [
            Run.parse(name, self.path, self.spacing, trajectory=self.trajectory, hour=hour, month=month, **still)
            for month in range(self.months + 1)
            for name, hour in zip(names, hours, strict=True)
        ]


@dataclass(frozen=True)
class Summary:
    """What was written; prints as a short report.

    Attributes:
        folder: folder of the building.
        sequences: number of frames by sequence, such as "mini_a_seq2_cloudy1", as the reader of the folder calls it.
        rooms: number of frames by room code.
        rendered: number of frames rendered by this call; the others were already there.
        seconds: time taken.
        files: further files, such as the contact sheet.
        changed: share of the surfaces in view that are different from the first month, by sequence, of later months.

    >>> Summary(Path("data/mini"), {"mini_a_seq2_cloudy1": 6}, {"CR-A": 4, "1PO-A": 2}, rendered=6, seconds=3.0)
    data/mini: 6 frames rendered in 3 s, 2.0 frames/s
      mini_a_seq2_cloudy1: 6 frames
      rooms: CR-A 4, 1PO-A 2
    """

    folder: Path
    sequences: dict[str, int]
    rooms: dict[str, int]
    rendered: int
    seconds: float
    files: tuple[Path, ...] = ()
    changed: dict[str, float] = field(default_factory=dict)

    def __repr__(self) -> str:
        if self.files:
            return "\n".join([f"{self.folder}: a preview", *(f"  {path}" for path in self.files)])
        lines = [f"{self.folder}: {self.rendered} frames rendered in {self.seconds:.0f} s{self.rate}"]
        lines += [f"  {line}" for line in self.lines()]
        lines.append("  rooms: " + ", ".join(f"{code} {count}" for code, count in self.rooms.items()))
        return "\n".join(lines)

    @property
    def rate(self) -> str:
        """The frames rendered per second, as words that follow a number of seconds; "" if none were."""
        return f", {self.rendered / self.seconds:.1f} frames/s" if self.rendered and self.seconds > 0 else ""

    def lines(self) -> list[str]:
        """Return a line for each run: its frames, and in later months how much has changed."""
        news = {name: f", {100 * share:.0f} % of the surfaces in view changed" for name, share in self.changed.items()}
        return [f"{name}: {count} frames{news.get(name, '')}" for name, count in self.sequences.items()]


@takes(SimulateConfig)
def simulate(*, settings: SimulateConfig = OF_FIELDS, **fields: Any) -> Summary:
    """Render a data set, or resume an interrupted one.

    With several workers, processes are spawned: call this under `if __name__ == "__main__":` in a script.

    Args:
        settings: what to render; the settings of the standard benchmark by default.

    Raises:
        ConfigError: a setting that does not exist, or an invalid value.
        DataError: an impossible building, a pose inside a wall, or a folder that contains other images.
        SiamlocError: embreex is not installed.
        StorageError: the disk cannot be written to.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as out:
    ...     summary = simulate(out=out, building="mini", runs=["cloudy1"], camera="panorama", frames=2)
    >>> summary.rooms
    {'CR-A': 2}
    """
    embree()
    begin = time.monotonic()
    building, drives = load_building(settings.building, settings.seed), settings.drives()
    folder = settings.out / building.name
    if settings.preview:
        pictures = write_preview(building, drives, folder / "preview")
        return Summary(folder, {}, {}, 0, time.monotonic() - begin, pictures)
    states = {run.name: draw_run(building, run) for run in drives}
    tracks = {name: state.track.head(settings.frames) for name, state in states.items()}
    work = [batch for run in drives for batch in _missing(settings, building, run, tracks[run.name])]
    total = sum(len(rows) for _, rows in work)
    for _ in track(_rendered(settings, work), total, f"rendering {building.name}", size=int) if work else ():
        pass
    counts: dict[str, int] = {}
    changed: dict[str, float] = {}
    for run in drives:
        wheels = draw_odometry(building, run, states[run.name].track)
        sequence = _sequence(settings, building, run)
        lists, name = sequence / "localization", name_sequence(sequence, run.name, tracks[run.name].codes).sequence
        counts[name] = len(tracks[run.name])
        if run.month:
            before = states[replace(run, month=0).name]
            changed[name] = _write_changes(lists, before, states[run.name], tracks[run.name])
        _write_lists(lists, tracks[run.name], wheels)
    rooms = dict(Counter(code for drive in tracks.values() for code in drive.codes))
    return Summary(folder, counts, rooms, total, time.monotonic() - begin, changed=changed)


def _write_changes(folder: Path, before: RunState, now: RunState, drive: Track) -> float:
    """Write what the months have changed, and return the share of the surfaces in view on a drive that differ."""
    eyes = np.column_stack([drive.poses[:, :2], np.full(len(drive), HEIGHT)])
    share = round(float(changed_share(built(before)[0], built(now)[0], eyes).mean()), 4)
    changes = [asdict(change) for change in now.changes]
    write_json(folder / CHANGES_FILE, {"schema": _SCHEMA, "changed": share, "changes": changes})
    return share


def _write_lists(folder: Path, drive: Track, wheels: Array | None) -> None:
    """Write the list of a drive's n images and rooms and, if there is odometry (n or more, 3), the table of it."""
    if wheels is not None:
        poses = wheels[: len(drive)].round(6).tolist()
        rows = [[f"../omni_cam/{name}", *pose] for name, pose in zip(drive.names, poses, strict=True)]
        write_text(folder / ODOMETRY_FILE, csv_text([("image", *ODOMETRY), *rows]))
    lines = [f"{name} {code}\n" for name, code in zip(drive.names, drive.codes, strict=True)]
    write_text(folder / "places.lst", "".join(lines))


def _sequence(config: SimulateConfig, building: Building, run: Run) -> Path:
    return config.out / building.name / f"part_{building.part}" / run.name


def _description(config: SimulateConfig, building: Building, run: Run) -> dict[str, Any]:
    """Describe the images of a sequence; equal descriptions mean equal bytes."""
    camera = CAMERAS[config.camera]
    layout = asdict(building)
    del layout["source"]
    if building.materials == "standard":
        del layout["materials"]
    poses = run.trajectory
    return {
        "schema": _SCHEMA,
        "images": config.camera,
        "rows": camera.shape[0],
        "columns": camera.shape[1],
        "height": HEIGHT,
        **asdict(camera),
        "building": building.name,
        "building_key": content_key(layout),
        "seed": config.seed,
        "run": run.name,
        "path": run.path,
        "spacing": run.spacing,
        "trajectory": None if poses is None else poses.name,
        "trajectory_key": None if poses is None else content_key(poses.read_text("utf-8")),
        "quality": _QUALITY,
        **{name: value for name in _OPTIONAL if (value := getattr(run, name)) != getattr(Run, name)},
    }


def _missing(config: SimulateConfig, building: Building, run: Run, drive: Track) -> list[tuple[Run, list[int]]]:
    """Prepare a sequence's folder and return which frames are missing, in batches."""
    sequence = _sequence(config, building, run)
    images, note = sequence / "omni_cam", sequence / "camera.json"
    wanted = _description(config, building, run)
    present: set[str] = set()
    # Any other files in the folder are the user's own.
    pictures = [file for file in images.glob("*.jp*g") if parse_name(file.name)]
    if pictures:
        if not note.is_file():
            raise DataError(f"{images} holds images that simulate did not render: choose another out")
        try:
            found = read_json(note)
        except FormatError:
            found = None
        if found == wanted:
            present = {file.name for file in pictures if (data := file.read_bytes()) and not cut_short(data)}
        elif not config.overwrite:
            there = found if isinstance(found, dict) else {}
            changed = sorted(key for key in wanted if there.get(key) != wanted[key]) if there else ["camera.json"]
            raise DataError(
                f"{sequence} holds images of another simulation (different: {', '.join(changed)}): choose another "
                "out, or replace them with overwrite=true"
            )
        with storage_errors(images):
            if any(name not in present for name in drive.names):
                # Done first, so that no list ever names a missing image.
                for name in ("places.lst", ODOMETRY_FILE, CHANGES_FILE):
                    (sequence / "localization" / name).unlink(missing_ok=True)
            for file in pictures:
                # Cut short, or from another simulation.
                if file.name not in present:
                    file.unlink(missing_ok=True)
    write_json(note, wanted)
    rows = [row for row, name in enumerate(drive.names) if name not in present]
    return [(run, rows[start : start + _BATCH]) for start in range(0, len(rows), _BATCH)]


def _rendered(config: SimulateConfig, work: list[tuple[Run, list[int]]]) -> Iterator[int]:
    """Render the batches of frames and yield the size of each batch when it is written."""
    workers = min(config.workers or min(processors(), 8), len(work))
    if workers <= 1:
        _stage.cache_clear()  # a file of the same name may describe a different building than in an earlier call
        for run, rows in work:
            yield _batch(config, run, rows)
        _stage.cache_clear()
        return
    with rendering_processes(workers) as pool:
        pending = [pool.submit(_batch, config, run, rows) for run, rows in work]
        try:
            for future in as_completed(pending):
                yield future.result()
        except BrokenProcessPool as error:
            raise DataError(
                "a rendering process died, perhaps for lack of memory: run again with fewer workers, finished images "
                "are kept; in a script, call simulate under `if __name__ == '__main__':`"
            ) from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@lru_cache(maxsize=1)
def _stage(building: str, seed: int, run: Run) -> tuple[Scene, Exposure]:
    """Return the scene of a run and its exposure, which a process keeps for the next batch of frames."""
    scene = build_scene(load_building(building, seed), run)
    return scene, meter(scene, scene.state.track)


def _batch(config: SimulateConfig, run: Run, rows: list[int]) -> int:
    """Render some frames of a run, and return how many."""
    scene, exposure = _stage(config.building, config.seed, run)
    drive, images = scene.state.track, _sequence(config, scene.building, run) / "omni_cam"
    pictures = frames(scene, drive, CAMERAS[config.camera], exposure, rows)
    for row, picture in zip(rows, pictures, strict=True):
        write_picture(images / drive.names[row], picture, _QUALITY)
    return len(rows)


def rendering_processes(count: int) -> ProcessPoolExecutor:
    """Start rendering processes; they are spawned, so a script needs `if __name__ == "__main__":`."""
    return ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_prepare)


def _prepare() -> None:
    """Limit the process to one thread, since all share the processors; the parent process handles interrupts."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    cv2.setNumThreads(1)


def _end_with_parent() -> None:
    """Stop this process when its parent is killed: nobody would collect its work."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
