"""Walk through a building with a ring camera, and locate another drive, at night, with what `walk` makes of it.

A cloudy drive becomes a video, 30 pictures per second, of a camera below a hyperbolic mirror, with simulated odometry
that drifts, and without. Its panoramas are rendered every 0.07 m, about five per second, and each is shown several
times. `siamloc.walk` turns the video into a bundle; its localizer then gets every third picture of a night drive.
Errors are mean distances in m: of the surveyed key frames from the true path, and of the located pictures, both after
the rigid motion that fits the survey to the true path best; without odometry also after the best scale. Minutes are
those of a processor, of one thread, so that other work on the machine does not count. With `--carried`, a row of a
360-degree camera that somebody carries is added: it sways by 3 degrees (standard deviation, to the side and ahead),
about once in a second, in the walk and at night, and no sensor says how.

Targets: located at night with a mean error of at most 0.20 m with odometry and 0.40 m without, in at most 10 minutes.

    siamloc simulate camera=panorama runs=[cloudy3] spacing=0.07 out=data
    siamloc simulate camera=panorama runs=[night2] out=data
    OMP_NUM_THREADS=1 python -m benchmarks.walk --data data/freiburg_like

The record also has `building=random` with the seeds 414 and 461, whose drives pass through no door's open leaf, and
`--carried data/carried`.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import siamloc
from benchmarks.report import Report, hardware, parser
from siamloc.data import EquirectangularCamera, FrameTable, HyperbolicMirror, PanoramaView, azimuth_column
from siamloc.evaluation.metrics import aligned_trajectory
from siamloc.maps import Survey
from siamloc.simulate import Run, build_scene, load_building
from siamloc.simulate.camera import OmnidirectionalCamera
from siamloc.simulate.odometry import odometry
from siamloc.simulate.rendering import frames as rendered
from siamloc.simulate.rendering import meter

MOST = {"with odometry": 0.20, "without odometry": 0.40}
MINUTES = 10
RATE = 30  # pictures per second of the video
_SHAPE = (480, 640)
_MIRROR = HyperbolicMirror()
_BODY = 40  # grey level of the camera's own parts
_CARRIED = "random", 414  # the building of the camera that is carried
_SWAY, _STEPS = 3.0, (0.6, 0.9)  # degrees, and Hz to the side and ahead

Pictures = Callable[[FrameTable], Iterator[NDArray[np.uint8]]]


def main() -> None:
    """Walk, locate, print a table and write the file."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--data", type=Path, nargs="*", default=[], help="rendered buildings")
    arguments.add_argument("--carried", type=Path, help="pictures of a camera that is carried, rendered where missing")
    arguments.add_argument("--frames", type=int, help="of the walk; all if not given")
    options = arguments.parse_args()
    report = Report("walk", options.out)
    rows = {data.resolve().name: measured(*_drives(data), ring_pictures, options.frames) for data in options.data}
    if options.carried is not None:
        rows["random_414, carried"] = measured(*carried(options.carried), stored_pictures, options.frames)
    rows = report.kept(rows) if options.keep else rows
    for name, row in rows.items():
        for way, most in MOST.items():
            found = row[way]["located"]["mean"]
            report.target(f"{name}, {way}: at most {most:.2f} m at night ({found:.3f})", found <= most)
            minutes = row[way]["processor_seconds"] / 60
            report.target(f"{name}, {way}: at most {MINUTES} minutes ({minutes:.1f})", minutes <= MINUTES)
    print(f"{hardware()['cpu']}\n\n{table(rows)}")
    report.write({"rows": rows})


def measured(day: FrameTable, night: FrameTable, pictures: Pictures, frames: int | None) -> dict[str, Any]:
    """Return the figures of a walk by day and of pictures at night, with odometry and without."""
    day, night = day.take(np.arange(len(day))[:frames]), night.every(3)
    row: dict[str, Any] = {"metres": float(np.hypot(*np.diff(day.xy, axis=0).T).sum()), "rendered": len(day)}
    with tempfile.TemporaryDirectory() as folder:
        film(day, pictures, Path(folder) / "cloudy.avi")
        write_odometry(day, Path(folder) / "wheels.txt")
        for way in MOST:
            row[way] = walked(day, night, pictures, Path(folder), wheels=way == "with odometry")
            print(f"{way}: {row[way]}", flush=True)
    return row


