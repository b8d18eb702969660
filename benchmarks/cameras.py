"""Locate one simulated drive by the shipped network through different cameras.

The map is a cloudy drive through `freiburg_like`, the queries another drive at night: each frame is rendered as a
panorama, as the network was trained on, and through each camera, whose picture is unwrapped. Poses are refined by
comparison with the map frames. One camera also sways, by angles of 3 degrees (standard deviation of both) that differ
from frame to frame, with its pictures levelled by their upright edges and not.

Targets: no camera loses more than 0.01 m of the mean error against panoramas, neither with its own map nor in the map
of another camera, nor does the one that sways if it is levelled.

    python -m benchmarks.cameras --data data/cameras --picture docs/cameras.jpg
    python -m benchmarks.cameras --data data/cameras --levelled docs/levelled.jpg
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import siamloc
from analytic import Description
from benchmarks.report import Report, parser
from foundation.files import write_picture
from siamloc.data import (
    DoubleSphereCamera,
    DualFisheyeCamera,
    EquirectangularCamera,
    FisheyeCamera,
    FrameTable,
    PanoramaLibrary,
    PanoramaView,
    Preprocessing,
    UnifiedCamera,
    seen,
    unwrap,
)
from siamloc.evaluation.metrics import error_floor
from siamloc.report.draw.look import style
from siamloc.simulate import Run, build_scene, load_building, render
from siamloc.simulate.camera import Camera, OmnidirectionalCamera, PanoramaCamera
from siamloc.simulate.rendering import frames as rendered
from siamloc.simulate.rendering import meter

PANORAMA = "panorama"
_MIRROR = UnifiedCamera(
    fx=131.0, xi=0.94, distortion=(-0.02, 0.001, 0.0005, -0.0003), elevation=-90, mirrored=True, fov=250
)
CAMERAS: dict[str, Camera] = {
    PANORAMA: PanoramaCamera(PanoramaView(*siamloc.models.pretrained().image_size)),
    "hyperbolic": OmnidirectionalCamera(),
    "equirectangular": OmnidirectionalCamera(EquirectangularCamera(), (400, 800)),
    "dual fisheye": OmnidirectionalCamera(DualFisheyeCamera(), (440, 880)),
    "unified": OmnidirectionalCamera(_MIRROR, (480, 640)),
}
SHOWN: dict[str, OmnidirectionalCamera] = {
    **{name: camera for name, camera in CAMERAS.items() if isinstance(camera, OmnidirectionalCamera)},
    "double sphere": OmnidirectionalCamera(
        DoubleSphereCamera(fx=74.0, xi=-0.1, alpha=0.52, elevation=90, roll=180, fov=284), (640, 640)
    ),
    "fisheye, 220 degrees": OmnidirectionalCamera(FisheyeCamera(fov=220, elevation=90, roll=180), (640, 640)),
}
SWAYING, LEVELLED = "equirectangular, swaying", "equirectangular, swaying, levelled"
MOST_LOST = 0.01
_SWAY = 3.0  # degrees
_DRIVES = {"map": ("cloudy", 6, 0, 36), "query": ("night", 7, 3, 40)}  # lighting, every which frame, from which, count
_NEAR = 0.7  # m, queries farther from all map frames are left out
_COMPARED = 8


def main() -> None:
    """Render, locate, print a table and write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="folder of the images, rendered where missing")
    arguments.add_argument("--picture", type=Path, help="only draw this picture of one place through the cameras")
    arguments.add_argument("--levelled", type=Path, help="only draw this picture of the camera that sways")
    options = arguments.parse_args()
    if options.levelled is not None:
        draw_levelled(options.data / SWAYING / "map", options.levelled)
        return
    if options.picture is not None:
        draw(options.picture)
        return
    network, report = siamloc.models.pretrained(), Report("cameras", options.out)
    libraries, maps, rows = {}, {}, dict[str, dict[str, Any]]()
    swaying = dict.fromkeys((SWAYING, LEVELLED), CAMERAS["equirectangular"])
    for name, camera in {**CAMERAS, **swaying}.items():
        frames = drives(options.data / (SWAYING if name in swaying else name), camera, _SWAY * (name in swaying))
        options_of = {"kind": "equirectangular", "level": name == LEVELLED}
        unwrapped = None if isinstance(camera, PanoramaCamera) else options_of if name in swaying else camera.model
        images = PanoramaLibrary(frames, options.data / "cache", unwrap=unwrapped, **network.view)
        libraries[name] = images
        maps[name] = siamloc.maps.build(network, images, frames.select(sequence="map"), progress=False)
    first = maps[PANORAMA].descriptors
    for name, known in maps.items():
        own = located(known, libraries[name])
        cross = own if name == PANORAMA else located(maps["hyperbolic"], libraries[name])
        apart = float(np.linalg.norm(known.descriptors - first, axis=1).mean())
        rows[name] = {**own, "in_map_of_hyperbolic": cross["mean"], "descriptor_distance": apart}
        print(
            f"{name:34} mean {own['mean']:.3f} m, in the map of another camera {cross['mean']:.3f} m, {apart:.2f} apart"
        )
    between = float(np.linalg.norm(np.diff(first, axis=0), axis=1).mean())
    judged = [row[key] for name, row in rows.items() if name != SWAYING for key in ("mean", "in_map_of_hyperbolic")]
    lost = max(judged) - rows[PANORAMA]["mean"]
    report.target(f"no camera loses more than {MOST_LOST} m ({lost:.3f})", lost <= MOST_LOST)
    report.write({"rows": rows, "between_map_frames": between})


