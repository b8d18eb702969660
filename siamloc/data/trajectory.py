"""`Trajectory`: poses along time, from a file, between whose entries poses are interpolated.

Four forms of files are read. TUM: `time x y z qx qy qz qw` on each line. KITTI: the upper three rows of a pose's
matrix, 12 numbers, or all of it, 16, without a time. EuRoC: a CSV table of a time in ns, x, y, z, qw, qx, qy, qz, and
maybe more columns. Planar: `time x y heading`, in rad.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from foundation.calls import typed
from foundation.files import read_text
from foundation.settings import Positive, shortened
from siamloc.data.text_rows import headed, is_number, name_words
from siamloc.errors import DataError, leave_out, logger, say_once

Array = NDArray[np.float64]
Form = Literal["tum", "kitti", "euroc", "planar"]
Order = Literal["xyzw", "wxyz"]
Axes = Literal["robot", "camera"]

#: The directions ahead and upwards in the frame whose poses are given.
AXES: dict[str, tuple[Array, Array]] = {
    "robot": (np.array([1.0, 0, 0]), np.array([0, 0, 1.0])),
    "camera": (np.array([0, 0, 1.0]), np.array([0, -1.0, 0])),
}
OTHER_ORDERS = ([1, 2, 3, 0], [3, 0, 1, 2])
"""Orders of columns that put quaternions (x, y, z, w) right again which were read in the wrong order."""
_FACTORS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_UNITS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))  # from a number this large, times count ns, us and ms
_A_DRIVE = 0.01  # of the time since 1970, half a year: no drive takes longer
_THIS_CENTURY = 9e8, 4.2e9  # s since 1970
_SLOWEST = 3600.0  # s between two entries of a drive since 1970
_SPARSE = 10  # s; whole numbers farther apart count another unit
_USUAL, _STEPS = 0.1, (1e-3, 60.0)  # s from an entry to the next
_UNIT_LENGTH = 0.01  # by which the length of a quaternion may differ from 1
_LEVEL = 0.98  # least length of the mean direction upwards of a robot that stays level
_TILTED = 0.9  # largest length of that mean for a robot that does not stay upright
_LEANS = np.radians(2)  # angle between an axis of the world and the ground from which on the ground counts
_FEWEST = 10  # positions that show the ground
_FLAT, _WIDE = 0.05, 0.01  # most thickness of a ground, as a share of its width, and least width, of its length
_STEADIER = 0.5  # how unsteady the ground's normal may be in the frame, as a share of how unsteady the axis is
_WHOLE_TURN = 2 * np.pi + 0.01
_EXACTLY = 1e-6  # rad
_ROTATES = 0.01  # by which the product of a rotation matrix and its transpose may differ from the unit matrix
_NO_GAP = 1e9  # s
_HEADING = {"theta", "th", "yaw", "heading", "phi", "psi", "angle"}  # words in the name of a column
_OTHER_UNITS = {"mm", "cm", "km", "ft", "feet", "deg", "degree", "degrees"}
_COLUMNS = {"tum": 8, "kitti": 12, "euroc": 8, "planar": 4}


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of a frame, such as the robot's, along time.

    Attributes:
        time: seconds (n,), increasing; NaN if the file holds none.
        position: in metres (n, 3).
        quaternion: unit quaternions (n, 4), x, y, z, w, which turn the frame's axes into those of the world.
        source: the file, for messages.
        in_order: whether the file says the order of its quaternions.
    """

    time: Array
    position: Array
    quaternion: Array
    source: str = ""
    in_order: bool = True

    def __len__(self) -> int:
        return len(self.time)

    @classmethod
    def of(cls, time: Array, position: Array, quaternion: Array, source: str, in_order: bool = True) -> Trajectory:
        """Make a trajectory of poses in any order of time; of poses with the same time the first is kept.

        Poses with a time, but without finite values or with a quaternion of zeros, such as robots send before they
        know where they are, are left out.

        Raises:
            DataError: no poses, without times a value that is not finite, or a quaternion that is not of unit length.
        """
        if not len(position):
            raise DataError(f"{source} holds no poses")
        length = np.linalg.norm(quaternion, axis=1)

        def said(row: int) -> str:
            return f"pose {row + 1}, {' '.join(f'{value:g}' for value in (*position[row], *quaternion[row]))}"

        known = np.isfinite(np.column_stack([position, length])).all(axis=1) & (length > 0)
        empty = ~known & np.isfinite(time)
        what = f"poses of {source} are not three finite numbers and a quaternion"
        leave_out([said(row) for row in np.flatnonzero(empty).tolist()], len(position), what, "skip")
        wrong = ~empty & ~(known & (np.abs(length - 1) <= _UNIT_LENGTH))
        if wrong.any():
            row = int(wrong.argmax())
            raise DataError(
                f"{source}: {said(row)}, is not three numbers and a quaternion of length 1, but of "
                f"length {length[row]:.3g}: check the order of the columns"
            )
        time, position, quaternion, length = (part[~empty] for part in (time, position, quaternion, length))
        order = np.unique(time, return_index=True)[1] if np.isfinite(time).all() else np.arange(len(time))
        return cls(time[order], position[order], (quaternion / length[:, None])[order], source, in_order)

    @classmethod
    def planar(cls, time: Array, poses: Array, source: str) -> Trajectory:
        """Make a trajectory of poses in the plane (n, 3): x, y, and heading in rad."""
        zero, half = np.zeros(len(poses)), poses[:, 2] / 2
        position = np.column_stack([poses[:, :2], zero])
        return cls.of(time, position, np.column_stack([zero, zero, np.sin(half), np.cos(half)]), source)

    @typed
    def at(self, times: Array, gap: Positive = 2.0) -> Trajectory:
        """Return the poses at some times (m,), in s: positions linear in time, orientations by spherical interpolation.

        Poses are NaN outside of the trajectory, and between two entries more than `gap` seconds apart.
        """
        after = np.clip(np.searchsorted(self.time, times), 1, max(len(self) - 1, 1))
        before = after - 1
        after = np.minimum(after, len(self) - 1)
        span = self.time[after] - self.time[before]
        share = np.divide(times - self.time[before], span, out=np.zeros(len(times)), where=span > 0)[:, None]
        position = (1 - share) * self.position[before] + share * self.position[after]
        quaternion = _slerp(self.quaternion[before], self.quaternion[after], share)
        exact = (times == self.time[before]) | (times == self.time[after])
        known = (times >= self.time[0]) & (times <= self.time[-1]) & ((span <= gap) | exact)
        position[~known], quaternion[~known] = np.nan, np.nan
        return Trajectory(np.asarray(times, dtype=np.float64), position, quaternion, self.source, self.in_order)

    @typed
    def flat(self, axes: Axes = "robot", whole: Trajectory | None = None) -> Array:
        """Return the poses in the plane of the ground (n, 3): x, y, and heading in rad, counter-clockwise.

        The direction upwards is that axis of the world to which the frame's own points all the time; or the normal of
        the plane of the positions, if that leans against the axis and stays the same in the frame while the axis does
        not, as in the world of a camera's first pose, which is tilted as the camera was. Seen from above, x is the
        world's first axis in the plane, and y lies a quarter turn to its left.

        Args:
            axes: the frame's axes: "robot" for x ahead and z up, "camera" for z ahead and y down.
            whole: the trajectory that says which way is up, if these are a few of its poses; this one if None.

        Returns:
            NaN where a pose is not known.

        Raises:
            DataError: the frame does not stay upright, or none of its poses is known.
        """
        return self.tilted(axes, whole)[:, :3]

    def tilted(self, axes: Axes = "robot", whole: Trajectory | None = None) -> Array:
        """Return the poses in the plane with roll and pitch in rad (n, 5), as `FrameTable` has them; see `flat`.

        Roll and pitch are NaN for a frame that is always exactly level: nobody measured them.
        """
        (ahead, up), upwards = AXES[axes], (whole or self)._upwards(axes)
        across = np.stack([ahead, np.cross(up, ahead), up], axis=1)
        seen = turned(self.inverse().quaternion, upwards) @ across
        tilt = np.column_stack([np.arctan2(seen[:, 1], seen[:, 2]), -np.arcsin(seen[:, 0].clip(-1, 1))])
        if not (np.abs(tilt) > _EXACTLY).any():
            tilt[:] = np.nan
        axis = _nearest_axis(upwards)
        vertical = int(np.abs(axis).argmax())
        first, second = [other for other in range(3) if other != vertical]
        left = axis[vertical] * (-1 if vertical == 1 else 1)
        level = _turn_between(upwards, axis)
        position, forward = (turned(level, of) for of in (self.position, turned(self.quaternion, ahead)))
        heading = np.arctan2(left * forward[:, second], forward[:, first])
        return np.column_stack([position[:, first], left * position[:, second], heading, tilt])

    def own_axes(self, given: Axes, *, beside: bool = False) -> Axes:
        """Return the axes of this trajectory: the given ones, or "robot" where it does not stay upright with them.

        Args:
            given: axes that the user gave for all trajectories of a drive.
            beside: whether the drive has another trajectory, which the given axes may be meant for: this one then has
                the axes with which it stays upright best, and otherwise those of a robot only if no others fit.
        """
        robot, camera = (np.abs(mean_up(self._oriented, axes)).max() for axes in ("robot", "camera"))
        others = camera <= robot if beside else camera < _TILTED <= robot
        return "robot" if others else given

    @property
    def _oriented(self) -> Array:
        """The quaternions that are known, (n or fewer, 4)."""
        return np.asarray(self.quaternion[np.isfinite(self.quaternion).all(axis=1)])

    def inverse(self) -> Trajectory:
        """Return the poses of the world's frame as seen from this one."""
        back = self.quaternion * np.array([-1, -1, -1, 1])
        return Trajectory(self.time, -turned(back, self.position), back, self.source, self.in_order)

    def _upwards(self, axes: Axes) -> Array:
        """Return the direction upwards in the world (3,): an axis, or the normal of a ground that leans; see `flat`."""
        if not len(self._oriented):
            raise DataError(
                f"{self.source}: none of the {len(self)} poses is known, so that nothing says which way is up: take "
                "times inside of the trajectory, or give the trajectory as whole"
            )
        upwards = self._upright(axes)
        if upwards is None:
            raise DataError(f"{self.source}: {self._why_tilted(axes)}")
        return upwards

    def _upright(self, axes: Axes) -> Array | None:
        """Return what `_upwards` returns; None if the frame does not stay upright with these axes."""
        mean = mean_up(self._oriented, axes)
        axis, ground = _nearest_axis(mean), self._ground()
        if ground is not None:
            ground = ground * np.sign(ground @ mean)
            back = self._oriented * np.array([-1, -1, -1, 1])
            unsteady, usual = (1 - np.linalg.norm(turned(back, of).mean(axis=0)) for of in (ground, axis))
            leans = ground @ axis < np.cos(_LEANS) and unsteady < _STEADIER * usual
            if leans and ground @ mean >= _TILTED:
                return np.asarray(ground)
        return axis if np.abs(mean).max() >= _TILTED else None

    def _ground(self) -> Array | None:
        """Return the normal of the plane in which the positions lie (3,); None if they lie in none, or on a line."""
        position = self.position[np.isfinite(self.position).all(axis=1)]
        if len(position) < _FEWEST:
            return None
        _, (length, width, thickness), directions = np.linalg.svd(position - position.mean(axis=0), full_matrices=False)
        return directions[2] if thickness < _FLAT * width and width > _WIDE * length else None

    def _steady(self, back: bool = False) -> Array:
        """Return how steady the frame's axes are in the world, or the world's in the frame (3,): 1 if they stay."""
        quaternion = self._oriented * np.array([-1, -1, -1, 1]) if back else self._oriented
        return np.array([np.linalg.norm(turned(quaternion, axis).mean(axis=0)) for axis in np.eye(3)])

    def _why_tilted(self, axes: Axes) -> str:
        other: Axes = "camera" if axes == "robot" else "robot"
        mean, others_mean = (mean_up(self._oriented, one) for one in (axes, other))
        swapped, others_swapped = (
            max(np.abs(mean_up(self._oriented[:, order], one)).max() for order in OTHER_ORDERS) for one in (axes, other)
        )
        order = "order=wxyz, or order=xyzw if w stands last"
        if not self.in_order and swapped > _LEVEL and np.linalg.norm(mean) < _LEVEL:  # else alike in any order
            return f"the quaternions are in the other order: give {order}"
        doubtful = not self.in_order and max(swapped, others_swapped) >= _TILTED
        doubt = f", unless the quaternions are in the other order ({order})" if doubtful else ""
        fits = np.abs(others_mean).max()
        if fits > _LEVEL or (other == "camera" and self._steady().min() < _LEVEL and self._upright(other) is not None):
            return f"the poses seem to be those of a {other}, not of a {axes}: give axes={other}{doubt}"
        if np.linalg.norm(mean) < _LEVEL and self._steady(back=True).max() < _LEVEL:
            return (
                f"no axis of the world stays upright, with axes={axes}: the {axes} tilts on its way, or the world "
                f"leans{doubt}"
            )
        tilt, others_tilt, most = np.degrees(np.arccos([np.abs(mean).max(), fits, _TILTED]))
        level = f"axes={other}, or the poses of a level frame" if fits >= _TILTED else "the poses of a level frame"
        return (
            f"with axes={axes} the frame is tilted by {tilt:.0f} degrees against the nearest axis of the world, with "
            f"axes={other} by {others_tilt:.0f}, and up to {int(most)} are read{doubt}: give {level}, such as the "
            "robot's base"
        )


