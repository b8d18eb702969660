"""Histograms of colours pixel by pixel, with the colours of the standard library."""

from __future__ import annotations

import colorsys
import math

import numpy as np

LOWER = 1e-4  # how far edges lie below whole numbers


def colours(image):
    """Return one image (H, W) or (3, H, W), uint8 or in [0, 1], as colours (3, H, W) in float64."""
    values = image / 255 if image.dtype == np.uint8 else image.astype(np.float64)
    return np.stack([values] * 3) if values.ndim == 2 else values


def places(pixel, hues, saturations, values):
    """Return the bins of hue, saturation and value, and the saturation."""
    hue, saturation, value = colorsys.rgb_to_hsv(*pixel)
    return (
        math.floor(hue * hues + LOWER) % hues,
        min(math.floor(saturation * saturations + LOWER), saturations - 1),
        min(math.floor(value * values + LOWER), values - 1),
        saturation,
    )


def undecided(image, hues, saturations, values, within=1e-6, **_):
    """Return how many pixels lie so near the edge of a bin that float32 may place them otherwise."""
    count = 0
    for pixel in colours(image).reshape(3, -1).T:
        chroma = max(pixel.max() - pixel.min(), within)
        hue, saturation, value = colorsys.rgb_to_hsv(*pixel)
        scaled = ((hue, hues, chroma), (saturation, saturations, max(value, within)), (value, values, 1))
        edges = [(share * bins + LOWER, within * bins / scale) for share, bins, scale in scaled]
        count += any(abs(place - round(place)) < near for place, near in edges)
    return count


def describe(image, rows, hues, saturations, values, window, step, circular=True, **_):
    """Return position (rows * (hues * saturations + values),) and orientation (W / step, hues + values)."""
    image = colours(image)
    height, width = image.shape[1:]
    both = np.zeros((rows, hues * saturations))
    bright = np.zeros((rows, values))
    columns = np.zeros((width, hues + values))
    for i in range(height):
        for j in range(width):
            hue, saturation, value, amount = places(image[:, i, j], hues, saturations, values)
            both[i // (height // rows), hue * saturations + saturation] += 1
            bright[i // (height // rows), value] += 1
            columns[j, hue] += amount
            columns[j, hues + value] += 1
    shares = np.concatenate([both, bright / 4], axis=1) / (height // rows * width)
    orientation = np.zeros((width // step, hues + values))
    for k in range(width // step):
        for j in range(k * step, k * step + window):
            if circular or j < width:
                orientation[k] += columns[j % width] / (height * window)
    return np.sqrt(shares).ravel(), orientation
