"""A hyperbolic mirror traced ray by ray: the oracle of `siamloc.data.panorama.HyperbolicMirror`.

The mirror's focus F is the origin, the camera C stands `depth` below it. A point P of the mirror satisfies
|P - C| - |P - F| = 2 a with a = depth / (2 e), by the definition of a hyperbola of eccentricity e.
"""

from __future__ import annotations

import math

import numpy as np


def half_axis(mirror) -> float:
    return mirror.camera_depth / (2 * mirror.eccentricity)


def path_difference(point, mirror) -> float:
    camera = np.array([0.0, 0.0, -mirror.camera_depth])
    return float(np.linalg.norm(point - camera) - np.linalg.norm(point))


def mirror_point(direction, mirror):
    """Return where the ray from the focus along a direction meets the mirror, by bisection."""
    unit = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    near, far = 0.0, 1e6
    assert path_difference(far * unit, mirror) < 2 * half_axis(mirror), "the mirror does not show this direction"
    for _ in range(200):
        middle = (near + far) / 2
        if path_difference(middle * unit, mirror) > 2 * half_axis(mirror):
            near = middle
        else:
            far = middle
    return near * unit


def surface_normal(point, mirror):
    """Return the unit normal, from the numerical gradient of the path difference."""
    step = 1e-6 * np.linalg.norm(point)
    gradient = np.zeros(3)
    for axis in range(3):
        shift = np.zeros(3)
        shift[axis] = step
        gradient[axis] = (path_difference(point + shift, mirror) - path_difference(point - shift, mirror)) / (2 * step)
    return gradient / np.linalg.norm(gradient)


def pixel(direction, mirror):
    """Return the pixel of a direction in the robot's frame: a camera that looks up, its upper rim to the front."""
    point = mirror_point(direction, mirror)
    height = point[2] + mirror.camera_depth
    right, up = point[1] / height, point[0] / height
    if not mirror.mirrored:
        right = -right
    turn = math.radians(mirror.forward)
    right, up = right * math.cos(turn) + up * math.sin(turn), up * math.cos(turn) - right * math.sin(turn)
    return mirror.cx + mirror.fx * right, mirror.cy - mirror.fy * up
