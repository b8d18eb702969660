"""The Radon transform of an omnidirectional image, in polar coordinates, where a turn of the robot is a shift.

The omnidirectional image fills a disc of the radius R = size / 2, in pixels of an image of size x size. A point in it
has the radius rho and the angle alpha, counted counter-clockwise as seen in the image, from the direction straight
down. A camera that looks up into its mirror shows the robot's front at the upper rim and its left on the
right; alpha then grows with the columns of the panorama, alpha = 2 pi (c + 1/2) / W at the middle of column c, and a
turn of the robot to the left by delta turns the image counter-clockwise by delta.

**From a panorama** (H, W): the ring 0.2 R <= rho < R. Row i lies at the radius R - (i + 1/2) 0.8 R / H: the upper row
is outermost, as in the default unwrapping. Between the centres of rows the image is linear in rho, and constant from
the first and the last centre to the rim of the ring. Outside the ring it is 0.
With `circular=False` each row is extended by its mirror image, so that the seam is no edge; W is then twice as large.

**From an omnidirectional image** (S, S): its inscribed disc, scaled to R. It is first sampled at H = S // 2 radii
(i + 1/2) S / (2 H) pixels, outermost first, and W = 4 ceil(pi S / 4) angles 2 pi (c + 1/2) / W, bilinearly between the
centres of pixels: the point lies rho sin(alpha) to the right of and rho cos(alpha) below the centre of the image. This
is a panorama as above, but with the disc rho < R instead of the ring: the row radii are R - (i + 1/2) R / H.

Along the angle a row is the trigonometric polynomial through its W values, of which the frequencies m = 0 ... M are
kept, M = min((T - 1) // 2, (W - 1) // 2), T = 360 / step being the number of orientations: frequencies that T
orientations or W columns cannot represent are left out. The transform therefore commutes with turns by any angle:

    f(rho, alpha) = sum over |m| <= M of P[rho, m] exp(i m alpha),
    P[row, m] = (1 / W) sum_c p[row, c] exp(-i m 2 pi (c + 1/2) / W).

**Lines.** Orientation t has the direction phi = 2 pi t / T, line k = 0 ... size / 2 - 1 the distance d = k + 1/2
pixels from the centre: the points with rho cos(alpha - phi) = d. These are half of all lines, the other half being
those of the opposite directions. A line is summed at points half a pixel apart, l = +-1/4, +-3/4, ... pixels from
its foot, as far as rho = sqrt(d^2 + l^2) < R:

    r[t, k] = (1/2) sum_l f(sqrt(d^2 + l^2), phi + atan2(l, d)),

in grey values times pixels. A left turn by 360 / T degrees moves r one row down: r[t] becomes r[t + 1].
"""

from __future__ import annotations

from functools import lru_cache
from math import ceil, pi
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from analytic.errors import AnalyticError
from foundation.settings import Rule

Source = Literal["panorama", "omnidirectional"]
Step = Annotated[
    float,
    Rule(
        "degrees that divide 360, at most 120, such as 1, 4 or 11.25",
        lambda value: 0 < value <= 120 and abs(steps(value) * value - 360) <= 1e-6,
    ),
]
Even = Annotated[int, Rule("an even number from 2 to 16,384", lambda value: 2 <= value <= 16_384 and value % 2 == 0)]
INNER = 0.2  # inner radius of a panorama's ring, as a share of the outer one
_SPACING = 0.5  # pixels between the points of a line


def steps(step: float) -> int:
    """Return the number of orientations in a full turn, 360 / step, for a step in degrees."""
    return round(360 / step)


def check_square(name: str, source: str, height: int, width: int) -> None:
    """Raise AnalyticError for an omnidirectional image that is not square.

    Args:
        name: name of the descriptor, for the message.
        source: "panorama", which may have any size, or "omnidirectional".
        height: rows of the image.
        width: columns of the image.
    """
    if source == "omnidirectional" and height != width:
        raise AnalyticError(
            f"{name} with source='omnidirectional' takes square images, got {height} x {width} pixels: crop them, or "
            "use source='panorama' for panoramas"
        )