def _nearest_axis(direction: Array) -> Array:
    """Return the axis of the world (3,), or its opposite, that is nearest to a direction (3,)."""
    size = np.abs(direction)
    return np.asarray(np.where(size == size.max(), np.sign(direction), 0.0))


def _turn_between(one: Array, other: Array) -> Array:
    """Return the quaternion (1, 4) of the shortest turn of a direction (3,) to another one, not its opposite."""
    quaternion = np.append(np.cross(one, other), 1 + one @ other)
    return quaternion[None] / np.linalg.norm(quaternion)


def composed(links: Sequence[Trajectory], source: str) -> Trajectory:
    """Return the poses of the last frame of a chain in the first one, at the times of the trajectory with most poses.

    Args:
        links: the poses of each frame in the frame before; a single pose holds for all times.
        source: name of the chain for messages.
    """
    times = max(links, key=len).time
    position, quaternion = np.zeros((len(times), 3)), np.tile([0.0, 0, 0, 1], (len(times), 1))
    for link in links:
        here = link.at(times, _NO_GAP) if len(link) > 1 else link
        position = position + turned(quaternion, here.position)
        quaternion = _product(quaternion, here.quaternion)
    known = np.isfinite(position).all(axis=1)
    return Trajectory.of(times[known], position[known], quaternion[known], source)


