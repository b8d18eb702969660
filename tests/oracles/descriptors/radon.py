"""The Radon transform, point by point along each line, and the two descriptors based on it."""

from __future__ import annotations

import math

import numpy as np


def unwrapped(square):
    """Return the polar samples (H, W) of the disc inscribed in a square picture."""
    side = len(square)
    height, width = side // 2, 4 * math.ceil(math.pi * side / 4)
    found = np.zeros((height, width))
    for i in range(height):
        rho = (height - 1 - i + 0.5) * side / (2 * height)
        for c in range(width):
            alpha = 2 * math.pi * (c + 0.5) / width
            x = side / 2 + rho * math.sin(alpha) - 0.5
            y = side / 2 + rho * math.cos(alpha) - 0.5
            left, top = min(max(math.floor(x), 0), side - 2), min(max(math.floor(y), 0), side - 2)
            fx, fy = x - left, y - top
            upper = (1 - fx) * square[top, left] + fx * square[top, left + 1]
            lower = (1 - fx) * square[top + 1, left] + fx * square[top + 1, left + 1]
            found[i, c] = (1 - fy) * upper + fy * lower
    return found


def harmonics(picture, outer, inner, most):
    """Return a function of radii (n,) that gives the coefficients P (n, 2 M + 1) there, and m."""
    height, width = picture.shape
    m = np.arange(-most, most + 1)
    azimuth = 2 * np.pi * (np.arange(width) + 0.5) / width
    waves = (picture @ np.exp(-1j * np.outer(azimuth, m)) / width)[::-1]  # innermost first
    radii = outer - (np.arange(height)[::-1] + 0.5) * (1 - inner) * outer / height

    def along(rho):
        real = [np.interp(rho, radii, column) for column in waves.real.T]  # constant beyond the ends
        imaginary = [np.interp(rho, radii, column) for column in waves.imag.T]
        values = np.array(real).T + 1j * np.array(imaginary).T
        return values * ((rho >= inner * outer) & (rho < outer))[:, None]

    return along, m


def prepared(grey, step, size, source, circular):
    picture, inner = (unwrapped(grey), 0.0) if source == "omnidirectional" else (grey, 0.2)
    if source == "panorama" and not circular:
        picture = np.concatenate([picture, picture[:, ::-1]], axis=1)
    count = round(360 / step)
    most = min((count - 1) // 2, (picture.shape[1] - 1) // 2)
    return count, harmonics(picture, size / 2, inner, most)


def points_of(d, outer):
    """Return how far the points of a line lie from its foot."""
    half = np.arange(0.25, outer, 0.5)
    points = np.concatenate([-half[::-1], half])
    return points[np.sqrt(d**2 + points**2) < outer]


def line(grey, step, size, t, k):
    """Return r[t, k] of a panorama, point by point."""
    count, (along, m) = prepared(grey, step, size, "panorama", True)
    total = 0.0
    for point in points_of(k + 0.5, size / 2):
        rho = math.hypot(k + 0.5, point)
        alpha = 2 * math.pi * t / count + math.atan2(point, k + 0.5)
        total += (along(np.array([rho]))[0] * np.exp(1j * m * alpha)).sum().real / 2
    return total


def transform(grey, step, size, source="panorama", circular=True):
    """Return r (360 / step, size / 2). A line is summed in the direction 0 and then turned, frequency by frequency."""
    count, (along, m) = prepared(grey, step, size, source, circular)
    found = np.zeros((count, size // 2))
    for k in range(size // 2):
        d = k + 0.5
        points = points_of(d, size / 2)
        values = along(np.sqrt(d**2 + points**2))
        upright = (values * np.exp(1j * np.outer(np.arctan2(points, d), m))).sum(axis=0) / 2
        for t in range(count):
            found[t, k] = (upright * np.exp(1j * m * 2 * math.pi * t / count)).sum().real
    return found


def mean_lines(r, lines):
    n = r.shape[1] // lines
    return np.stack([r[:, k * n : (k + 1) * n].mean(axis=1) for k in range(lines)], axis=1)


def along_orientations(q):
    """Return c[u, k] = (1 / T) sum_t q[t, k] exp(-2 pi i u t / T)."""
    count = len(q)
    return np.exp(-2j * np.pi * np.outer(np.arange(count), np.arange(count)) / count) @ q / count


def fourier(grey, step, size, lines, orientation_lines, source="panorama", circular=True):
    """Return position (T * lines,) and orientation (T, orientation_lines) of `radon_fourier`."""
    r = transform(grey, step, size, source, circular)
    position = np.abs(along_orientations(mean_lines(r, lines)))
    c = along_orientations(mean_lines(r, orientation_lines))
    count = len(c)
    g = np.zeros(c.shape, dtype=complex)
    for k in range(orientation_lines):
        largest = np.abs(c[:, k]).max()
        if largest > 0:
            g[:, k] = c[:, k] / np.maximum(np.abs(c[:, k]), 1e-9 * largest)
    back = np.exp(2j * np.pi * np.outer(np.arange(count), np.arange(count)) / count)
    return position.ravel(), (back @ g).real / count


def phases(r):
    """Return g[u, v] of `radon_poc`, zeros of zeros."""
    spectrum = np.fft.fft2(r)
    size = np.abs(spectrum)
    return spectrum / np.maximum(size, 1e-9 * size.max()) if size.any() else spectrum


def poc(grey, step, size, source="panorama", circular=True):
    """Return position (T * N,) and orientation (T, N) of `radon_poc`."""
    x = np.fft.ifft2(phases(transform(grey, step, size, source, circular))).real
    length = math.sqrt((x**2).sum())
    x = x / length if length else x
    return x.ravel(), x


def poc_scores(query, reference, **params):
    """Return poc[s] of two pictures, from the matrices r themselves."""
    q, r = (phases(transform(grey, **params)) for grey in (query, reference))
    area = math.sqrt((np.abs(q) ** 2).sum() * (np.abs(r) ** 2).sum())
    count = len(q)
    u = np.arange(count)[:, None]
    return [float((q * r.conj() * np.exp(2j * np.pi * u * s / count)).sum().real) / area for s in range(count)]