def harmonics(
    image: NDArray[np.float32], step: float, size: int, lines: int, source: str = "panorama", circular: bool = True
) -> NDArray[np.complex128]:
    """Return the Fourier coefficients of the transform along its orientations (M + 1, lines).

    r[t] = sum over |m| <= M of c[m] exp(2 pi i m t / T), c[-m] being the conjugate of c[m].

    Args:
        image: (H, W).
        step: degrees between orientations.
        size: side of the disc in pixels.
        lines: number of lines kept; it divides size / 2. Each is the mean of size / 2 / lines neighbours.
        source: "panorama" or "omnidirectional".
        circular: whether the columns of a panorama wrap around.
    """
    if source == "omnidirectional":
        polar, inner = _unwrapped(image), 0.0
    else:
        whole = image if circular else np.concatenate([image, image[:, ::-1]], axis=1)
        polar, inner = whole.astype(np.float64), INNER
    # In double precision even a coefficient near zero keeps its magnitude and phase when the robot turns.
    kernel, phase = _operator(*polar.shape, size, lines, steps(step), inner)
    found = np.fft.rfft(polar, axis=1)[:, : len(phase)] * phase
    parts = np.ascontiguousarray(found.T)[..., None].view(np.float64)  # (M + 1, H, 2)
    return np.ascontiguousarray(kernel @ parts).view(np.complex128)[..., 0]


def orientations(found: NDArray[np.complex128], count: int) -> NDArray[np.float64]:
    """Return the values (T, F) at T orientations of a function with Fourier coefficients (M + 1, F)."""
    return np.fft.irfft(found, n=count, axis=0, norm="forward")


def _unwrapped(image: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the polar samples (H, W) of the inscribed disc of a square image (S, S), bilinear between pixels."""
    side = len(image)
    place = np.clip(((_grid(side) + 1) * side - 1) / 2, 0, side - 1)
    first = np.minimum(place.astype(np.int64), max(side - 2, 0))
    share = place - first
    (x, y), (right, down) = np.moveaxis(first, -1, 0), np.moveaxis(share, -1, 0)
    beside, below = np.minimum(x + 1, side - 1), np.minimum(y + 1, side - 1)
    upper = image[y, x] * (1 - right) + image[y, beside] * right
    lower = image[below, x] * (1 - right) + image[below, beside] * right
    return np.asarray(upper * (1 - down) + lower * down)


@lru_cache(maxsize=8)
def _grid(side: int) -> NDArray[np.float64]:
    """Return where to sample (H, W, 2): to the right and down from the middle, 1 being half the image's side."""
    height, width = side // 2, 4 * ceil(pi * side / 4)
    radius = 1 - (np.arange(height) + 0.5) / height
    angle = 2 * pi * (np.arange(width) + 0.5) / width
    return radius[:, None, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)


@lru_cache(maxsize=8)
def _operator(
    height: int, width: int, size: int, lines: int, count: int, inner: float
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Return the share of each row in each line by frequency (M + 1, lines, H), and the columns' phases (M + 1,).

    As a line is symmetric about its foot, the sum of exp(i m alpha) along it is a sum of cosines: all shares are real.
    """
    outer = size / 2
    frequency = np.arange(min((count - 1) // 2, (width - 1) // 2) + 1)
    distance = np.arange(size // 2) + 0.5
    place = (np.arange(ceil(outer / _SPACING)) + 0.5) * _SPACING
    kernel = np.zeros((len(frequency), lines, height))
    together = size // 2 // lines
    for line, d in enumerate(distance):
        radius, angle = np.hypot(d, place), np.arctan2(place, d)
        seen = (radius < outer) & (radius >= inner * outer)
        share = _rows(radius[seen], height, outer, inner)
        kernel[:, line // together] += (share @ np.cos(angle[seen, None] * frequency)).T
    kernel *= 2 * _SPACING / together  # both sides of the foot
    return kernel, np.exp(-1j * pi * frequency / width) / width


def _rows(radius: NDArray[np.float64], height: int, outer: float, inner: float) -> NDArray[np.float64]:
    """Return the weight of each row at given radii (H, n), linear between the centres of rows."""
    row = np.clip((outer - radius) / (outer * (1 - inner)) * height - 0.5, 0, height - 1)
    return np.maximum(0, 1 - np.abs(row - np.arange(height)[:, None]))
