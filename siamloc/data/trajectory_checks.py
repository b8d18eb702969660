"""Doubts about a trajectory that can be read, but perhaps not as it is: each check returns a sentence, or None."""

from __future__ import annotations

import numpy as np

from siamloc.data.trajectory import AXES, OTHER_ORDERS, Array, Axes, Trajectory, mean_up, turned

_SLOW, _FAST = 0.005, 20.0  # m/s; no robot that drives a metre is slower or faster
_UNITS = {"ms": 1e3, "us": 1e6, "ns": 1e9}
_ALIGNED = 0.9


def doubts(trajectory: Trajectory, axes: Axes = "robot") -> list[str]:
    """Return a sentence for each doubt about a trajectory."""
    way = float(np.linalg.norm(np.diff(trajectory.position, axis=0), axis=1).sum())
    span = float(np.ptp(trajectory.time)) if len(trajectory) > 1 else np.nan
    unit = other_unit(trajectory.source, way, span)
    found = (other_order(trajectory, axes), unit, other_frame(trajectory, axes))
    return [text for text in found if text is not None]


def other_order(trajectory: Trajectory, axes: Axes = "robot") -> str | None:
    """Look for quaternions that may be in the other order: of a robot that hardly turns, both orders stay upright.

    In the other order, the robot then stands on its head, or drives backwards.
    """
    read = _upright(trajectory.quaternion, axes), _forward(trajectory, trajectory.quaternion, axes)
    if trajectory.in_order or abs(read[0]) < _ALIGNED:
        return None  # the latter is an error
    for rolled in (trajectory.quaternion[:, order] for order in OTHER_ORDERS):
        other = _upright(rolled, axes), _forward(trajectory, rolled, axes)
        on_its_head = read[0] < 0 and other[0] > _ALIGNED and not other[1] < 0
        backwards = read[1] < -_ALIGNED and other[1] > _ALIGNED and abs(other[0]) > _ALIGNED
        if on_its_head or backwards:
            how = "stands on its head" if on_its_head else "drives backwards"
            return (
                f"{trajectory.source}: the robot {how} all the time, and would not with the quaternions in the other "
                "order: if w stands first give order=wxyz, if last order=xyzw"
            )
    return None


def other_unit(source: str, way: float, span: float) -> str | None:
    """Look for times in ms, us or ns that are taken for seconds: in a drive of `way` m the robot then hardly moves."""
    if way < 1 or not way < _SLOW * span:
        return None
    unit = next((unit for unit, factor in _UNITS.items() if _SLOW < way / span * factor < _FAST), None)
    if unit is None:
        return None
    return (
        f"{source}: with times in seconds, the robot drives {way:.0f} m in {span:.0f} s: if they count "
        f"{unit}, divide them by {_UNITS[unit]:.0f}"
    )


def other_frame(trajectory: Trajectory, axes: Axes = "robot") -> str | None:
    """Look for the axes of another frame, of whose direction ahead the robot makes upwards: it then rises or sinks."""
    upright = np.abs(mean_up(trajectory.quaternion, axes))
    up, size = int(upright.argmax()), np.ptp(trajectory.position, axis=0)
    height, wide = float(size[up]), float(np.delete(size, up).max())
    if upright[up] < _ALIGNED or height < max(1.0, wide):
        return None
    other = next(name for name in AXES if name != axes)
    return (
        f"{trajectory.source}: with axes={axes}, the robot rises or sinks by {height:.0f} m, and goes {wide:.0f} m on "
        f"the level: if these are the poses of a {other}, give axes={other}"
    )


def _upright(quaternion: Array, axes: Axes) -> float:
    """Return how upright the frame is on average, from -1, on its head, to 1; y points down in a camera's world."""
    mean = mean_up(quaternion, axes)
    vertical = int(np.abs(mean).argmax())
    return float(mean[vertical]) * (-1 if axes == "camera" and vertical == 1 else 1)


def _forward(trajectory: Trajectory, quaternion: Array, axes: Axes) -> float:
    """Return how well the robot drives ahead, from -1 (backwards) to 1; NaN if it stands still."""
    steps = np.diff(trajectory.position, axis=0)
    length = np.linalg.norm(steps, axis=1)
    real = length > max(float(np.median(length)) / 4 if len(length) else 0.0, 1e-6)
    if not real.any():
        return np.nan
    ahead = turned(quaternion[:-1], AXES[axes][0])[real]
    return float(((ahead * steps[real]).sum(axis=1) / length[real]).mean())
