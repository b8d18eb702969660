"""Training images: random buildings under several lights, rendered several times faster than a data set.

A data set shows one drive after another, each under its own light. Here, the items in a building stay in place while
the light changes: what a ray hits, what a lamp lights and how surfaces light each other is computed once for all
lights. One ray is cast per pixel, and textures are not smoothed; that is enough for small images.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from foundation.calls import typed
from foundation.settings import Size
from siamloc.data.frames import FrameTable
from siamloc.data.names import LIGHTINGS
from siamloc.simulate.buildings import Worlds, random_building
from siamloc.simulate.camera import Cameras, ViewCamera, develop, draw_camera, metered
from siamloc.simulate.imaging import LONGEST, Imaging, draw_imaging
from siamloc.simulate.layout import Array, Building, Rng, seeded, single
from siamloc.simulate.light import ROUGH
from siamloc.simulate.overlap import visual_overlap
from siamloc.simulate.plan import room_at
from siamloc.simulate.rendering import turned
from siamloc.simulate.run import Light, Run, draw_light
from siamloc.simulate.scene import Scene, build_scene, relit

Exposures = Literal["drawn", "metered"]
"""Whether exposure and white balance of the images vary and noise is added, or exposure and balance are optimal."""
Imagings = Literal["plain", "drawn"]
"""Whether all cameras have the response of a data set's camera, or each its own response, flaws and robot in view."""

#: Seeds of training buildings start here, so that none coincides with a seed that a user or a test gives.
FIRST_SEED = 1 << 28
_DRIVEN = 0.05  # metres between the candidate poses
_YAW = 0.07  # rad by which an ordinary camera deviates from its direction


@dataclass(frozen=True)
class Views:
    """N images of one building.

    Attributes:
        images: (N, 3, H, W) uint8, RGB.
        xy: positions in metres (N, 2).
        heading: headings in rad (N,).
        room: index of the room (N,).
        light: index of the light (N,); each drive has its own lights, and items move between the drives.
        lighting: "cloudy", "night" or "sunny", for each light.
        pose: index of the pose (N,) among the P poses of all drives; the images of a pose differ in their light.
        overlap: visual overlap (P, P) of images from the poses, see `siamloc.simulate.overlap`. The items are where
            they stand during the first drive, also for the poses of the others.
        wraps: whether the images are panoramas, whose columns cover a full turn.
    """

    images: Array
    xy: Array
    heading: Array
    room: Array
    light: Array
    lighting: tuple[str, ...]
    pose: Array
    overlap: Array
    wraps: bool = True

    def __len__(self) -> int:
        return len(self.images)

    def __repr__(self) -> str:
        lights = ", ".join(self.lighting)
        return f"Views({len(self)} pictures; rooms: {len(np.unique(self.room))}; lights: {lights})"


@typed
def draw_views(
    seed: int,
    image_size: Size = (64, 256),
    drives: int = 2,
    lights: int = 4,
    poses: int = 60,
    spacing: float = 0.4,
    cameras: Cameras = "any",
    exposure: Exposures = "drawn",
    worlds: Worlds = "offices",
    imaging: Imagings = "plain",
) -> Views:
    """Draw a building, a camera and lights from a seed, and render images of a part of the building.

    The camera's height, exposure and white balance are also drawn: most buildings are seen by an omnidirectional
    camera, others by an ordinary one or through a fisheye lens, which keeps looking in one direction.

    Args:
        seed: any non-negative whole number; equal seeds give equal images.
        image_size: rows and columns.
        drives: how often the robot drives past; doors, chairs and people move between two drives.
        lights: number of lights per drive.
        poses: largest number of poses per drive.
        spacing: metres between poses.
        cameras: cameras to draw from: "any", "panoramas", only the "built_in" camera, or only "ordinary" cameras.
        exposure: "drawn", or "metered" for the best exposure and white balance, without noise.
        worlds: "offices" draws office floors, flats and halls with matt surfaces; "any" also homes, workshops and high
            halls, most of them with natural textures and surfaces that reflect.
        imaging: "plain" for the response of a data set's camera, or "drawn" for the tone curve, colours, lens, dirt
            and visible parts of the robot of a camera that is drawn with the building.

    Raises:
        ConfigError: an invalid value.
        SiamlocError: embreex is not installed.

    >>> draw_views(0, (16, 64), drives=1, lights=2, poses=3)
    Views(6 pictures; rooms: 1; lights: cloudy, night)
    """
    rng = seeded(seed, "views")
    building = random_building(FIRST_SEED + seed, worlds)
    camera, height = draw_camera(rng, image_size, cameras)
    taken = draw_imaging(seeded(seed, "imaging"), camera) if imaging == "drawn" else None
    start, first = rng.random(), int(rng.integers(1, 1000))
    parts: list[tuple[Array, ...]] = []
    lightings: list[str] = []
    eyes: list[Array] = []
    ahead = None
    for drive in range(drives):
        shining = _draw_lights(building, lights, rng)
        run = Run.parse(f"{rng.choice(LIGHTINGS)}{first + drive}", spacing=_DRIVEN)
        scene = build_scene(building, run, ROUGH, shining[0])
        x, y, theta = scene.state.track.poses.T
        spaced = FrameTable(path=np.array(scene.state.track.names), x=x, y=y, theta=theta).spaced(spacing)
        track = np.column_stack([spaced.xy, spaced.theta])
        begin = int(start * max(0, len(track) - poses))
        chosen = track[begin : begin + poses]
        scenes = [scene, *(relit(scene, one) for one in shining[1:])]
        heights = height + rng.normal(0, 0.01, len(chosen))
        eyes.append(np.column_stack([chosen[:, :2], heights]))
        if drive == 0:
            seen = scene.surfaces.mesh, scene.caster
        if not camera.wraps:  # an ordinary camera sees the same place only if it looks in the same direction
            ahead = float(chosen[rng.integers(len(chosen)), 2]) if ahead is None else ahead
            chosen[:, 2] = ahead + rng.normal(0, _YAW, len(chosen))
        standing = np.column_stack([chosen[:, :2], heights, chosen[:, 2]])
        images = look_around(scenes, standing, camera, rng, exposure, taken)
        images = images.reshape(-1, *images.shape[2:]).transpose(0, 3, 1, 2)
        xy, heading = (np.repeat(values, lights, axis=0) for values in (chosen[:, :2], chosen[:, 2]))
        parts.append((images, xy, heading, np.tile(np.arange(lights) + drive * lights, len(chosen))))
        lightings += [one.lighting for one in shining]
    images, xy, heading, light = (np.concatenate(part) for part in zip(*parts, strict=True))
    images = np.ascontiguousarray(images)
    looking = None if camera.wraps else heading[::lights]
    overlap = visual_overlap(*seen, np.concatenate(eyes), headings=looking, field=camera.field)
    pose = np.arange(len(images)) // lights
    return Views(images, xy, heading, room_at(building, xy), light, tuple(lightings), pose, overlap, camera.wraps)