def _product(first: Array, second: Array) -> Array:
    """Return the product of quaternions (n, 4) and (n, 4) or (1, 4)."""
    axis, w = first[:, :3], first[:, 3:]
    other, v = second[:, :3], second[:, 3:]
    return np.column_stack([w * other + v * axis + np.cross(axis, other), w * v - (axis * other).sum(axis=1)[:, None]])


def mean_up(quaternion: Array, axes: Axes) -> Array:
    """Return the mean direction upwards (3,) of a frame, in the world; of length 1 if it stays the same."""
    return np.asarray(turned(quaternion, AXES[axes][1]).mean(axis=0))


def turned(quaternion: Array, vector: Array) -> Array:
    """Return a vector (3,), or one for each (n, 3), turned by quaternions (n, 4), as (n, 3)."""
    axis, w = quaternion[:, :3], quaternion[:, 3:]
    across = 2 * np.cross(axis, vector)
    return np.asarray(vector + w * across + np.cross(axis, across))


def _slerp(first: Array, second: Array, share: Array) -> Array:
    """Return the orientations (n, 4) at a share (n, 1) of the shorter way between quaternions (n, 4)."""
    cosine = (first * second).sum(axis=1, keepdims=True)
    second, cosine = np.where(cosine < 0, -second, second), np.abs(cosine)
    angle = np.arccos(np.clip(cosine, 0, 1))
    sine = np.maximum(np.sin(angle), 1e-12)
    near = angle < 1e-6  # where the arc is straight
    weights = [np.where(near, part, np.sin(part * angle) / sine) for part in (1 - share, share)]
    mixed = weights[0] * first + weights[1] * second
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))


