"""Render the frames of a run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import cv2
import numpy as np

from foundation.calls import typed
from siamloc.data.panorama import PanoramaView
from siamloc.simulate.camera import CAMERAS, HEIGHT, OFFSETS, Camera, CameraName, Exposure, develop, expose
from siamloc.simulate.layout import Array, single
from siamloc.simulate.scene import LOOKS, Scene
from siamloc.simulate.trajectory import Track

_PROBE = PanoramaView(height=8, width=40)
_CHUNK = 100
_BLURRED = 0.35
#: Mean and standard deviation of the exposure compensation in stops; sunshine misleads the meter most.
_COMPENSATION = {"cloudy": (0.0, 0.1), "night": (0.0, 0.15), "sunny": (0.4, 0.3)}


@typed
def render(scene: Scene, poses: Array | Track, camera: Camera | CameraName = "panorama") -> Array:
    """Render images from poses.

    Args:
        scene: building, run and light.
        poses: x, y in metres and heading in rad (n, 3), of a robot standing still; or a `Track`, whose frames are
            blurred according to its speeds.
        camera: "panorama" (128 x 512), "omnidirectional" (480 x 640), or a camera.

    Returns:
        (n, rows, columns, 3) uint8, RGB.

    >>> from siamloc.simulate import Run, build_scene, load_building
    >>> scene = build_scene(load_building("mini"), Run("night", 1))
    >>> render(scene, scene.state.track.poses[:2], "panorama").shape
    (2, 128, 512, 3)
    """
    track = poses if isinstance(poses, Track) else standing(poses)
    chosen = CAMERAS[camera] if isinstance(camera, str) else camera
    exposure = meter(scene, track)
    return np.stack(list(frames(scene, track, chosen, exposure, range(len(track)))))


def standing(poses: Array) -> Track:
    """Return a track of a robot that stands still at poses (n, 3), a minute apart."""
    poses = np.atleast_2d(np.asarray(poses, dtype=np.float64))
    still = np.zeros(len(poses))
    blank = ("",) * len(poses)
    return Track(poses, 60.0 * np.arange(len(poses)), still, still, blank, blank)


def meter(scene: Scene, track: Track) -> Exposure:
    """Measure the light of every frame of a run and set the camera's exposure."""
    directions = _PROBE.directions().reshape(-1, 3)
    brightness, total = [], np.zeros(3)
    for start in range(0, len(track), _CHUNK):
        part = track.poses[start : start + _CHUNK]
        rays = single(np.concatenate([turned(directions, theta) for theta in part[:, 2]]))
        eyes = np.column_stack([part[:, :2], np.full(len(part), HEIGHT)])
        spread = np.full(len(rays), 2 * np.pi / _PROBE.width, dtype=np.float32)
        light, _, _ = scene.trace(single(np.repeat(eyes, len(directions), axis=0)), rays, spread)
        brightness.append(light.mean(axis=1).reshape(len(part), -1))
        total += np.minimum(light, 3.0).sum(axis=0)
    rng = scene.building.rng("exposure", scene.run.lighting, scene.run.number)
    mean, spread_stops = _COMPENSATION[scene.run.lighting]
    offset = rng.normal(mean, spread_stops)
    return expose(np.concatenate(brightness), total, track.time, offset)


def frames(scene: Scene, track: Track, camera: Camera, exposure: Exposure, rows: Iterable[int]) -> Iterator[Array]:
    """Yield the images (rows, columns, 3) uint8 of the frames in `rows`; each depends only on its own frame."""
    pixels = camera.pixels
    quiet = 0.75 if camera.wraps else 1.0
    for row in rows:
        x, y, theta = track.poses[row]
        light, distance = _look(scene, camera, float(x), float(y), float(theta), float(track.time[row]))
        light *= pixels.vignette[:, None]
        image = np.zeros((*camera.shape, 3), dtype=np.float32)
        image[pixels.rows, pixels.columns] = light
        reach = float(exposure.seconds[row])
        image = _motion(image, camera, distance, float(track.speed[row]), float(track.turn_rate[row]), reach)
        rng = scene.building.rng(scene.run.name, "frame", int(row))
        yield develop(image, float(exposure.gain[row]), exposure.balance, camera.wraps, rng, quiet)


def turned(directions: Array, theta: float) -> Array:
    """Rotate directions (..., 3) from the frame of a robot with heading `theta`, in rad, to the building's frame."""
    cosine, sine = np.cos(theta), np.sin(theta)
    return directions @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]], dtype=directions.dtype)


