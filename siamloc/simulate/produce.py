"""Write a simulated data set in COLD's layout with several processes, or resume an interrupted one."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from inspect import Signature, signature
from pathlib import Path
from typing import Any

import cv2

from foundation.calls import typed
from foundation.files import content_key, read_json, storage_errors, write_bytes, write_json, write_text
from siamloc.data.names import parse_name
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.progress import track
from siamloc.simulate.camera import HEIGHT, Exposure, OmnidirectionalCamera, PanoramaCamera, make_camera
from siamloc.simulate.config import SimulateConfig
from siamloc.simulate.layout import Array, Building
from siamloc.simulate.load import load_building
from siamloc.simulate.mesh import embree
from siamloc.simulate.preview import write_preview
from siamloc.simulate.processes import processors, rendering_processes
from siamloc.simulate.render import frames, meter
from siamloc.simulate.run import Run, draw_run
from siamloc.simulate.scene import Scene, build_scene
from siamloc.simulate.trajectory import Track

_SCHEMA = 1
_BATCH = 16


@dataclass(frozen=True)
class Summary:
    """What was written; prints as a short report.

    Attributes:
        folder: folder of the building.
        sequences: number of frames by run folder.
        rooms: number of frames by room code.
        rendered: number of frames rendered by this call; the others were already there.
        seconds: time taken.
        files: further files, such as the contact sheet.

    >>> Summary(Path("data/mini"), {"seq2_cloudy1": 6}, {"CR-A": 4, "1PO-A": 2}, rendered=6, seconds=3.0)
    data/mini: 6 frames rendered in 3 s, 2.0 frames/s
      seq2_cloudy1: 6 frames
      rooms: CR-A 4, 1PO-A 2
    """

    folder: Path
    sequences: dict[str, int]
    rooms: dict[str, int]
    rendered: int
    seconds: float
    files: tuple[Path, ...] = ()

    def __repr__(self) -> str:
        if self.files:
            return "\n".join([f"{self.folder}: a preview", *(f"  {path}" for path in self.files)])
        rate = f", {self.rendered / self.seconds:.1f} frames/s" if self.rendered and self.seconds > 0 else ""
        lines = [f"{self.folder}: {self.rendered} frames rendered in {self.seconds:.0f} s{rate}"]
        lines += [f"  {name}: {count} frames" for name, count in self.sequences.items()]
        lines.append("  rooms: " + ", ".join(f"{code} {count}" for code, count in self.rooms.items()))
        return "\n".join(lines)


@typed
def simulate(config: SimulateConfig | None = None, /, **settings: Any) -> Summary:
    """Render a data set, or resume an interrupted one.

    With several workers, processes are spawned: call this under `if __name__ == "__main__":` in a script.

    Args:
        config: all settings at once; by default those of the standard benchmark.
        settings: the fields of `SimulateConfig` by name; they override those of `config`.

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
    config = SimulateConfig.of({**(vars(config) if config else {}), **settings})
    embree()
    begin = time.monotonic()
    building = load_building(config.building, config.seed)
    folder = config.out / building.name
    if config.preview:
        pictures = write_preview(building, config, folder / "preview")
        return Summary(folder, {}, {}, 0, time.monotonic() - begin, pictures)
    drives = config.drives()
    tracks = {run.name: draw_run(building, run).track.head(config.frames) for run in drives}
    work: list[tuple[Run, list[int]]] = []
    for run in drives:
        work += _missing(config, building, run, tracks[run.name], folder)
    total = sum(len(rows) for _, rows in work)
    for _ in track(_rendered(config, work), total, f"rendering {building.name}"):
        pass
    rooms: dict[str, int] = {}
    for run in drives:
        _finish(_sequence(folder, building, run), tracks[run.name])
        for code in tracks[run.name].codes:
            rooms[code] = rooms.get(code, 0) + 1
    counts = {run.name: len(tracks[run.name]) for run in drives}
    return Summary(folder, counts, rooms, total, time.monotonic() - begin)


# Lets help and tab completion show every setting with its type and default.
simulate.__signature__ = Signature(  # type: ignore[attr-defined]
    [signature(simulate).parameters["config"], *signature(SimulateConfig).parameters.values()],
    return_annotation=Summary,
)


def _sequence(folder: Path, building: Building, run: Run) -> Path:
    return folder / f"part_{building.part}" / run.name


def _description(config: SimulateConfig, building: Building, run: Run) -> dict[str, Any]:
    """Describe the images of a sequence; equal descriptions mean equal bytes."""
    camera = make_camera(config.camera)
    lens = camera.view if isinstance(camera, PanoramaCamera) else camera.mirror
    aside = ("source", "materials") if building.materials == "standard" else ("source",)
    layout = _without_lines({key: value for key, value in asdict(building).items() if key not in aside})
    layout["paths"] = {name: path.points for name, path in building.paths.items()}
    return {
        "schema": _SCHEMA,
        "images": config.camera,
        "rows": camera.shape[0],
        "columns": camera.shape[1],
        "height": HEIGHT,
        ("mirror" if isinstance(camera, OmnidirectionalCamera) else "view"): asdict(lens),
        "building": building.name,
        "building_key": content_key(layout),
        "seed": config.seed,
        "run": run.name,
        "path": run.path,
        "spacing": run.spacing,
        "trajectory": None if run.trajectory is None else Path(run.trajectory).name,
        "trajectory_key": None if run.trajectory is None else content_key(Path(run.trajectory).read_text("utf-8")),
        "quality": config.quality,
    }


