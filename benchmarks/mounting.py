"""Locate one simulated drive by the shipped network with a camera that is mounted turned, mirrored or off the centre.

The map is a cloudy drive through `freiburg_like`, the queries another drive at night. The panoramas are those of a
straight camera, turned or flipped as such a camera would store them; for a camera off the robot's centre, the poses
are moved. The map estimates the mounting from its own frames; a map that takes the camera for straight is the
comparison.

Targets: no mounting loses more than 0.005 m of the mean error of refined poses, and angles are stated within 1 degree.

    python -m benchmarks.mounting --data data/mounting
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import siamloc
from analytic import Description
from benchmarks.report import Report, parser
from siamloc.data import FrameTable, Mounting, PanoramaLibrary, PanoramaView
from siamloc.evaluation.metrics import error_floor
from siamloc.simulate import Run, build_scene, load_building
from siamloc.simulate.camera import PanoramaCamera
from siamloc.simulate.rendering import frames as rendered
from siamloc.simulate.rendering import meter

MOUNTINGS = {
    "straight": Mounting(),
    **{f"{yaw} degrees": Mounting(yaw) for yaw in (10, 30, 90, 180)},
    "mirrored": Mounting(mirrored=True),
    "mirrored, 30 degrees": Mounting(30, mirrored=True),
    "off the centre": Mounting(ahead=0.3, left=-0.1),
}
MOST_LOST, CLOSE = 0.005, 1.0
_DRIVES = {"map": ("cloudy", 3, 0, 110), "query": ("night", 7, 3, 44)}  # lighting, every which frame, from which, count
_WIDE = PanoramaCamera(PanoramaView(64, 1440))  # a quarter of a degree a column
_NEAR = 0.7  # m, queries farther from all map frames are left out


def main() -> None:
    """Render, locate, print a table and write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="folder for the images")
    options = arguments.parse_args()
    by = siamloc.models.as_descriptor(siamloc.models.pretrained(), "cpu")
    report, rows = Report("mounting", options.out), dict[str, dict[str, Any]]()
    drives = {name: _rendered(*drive) for name, drive in _DRIVES.items()}
    for name, mounting in MOUNTINGS.items():
        tables = [_stored(options.data / name.replace(" ", "_") / drive, *drives[drive], mounting) for drive in drives]
        images = PanoramaLibrary(siamloc.data.concatenate(tables), options.data / "cache", image_size=(64, 256))
        found = siamloc.data.find_mounting(by, images, tables[0])
        known = siamloc.maps.build(by, images, tables[0], progress=False)
        unaware = siamloc.maps.build(by, images, tables[0], mounting=Mounting(), progress=False)
        off = (found.yaw - mounting.yaw + 180) % 360 - 180
        rows[name] = {
            "mean": _mean_error(known, images, tables[1]),
            "unaware": _mean_error(unaware, images, tables[1]),
            "yaw": found.yaw,
            "yaw_deviation": found.yaw_deviation,
            "yaw_error": abs(off),
            "mirrored": found.mirrored,
            "offset": found.offset,
        }
        print(f"{name:22} {rows[name]['mean']:.3f} m, unaware {rows[name]['unaware']:.3f} m; {found.summary()}")
    lost = max(row["mean"] for row in rows.values()) - rows["straight"]["mean"]
    worst = max(row["yaw_error"] for row in rows.values())
    right = all(row["mirrored"] == MOUNTINGS[name].mirrored for name, row in rows.items())
    report.target(f"no mounting loses more than {MOST_LOST} m ({lost:.4f})", lost <= MOST_LOST)
    report.target(f"angles are stated within {CLOSE:g} degree ({worst:.2f})", worst <= CLOSE)
    report.target("mirrored panoramas are recognized, and no others", right)
    report.write({"rows": rows, "lost": lost, "worst_yaw_error": worst})


def _rendered(light: str, every: int, start: int, count: int) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Return the panoramas (n, H, W, 3) and poses (n, 3) of a drive by a straight camera."""
    scene = build_scene(load_building("freiburg_like"), Run(light, 1))
    track = scene.state.track
    chosen = np.arange(len(track))[start::every][:count]
    return np.stack(list(rendered(scene, track, _WIDE, meter(scene, track), chosen))), track.poses[chosen]


def _stored(folder: Path, images: NDArray[np.uint8], poses: NDArray[np.float64], mounting: Mounting) -> FrameTable:
    """Write the panoramas as a camera that is mounted so stores them, and return the frames with the robot's poses."""
    folder.mkdir(parents=True, exist_ok=True)
    turned = np.roll(images, round(mounting.yaw * images.shape[2] / 360), axis=2)
    paths = [folder / f"{row:04d}.png" for row in range(len(images))]
    for path, image in zip(paths, turned[:, :, ::-1] if mounting.mirrored else turned, strict=True):
        cv2.imwrite(str(path), image[..., ::-1])
    (x, y), theta = (poses[:, :2] - mounting.offset(poses[:, 2])).T, poses[:, 2]
    names = [str(path) for path in paths]
    return FrameTable(path=names, x=x, y=y, theta=theta, sequence=[folder.name] * len(names))


def _mean_error(known: siamloc.maps.VisualMap, images: PanoramaLibrary, queries: FrameTable) -> float:
    """Return the mean error of refined poses in m."""
    queries = queries.take(error_floor(known.frames.xy, queries.xy) < _NEAR)
    asked = Description.concatenate(list(siamloc.maps.describe(known, images, queries)))
    poses = siamloc.maps.refine(known, asked, siamloc.maps.match(known, asked, 8))
    return float(np.linalg.norm(np.asarray(poses.xy) - queries.xy, axis=1).mean())


if __name__ == "__main__":
    main()