def walked(day: FrameTable, night: FrameTable, pictures: Pictures, folder: Path, *, wheels: bool) -> dict[str, Any]:
    """Return the figures of a walk by the video in a folder, with its odometry or without."""
    given = {"odometry": str(folder / "wheels.txt")} if wheels else {}
    begin, used = time.monotonic(), time.process_time()
    made = siamloc.walk(folder / "cloudy.avi", folder / str(wheels), recording=given)
    seconds, used = time.monotonic() - begin, time.process_time() - used
    located = siamloc.runtime.Localizer(made.bundle.path)
    asked = [located.locate(picture) for picture in pictures(night)]
    frames, true = made.survey.frames, true_poses(made.survey, day)
    surveyed = np.column_stack([frames.xy, frames.theta])
    found = np.array([[one.x, one.y, one.theta or 0.0] for one in asked])
    moved = _aligned(surveyed, true, np.concatenate([surveyed, found]), not wheels)
    off = np.hypot(*(moved[: len(true), :2] - true[:, :2]).T)
    near = np.hypot(*(night.xy[:, None] - true[None, :, :2]).transpose(2, 0, 1)).min(axis=1) < 1.0
    errors = np.hypot(*(moved[len(true) :, :2] - night.xy).T)[near]
    lost = np.array([bool(one.lost) for one in asked])[near]
    return {
        "seconds": seconds,
        "processor_seconds": used,
        "key_frames": len(frames),
        "surveyed": float(off.mean()),
        "located": {
            "queries": int(near.sum()),
            "mean": float(errors.mean()),
            "median": float(np.median(errors)),
            "p95": float(np.quantile(errors, 0.95)),
            "lost": float(lost.mean()),
            "mean_unless_lost": float(errors[~lost].mean()),
        },
        "megabytes": made.bundle.bytes / 1e6,
    }


def film(drive: FrameTable, pictures: Pictures, path: Path) -> None:
    """Write the pictures of a drive as a video; each shows what the camera saw last."""
    shown = np.bincount(np.ceil((drive.time - drive.time[0]) * RATE).astype(int)).cumsum()  # pictures so far
    counts = np.unique(shown, return_counts=True)[1].tolist()
    writer = None
    for picture, count in zip(pictures(drive), counts, strict=True):
        size = picture.shape[1::-1]
        writer = writer or cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), RATE, size)
        for _ in range(count):
            writer.write(np.ascontiguousarray(picture[..., ::-1]))
    if writer is not None:
        writer.release()


def stored_pictures(drive: FrameTable) -> Iterator[NDArray[np.uint8]]:
    """Yield the pictures of a drive, RGB, as they are stored."""
    for path in drive.path.tolist():
        yield cv2.imread(path)[..., ::-1]


def carried(folder: Path) -> tuple[FrameTable, FrameTable]:
    """Return a drive by day and one at night of a 360-degree camera that sways, rendered into the folder if missing."""
    camera = OmnidirectionalCamera(EquirectangularCamera(), (400, 800))
    building, tables = load_building(_CARRIED[0], seed=_CARRIED[1]), []
    for run in (Run("cloudy", 3, spacing=0.07), Run("night", 2)):
        scene = build_scene(building, run)
        track = scene.state.track
        paths = [folder / run.name / f"{row:04d}.png" for row in range(len(track))]
        if missing := [row for row, path in enumerate(paths) if not path.is_file()]:
            paths[0].parent.mkdir(parents=True, exist_ok=True)
            exposure, since = meter(scene, track), track.time - track.time[0]
            roll, elevation = (_SWAY * np.sqrt(2) * np.sin(2 * np.pi * rate * since) for rate in _STEPS)
            for row in missing:
                model = replace(camera.model, roll=float(roll[row]), elevation=float(elevation[row]))
                (image,) = rendered(scene, track, replace(camera, model=model), exposure, [row])
                cv2.imwrite(str(paths[row]), image[..., ::-1])
        x, y, theta = track.poses.T
        named = {"path": list(map(str, paths)), "sequence": [run.name] * len(paths)}
        tables.append(FrameTable(**named, x=x, y=y, theta=theta, time=track.time))
    return tables[0], tables[1]