def drives(folder: Path, camera: Camera, sway: float = 0.0) -> FrameTable:
    """Return the frames of both drives through a camera that sways by some degrees, rendered if missing."""
    tables, rng = [], np.random.default_rng(0)
    for name, (light, every, start, count) in _DRIVES.items():
        scene = build_scene(load_building("freiburg_like"), Run(light, 1))
        track = scene.state.track
        rows = np.arange(len(track))[start::every][:count]
        paths = [folder / name / f"{row:04d}.png" for row in rows]
        if not all(path.is_file() for path in paths):
            (folder / name).mkdir(parents=True, exist_ok=True)
            exposure = meter(scene, track)
            for path, row in zip(paths, rows, strict=True):
                held = camera
                if sway and isinstance(camera, OmnidirectionalCamera):
                    elevation, roll = rng.normal(0, sway, 2)
                    held = replace(camera, model=replace(camera.model, elevation=elevation, roll=roll))
                (image,) = rendered(scene, track, held, exposure, [row])
                cv2.imwrite(str(path), image[..., ::-1])
        x, y, theta = track.poses[rows].T
        tables.append(
            FrameTable(path=[str(path) for path in paths], x=x, y=y, theta=theta, sequence=[name] * len(rows))
        )
    return siamloc.data.concatenate(tables)


def located(known: siamloc.maps.VisualMap, images: PanoramaLibrary) -> dict[str, Any]:
    """Return the errors of the queries in m: those of the nearest map frames, and those of the refined poses."""
    queries = images.frames.select(sequence="query")
    queries = queries.take(error_floor(known.frames.xy, queries.xy) < _NEAR)
    asked = Description.concatenate(list(siamloc.maps.describe(known, images, queries)))
    found = siamloc.maps.match(known, asked, _COMPARED)
    poses = siamloc.maps.refine(known, asked, found)
    nearest = np.linalg.norm(known.frames.xy[found.indices[:, 0]] - queries.xy, axis=1)
    errors = np.linalg.norm(np.asarray(poses.xy) - queries.xy, axis=1)
    return {
        "queries": len(queries),
        "nearest": float(nearest.mean()),
        "mean": float(errors.mean()),
        "median": float(np.median(errors)),
    }


def draw(path: Path) -> Path:
    """Draw one place through each camera, with its panorama beside it, and return the file."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    view = PanoramaView()
    scene = build_scene(load_building("freiburg_like"), Run("cloudy", 1))
    pose = scene.state.track.poses[[60]]
    with style():
        figure = Figure(figsize=(10, 8.6), dpi=130)
        canvas = FigureCanvasAgg(figure)
        grid = figure.subplots(len(SHOWN), 3, width_ratios=[0.42, 1, 2])
        for (label, left, right), (name, camera) in zip(grid, SHOWN.items(), strict=True):
            image: NDArray[np.uint8] = render(scene, pose, camera)[0]
            left.imshow(image)
            right.imshow(unwrap(image, camera.model, view))
            sees = seen(camera.model, view, camera.shape)
            if not sees.all():
                right.contour(sees, levels=[0.5], colors="#D55E00", linewidths=1.2, linestyles="--")
            label.text(1, 0.5, name.replace(", ", ",\n"), ha="right", va="center", transform=label.transAxes)
            for axes in (label, left, right):
                axes.set_anchor("E")
                axes.set(xticks=[], yticks=[])
                axes.grid(visible=False)
                for spine in axes.spines.values():
                    spine.set_visible(False)
        grid[0, 1].set_title("picture of the camera")
        grid[0, 2].set_title("panorama, 30 to -45 degrees of elevation")
        canvas.draw()
        write_picture(path, np.asarray(canvas.buffer_rgba())[..., :3])
    return path


def draw_levelled(folder: Path, path: Path) -> Path:
    """Draw the three most tilted pictures of a camera, as taken and levelled, side by side, and return the file."""
    as_taken, gap = Preprocessing(PanoramaView(), EquirectangularCamera()), 8
    pictures = np.array(sorted(folder.glob("*.png")))
    tilts = np.linalg.norm(as_taken.tilts(pictures, len(pictures)), axis=1)
    rows = []
    for picture in pictures[np.sort(np.argsort(tilts)[-3:])]:
        left, right = (made.panorama(picture).transpose(1, 2, 0) for made in (as_taken, replace(as_taken, level=True)))
        white = np.full((len(left), gap, 3), 255, np.uint8)
        rows += [np.hstack([left, white, right]), np.full((gap, 2 * left.shape[1] + gap, 3), 255, np.uint8)]
    write_picture(path, np.vstack(rows[:-1]))
    return path


if __name__ == "__main__":
    main()
