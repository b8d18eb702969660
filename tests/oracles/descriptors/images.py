"""Grey values and the homomorphic filter, from their definitions."""

from __future__ import annotations

import math

import numpy as np


def grey(image: np.ndarray) -> np.ndarray:
    """Return one image (H, W) or (3, H, W), uint8 or in [0, 1], as BT.601 luma (H, W) in float64."""
    values = image / 255 if image.dtype == np.uint8 else image.astype(np.float64)
    if values.ndim == 2:
        return values.astype(np.float64)
    return 0.299 * values[0] + 0.587 * values[1] + 0.114 * values[2]


def homomorphic(grey, cutoff=4.0, low=0.5, high=1.0, circular=True, clip=True):
    """exp(F^-1(T F(log(I + 1/255)))) - 1/255, the transforms being products with matrices of waves."""
    height, width = grey.shape
    log = np.log(grey + 1 / 255)
    log = np.concatenate([log, log[::-1]], axis=0)
    if not circular:
        log = np.concatenate([log, log[:, ::-1]], axis=1)
    rows, columns = log.shape
    down = np.exp(-2j * np.pi * np.outer(np.arange(rows), np.arange(rows)) / rows)
    right = np.exp(-2j * np.pi * np.outer(np.arange(columns), np.arange(columns)) / columns)
    spectrum = down @ log @ right
    for v in range(rows):
        for u in range(columns):
            signed_v = v if v <= rows // 2 else v - rows
            signed_u = u if u <= columns // 2 else u - columns
            far = width * math.hypot(signed_u / columns, signed_v / rows)
            spectrum[v, u] *= low + (high - low) * (1 - math.exp(-((far / cutoff) ** 2) / 2))
    back = (down.conj() @ spectrum @ right.conj()).real / (rows * columns)
    found = np.exp(back[:height, :width]) - 1 / 255
    return found.clip(0, 1) if clip else found


def homomorphic_colour(image, circular=True, **params):
    """Return a colour image (3, H, W) in [0, 1], each channel of a pixel scaled by the gain of the pixel's luma."""
    luma = grey(image)
    gain = (homomorphic(luma, circular=circular, clip=False, **params) + 1 / 255) / (luma + 1 / 255)
    return ((image + 1 / 255) * gain - 1 / 255).clip(0, 1)