def ring_pictures(drive: FrameTable) -> Iterator[NDArray[np.uint8]]:
    """Yield the pictures (480, 640, 3), RGB, that a camera below a mirror takes of what the panoramas show."""
    for path in drive.path.tolist():
        panorama = cv2.imread(path)
        columns, rows, inside = _sampling(panorama.shape[:2])
        picture = cv2.remap(panorama, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        yield np.where(inside[..., None], picture, _BODY)[..., ::-1].astype(np.uint8)


@lru_cache(maxsize=2)
def _sampling(size: tuple[int, int]) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Return the columns and rows of a panorama that the pixels of the ring show, and which pixels show any."""
    view = PanoramaView(*size)
    pixels = np.stack(np.meshgrid(np.arange(_SHAPE[1]), np.arange(_SHAPE[0])), axis=-1).astype(np.float64)
    ahead, left, up = np.moveaxis(_MIRROR.back_project(pixels), -1, 0)
    high, low = np.tan(np.radians([view.top, view.bottom]))
    share = (high - up / np.hypot(ahead, left)) / (high - low)
    inside = np.isfinite(share) & (share >= 0) & (share <= 1)
    columns = azimuth_column(np.arctan2(left, ahead), view.width)
    rows = np.clip(np.nan_to_num(share) * view.height - 0.5, 0, view.height - 1)
    return np.nan_to_num(columns).astype(np.float32), rows.astype(np.float32), inside


def write_odometry(drive: FrameTable, path: Path) -> None:
    """Write simulated odometry of a drive in TUM form, in the clock of its video."""
    x, y, theta = odometry(np.column_stack([drive.xy, drive.theta]), np.random.default_rng(0)).T
    zero = np.zeros(len(x))
    columns = [drive.time - drive.time[0], x, y, zero, zero, zero, np.sin(theta / 2), np.cos(theta / 2)]
    np.savetxt(path, np.column_stack(columns), fmt="%.6f")


def true_poses(found: Survey, drive: FrameTable) -> NDArray[np.float64]:
    """Return the true poses (n, 3) of surveyed frames, by the times of their pictures in the video."""
    rows = np.searchsorted(np.ceil((drive.time - drive.time[0]) * RATE), np.rint(found.frames.time * RATE), "right") - 1
    return np.column_stack([drive.xy, drive.theta])[rows]


def table(rows: dict[str, Any]) -> str:
    """Return the figures as a table of Markdown."""
    lines = ["| building | odometry | key frames | surveyed, m | at night, m | minutes |", "|---|---|---|---|---|---|"]
    for name, row in rows.items():
        for way in MOST:
            one = row[way]
            cells = (f"{one['surveyed']:.2f}", f"{one['located']['mean']:.2f}", f"{one['processor_seconds'] / 60:.1f}")
            lines.append(f"| {name} | {way.split()[0]} | {one['key_frames']} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _aligned(
    given: NDArray[np.float64], true: NDArray[np.float64], poses: NDArray[np.float64], scale: bool
) -> NDArray[np.float64]:
    """Return poses (m, 3) after the motion, and scale, that fit the given poses (n, 3) to the true ones best."""
    fitted = aligned_trajectory(given, true, scale=scale)
    columns = np.column_stack([given[:, :2], np.ones(len(given))])
    motion = np.linalg.lstsq(columns, fitted[:, :2], rcond=None)[0]
    return np.column_stack([poses[:, :2], np.ones(len(poses))]) @ motion


def _drives(data: Path) -> tuple[FrameTable, FrameTable]:
    """Return the last cloudy drive of a rendered building, and its last one at night."""
    drives = siamloc.data.read("cold", root=data)
    day, night = (_last(drives, f"*{name}*") for name in ("cloudy3", "night"))
    return day, night


def _last(frames: FrameTable, pattern: str) -> FrameTable:
    """Return the last drive that matches, in the order of its times."""
    some = frames.select(sequence=pattern)
    some = some.select(sequence=sorted(set(some.sequence.tolist()))[-1])
    return some.take(np.argsort(some.time, kind="stable"))


if __name__ == "__main__":
    main()