def camera_of(seed: int, image_size: Sequence[int]) -> ViewCamera:
    """Return the camera that takes the images of `draw_views` for a seed, with images of (rows, columns)."""
    return draw_camera(seeded(seed, "views"), image_size)[0]


def look_around(
    scenes: Sequence[Scene],
    poses: Array,
    camera: ViewCamera,
    rng: Rng,
    exposure: Exposures = "drawn",
    imaging: Imaging | None = None,
) -> Array:
    """Render images from poses under several lights.

    Args:
        scenes: one scene, and others that `relit` made from it (L).
        poses: x, y, height in metres and heading in rad (P, 4).
        camera: the camera that takes the images.
        rng: draws where within their pixels the rays of an image pass, exposure, white balance and noise.
        exposure: as for `draw_views`.
        imaging: how the camera turns light into pixel values; like a data set's camera if None.

    Returns:
        (P, L, rows, columns, 3) uint8, RGB.
    """
    rows, columns = camera.rows, camera.columns
    found = np.empty((len(poses), len(scenes), rows, columns, 3), dtype=np.uint8)
    balances: list[Array] = []
    strength, stops = rng.uniform(0.3, 1.0, len(scenes)), rng.normal(0.0, 0.3, len(scenes))
    quiet = 0.75
    longest = 6.0 if imaging is None else LONGEST
    if exposure == "metered":  # the drawn values are not used, so that everything else stays the same
        strength[:], stops[:], quiet = 1.0, 0.0, 0.0
    rim = rng.integers(0, 12, (rows, columns, 1), dtype=np.uint8)
    for row, (x, y, z, heading) in enumerate(poses):
        across, down = rng.uniform(-0.3, 0.3, 2)
        directions = single(turned(camera.directions(across, down), heading)).reshape(-1, 3)
        eyes = np.empty_like(directions)
        eyes[:] = (x, y, z)
        hits = scenes[0].hits(eyes, directions, camera.spread, smooth=False)
        for number, scene in enumerate(scenes):
            light = np.minimum(scene.shine(hits)[0], 12.0)
            if row == 0:
                colour = np.minimum(light, 3.0).mean(axis=0)
                balances.append((colour / max(float(colour.mean()), 1e-6)) ** (-0.7 * strength[number]))
            brightness = light[:: max(1, len(light) // 200)].mean(axis=1)
            off = stops[number] + rng.normal(0, 0.15) * (exposure == "drawn")
            gain = float(np.clip(metered(brightness, 12) * 2**off, 0.02, longest))
            picture = light.reshape(rows, columns, 3)
            found[row, number] = (imaging or develop)(picture, gain, balances[number], camera.wraps, rng, quiet)
    if camera.shown is not None:
        found[:, :, ~camera.shown] = rim[~camera.shown]
    return found


def _draw_lights(building: Building, count: int, rng: Rng) -> list[Light]:
    """Draw lights: the three lightings once each in random order, then any lighting."""
    order = [LIGHTINGS[i % 3] for i in rng.permutation(3)]
    names = [order[i] if i < 3 else str(rng.choice(LIGHTINGS)) for i in range(count)]
    return [draw_light(building, name, rng) for name in names]