def _look(scene: Scene, camera: Camera, x: float, y: float, theta: float, time: float) -> tuple[Array, Array]:
    """Return the light (n, 3) and the distance (n,) of a camera's pixels, with smoothed edges."""
    pixels = camera.pixels
    eye = np.array([x, y, HEIGHT], dtype=np.float32)
    main = turned(pixels.directions[0], theta)
    light, distance, quad = _cast(scene, eye, main, pixels.spread, time)
    edge = np.flatnonzero(_edges(camera, quad))
    if len(edge):
        extra = [turned(direction[edge], theta) for direction in pixels.directions[1:]]
        more, _, _ = _cast(scene, eye, np.concatenate(extra), np.tile(pixels.spread[edge], len(OFFSETS) - 1), time)
        # Clipping first keeps bright windows from swallowing the bars between their panes.
        total = np.minimum(light[edge], 12.0) + np.minimum(more.reshape(len(OFFSETS) - 1, -1, 3), 12.0).sum(axis=0)
        light[edge] = total / len(OFFSETS)
    return light, distance


def _edges(camera: Camera, quad: Array) -> Array:
    """Return True for the pixels (n,) that see a different quad from a neighbour."""
    pixels = camera.pixels
    image = np.full(camera.shape, -2, dtype=np.int64)
    image[pixels.rows, pixels.columns] = quad
    differs = np.zeros(camera.shape, dtype=bool)
    for one, other in (np.s_[:, 1:], np.s_[:, :-1]), (np.s_[1:], np.s_[:-1]):
        across = image[one] != image[other]
        differs[one] |= across
        differs[other] |= across
    return differs[pixels.rows, pixels.columns]


def _cast(scene: Scene, eye: Array, directions: Array, spread: Array, time: float) -> tuple[Array, Array, Array]:
    """Trace rays from one point; return their light, lengths and what they hit, people who walk included."""
    light, distance, quad = scene.trace(np.broadcast_to(eye, directions.shape).copy(), directions, spread)
    flat = np.hypot(directions[:, 0], directions[:, 1])
    for number, walker in enumerate(scene.state.walkers):
        place = walker.place(time)
        if place is None:
            continue
        x, y, degrees = place
        offset = np.array([x - eye[0], y - eye[1]])
        away = float(np.hypot(*offset))
        if not 0.4 <= away <= 12:
            continue
        near = np.flatnonzero(directions[:, :2] @ single(offset / away) > flat * np.cos(np.arctan2(0.45, away)))
        if not len(near):
            continue
        surfaces, caster = scene.people[walker.look % LOOKS]
        angle = np.radians(degrees)
        origin = single(turned(np.array([[-offset[0], -offset[1], eye[2]]]), -angle))
        rays = single(turned(directions[near], -angle))
        hit, s, t, reach = caster.first_hit(np.repeat(origin, len(near), axis=0), rays)
        keep = (hit >= 0) & (reach < distance[near])
        rows, hit, s, t, reach = near[keep], hit[keep], s[keep], t[keep], reach[keep]
        colour = surfaces.colour(scene.atlas, hit, s, t, reach * spread[rows], smooth=True) * surfaces.mesh.tint[hit]
        shade = (0.75 + 0.25 * surfaces.normals[hit, 2] + 0.12 * surfaces.normals[hit, 0])[:, None]
        light[rows] = colour * shade * scene.light_at(x, y)
        distance[rows] = reach
        quad[rows] = 10**7 + 10**5 * number + hit
    return light, distance, quad


def _motion(image: Array, camera: Camera, distance: Array, speed: float, turn_rate: float, seconds: float) -> Array:
    """Blur an image by the robot's motion while the shutter is open."""
    if abs(turn_rate) * seconds < 0.002 and abs(speed) * seconds < 0.002:
        return image
    pixels = camera.pixels
    reach = np.minimum(distance, 50.0)[:, None]
    points = pixels.directions[0] * reach
    moves = np.zeros_like(points)
    moves[:, 0] = -speed * seconds + turn_rate * seconds * points[:, 1]
    moves[:, 1] = -turn_rate * seconds * points[:, 0]
    dx, dy = camera.displacement(moves, points)
    if max(np.abs(dx).max(), np.abs(dy).max()) < _BLURRED:
        return image
    flow: Array = np.zeros((*camera.shape, 2), dtype=np.float32)
    flow[pixels.rows, pixels.columns, 0] = np.clip(dx, -12, 12)
    flow[pixels.rows, pixels.columns, 1] = np.clip(dy, -12, 12)
    flow = cv2.blur(flow, (3, 3))
    rows, columns = np.mgrid[0 : camera.shape[0], 0 : camera.shape[1]].astype(np.float32)
    border = cv2.BORDER_WRAP if camera.wraps else cv2.BORDER_REPLICATE
    total = image.copy()
    for share in (-0.4, -0.2, 0.2, 0.4):
        x, y = columns + share * flow[..., 0], rows + share * flow[..., 1]
        if camera.wraps:
            y = np.clip(y, 0, camera.shape[0] - 1)
        total += cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=border)
    return total / 5
