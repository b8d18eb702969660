"""What real cameras add to an ideal image: their response, flaws of lens and sensor, and parts of the robot in view.

All of it is drawn once for a camera, and is the same in all of its images.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from siamloc.simulate.camera import ViewCamera, add_glare, add_noise, enlarged
from siamloc.simulate.layout import Array, Rng, single

#: Families of tone curves; all give 0 for 0 and 1 for 1.
TONES = ("gamma", "srgb", "film", "log")
#: Largest gain, for the longest exposure.
LONGEST = 30.0
_NOISIEST = 6.0  # gain above which the shutter stays open longer, which adds no noise
_LIGHT = np.linspace(0, 1, 4096) ** 2  # of which a tone curve has values
_GREY, _MIDDLE = 0.2, 0.5  # light of a wall, and its pixel value under the response of a data set


@dataclass(frozen=True)
class Imaging:
    """How one camera turns light into pixel values. Called like `siamloc.simulate.camera.develop`.

    Attributes:
        passing: factor of the scene's light at each pixel (rows, columns, 3): smaller through dirt and towards the rim
            of the lens, and 0 where the robot is in view.
        own: light that dust and the robot send to each pixel, in units of the mean light (rows, columns, 3).
        fringes: for red and blue, the columns and rows of the points in the image that are shown at each pixel
            (2, 2, rows, columns); None if the lens has no fringes.
        soft: share of the blurred image at each pixel (rows, columns, 3).
        blur: standard deviations of the blur in pixels, along rows and along columns of the image.
        veil: share of the light that the lens scatters.
        spread: standard deviation of the scattered light in columns.
        grain: scale of the noise (rows, columns, 3).
        colours: response of red, green and blue to the colours of the light (3, 3).
        curve: pixel values, uint8, for evenly spaced square roots of the light, from 0 to 1.
        quality: quality of the JPEG compression, 1 to 100; None if images are not compressed.
    """

    passing: Array
    own: Array
    fringes: Array | None
    soft: Array
    blur: tuple[float, float]
    veil: float
    spread: float
    grain: Array
    colours: Array
    curve: Array
    quality: int | None

    def __call__(self, light: Array, gain: float, balance: Array, wraps: bool, rng: Rng, quiet: float) -> Array:
        """Expose an image (rows, columns, 3), uint8; arguments as for `siamloc.simulate.camera.develop`."""
        value = cv2.transform(light, single(np.diag(gain * balance)))
        mean = cv2.mean(np.minimum(value[::4], 1))[:3]  # a quarter of the rows is enough
        value = value * self.passing + cv2.transform(self.own, single(np.diag(mean)))
        if self.fringes is not None:
            for channel, (columns, rows) in zip((0, 2), self.fringes, strict=True):
                plane = np.ascontiguousarray(value[..., channel])
                value[..., channel] = cv2.remap(plane, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        if self.soft.any():
            value += self.soft * (blurred(value, self.blur, wraps) - value)
        add_glare(value, wraps)
        value += np.float32(self.veil) * (scattered(value, self.spread, wraps) - value)
        add_noise(value, min(gain, _NOISIEST), rng, quiet * self.grain)
        value = cv2.sqrt(np.clip(cv2.transform(value, self.colours), 0, 1))
        image: Array = self.curve[(value * (len(self.curve) - 1)).astype(np.int32)]
        if self.quality is None:
            return image
        written = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
        packed = cv2.imencode(".jpg", written, [cv2.IMWRITE_JPEG_QUALITY, self.quality])[1]
        return cv2.cvtColor(np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR)), cv2.COLOR_BGR2RGB)


def draw_imaging(rng: Rng, camera: ViewCamera) -> Imaging:
    """Draw how a camera of training images turns light into pixel values.

    Args:
        rng: draws all of it.
        camera: the camera. The rim of its lens is at the upper or the lower edge of a panorama, and in the corners of
            an ordinary image.
    """
    rows, columns, wraps = camera.rows, camera.columns, camera.wraps
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    points = np.stack([x, y]) - 0.5
    if wraps:  # a mirror has its rim at the ceiling, a lens that looks up at the floor
        x, y = 0 * x, y - rows * (rng.random() < 0.65)
    else:
        x, y = x - columns / 2, y - rows / 2
    rim = np.hypot(x / columns, y / rows)[..., None]
    rim /= rim.max() or 1
    inner = 1 - rim if wraps else rim  # an unwrapped ring has few pixels at its inner edge; lenses are soft at the rim
    fringes = single(points + rng.normal(0, 0.4, (2, 1, 1, 1)) * np.stack([x, y]) / 64)
    softness = rng.uniform(-0.3, 1) * (inner if rng.random() < 0.7 else rim) ** rng.uniform(0.7, 3)
    response = tone(_LIGHT, str(rng.choice(TONES)), rng.random(), rng.uniform(-0.3, 0.7))
    gain = np.interp(_MIDDLE, response, _LIGHT) / _GREY * 2 ** rng.normal(0, 0.2)
    dirt, dust = _draw_dirt(rng, camera)
    hidden, robot = _draw_robot(rng, camera)
    clear = gain * (1 - rng.uniform(0, 0.5) * rim**4)
    return Imaging(
        passing=single((clear * dirt * (1 - hidden)).repeat(3, axis=-1)),
        own=single(clear * (dust * (1 - hidden) + robot)),
        fringes=fringes if rng.random() < 0.5 else None,
        soft=single(np.maximum(softness, 0).repeat(3, axis=-1)),
        blur=(rng.uniform(0.6, 2.2) * columns / 256, rng.uniform(0.4, 1.0) * rows / 64),
        veil=_log_uniform(rng, 0.003, 0.06),
        spread=_log_uniform(rng, 0.03, 0.2) * columns,
        grain=single(_log_uniform(rng, 0.4, 1.6) * (0.7 + 0.6 * inner.repeat(3, axis=-1))),
        colours=_draw_colours(rng),
        curve=(255 * response + 0.5).astype(np.uint8),
        quality=int(rng.integers(50, 95)) if rng.random() < 0.3 else None,
    )


def tone(light: Array, family: str, strength: float, contrast: float) -> Array:
    """Return the response to light from 0 to 1, from 0 to 1.

    Args:
        light: linear light, of any shape.
        family: one of `TONES`: a power, the curve of sRGB, a film with a shoulder, or a logarithm.
        strength: from 0 to 1, how far the dark parts are lifted above the bright ones; without meaning for sRGB.
        contrast: how far the middle is steeper than the ends, from -0.5 to 1.
    """
    if family == "gamma":
        response = light ** (1 / (1.8 + 0.7 * strength))
    elif family == "srgb":
        response = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    elif family == "film":
        white = 1.5 + 4 * strength  # in units of the light at which the shoulder begins
        response = (light * (white + light) / (1 + white * light)) ** (1 / 2.2)
    else:
        steep = 8 * 6**strength
        response = np.log1p(steep * light) / np.log1p(steep)
    return response + contrast * response * (1 - response) * (2 * response - 1)


def blurred(value: Array, deviations: tuple[float, float], wraps: bool) -> Array:
    """Blur an image with standard deviations in pixels, along its rows and along its columns; no light is lost."""
    pad = int(np.ceil(4 * deviations[0])) if wraps else 0
    wide = cv2.copyMakeBorder(value, 0, 0, pad, pad, cv2.BORDER_WRAP)
    wide = cv2.GaussianBlur(wide, (0, 0), deviations[0], sigmaY=deviations[1], borderType=cv2.BORDER_REFLECT)
    return wide[:, pad : pad + value.shape[1]]


def scattered(value: Array, spread: float, wraps: bool) -> Array:
    """Blur an image (rows, columns, 3) widely, with a standard deviation of `spread` columns; no light is lost."""
    rows, columns = value.shape[:2]
    small = cv2.resize(value, (max(1, columns // 8), max(1, rows // 8)), interpolation=cv2.INTER_AREA)
    return enlarged(blurred(small, (spread / 8, spread / 8), wraps), rows, columns, wraps)


def _draw_colours(rng: Rng) -> Array:
    """Draw the response of red, green and blue to the colours of the light (3, 3): cross-talk, saturation, balance."""
    sharing = rng.uniform(0, 0.12) + rng.normal(0, 0.03, (3, 3))
    mixed = np.eye(3) + sharing - np.diag(sharing.sum(axis=1))  # white stays white
    balance = np.exp(rng.normal(0, 0.05, 3))
    return single((1 / 3 + rng.uniform(0.7, 1.4) * (mixed - 1 / 3)) * (balance / balance.mean())[:, None])


def _draw_dirt(rng: Rng, camera: ViewCamera) -> tuple[Array, Array]:
    """Draw the share of the light that dirt lets pass, and the light of dust as of the robot (rows, columns, 1)."""
    passing, dust = np.ones((camera.rows, camera.columns, 1)), np.zeros((camera.rows, camera.columns, 1))
    for _ in range(int(rng.integers(1, 7)) if rng.random() < 0.5 else 0):
        across, down = _apart(camera, rng.random()), np.arange(camera.rows)[:, None] - rng.random() * camera.rows
        size = _log_uniform(rng, 0.8, 6) * camera.rows / 64
        spot = np.exp(-((across / rng.uniform(1, 2)) ** 2 + down**2) / (2 * size**2))[..., None]
        passing *= 1 - rng.uniform(0.05, 0.35) * spot
        dust += rng.uniform(0.02, 0.15) * (rng.random() < 0.4) * spot
    return passing, dust


def _draw_robot(rng: Rng, camera: ViewCamera) -> tuple[Array, Array]:
    """Draw the parts of the robot in view: mostly none or few.

    Returns:
        The share of each pixel that they cover (rows, columns, 1), and their light in units of the mean light
        (rows, columns, 3).
    """
    # Middle and width as shares of the columns, top as share of the rows, and shares of the columns by which it sways.
    parts: list[tuple[float, float, float, float]] = []
    deck, laptop, posts, cable = rng.random(4) < np.array([0.3, 0.08, 0.15, 0.1]) * (1.0 if camera.wraps else 0.3)
    if deck:
        top = 1 - rng.uniform(0.02, 0.1)
        boxes = rng.uniform((0, 0.02, -0.06), (1, 0.15, 0), (rng.integers(0, 5), 3))
        parts += [(0.5, 2.0, top, 0.0), *((middle, width, top + higher, 0.0) for middle, width, higher in boxes)]
    if laptop:
        parts.append((rng.random(), rng.uniform(0.08, 0.2), 1 - rng.uniform(0.06, 0.2), 0.0))
    if posts:
        count, first, width = int(rng.integers(1, 5)), rng.random(), rng.uniform(0.004, 0.02)
        parts += [(first + number / count, width, -1.0, 0.0) for number in range(count)]
    if cable:
        parts.append((rng.random(), rng.uniform(0.003, 0.006), -1.0, rng.uniform(0.001, 0.01)))
    hidden, own = np.zeros((camera.rows, camera.columns, 1)), np.zeros((camera.rows, camera.columns, 3))
    down = (np.arange(camera.rows)[:, None] + 0.5) / camera.rows
    for middle, width, top, sway in parts:
        half = width * camera.columns / 2
        across = _apart(camera, middle) + sway * camera.columns * np.sin(rng.uniform(3, 9) * (down + rng.random()))
        cover = (np.clip(0.5 + half - np.abs(across), 0, 1) * np.clip(0.5 + (down - top) * camera.rows, 0, 1))[
            ..., None
        ]
        round_off = 1 - 0.5 * np.minimum((across / max(half, 0.5)) ** 2, 1)[..., None]
        hidden += cover * (1 - hidden)
        own += cover * (round_off * _log_uniform(rng, 0.04, 0.7) * np.exp(rng.normal(0, 0.08, 3)) - own)
    return hidden, own


def _apart(camera: ViewCamera, middle: float) -> Array:
    """Return how far each column lies to the right of a middle, given as a share of the width (1, columns)."""
    apart, half = np.arange(camera.columns)[None] + 0.5 - middle * camera.columns, camera.columns / 2
    return (apart + half) % camera.columns - half if camera.wraps else apart


def _log_uniform(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
