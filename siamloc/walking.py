"""`walk`: from one recording of a robot or of a 360-degree camera to the bundle of a robot that knows where it is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, cast

import numpy as np

from foundation.calls import OF_FIELDS, takes
from foundation.files import expanded, read_json, write_json, write_text
from foundation.settings import Positive, Rule, Settings, Text
from foundation.words import as_words
from siamloc import evaluation, maps, runtime
from siamloc.data import (
    AutoRing,
    DualFisheyeCamera,
    Extraction,
    HyperbolicMirror,
    PanoramaLibrary,
    PanoramaView,
    PolarRing,
    Preprocessing,
    extract,
    find_camera,
    read,
)
from siamloc.data.checks import unseen
from siamloc.data.extracting import writes_camera
from siamloc.data.manifest import manifest_of
from siamloc.data.photo_sphere import stated
from siamloc.data.picture_checks import drive_faults
from siamloc.errors import ConfigError, DataError
from siamloc.maps import Survey, SurveySettings, VisualMap
from siamloc.maps.floor import shows_floor
from siamloc.models.registry import PRETRAINED_SIZE
from siamloc.report import write_report
from siamloc.report.draw.survey import save_survey
from siamloc.runs import Run
from siamloc.runtime import Bundle
from siamloc.runtime.exportable import check_counted, check_not_updated

_NETWORK = "pretrained"
_LOOKED_AT, _SWAYS = 40, 1.0  # pictures, and the tilt in degrees from which on each is levelled
_RIM = 1.0  # degrees by which the inner rim of a ring may differ from what the guide says
_POSITIONS, _SCALE = 0.4, 0.25  # typical deviation in metres, and that of the scale, above which a map is of little use
_FEWEST = 60  # key frames: a third of them teaches the error model


@dataclass(frozen=True)
class Recording(Extraction):
    """What to take from the recording of a walk: no poses, and five pictures per second."""

    poses: Text | None = "none"
    rate: Positive | None = 5.0


@dataclass(frozen=True)
class WalkSettings(Settings):
    """Settings of a walk, each of which has a usual value.

    Attributes:
        recording: what to take from the recording; poses are not used.
        unwrap: the camera, as for `PanoramaLibrary`; found if its kind is "auto" (`siamloc.data.find_camera`). Whether
            its pictures are levelled is decided by how much they are tilted, unless `level` says it.
        spacing: distance of two key frames in metres, at least.
        survey: how the survey searches loops, and the height of the camera.
        left_out: every k-th key frame is left out of the map, to learn the expected errors, and to measure.
        lost_above: expected error in metres above which the robot counts as lost.
    """

    recording: Recording = field(default_factory=Recording)
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
    overwrite: bool = False,
    settings: WalkSettings = OF_FIELDS,
    **fields: Any,
) -> Walked:
    """Make a robot that knows where it is from one recording of a drive, without true poses.

    Finds the camera, chooses key frames, surveys them, makes a map, learns the expected errors on key frames that are
    left out of it, and writes the robot's bundle and a report. Most decisions are lines of what it says.

    Args:
        file: a video, a ROS bag, or a folder of pictures, with times in their names or in capture order. With odometry
            (of the bag, or `recording={"odometry": FILE}`), or the height of the camera (`survey={"height": 0.95}`),
            the map is in metres; without, its scale may be off by a tenth or more.
        out: the folder for everything, which is then a run: `siamloc report`, `live` and `localize` take it as run=.
        say: receives the lines.
        overwrite: replace a bundle in the folder even if robots updated its map.
        settings: all fields of `WalkSettings` together, instead of one keyword each.

    Raises:
        ConfigError: a bundle in the folder whose map robots updated, or a left_out with which too few key frames are
            left out.
        DataError: no pictures, no camera that is sure, or too short a way.

    Example:
        >>> made = siamloc.walk("monday.mp4", "robot", recording={"odometry": "wheels.txt"})  # doctest: +SKIP
        >>> siamloc.runtime.Localizer(made.bundle.path).locate("photo.jpg")  # doctest: +SKIP
    """
    folder, lines = expanded(out), list[str]()
    say = partial(_say, say, lines)
    if not overwrite:
        check_counted(Run(folder).bundle, None)
        check_not_updated(Run(folder).evaluation(_NETWORK) / "map.npz")
    if not writes_camera(folder / "frames", settings.unwrap):
        Preprocessing.checked(PRETRAINED_SIZE, settings.unwrap)  # before the long work
    frames = extract(file, folder / "frames", second=settings.unwrap.get("second"), settings=settings.recording)
    given = Preprocessing.checked(PRETRAINED_SIZE, settings.unwrap)
    wheels = int(np.isfinite(frames.odometry).all(axis=1).sum())
    share = f" of {wheels} of them" if 0 < wheels < len(frames) else ""
    has = f"{'with' if wheels else 'without'} odometry{share} (recording.odometry=)"
    say(f"recording: {len(frames)} pictures of {file} (recording.rate=), {has}")
    camera = replace(given, camera=find_camera(frames.path.tolist(), given.camera))
    size = camera.usual_size(frames.path.tolist())
    shape = f" (unwrap=), for pictures of {size[1]} x {size[0]} px" if size else " (unwrap=)"
    placed = size is not None and stated(camera.camera, frames.path[0], size) != camera.camera
    ring, seen = camera.camera, ", each placed and levelled by what it says of itself" * placed
    if ring is None:
        top, bottom = (f"{edge:g}" for edge in (camera.view.top, camera.view.bottom))
        seen = (
            f", assumed to be panoramas of {top} to {bottom} degrees of elevation: parts of whole 360-degree pictures "
            f"are unwrap=equirectangular unwrap.highest={top} unwrap.lowest={bottom}, with the degrees that they show"
        )
    say(f"camera: {camera.words()}{shape}{seen}")
    if isinstance(ring, DualFisheyeCamera) and ring == (usual := DualFisheyeCamera(second=ring.second)):
        say(f"lenses: each is taken to see {usual.front.fov:g} degrees (unwrap.front.fov=, unwrap.back.fov=)")
    if isinstance(given.camera, AutoRing) and isinstance(ring, HyperbolicMirror):
        low, usual_low = np.degrees(ring.lowest_elevation), PanoramaView().bottom
        if abs(low - usual_low) > _RIM:
            say(
                f"rims: the inner rim is taken for {low:.0f} degrees of elevation, since no mirror that is built shows "
                f"{usual_low:g} in such a ring: a calibrated camera is more exact (unwrap=calibrated)"
            )
    if not wheels and isinstance(given.camera, AutoRing) and isinstance(ring, HyperbolicMirror | PolarRing):
        mirrored = "mirrored" if ring.mirrored else "not mirrored"
        say(f"direction: the robot is taken to drive ahead, and the picture to be {mirrored} (unwrap.mirrored=)")
    unsettled = settings.unwrap.get("level") is None and not np.isfinite(frames.tilt).any()
    if unsettled and camera.elevations is not None and len(tilts := camera.tilts(frames.path.tolist(), _LOOKED_AT)):
        tilt = np.degrees(np.median(np.hypot(*tilts.T)))
        camera = replace(camera, level=bool(tilt > _SWAYS))
        how = "levelled by upright edges" if camera.level else "taken as they are"
        say(f"level: pictures are tilted by {tilt:.1f} degrees in the median, and {how} (unwrap.level=)")
    library = partial(
        PanoramaLibrary, cache=folder / "panoramas", image_size=PRETRAINED_SIZE, unwrap=camera.unwrap_settings()
    )
    images = library(frames)
    shows_floor(images, settings.survey.height)  # or refuse the height before the long work
    for fault in (*unseen(images), *drive_faults(images.readable(frames), images)):
        say(f"note: {fault}")
    chosen = maps.key_frames(_NETWORK, images, frames, spacing=settings.spacing)
    say(f"key frames: {len(chosen)} of {len(images)}, each {settings.spacing:g} m or more from the last (spacing=)")
    if len(chosen) < _FEWEST:
        longer = np.ceil(10 * _FEWEST / len(chosen)) / 10  # key frames are farther apart than `spacing`
        raise DataError(
            f"{file} has {len(chosen)} key frames, and a map needs {_FEWEST}: record {longer:.1f} times this way or "
            f"more, or take a smaller spacing than {settings.spacing:g}"
        )
    if 2 * settings.left_out > len(chosen):
        raise ConfigError(
            f"left_out={settings.left_out} leaves too few of {len(chosen)} key frames out to measure with"
        )
    found = maps.survey(_NETWORK, images, chosen, settings=settings.survey)
    for line in (*(f"note: {note}" for note in found.notes), f"survey: {found.summary()}"):
        say(line)
    if found.typical_deviation > _POSITIONS or found.scale_deviation > _SCALE:
        of_all = " of all pictures" if wheels else ""
        lacks = [f"give odometry{of_all} (recording.odometry=)"] if wheels < len(frames) else []
        if settings.survey.height is None and not (wheels and found.floor is None):
            lacks.append("give the height of a camera of known elevations (survey.height=)")
        say(
            f"note: the survey is not exact, its positions only within {found.typical_deviation:.2f} m and its scale "
            f"within {found.scale_deviation:.0%}: {', or '.join([*lacks, 'record a way that visits places again'])}"
            f"{found.doubt}"
        )
    save_survey(found, folder, settings.plain())
    part = np.full(len(chosen), "map", dtype="U10")
    part[settings.left_out - 1 :: 2 * settings.left_out] = "validation"
    part[2 * settings.left_out - 1 :: 2 * settings.left_out] = "query"
    write_text(folder / "parts.csv", manifest_of(found.frames.with_columns(sequence=part), folder))
    parts = read("manifest", manifest=folder / "parts.csv")
    images = library(parts)
    known = maps.build(_NETWORK, images, parts.select(sequence="map"))
    errors = evaluation.localization(
        known,
        images,
        parts.select(sequence="query"),
        validation=parts.select(sequence="validation"),
        refine="relative",
        error_model=True,
        lost_above=settings.lost_above,
    )
    off = cast(dict[str, Any], errors.parts["absolute_refined"])["overall"]["error"]["mean"]
    left_out = f"of those left out (left_out={settings.left_out}) {len(errors)}"
    apart = f"{off:.2f} m from where the survey has them, on average{found.doubt}"
    say(f"map: {len(known)} key frames; {left_out} are located {apart}")
    if off > 2 * (settings.spacing + found.typical_deviation):
        say(
            "note: the key frames that were left out look like others elsewhere: the robot will take places that look "
            "the same for each other, or the survey is wrong (see the plan): do not rely on it without looking"
        )
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
        overwrite=overwrite,
    )
    say(bundle.summary())
    write_json(folder / "survey.json", {**read_json(folder / "survey.json"), "walk": lines})
    report = write_report(folder, folder / "report.html")
    say(f"report: {report}, with the plan in {folder / 'survey.png'}")
    say(f"next: siamloc live {as_words({'run': folder, 'images': ['camera:0']})}")
    return Walked(found, known, errors, bundle, report)


def _say(say: Callable[[str], None], lines: list[str], line: str) -> None:
    """Say a line, and keep it for the report."""
    lines.append(line)
    say(line)