@typed
def read_trajectory(file: str | Path, form: Form | None = None, order: Order | None = None) -> Trajectory:
    """Read a trajectory in TUM, KITTI, EuRoC or planar form.

    Args:
        file: the file; lines that begin with # are skipped, as is a first line of names.
        form: its form; if None, KITTI for lines of 12 or 16 numbers, planar for lines of 4, EuRoC for numbers between
            commas, and otherwise TUM.
        order: order of a quaternion, if it is another than that of the names of the columns, or else of the form.

    Returns:
        The poses; times are in s, also of files that count ms, us or ns, and NaN in KITTI form.

    Raises:
        DataError: the file cannot be read or has another form (with line), or its poses are not poses.

    Example:
        >>> import tempfile
        >>> file = Path(tempfile.mkdtemp()) / "groundtruth.txt"
        >>> _ = file.write_text("# time x y z qx qy qz qw\\n0.0 0 0 0 0 0 0 1\\n1.0 2 0 0 0 0 1 0\\n")
        >>> read_trajectory(file).at(np.array([0.5])).flat().round(2).tolist()
        [[1.0, 0.0, 1.57]]
    """
    path = Path(file)
    numbers, names, commas = read_numbers(path)
    if numbers.shape[1] == 16 and (numbers[:, 12:] == [0, 0, 0, 1]).all():
        numbers = numbers[:, :12]
    by_width: dict[int, Form] = {4: "planar", 12: "kitti"}
    form = form or by_width.get(numbers.shape[1], "euroc" if commas else "tum")
    if numbers.shape[1] < _COLUMNS[form] or (form == "kitti" and numbers.shape[1] != 12):
        raise DataError(
            f"{path} has {numbers.shape[1]} numbers on a line, and a trajectory in {form} form has {_COLUMNS[form]}: "
            "give form=tum, kitti, euroc or planar (time, x, y, heading)"
        )
    if other := next((name for name in names[1 : _COLUMNS[form]] if _OTHER_UNITS & name_words(name)), None):
        raise DataError(f"{path} has the column {other!r}: convert it to m or rad, and name it without the unit")
    if form == "planar":
        if names and not _HEADING & name_words(names[3]):
            raise DataError(
                f"{path} has the column {names[3]!r} where a trajectory in planar form has the heading: name it theta, "
                "yaw or heading if it is one, in rad, or give quaternions"
            )
        if np.abs(numbers[:, 3]).max() > _WHOLE_TURN:
            logger.warning(
                "%s: the headings reach from %.1f to %.1f and are taken for rad: convert them if they are degrees",
                *(path, numbers[:, 3].min(), numbers[:, 3].max()),
            )
        return Trajectory.planar(seconds(numbers[:, 0], str(path)), numbers[:, 1:4], str(path))
    if form == "kitti":
        matrices, no_times = numbers.reshape(-1, 3, 4), np.full(len(numbers), np.nan)
        return Trajectory.of(no_times, matrices[:, :, 3], _of_matrices(matrices[:, :, :3], path), str(path))
    named = "".join(re.sub("[^a-z]", "", name)[-1:] for name in names[4:8])
    order = order or next((one for one in get_args(Order) if one == named), "xyzw" if form == "tum" else "wxyz")
    quaternion = numbers[:, [5, 6, 7, 4] if order == "wxyz" else [4, 5, 6, 7]]
    return Trajectory.of(seconds(numbers[:, 0], str(path)), numbers[:, 1:4], quaternion, str(path), named == order)


