"""Errors of whole trajectories, by the definitions of Sturm et al. 2012 that the tool `evo` follows."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import typed
from foundation.settings import Count
from siamloc.data.moves import composed, inverse, relative, wrapped
from siamloc.errors import DataError
from siamloc.evaluation.metrics.arrays import column_of, numbers_of, positions_of


def aligned_trajectory(estimated: ArrayLike, true: ArrayLike, *, scale: bool = False) -> NDArray[np.float64]:
    """Return estimated poses (n, 3) after the motion that brings their positions closest to the true ones.

    The sum of the squared distances is smallest ([Umeyama 1991]); mirror images are not considered.

    Args:
        estimated: x, y and heading in rad (n, 3), in any frame.
        true: x, y and heading in rad (n, 3).
        scale: whether the motion may also scale the positions.

    Raises:
        DataError: other shapes, a pose that is not finite, or estimated positions that are all the same.

    Example:
        >>> aligned_trajectory([[0, 0, 0], [0, 1, 0]], [[5, 5, 1], [7, 5, 1]], scale=True).round(2).tolist()
        [[5.0, 5.0, -1.57], [7.0, 5.0, -1.57]]
    """
    given, wanted = _trajectories(estimated, true)
    middle, goal = given[:, :2].mean(axis=0), wanted[:, :2].mean(axis=0)
    one, other = given[:, :2] - middle, wanted[:, :2] - goal
    size = float(np.square(one).sum())
    if size == 0:
        raise DataError("the estimated positions are all the same, so no motion brings them closest to the true ones")
    cross = one.T @ other
    angle = np.arctan2(cross[0, 1] - cross[1, 0], cross[0, 0] + cross[1, 1])
    moved = composed(np.array([[0.0, 0.0, angle]]), np.column_stack([one, given[:, 2]]))
    moved[:, :2] *= (moved[:, :2] * other).sum() / size if scale else 1.0
    return np.column_stack([moved[:, :2] + goal, wrapped(moved[:, 2])])


def absolute_trajectory_error(estimated: ArrayLike, true: ArrayLike, *, scale: bool = False) -> NDArray[np.float64]:
    """Return the distances (n,) of estimated positions from the true ones after `aligned_trajectory`.

    Their root mean square is the ATE.

    Raises:
        DataError: as for `aligned_trajectory`.
    """
    _, wanted = _trajectories(estimated, true)
    apart = aligned_trajectory(estimated, true, scale=scale)[:, :2] - wanted[:, :2]
    return np.hypot(apart[:, 0], apart[:, 1])


@typed
def relative_trajectory_error(
    estimated: ArrayLike, true: ArrayLike, delta: Count = 1
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return by how much the moves over `delta` frames are off: distances (n - delta,), and angles in rad, in [0, pi].

    Their root mean squares are the RPE of translation and rotation. No alignment is needed.

    Raises:
        ConfigError: a delta that is not a whole number from 1.
        DataError: other shapes, a pose that is not finite, or a delta that is not below n.
    """
    given, wanted = _trajectories(estimated, true)
    if delta >= len(given):
        raise DataError(f"moves over delta frames need a delta from 1 to {len(given) - 1}, got {delta}")
    first = np.arange(len(given) - delta)
    moves = [relative(poses, first, first + delta) for poses in (given, wanted)]
    error = composed(inverse(moves[1]), moves[0])
    return np.hypot(error[:, 0], error[:, 1]), np.abs(wrapped(error[:, 2]))


def _trajectories(estimated: ArrayLike, true: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Check two trajectories and return them as float64 (n, 3)."""
    found = []
    for poses, what in ((estimated, "estimated"), (true, "true")):
        given = numbers_of(poses, f"{what} poses")
        if given.ndim != 2 or given.shape[1] != 3:
            raise DataError(f"{what} poses must have shape (n, 3), x, y and heading, got {given.shape}")
        found.append(np.column_stack([positions_of(given[:, :2], what), column_of(given[:, 2], f"{what} headings")]))
    if len(found[0]) != len(found[1]) or not len(found[0]):
        raise DataError(
            f"as many estimated as true poses are needed, and at least one, got {len(found[0])} and {len(found[1])}"
        )
    return found[0], found[1]
