"""How a robot moves between the frames of a map, learned from the map's own spacing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError

_REACH = 4.0  # standard deviations; the weight beyond is below 4e-4 and left to kidnapping
_FAST = 95  # percentile of the map's speeds that a robot keeps below


@dataclass(frozen=True, eq=False)
class MotionModel:
    """Probabilities of going from one map frame to another between two queries, as a list of pairs.

    The probability falls with the distance d between two frames as exp(-d^2 / (2 sigma^2)), in whatever direction, with
    sigma^2 = step^2 + spacing^2 / 6. The second term is there because a frame stands for all places up to half a
    spacing from it: the difference of two such places has that variance.

    Attributes:
        xy: (m, 2) positions of the map's frames.
        source: (e,) frame from which, every frame to itself among them.
        target: (e,) frame to which.
        weight: (e,) probability; those of one source add up to 1.
        step: how far the robot goes between two queries.
        spacing: median distance between consecutive frames of the map.
    """

    xy: NDArray[np.float64]
    source: NDArray[np.int64]
    target: NDArray[np.int64]
    weight: NDArray[np.float64]
    step: float
    spacing: float

    def __len__(self) -> int:
        return len(self.xy)

    @classmethod
    def learn(cls, frames: FrameTable, step: float | None = None, interval: float | None = None) -> MotionModel:
        """Learn the motion from the frames of a map.

        Args:
            frames: m frames in capture order inside each sequence, all with positions.
            step: how far a robot goes between two queries, in units of x and y. If None, it goes as far in `interval`
                as the map's robot at the speed that 95 % of its steps kept below; and as far as the map's spacing
                where there is no interval or the map has no times.
            interval: seconds between two queries.

        Raises:
            ConfigError: a step or an interval that is not positive.
            DataError: no frames, or a frame without a position.
        """
        for name, value in (("step", step), ("interval", interval)):
            if value is not None and not 0 < value < np.inf:
                raise ConfigError(f"the {name} of a motion model must be positive, got {value}")
        if not len(frames) or not frames.has_position.all():
            raise DataError(
                f"{int((~frames.has_position).sum())} of {len(frames)} map frames have no position: motion is learned "
                "from a map whose frames all have one"
            )
        length, seconds = _steps(frames)
        spacing = float(np.median(length[length > 0])) if (length > 0).any() else 0.0
        if step is None:
            timed = (seconds > 0) & np.isfinite(seconds)
            step = spacing
            if interval is not None and (length[timed] > 0).any():
                step = interval * float(np.percentile(length[timed] / seconds[timed], _FAST))
        return cls(frames.xy, *_transitions(frames, np.sqrt(step**2 + spacing**2 / 6)), float(step), spacing)

    def predict(self, belief: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the belief (m,) after one more step of the robot."""
        moved = np.bincount(self.target, self.weight * belief[self.source], minlength=len(self))
        return np.asarray(moved, dtype=np.float64)


def _steps(frames: FrameTable) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the distances and the times between consecutive frames of each sequence."""
    length, seconds = [np.empty(0)], [np.empty(0)]
    for rows in frames.rows_by("sequence").values():
        length.append(np.hypot(np.diff(frames.x[rows]), np.diff(frames.y[rows])))
        seconds.append(np.diff(frames.time[rows]))
    return np.concatenate(length), np.concatenate(seconds)


def _transitions(frames: FrameTable, sigma: float) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    from scipy.spatial import cKDTree

    near = cKDTree(frames.xy).query_pairs(_REACH * sigma, output_type="ndarray").astype(np.int64)
    near = near[frames.building[near[:, 0]] == frames.building[near[:, 1]]]
    own = np.arange(len(frames))
    source = np.concatenate([own, near[:, 0], near[:, 1]])
    target = np.concatenate([own, near[:, 1], near[:, 0]])
    squared = np.square(frames.xy[source] - frames.xy[target]).sum(axis=1)
    weight = np.exp(-squared / (2 * sigma**2)) if sigma > 0 else np.ones(len(source))
    return source, target, weight / np.bincount(source, weight, minlength=len(frames))[source]