def seconds(times: Array, source: str, span: float | None = None) -> Array:
    """Return times in s that are given in s, ms, us or ns.

    Times since 1970 are known by their size. From any other start, whole numbers with a median step above 10 are in the
    unit that brings this step nearest to 0.1 s, or the drive nearest to its known length, which is said; all others are
    s.

    Args:
        times: (n,), in any order.
        source: the file or folder, for the line that says the unit.
        span: how long the drive takes by other times, in s; None if unknown.
    """
    largest = np.abs(times).max(initial=0)
    steps = np.diff(np.unique(times))
    step = float(np.median(steps)) if len(steps) else 0.0
    by_size = next((factor for least, factor in _UNITS if largest >= least), 1.0)
    known = _THIS_CENTURY[0] <= largest * by_size <= _THIS_CENTURY[1] and np.ptp(times) <= _A_DRIVE * largest
    if (known and step * by_size <= _SLOWEST) or step <= _SPARSE or (times % 1).any():
        return times * (by_size if known else 1.0)
    units = _FACTORS
    if span is not None:  # of poses that the images lie within
        every = {"s": 1.0, **_FACTORS}
        units = {unit: factor for unit, factor in every.items() if np.ptp(times) * factor <= 1.5 * span} or _FACTORS
    ratio = step / _USUAL if span is None else np.ptp(times) / span
    unit, factor = min(units.items(), key=lambda one: abs(np.log(ratio * one[1])))
    if unit == "s" or (span is None and not _STEPS[0] <= step * factor <= _STEPS[1]):
        return times * (by_size if known else 1.0)
    say_once(
        f"{source}: the times from {times.min():.0f} to {times.max():.0f} are taken for {unit} since some start, in "
        f"steps of {step * factor:.3g} s: if that is wrong, write them in s"
    )
    return times * factor


