"""From light to pixels: exposure with a lag, glare, noise, white balance and gamma."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from siamloc.simulate.layout import Array

_KEY = 0.40
_LAG = 1.4
_GAINS = (0.04, 4.5)
_SHOT, _READ = 0.006, 0.0025
_BANK = 1 << 21


@dataclass(frozen=True)
class Exposure:
    """How the camera was set for every frame of a run.

    Attributes:
        gain: pixel value per radiosity (n,).
        balance: colour gains of the run (3,).
        seconds: how long the shutter stood open (n,).
    """

    gain: Array
    balance: Array
    seconds: Array


def expose(brightness: Array, colour: Array, time: Array, offset: float) -> Exposure:
    """Follow the brightness as an automatic exposure does.

    Args:
        brightness: radiosity of k directions in every frame (n, k).
        colour: mean colour of the run (3,).
        time: seconds (n,).
        offset: exposure compensation of the run in stops.
    """
    wanted = np.array([_metered(values) for values in brightness]) * 2.0**offset
    wanted = np.log(np.clip(wanted, *_GAINS))
    gain = wanted.copy()
    for row in range(1, len(gain)):
        share = 1 - np.exp(-min(max(time[row] - time[row - 1], 0.0), 5.0) / _LAG)
        gain[row] = gain[row - 1] + share * (wanted[row] - gain[row - 1])
    balance = (colour / colour.mean()) ** -0.7
    gain = np.exp(gain)
    seconds = np.clip(0.03 * gain / 0.5, 0.004, 0.06)
    return Exposure(gain, balance, seconds)


def _metered(values: Array) -> float:
    """Return the gain at which the mean of the clipped pixels is mid grey."""
    low, high = np.log(1e-3), np.log(1e2)
    for _ in range(24):
        middle = (low + high) / 2
        if np.mean(np.clip(values * np.exp(middle), 0, 1) ** (1 / 2.2)) < _KEY + 0.12:
            low = middle
        else:
            high = middle
    return float(np.exp((low + high) / 2))


def develop(light: Array, gain: float, balance: Array, wraps: bool, rng: np.random.Generator, quiet: float) -> Array:
    """Turn radiosity (rows, columns, 3) into a uint8 picture.

    Args:
        light: radiosity after lens and motion.
        gain: pixel value per radiosity.
        balance: colour gains (3,).
        wraps: the left rim continues at the right one.
        rng: draws the noise.
        quiet: scale of the noise; below 1 where unwrapping would have averaged it.
    """
    value = light * (gain * balance).astype(np.float32)
    _glare(value, wraps)
    shot = _SHOT * np.sqrt(gain)
    start = int(rng.integers(0, _BANK - value.size))
    grain = _noise_bank()[start : start + value.size].reshape(value.shape)
    spread = cv2.sqrt(np.maximum(value, 0) * np.float32(shot**2) + np.float32((_READ * gain) ** 2))
    value += grain * spread * np.float32(quiet)
    grey = value.mean(axis=-1, keepdims=True)
    value = np.clip(grey + 1.12 * (value - grey), 0, 1)
    return _curve()[(value * 4095).astype(np.int32)]


def _glare(value: Array, wraps: bool) -> None:
    """Let what is too bright spill over its surroundings, in place."""
    height, width = value.shape[:2]
    small = cv2.resize(value, (width // 4, height // 4), interpolation=cv2.INTER_AREA)
    excess = np.clip(small - 1, 0, 40)
    if not excess.any():
        return
    pad = 24
    mode = "wrap" if wraps else "edge"
    excess = np.pad(excess, ((0, 0), (pad, pad), (0, 0)), mode=mode)  # type: ignore[call-overload]
    halo = 0.03 * cv2.GaussianBlur(excess, (0, 0), 6) + 0.03 * cv2.GaussianBlur(excess, (0, 0), 1.5)
    value += cv2.resize(halo[:, pad:-pad], (width, height), interpolation=cv2.INTER_LINEAR)


@lru_cache(maxsize=1)
def _noise_bank() -> Array:
    return np.random.default_rng(20110).standard_normal(_BANK, dtype=np.float32)


@lru_cache(maxsize=1)
def _curve() -> Array:
    """Return the response of the camera: gamma with a slight shoulder, 4096 values."""
    x = np.arange(4096) / 4095
    return np.clip(255 * (x ** (1 / 2.2)) * (1 + 0.06 * np.sin(np.pi * x)) + 0.5, 0, 255).astype(np.uint8)