def _without_lines(value: Any) -> Any:
    """Leave out line numbers: a file with one more comment describes the same building."""
    if isinstance(value, dict):
        return {key: _without_lines(item) for key, item in value.items() if key != "line"}
    if isinstance(value, (list, tuple)):
        return [_without_lines(item) for item in value]
    return value


def _is_whole(path: Path) -> bool:
    """Whether a JPEG file is complete, from start marker to end marker."""
    with path.open("rb") as file:
        head = file.read(2)
        file.seek(0, os.SEEK_END)
        if file.tell() < 4:
            return False
        file.seek(-2, os.SEEK_END)
        return head == b"\xff\xd8" and file.read() == b"\xff\xd9"


def _missing(
    config: SimulateConfig, building: Building, run: Run, drive: Track, folder: Path
) -> list[tuple[Run, list[int]]]:
    """Prepare a sequence's folder and return which frames are missing, in batches."""
    sequence = _sequence(folder, building, run)
    images = sequence / "omni_cam"
    wanted = _description(config, building, run)
    note = sequence / "camera.json"
    present: set[str] = set()
    # Any other files in the folder are the user's own.
    pictures = [file for file in images.glob("*.jp*g") if parse_name(file.name)] if images.is_dir() else []
    if pictures:
        if not note.is_file():
            raise DataError(f"{images} holds images that simulate did not render: choose another out")
        try:
            found = read_json(note)
        except FormatError:
            found = None
        if found != wanted and not config.overwrite:
            changed = (
                sorted(key for key in wanted if (found or {}).get(key) != wanted[key]) if found else ["camera.json"]
            )
            raise DataError(
                f"{sequence} holds images of another simulation (different: {', '.join(changed)}): choose another "
                "out, or replace them with overwrite=true"
            )
        if found == wanted:
            present = {file.name for file in pictures if _is_whole(file)}
        with storage_errors(images):
            if any(name not in present for name in drive.names):
                # Done first, so that no list ever names a missing image.
                (sequence / "localization" / "places.lst").unlink(missing_ok=True)
            for file in pictures:
                # Cut short, or from another simulation.
                if file.name not in present:
                    file.unlink(missing_ok=True)
    write_json(note, wanted)
    rows = [row for row, name in enumerate(drive.names) if name not in present]
    return [(run, rows[start : start + _BATCH]) for start in range(0, len(rows), _BATCH)]


def _finish(sequence: Path, drive: Track) -> None:
    """Write the list of a sequence once all of its images are there."""
    lines = [f"{name} {code}\n" for name, code in zip(drive.names, drive.codes, strict=True)]
    write_text(sequence / "localization" / "places.lst", "".join(lines))


def _rendered(config: SimulateConfig, work: list[tuple[Run, list[int]]]) -> Iterator[int]:
    """Render every batch and yield once for each frame written."""
    workers = config.workers or min(processors(), 8)
    workers = min(workers, len(work))
    if workers <= 1:
        global _stage
        _stage = None  # a file of the same name may describe a different building than in an earlier call
        try:
            for run, rows in work:
                for _ in range(_batch(config, run, rows)):
                    yield 1
        finally:
            _stage = None
        return
    with rendering_processes(workers) as pool:
        pending = [pool.submit(_batch, config, run, rows) for run, rows in work]
        try:
            for future in as_completed(pending):
                for _ in range(future.result()):
                    yield 1
        except BrokenProcessPool as error:
            raise DataError(
                "a rendering process died, perhaps for lack of memory: run again with fewer workers, finished images "
                "are kept; in a script, call simulate under `if __name__ == '__main__':`"
            ) from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@dataclass(frozen=True)
class _Stage:
    key: tuple[Any, ...]
    scene: Scene
    drive: Track
    exposure: Exposure


_stage: _Stage | None = None


def _batch(config: SimulateConfig, run: Run, rows: list[int]) -> int:
    """Render some frames of a run in this process, which keeps the scene for the next batch."""
    global _stage
    key = (config.building, config.seed, run)
    if _stage is None or _stage.key != key:
        _stage = None
        scene = build_scene(load_building(config.building, config.seed), run)
        _stage = _Stage(key, scene, scene.state.track, meter(scene, scene.state.track))
    stage = _stage
    images = _sequence(config.out / stage.scene.building.name, stage.scene.building, run) / "omni_cam"
    pictures = frames(stage.scene, stage.drive, make_camera(config.camera), stage.exposure, rows)
    for row, picture in zip(rows, pictures, strict=True):
        _write(images / stage.drive.names[row], picture, config.quality)
    return len(rows)


def _write(path: Path, picture: Array, quality: int) -> None:
    done, coded = cv2.imencode(".jpeg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise ConfigError(f"OpenCV cannot encode {path.name} as JPEG: its build lacks the codec")
    write_bytes(path, coded.tobytes())
