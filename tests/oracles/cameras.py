"""Camera models, point by point as in their papers: the oracles of `siamloc.data.cameras`.

Each takes a point (x right, y down, z ahead of the camera) and the parameters of a camera, and returns a pixel.
"""

from __future__ import annotations

import math

import numpy as np


def turned(direction, camera):
    """From the robot's frame to the camera's: turn to the azimuth, raise, roll; then x right, y down, z ahead."""
    a, e, r = (math.radians(angle) for angle in (camera.azimuth, camera.elevation, camera.roll))
    about_up = np.array([[math.cos(a), -math.sin(a), 0], [math.sin(a), math.cos(a), 0], [0, 0, 1]])
    raised = np.array([[math.cos(e), 0, -math.sin(e)], [0, 1, 0], [math.sin(e), 0, math.cos(e)]])
    rolled = np.array([[1, 0, 0], [0, math.cos(r), -math.sin(r)], [0, math.sin(r), math.cos(r)]])
    ahead, left, up = (about_up @ raised @ rolled).T @ np.asarray(direction, dtype=float)
    return (left if camera.mirrored else -left), -up, ahead


def fisheye(x, y, z, camera):
    """Kannala & Brandt 2006, eq. 6, with the coefficients of odd powers after the first relative to it."""
    theta, phi = math.acos(z / math.sqrt(x * x + y * y + z * z)), math.atan2(y, x)
    r = theta + sum(k * theta ** (2 * i + 3) for i, k in enumerate(camera.k))
    return camera.fx * r * math.cos(phi) + camera.cx, camera.fy * r * math.sin(phi) + camera.cy


def unified(x, y, z, camera):
    """Mei & Rives 2007, section II.A, steps 1 to 5."""
    norm = math.sqrt(x * x + y * y + z * z)
    mx, my = x / norm / (z / norm + camera.xi), y / norm / (z / norm + camera.xi)
    k1, k2, p1, p2 = camera.distortion
    rho = math.hypot(mx, my)
    bend = k1 * rho**2 + k2 * rho**4
    dx = mx * bend + 2 * p1 * mx * my + p2 * (rho**2 + 2 * mx**2)
    dy = my * bend + p1 * (rho**2 + 2 * my**2) + 2 * p2 * mx * my
    return camera.fx * (mx + dx) + camera.skew * (my + dy) + camera.cx, camera.fy * (my + dy) + camera.cy


def double_sphere(x, y, z, camera):
    """Usenko et al. 2018, eq. 40 to 42."""
    d1 = math.sqrt(x**2 + y**2 + z**2)
    d2 = math.sqrt(x**2 + y**2 + (camera.xi * d1 + z) ** 2)
    below = camera.alpha * d2 + (1 - camera.alpha) * (camera.xi * d1 + z)
    return camera.fx * x / below + camera.cx, camera.fy * y / below + camera.cy


def ocam(x, y, z, camera):
    """Scaramuzza et al. 2006: the smallest radius whose polynomial gives the direction, from the roots."""
    # The toolbox has x along the rows, y along the columns, and the optical axis along -z.
    along_rows, along_columns, depth = y, x, -z
    side = math.hypot(along_rows, along_columns)
    coefficients = list(camera.polynomial)
    coefficients[1] -= depth / side
    roots = np.roots(coefficients[::-1])
    radius = min(root.real for root in roots if abs(root.imag) < 1e-9 and root.real > 0)
    xs, ys = along_rows / side * radius, along_columns / side * radius
    c, d, e = camera.affine
    return e * xs + ys + camera.cx, c * xs + d * ys + camera.cy


def equirectangular(x, y, z, rows, columns):
    """Longitude grows to the right, latitude upwards; pixels have their middle at whole numbers."""
    longitude, latitude = math.atan2(x, z), math.asin(-y / math.sqrt(x * x + y * y + z * z))
    return (longitude / (2 * math.pi) + 0.5) * columns - 0.5, (0.5 - latitude / math.pi) * rows - 0.5
