"""Pictures to learn from: random buildings under several lights, rendered several times faster than a data set.

A data set shows one drive under one light after the other. Here the things in a building stay where they are while the
light changes: what a ray meets, what a lamp lights and what surfaces throw at each other is found once for all lights.
One ray per pixel is cast, and textures are not smoothed; that is enough for small pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from siamloc.data.frames import FrameTable
from siamloc.data.panorama import PanoramaView
from siamloc.simulate.camera import HEIGHT, develop, metered
from siamloc.simulate.layout import Array, Building, seeded
from siamloc.simulate.light import ROUGH
from siamloc.simulate.load import load_building
from siamloc.simulate.plan import room_at
from siamloc.simulate.run import LIGHTINGS, Light, Run, draw_light
from siamloc.simulate.scene import Scene, build_scene, relit

#: Seeds of buildings to learn from begin here, so that none is one that a user or a test names.
FIRST_SEED = 1 << 28
_DRIVEN = 0.05  # metres between the poses that are chosen from


@dataclass(frozen=True)
class Views:
    """Pictures of one building, N together.

    Attributes:
        images: (N, 3, H, W) uint8, RGB.
        xy: metres (N, 2).
        heading: rad (N,).
        room: index of the room (N,).
        light: index of the light (N,); each drive has its own ones, and things moved between the drives.
        lighting: "cloudy", "night" or "sunny", for each light.
    """

    images: Array
    xy: Array
    heading: Array
    room: Array
    light: Array
    lighting: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.images)

    def __repr__(self) -> str:
        lights = ", ".join(self.lighting)
        return f"Views({len(self)} pictures; rooms: {len(np.unique(self.room))}; lights: {lights})"


def draw_views(
    seed: int,
    image_size: Sequence[int] = (64, 256),
    drives: int = 2,
    lights: int = 4,
    poses: int = 60,
    spacing: float = 0.4,
) -> Views:
    """Draw a building, a camera and lights from a seed, and render pictures of a part of it.

    The camera's height, its vertical field of view, its exposure and white balance are drawn, too.

    Args:
        seed: any whole number, not negative; equal seeds give equal pictures.
        image_size: rows and columns.
        drives: how often the robot drives by; between two drives doors, chairs and people move.
        lights: of each drive.
        poses: of each drive, at most.
        spacing: metres between them.

    Raises:
        SiamlocError: embreex is not installed.

    >>> draw_views(0, (16, 64), drives=1, lights=2, poses=3)
    Views(6 pictures; rooms: 1; lights: sunny, cloudy)
    """
    rng = seeded(seed, "views")
    building = load_building("random", FIRST_SEED + seed)
    view, height = _draw_camera(rng, image_size)
    start, first = float(rng.random()), int(rng.integers(1, 1000))
    found, places, headings, light, lightings = [], [], [], [], []
    for drive in range(drives):
        shining = _draw_lights(building, lights, rng)
        run = Run(str(rng.choice(LIGHTINGS)), first + drive, spacing=_DRIVEN)
        scene = build_scene(building, run, ROUGH, shining[0])
        x, y, theta = scene.state.track.poses.T
        spaced = FrameTable(path=np.array(scene.state.track.names), x=x, y=y, theta=theta).spaced(spacing)
        track = np.column_stack([spaced.xy, spaced.theta])
        begin = int(start * max(0, len(track) - poses))
        chosen = track[begin : begin + poses]
        scenes = [scene, *(relit(scene, one) for one in shining[1:])]
        heights = height + rng.normal(0, 0.01, len(chosen))
        images = look_around(scenes, np.column_stack([chosen[:, :2], heights, chosen[:, 2]]), view, rng)
        found.append(images.reshape(-1, *images.shape[2:]))
        places.append(np.repeat(chosen[:, :2], lights, axis=0))
        headings.append(np.repeat(chosen[:, 2], lights))
        light.append(np.tile(np.arange(lights) + drive * lights, len(chosen)))
        lightings += [one.lighting for one in shining]
    xy = np.concatenate(places)
    pictures = np.ascontiguousarray(np.concatenate(found).transpose(0, 3, 1, 2))
    return Views(pictures, xy, np.concatenate(headings), room_at(building, xy), np.concatenate(light), tuple(lightings))


def look_around(scenes: Sequence[Scene], poses: Array, view: PanoramaView, rng: np.random.Generator) -> Array:
    """Render panoramas from poses under several lights.

    Args:
        scenes: one scene, and others that `relit` made of it (L).
        poses: x, y, height in metres and heading in rad (P, 4).
        view: size and elevations.
        rng: draws where in their pixels the rays of a picture pass, exposure, white balance and noise.

    Returns:
        (P, L, rows, columns, 3) uint8, RGB.
    """
    rows, columns = view.height, view.width
    high, low = np.tan(np.radians([view.top, view.bottom]))
    spread = (2 * np.pi / columns * np.cos(view.row_elevation())).astype(np.float32).repeat(columns)
    found = np.empty((len(poses), len(scenes), rows, columns, 3), dtype=np.uint8)
    balances: list[Array] = []
    strength, stops = rng.uniform(0.3, 1.0, len(scenes)), rng.normal(0.0, 0.3, len(scenes))
    for row, (x, y, z, heading) in enumerate(poses):
        across, down = rng.uniform(-0.3, 0.3, 2)
        azimuth = heading - (np.arange(columns) + across + 0.5 - columns / 2) * (2 * np.pi / columns)
        slope = high + (np.arange(rows) + down + 0.5) / rows * (low - high)
        flat = 1 / np.sqrt(1 + slope**2)
        rays = np.empty((rows, columns, 3), dtype=np.float32)
        rays[..., 0] = np.cos(azimuth) * flat[:, None]
        rays[..., 1] = np.sin(azimuth) * flat[:, None]
        rays[..., 2] = (slope * flat)[:, None]
        directions: Array = rays.reshape(-1, 3)
        eyes = np.empty_like(directions)
        eyes[:] = (x, y, z)
        hits = scenes[0].hits(eyes, directions, spread, smooth=False)
        for number, scene in enumerate(scenes):
            light = np.minimum(scene.shine(hits)[0], 12.0)
            if row == 0:
                colour = np.minimum(light, 3.0).mean(axis=0)
                balances.append((colour / max(float(colour.mean()), 1e-6)) ** (-0.7 * strength[number]))
            brightness = light[:: max(1, len(light) // 200)].mean(axis=1)
            gain = float(np.clip(metered(brightness, 12) * 2 ** (stops[number] + rng.normal(0, 0.15)), 0.02, 6.0))
            found[row, number] = develop(light.reshape(rows, columns, 3), gain, balances[number], True, rng, 0.75)
    return found


def _draw_camera(rng: np.random.Generator, image_size: Sequence[int]) -> tuple[PanoramaView, float]:
    """Draw the vertical field of view and the height: now and then those of the built-in camera."""
    rows, columns = image_size
    if rng.random() < 0.3:
        return PanoramaView(rows, columns), HEIGHT
    view = PanoramaView(rows, columns, float(rng.uniform(15, 45)), -float(rng.uniform(20, 50)))
    return view, float(rng.uniform(0.35, 1.5))


def _draw_lights(building: Building, count: int, rng: np.random.Generator) -> list[Light]:
    """Draw lights, each lighting in its turn, in any order."""
    order = [LIGHTINGS[i % 3] for i in rng.permutation(3)]
    names = [order[i] if i < 3 else str(rng.choice(LIGHTINGS)) for i in range(count)]
    return [draw_light(building, name, rng) for name in names]