def read_numbers(path: Path) -> tuple[Array, list[str], bool]:
    """Return the numbers of a file (n, columns), the names of the columns, and whether commas separate them.

    There are no names, or one for each column.
    """
    names, rows = headed(path)
    names, lines = [name.lower() for name in names], read_text(path).splitlines()
    width = len(rows[0][1])
    expected = f"{width} numbers" if is_number(rows[0][1][0]) else "lines of numbers, 4, 8 or 12 for a trajectory"
    for number, words in rows:
        if len(words) != width or not all(map(is_number, words)):
            line = shortened(lines[number - 1].strip())
            raise DataError(
                f"{path}, line {number}: expected {expected}, got {line!r}: it is cut short, or no trajectory; "
                "poses by the names of images are a manifest, a table with the columns image, x, y and theta"
            )
    if "x" in names and names[1:3] != ["x", "y"]:
        raise DataError(f"{path} has the columns {', '.join(names)}: expected the time, x and y first")
    numbers = np.array([words for _, words in rows], dtype=np.float64)
    return numbers, names if len(names) == width else [], "," in lines[rows[0][0] - 1]


def _of_matrices(matrices: Array, path: Path) -> Array:
    """Return the quaternions (n, 4) of rotation matrices (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    off = np.abs(matrices @ matrices.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    wrong = ~(off <= _ROTATES) | ~(np.linalg.det(matrices) > 0)
    if wrong.any():
        raise DataError(f"{path}: the matrix of pose {wrong.argmax() + 1} is not a rotation: it is not in KITTI form")
    return np.asarray(Rotation.from_matrix(matrices).as_quat())
