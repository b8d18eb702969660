"""`walk`: from one recording of a robot or of a 360-degree camera to the bundle of a robot that knows where it is."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np

from foundation.calls import OF_FIELDS, takes
from foundation.files import write_text
from foundation.settings import Positive, Rule, Settings
from siamloc import evaluation, maps, runtime
from siamloc.data import AutoRing, Extraction, FrameTable, PanoramaLibrary, Preprocessing, contents, extract, read
from siamloc.data.manifest import manifest_of
from siamloc.data.ring import find_camera
from siamloc.errors import ConfigError, DataError
from siamloc.maps import Survey, SurveySettings, VisualMap
from siamloc.models.registry import PRETRAINED_SIZE
from siamloc.report import write_report
from siamloc.report.draw.survey import save_survey
from siamloc.runs import Run
from siamloc.runtime import Bundle

_NETWORK = "pretrained"
_FEWEST = 60  # key frames: a third of them teaches the error model
_OF_FOLDERS = ("odometry", "form", "order", "offset", "gap", "sequence", "on_error")


@dataclass(frozen=True)
class WalkSettings(Settings):
    """What a walk decides, and may be told.

    Attributes:
        recording: what to take from the recording; poses are not used.
        rate: pictures per second that are looked at, at most; all if the recording has no times.
        unwrap: the camera, as for `PanoramaLibrary`; found if its kind is "auto" (`siamloc.data.find_camera`).
        spacing: distance of two key frames in metres, at least.
        survey: how the survey searches loops.
        left_out: every k-th key frame is left out of the map, to learn the expected errors, and to measure.
        lost_above: expected error in metres above which the robot counts as lost.
    """

    recording: Extraction = field(default_factory=Extraction)
    rate: Positive = 5.0
    unwrap: Mapping[str, Any] = field(default_factory=lambda: {"kind": "auto"})
    spacing: Positive = 0.3
    survey: SurveySettings = field(default_factory=SurveySettings)
    left_out: Annotated[int, Rule("a whole number from 2", lambda value: value >= 2)] = 3
    lost_above: Positive = 1.0


@dataclass(frozen=True)
class Walked:
    """What a walk made.

    Attributes:
        survey: the key frames with their poses.
        known: the map.
        errors: errors of the key frames that were left out of the map, against their surveyed poses.
        bundle: the bundle for the robot.
        report: the page about all of it.
    """

    survey: Survey
    known: VisualMap
    errors: evaluation.Result
    bundle: Bundle
    report: Path


@takes(WalkSettings)
def walk(
    file: str | Path,
    out: str | Path,
    *,
    say: Callable[[str], None] = print,
    settings: WalkSettings = OF_FIELDS,
    **fields: Any,
) -> Walked:
    """Make a robot that knows where it is from one recording of a drive, without true poses.

    Finds the camera, chooses key frames, surveys them, makes a map, learns the expected errors on key frames that are
    left out of it, and writes the robot's bundle and a report. Each decision is one line, with the setting that changes
    it.

    Args:
        file: a video, a ROS bag, a folder of pictures (with times in their names), or a manifest of pictures in
            capture order. With odometry (of the bag, of the manifest, or `recording={"odometry": FILE}`) the map is in
            metres; without, its scale may be off by a tenth or more.
        out: the folder for everything, which is then a run: `siamloc report`, `live` and `localize` take it as run=.
        say: receives the lines.

    Raises:
        DataError: no pictures, no camera that is sure, or too short a way.

    Example:
        >>> made = siamloc.walk("monday.mp4", "robot", recording={"odometry": "wheels.txt"})  # doctest: +SKIP
        >>> siamloc.runtime.Localizer(made.bundle.path).locate("photo.jpg")  # doctest: +SKIP
    """
    folder = Path(out).expanduser()
    frames = _pictures(Path(file).expanduser(), folder, settings, say)
    images = PanoramaLibrary(
        frames, folder / "panoramas", image_size=PRETRAINED_SIZE, unwrap=_camera(frames, settings, say)
    )
    chosen = maps.key_frames(_NETWORK, images, frames, spacing=settings.spacing)
    say(f"key frames: {len(chosen)} of {len(images)}, each {settings.spacing:g} m or more from the last (spacing=)")
    if len(chosen) < _FEWEST:
        raise DataError(
            f"{file} has {len(chosen)} key frames, and a map needs {_FEWEST}: record a way of "
            f"{_FEWEST * settings.spacing:.0f} m or more, or take a smaller spacing than {settings.spacing:g}"
        )
    found = maps.survey(_NETWORK, images, chosen, settings=settings.survey)
    for line in (*(f"note: {note}" for note in found.notes), f"survey: {found.summary()}"):
        say(line)
    save_survey(found, folder, settings.plain())
    write_text(folder / "parts.csv", manifest_of(_parted(found.frames, settings.left_out), folder))
    parts = read("manifest", manifest=folder / "parts.csv")
    images = PanoramaLibrary(
        parts, folder / "panoramas", image_size=PRETRAINED_SIZE, unwrap=images.preprocessing.camera
    )
    known = maps.build(_NETWORK, images, parts.select(sequence="*_map"))
    errors = evaluation.localization(
        known,
        images,
        parts.select(sequence="*_query"),
        validation=parts.select(sequence="*_validation"),
        refine="relative",
        error_model=True,
        lost_above=settings.lost_above,
    )
    say(_judged(known, errors, settings))
    run = Run(folder)
    errors.save(run.evaluation(_NETWORK))
    known.save(run.evaluation(_NETWORK) / "map.npz")
    bundle = runtime.export(
        _NETWORK,
        known,
        run.bundle,
        errors=errors.error_model,
        refinement=errors.refinement,
        images=images,
        thumbnails=True,
    )
    say(bundle.summary())
    report = write_report(folder, folder / "report.html")
    say(f"report: {report}, with the plan in {folder / 'survey.png'}")
    say(f"next: {shlex.join(['siamloc', 'live', f'run={folder}', 'images=[camera:0]'])}")
    return Walked(found, known, errors, bundle, report)


def _pictures(file: Path, folder: Path, settings: WalkSettings, say: Callable[[str], None]) -> FrameTable:
    """Return the frames of a recording, as many per second as are looked at."""
    how, every = settings.recording, 1
    if file.suffix.lower() == ".csv":
        _unused(file, how, ())
        frames = read("manifest", manifest=file)
    elif file.is_dir() and not (file / "metadata.yaml").is_file():
        _unused(file, how, _OF_FOLDERS)
        frames = read("trajectory", images=file, **{key: getattr(how, key) for key in _OF_FOLDERS})
    else:
        inside = contents(file)
        count = inside.topics.get(how.images or inside.proposal.get("images", ""), ("", 0))[1]
        every = max(1, round(count / max(inside.seconds, 1e-9) / settings.rate))
        frames = extract(file, folder / "frames", settings=replace(how, poses="none", every=how.every * every))
    seconds = float(np.ptp(frames.time)) if len(frames) else 0.0
    if every == 1 and seconds > 0:
        frames = frames.every(max(1, round((len(frames) - 1) / seconds / settings.rate)))
    wheels = "with odometry" if np.isfinite(frames.odometry).all(axis=1).any() else "without odometry"
    say(f"recording: {len(frames)} pictures of {file}, {wheels}, at most {settings.rate:g} per second (rate=)")
    return frames


def _unused(file: Path, how: Extraction, used: Sequence[str]) -> None:
    """Refuse settings that a recording of this kind does not take.

    Raises:
        ConfigError: such a setting.
    """
    plain, usual = how.plain(), Extraction().plain()
    if further := sorted(key for key in plain if plain[key] != usual[key] and key not in used):
        raise ConfigError(f"{file} is no bag or video, which recording.{further[0]} is for: leave it out")


def _camera(frames: FrameTable, settings: WalkSettings, say: Callable[[str], None]) -> Any:
    """Return the camera that was given, or that the pictures show."""
    given = Preprocessing.checked(PRETRAINED_SIZE, settings.unwrap).camera
    if not isinstance(given, AutoRing):
        return settings.unwrap
    camera = find_camera(frames.path.tolist(), given)
    plain = Preprocessing.checked(PRETRAINED_SIZE, camera).unwrap_settings()
    shown = {key: value for key, value in plain.items() if isinstance(value, bool | float)}
    told = {key: str(value).lower() if isinstance(value, bool) else f"{value:.6g}" for key, value in shown.items()}
    values = "".join(f" unwrap.{key}={value}" for key, value in told.items())
    say(f"camera: unwrap={plain['kind']}{values}, by the pictures")
    return camera


def _parted(frames: FrameTable, every: int) -> FrameTable:
    """Return key frames in three drives: of every k-th frame, the next in turn for validation and as a query."""
    roles = np.full(len(frames), "map", dtype="U10")
    for rows in frames.rows_by("sequence").values():
        roles[rows[every - 1 :: 2 * every]], roles[rows[2 * every - 1 :: 2 * every]] = "validation", "query"
    names = [f"{name or 'walk'}_{role}" for name, role in zip(frames.sequence.tolist(), roles.tolist(), strict=True)]
    return frames.with_columns(sequence=names)


def _judged(known: VisualMap, errors: evaluation.Result, settings: WalkSettings) -> str:
    refined = cast(dict[str, Any], errors.parts["absolute_refined"])["overall"]["error"]
    return (
        f"map: {len(known)} key frames; of those left out (left_out={settings.left_out}) {len(errors)} are located "
        f"{refined['mean']:.2f} m from where the survey has them, on average"
    )
