"""COLD image names, which carry the time and the pose: `t<seconds>_x<metres>_y<metres>_a<radians>.jpeg`."""

from __future__ import annotations

import math
import re
from typing import NamedTuple

LIGHTINGS = ("cloudy", "night", "sunny")

_NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_NAME = re.compile(
    rf"t(?P<time>{_NUMBER})_x(?P<x>{_NUMBER})_y(?P<y>{_NUMBER})_a(?P<theta>{_NUMBER})\.(?:jpe?g|png)", re.IGNORECASE
)


class NamedPose(NamedTuple):
    """What a COLD image name says: time in s, position in m, heading in rad."""

    time: float
    x: float
    y: float
    theta: float


def parse_name(name: str) -> NamedPose | None:
    """Return the time and pose that a file name (without its folder) carries, or None where it is no COLD name.

    The whole name has to fit, and the numbers have to be finite; exponents such as `1e-05` and `-0.000000` are
    understood, `.jpg` and `.png` too.
    """
    match = _NAME.fullmatch(name)
    if match is None:
        return None
    pose = NamedPose(**{key: float(value) for key, value in match.groupdict().items()})
    return pose if all(math.isfinite(value) for value in pose) else None


def format_name(pose: NamedPose, suffix: str = ".jpeg") -> str:
    """Return the COLD file name of a pose, with six decimals as the database writes them.

    Raises:
        ValueError: a number that is not finite.
    """
    if not all(math.isfinite(value) for value in pose):
        raise ValueError(f"a file name carries finite numbers only, got {pose}")
    return f"t{pose.time:.6f}_x{pose.x:.6f}_y{pose.y:.6f}_a{pose.theta:.6f}{suffix}"


def lighting_in(text: str) -> str:
    """Return the one lighting (cloudy, night, sunny) that a text names, in whatever case, or the empty text."""
    named = [lighting for lighting in LIGHTINGS if lighting in text.lower()]
    return named[0] if len(named) == 1 else ""
