"""What the wheels and the gyroscope of a simulated robot report of its drive."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from siamloc.data.moves import chained, moves
from siamloc.simulate.layout import Array, Rng


@dataclass(frozen=True)
class WheelErrors:
    """Sizes of the errors of a robot's odometry; all 0 for a perfect one.

    Attributes:
        scale: standard deviation of the error of all distances of a drive, as a share of them: the wheels' diameter.
        bias: standard deviation of the gyroscope's bias, which is constant in a drive, in rad per metre.
        distance: standard deviation of the error of each distance, as a share of it.
        turn: standard deviation of the error of each turn, in rad per square root of the metres.
        slips: number of slips per metre. In one half of them, the wheels report 10 to 50 % too little distance; in the
            other, a turn that is wrong by 1 to 5 degrees.
    """

    scale: float = 0.02
    bias: float = np.radians(0.5)
    distance: float = 0.01
    turn: float = np.radians(0.3)
    slips: float = 1 / 30


def odometry(poses: Array, generator: Rng, errors: WheelErrors | None = None) -> Array:
    """Return the poses that a robot computes from its wheels and its gyroscope.

    Args:
        poses: true poses of the drive: x, y in metres and heading in rad (n, 3).
        generator: draws the errors.
        errors: sizes of the errors; the default ones if None.

    Returns:
        x, y in metres and heading in rad, in (-pi, pi] (n, 3), in the frame of the first pose: it is (0, 0, 0).

    Example:
        >>> ahead = np.column_stack([np.arange(4.0), np.zeros((4, 2))])
        >>> odometry(ahead, np.random.default_rng(0))[:, 0].round(2).tolist()
        [0.0, 1.0, 2.01, 3.0]
    """
    sizes = WheelErrors() if errors is None else errors
    true = moves(poses)
    metres, n = np.hypot(*true[:, :2].T), len(true)
    scale, bias = generator.standard_normal(2) * (sizes.scale, sizes.bias)
    noise = generator.standard_normal((n, 2)) * (sizes.distance, sizes.turn)
    slipped = generator.random(n) < 1 - np.exp(-sizes.slips * metres)
    turning, side = generator.random((2, n)) < 0.5
    lost, angle = generator.uniform(0.1, 0.5, n), np.radians(generator.uniform(1, 5, n))
    true[:, :2] *= ((1 + scale) * (1 + noise[:, 0]) * np.where(slipped & ~turning, 1 - lost, 1.0))[:, None]
    true[:, 2] += bias * metres + noise[:, 1] * np.sqrt(metres)
    true[:, 2] += np.where(slipped & turning, np.where(side, angle, -angle), 0.0)
    return chained(true)
