"""Drives through simulated buildings by cameras below mirrors that are drawn at random, as pictures of the ring.

Panoramas are rendered once for each building and light. A picture of the ring samples a panorama by the inverse of the
mirror, written here without siamloc's unwrapping, so that neither can hide an error of the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from siamloc.data import PanoramaView
from siamloc.simulate import Run, build_scene, load_building
from siamloc.simulate.camera import PanoramaCamera
from siamloc.simulate.rendering import frames as rendered
from siamloc.simulate.rendering import meter

Array = NDArray[Any]

VIEW = PanoramaView(160, 512, top=40, bottom=-72)
LIGHTINGS = ("cloudy", "night", "sunny")
FRAMES = 24  # of a clip, 3.5 m and more
_SIZES = ((480, 640), (480, 640), (600, 800), (720, 720), (480, 752), (768, 1024))


@dataclass(frozen=True)
class Clip:
    """Part of a drive: panoramas (n, H, W, 3), uint8, and poses (n, 3)."""

    panoramas: Array
    poses: Array


@dataclass(frozen=True)
class Mirror:
    """A mirror as the benchmark draws it, and what hides parts of it.

    Attributes:
        size: rows and columns of a picture.
        centre: column and row of the ring's centre.
        inner: inner radius in pixels.
        outer: outer radius in pixels.
        forward: degrees clockwise from the picture's upper edge.
        mirrored: whether the image shows the left on its right.
        top: elevation in degrees at the outer rim.
        bottom: elevation in degrees at the inner rim, of a mirror whose rows are evenly spaced.
        hyperbolic: eccentricity of a hyperbolic mirror; None for one whose rows are evenly spaced in the tangent.
    """

    size: tuple[int, int]
    centre: tuple[float, float]
    inner: float
    outer: float
    forward: float
    mirrored: bool
    top: float
    bottom: float
    hyperbolic: float | None

    def slope(self, radius: Array) -> Array:
        """Return the tangent of the elevation at a radius in pixels."""
        high, low = np.tan(np.radians([self.top, self.bottom]))
        if self.hyperbolic is None:
            return high + (self.outer - radius) / (self.outer - self.inner) * (low - high)
        elevation = np.linspace(np.radians(self.top), -np.pi / 2 + 1e-3, 2000)
        offset = 2 * self.hyperbolic / (1 + self.hyperbolic**2)
        reach = np.cos(elevation) / (offset - np.sin(elevation))
        return np.tan(np.interp(radius, (reach / reach[0] * self.outer)[::-1], elevation[::-1]))


def clips(count: int, cache: Path, only: int | None = None) -> list[Clip]:
    """Render clips of drives, a night among three, or read them from a folder; all of them, or `only` one."""
    found = []
    for number in range(count) if only is None else [only]:
        path = cache / f"clip_{number:03d}.npz"
        if not path.is_file():
            cache.mkdir(parents=True, exist_ok=True)
            rng = np.random.default_rng([7, number])
            scene = build_scene(load_building("random", 1000 + number), Run(LIGHTINGS[number % 3], 1))
            track, camera = scene.state.track, PanoramaCamera(VIEW)
            start = int(rng.integers(0, max(1, len(track) - FRAMES)))
            rows = np.arange(start, min(start + FRAMES, len(track)))
            images = np.stack(list(rendered(scene, track, camera, meter(scene, track), rows)))
            np.savez(path, panoramas=images, poses=track.poses[rows])
        with np.load(path, allow_pickle=False) as kept:
            found.append(Clip(kept["panoramas"], kept["poses"]))
    return found


def draw_mirror(rng: np.random.Generator) -> Mirror:
    """Draw a mirror whose ring lies in the picture."""
    rows, columns = _SIZES[rng.integers(len(_SIZES))]
    outer = min(rows, columns) * rng.uniform(0.3, 0.475)
    reach = np.minimum([columns / 2 - outer - 4, rows / 2 - outer - 4], 0.08 * rows)
    centre = np.array([columns - 1, rows - 1]) / 2 + rng.uniform(-1, 1, 2) * reach
    return Mirror(
        size=(rows, columns),
        centre=(float(centre[0]), float(centre[1])),
        inner=float(outer * rng.uniform(0.08, 0.35)),
        outer=float(outer),
        forward=float(rng.uniform(0, 360)),
        mirrored=bool(rng.random() < 0.7),
        top=float(rng.uniform(8, 38)),
        bottom=-float(rng.uniform(35, 65)),
        hyperbolic=float(rng.uniform(1.15, 1.5)) if rng.random() < 0.5 else None,
    )


def draw_pictures(rng: np.random.Generator, panoramas: Array, mirror: Mirror) -> tuple[Array, Array, dict[str, Any]]:
    """Draw the pictures (n, rows, columns, 3) of a drive, the ring's centre in each (n, 2), and what was drawn."""
    blur, noise = rng.uniform(0.4, 1.6), rng.uniform(0.5, 4)
    moving = rng.uniform(0.5, 2) if rng.random() < 0.25 else 0.0
    dim = 1.0 if rng.random() < 0.8 else rng.uniform(0.15, 0.5)
    quality = int(rng.integers(60, 96))
    parts, own, about = _parts(rng, mirror)
    lit = rng.random() < 0.5  # whether the light of the room falls on what never moves
    centres = np.asarray(mirror.centre) + moving * rng.normal(0, 1, (len(panoramas), 2)).clip(-1.5, 1.5)
    rows, columns = mirror.size
    grid = np.mgrid[0:rows, 0:columns][::-1].astype(np.float64)
    pictures = np.empty((len(panoramas), rows, columns, 3), np.uint8)
    brightness = panoramas.mean(axis=(1, 2, 3)) / panoramas.mean()
    for number, (panorama, centre) in enumerate(zip(panoramas, centres, strict=True)):
        x, y = grid[0] - centre[0], grid[1] - centre[1]
        radius = np.hypot(x, y)
        shown = _smooth(mirror.outer - radius) * _smooth(radius - mirror.inner)
        angle = np.arctan2(x, -y) - np.radians(mirror.forward)
        azimuth = angle if mirror.mirrored else -angle
        high, low = np.tan(np.radians([VIEW.top, VIEW.bottom]))
        down = (high - mirror.slope(radius.clip(mirror.inner, mirror.outer))) / (high - low) * VIEW.height - 0.5
        across = (VIEW.width / 2 - 0.5 - azimuth * VIEW.width / (2 * np.pi)) % VIEW.width
        scene = cv2.remap(
            np.concatenate([panorama, panorama[:, :2]], axis=1),
            across.astype(np.float32),
            down.clip(0, VIEW.height - 1).astype(np.float32),
            cv2.INTER_LINEAR,
        ).astype(np.float32)
        shift = centre - mirror.centre
        move = np.array([[1, 0, shift[0]], [0, 1, shift[1]]], dtype=np.float32)
        hide, paint = (
            cv2.warpAffine(one, move, (columns, rows), borderMode=cv2.BORDER_REPLICATE) for one in (parts, own)
        )
        paint = paint * (0.5 + 0.5 * brightness[number] if lit else 1.0)
        shown = (shown * (1 - hide))[..., None].astype(np.float32)
        picture = cv2.GaussianBlur(scene * shown + paint * (1 - shown), (0, 0), blur)
        picture = dim * rng.normal(1, 0.06) * picture
        picture += rng.normal(0, 1, picture.shape).astype(np.float32) * noise * np.sqrt(0.3 + picture.clip(0) / 180)
        coded = cv2.imencode(".jpg", picture.clip(0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        pictures[number] = cv2.imdecode(coded, cv2.IMREAD_COLOR)
    return pictures, centres, {"blur": blur, "noise": noise, "moving": moving, "dim": dim, "lit": lit, **about}


def _smooth(inside: Array) -> Array:
    """Return the share of a pixel inside a rim, from the distance in pixels to the rim."""
    return np.clip(inside + 0.5, 0, 1)


def _parts(rng: np.random.Generator, mirror: Mirror) -> tuple[Array, Array, dict[str, Any]]:
    """Draw the robot's parts: how far they hide the mirror (rows, columns), and what is seen there and outside."""
    rows, columns = mirror.size
    kind = str(rng.choice(["black", "grey", "bright"], p=[0.6, 0.25, 0.15]))
    level = {"black": rng.uniform(0, 15), "grey": rng.uniform(30, 110), "bright": rng.uniform(120, 210)}[kind]
    texture = cv2.GaussianBlur(rng.normal(0, 1, (rows, columns, 1)).astype(np.float32), (0, 0), rng.uniform(2, 12))
    texture = texture / texture.std() * rng.uniform(0.02, 0.25)
    own = (level * (1 + texture))[..., None].repeat(3, axis=2).astype(np.float32).clip(0, 255)
    (cx, cy), centre = mirror.centre, tuple(round(value) for value in mirror.centre)
    cv2.circle(own, centre, round(0.9 * mirror.inner), [float(rng.uniform(5, 90))] * 3, -1)
    cv2.circle(own, centre, round(0.4 * mirror.inner), [float(rng.uniform(5, 200))] * 3, -1)
    hide = np.zeros((rows, columns), np.float32)
    struts, cable, body = int(rng.choice([0, 0, 1, 3, 4])), rng.random() < 0.3, rng.random() < 0.3
    turn, reach = rng.uniform(0, 2 * np.pi), 1.05 * mirror.outer
    for angle in turn + np.arange(struts) * 2 * np.pi / max(struts, 1):
        end = (round(cx + reach * np.cos(angle)), round(cy + reach * np.sin(angle)))
        cv2.line(hide, centre, end, 1.0, max(2, round(mirror.outer * rng.uniform(0.02, 0.1))))
    if cable:
        share = np.linspace(0, 1, 20)
        bend = rng.uniform(0, 2 * np.pi) + rng.uniform(-0.6, 0.6) * np.sin(2.5 * share)
        points = np.column_stack([cx + share * reach * np.cos(bend), cy + share * reach * np.sin(bend)])
        cv2.polylines(hide, [points.round().astype(np.int32)], isClosed=False, color=1.0, thickness=5)
    if body:  # a corner of the robot's deck
        angle, half = rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 0.9)
        far = mirror.inner + rng.uniform(0.1, 0.4) * (mirror.outer - mirror.inner)
        bends = np.linspace(angle - half, angle + half, 12)
        points = np.column_stack([cx + far * np.cos(bends), cy + far * np.sin(bends)])
        cv2.fillPoly(hide, [np.vstack([[cx, cy], points]).round().astype(np.int32)], 1.0)
    inside = np.hypot(*(np.mgrid[0:rows, 0:columns][::-1] - np.reshape(mirror.centre, (2, 1, 1)))) < mirror.outer
    own[(hide > 0) & inside] = float(rng.uniform(5, 160))
    return hide, own, {"outside": kind, "struts": struts, "cable": bool(cable), "body": bool(body)}
