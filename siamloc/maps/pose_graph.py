"""Least squares over a graph of poses: frames joined by compared panoramas and by odometry.

The unknowns are the poses of all frames, the scale of the compared displacements, and for each drive the scale and the
gyro bias of its odometry. Errors of comparisons follow a t-distribution, so that a wrong one is weighted down; the
minimum is found by Levenberg and Marquardt's method with weights that are computed again in every round.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from foundation.columns import Rows
from siamloc.data.moves import relative, wrapped
from siamloc.maps.joining import FREEDOM
from siamloc.maps.search import slices

Array = NDArray[np.float64]

SHARED = 25.0
"""How many comparisons make the same errors: their information counts divided by this."""
SCALE, WHEEL_SCALE = 0.15, 0.03  # standard deviations of the logarithms of the scales
GYRO_BIAS = np.radians(1.0)  # standard deviation, rad per unit of distance
SMALL = 1e-4  # m or rad: a solution that moves by less has converged
_FIXED = 1e8  # information of a pose that is given
_AT_ONCE = 1 << 18  # values of a third of the columns of the inverse


@dataclass(frozen=True, eq=False)
class Edges(Rows):
    """Measured poses of frames as seen from others (e edges).

    Attributes:
        first: (e,) frames that the others are seen from.
        second: (e,) frames whose poses are measured.
        pose: (e, 3) displacement ahead and to the left of `first`, and the turn to the left in rad.
        information: (e, 3, 3) inverse of the scale matrix.
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    pose: Array
    information: Array


@dataclass(frozen=True, eq=False)
class PoseGraph:
    """What was measured about the poses of n frames.

    Attributes:
        pictures: compared panoramas; their displacements are too long by one unknown scale.
        wheels: odometry between consecutive frames; each drive has its scale and bias.
        drive: (n,) number of the drive of each frame, from 0.
        fixed: rows of frames whose poses are given; the first frame, at its start, if there are none.
        scale: standard deviation of the logarithm of that scale before anything is measured.
    """

    pictures: Edges
    wheels: Edges
    drive: NDArray[np.int64]
    fixed: NDArray[np.int64]
    scale: float = SCALE

    def __len__(self) -> int:
        return len(self.drive)

    @property
    def held(self) -> NDArray[np.int64]:
        """Rows of the frames that keep the poses of the start: the fixed ones, or the first."""
        return self.fixed if len(self.fixed) else np.zeros(1, np.int64)


@dataclass(frozen=True, eq=False)
class Solution:
    """The most likely poses of n frames in d drives.

    Attributes:
        poses: (n, 3) x, y and heading in rad.
        scale: length of compared displacements over true lengths.
        wheel_scale: (d,) lengths by odometry over true lengths.
        gyro_bias: (d,) turn that odometry adds, in rad per unit of distance.
        weight: (e,) weight of each compared pair, from 0 to 1: 1 / (1 + q / 4), with its squared error q in units of
            the expected one.
        cost: negative logarithm of the likelihood, up to a constant.
    """

    poses: Array
    scale: float
    wheel_scale: Array
    gyro_bias: Array
    weight: Array
    cost: float

    @property
    def unknowns(self) -> Array:
        """The unknowns of the graph, one after the other (3 n + 1 + 2 d,): scales by their logarithms."""
        return np.concatenate([self.poses.ravel(), [np.log(self.scale)], np.log(self.wheel_scale), self.gyro_bias])


def solve(
    graph: PoseGraph, start: Array | Solution, freedom: float = FREEDOM, enough: float = SMALL, rounds: int = 60
) -> Solution:
    """Return the most likely poses, beginning at start poses; those of fixed frames are kept.

    With many degrees of freedom, errors have nearly a normal distribution: no measurement is weighted down, so that
    even a start that is far off is pulled to where all of them agree.

    Args:
        graph: what was measured.
        start: poses to begin at (n, 3), or the solution of nearly the same graph.
        freedom: degrees of freedom of the errors.
        enough: a solution whose poses move by less, in the unit of the positions or rad, has converged.
        rounds: steps at most.

    Example:
        >>> one_metre, sure = np.tile([1.0, 0.0, 0.0], (2, 1)), np.tile(np.eye(3), (2, 1, 1))
        >>> ahead = Edges(np.array([0, 1]), np.array([1, 2]), one_metre, sure)
        >>> graph = PoseGraph(ahead, ahead.take(slice(0, 0)), np.zeros(3, int), np.array([0, 2]))
        >>> solve(graph, np.array([[0.0, 0, 0], [0, 0, 0], [2.2, 0, 0]])).poses.round(3).tolist()
        [[0.0, 0.0, 0.0], [1.1, 0.0, 0.0], [2.2, 0.0, 0.0]]
    """
    drives = int(graph.drive.max()) + 1
    begin = start.unknowns if isinstance(start, Solution) else np.append(start, np.zeros(1 + 2 * drives))
    system, damping = _System(graph, begin, freedom), 1e-9 if isinstance(start, Solution) else 1e-4
    held = system.poses[graph.held]
    for _ in range(rounds):
        step = system.step(damping)
        tried = _System(graph, system.unknowns + step, freedom)
        if tried.cost <= system.cost:
            system, damping = tried, max(damping / 10, 1e-9)
            if np.abs(step[: 3 * len(graph)]).max() < enough:
                break
        elif (damping := damping * 10) > 1e6:
            break
    system.poses[graph.held] = held
    scales = float(np.exp(system.scale)), np.exp(system.wheel_scale), system.gyro_bias
    return Solution(system.poses, *scales, system.weight, system.cost)


def covariances(graph: PoseGraph, found: Solution) -> Array:
    """Return the covariances (n, 3, 3) of the poses, given the fixed ones, in squared units and rad."""
    factors, n = _factors(_System(graph, found.unknowns).normal(0.0)), len(graph)
    made = np.empty((n, 3, 3))
    for part in slices(n, _AT_ONCE // factors.shape[0]):
        rows = np.arange(n)[part]
        unknowns = (3 * rows[:, None] + np.arange(3)).ravel()
        units = np.zeros((factors.shape[0], len(unknowns)))
        units[unknowns, np.arange(len(unknowns))] = 1
        inverse = factors.solve(units)[unknowns].reshape(len(rows), 3, len(rows), 3)
        made[rows] = inverse[np.arange(len(rows)), :, np.arange(len(rows))]
    return made


def of_shape(covariance: Array, graph: PoseGraph, found: Solution) -> tuple[Array, float]:
    """Return covariances (n, 3, 3) of the poses after the best rigid motion and scale, and the scale's deviation.

    How exact a map is in itself does not depend on the frame that it is given in: of poses of which only the first is
    fixed, the others are the less certain the farther away they are, together. An S-transformation takes out what all
    poses have in common ([Baarda 1973]).

    Args:
        covariance: (n, 3, 3) what `covariances` returns.
        graph: the graph.
        found: its solution.
    """
    apart, n = found.poses[:, :2] - found.poses[:, :2].mean(axis=0), len(graph)
    common = np.zeros((n, 3, 4))  # how poses move with the map: along x, along y, turned, larger
    common[:, 0, 0] = common[:, 1, 1] = common[:, 2, 2] = 1
    common[:, 0, 2], common[:, 1, 2] = -apart[:, 1], apart[:, 0]
    common[:, :2, 3] = apart
    fitted = common * [[1], [1], [0]]  # the best motion is that of the positions
    inverse = np.linalg.inv(np.einsum("nij,nik->jk", fitted, common))
    factors = _factors(_System(graph, found.unknowns).normal(0.0))
    known = np.zeros((factors.shape[0], 4))
    known[: 3 * n] = fitted.reshape(-1, 4)
    with_all = factors.solve(known)[: 3 * n].reshape(n, 3, 4) @ inverse.T
    of_common = inverse @ np.einsum("nij,nik->jk", fitted, with_all)
    cross = with_all @ common.swapaxes(1, 2)
    whole = covariance - cross - cross.swapaxes(1, 2) + common @ of_common @ common.swapaxes(1, 2)
    return whole, float(np.sqrt(of_common[3, 3]))


class _System:
    """The graph linearized at some values of its unknowns: its cost, and the normal equations of a step."""

    def __init__(self, graph: PoseGraph, unknowns: Array, freedom: float = FREEDOM) -> None:
        n, drives = len(graph), int(graph.drive.max()) + 1
        self.unknowns, self.poses, given = unknowns, unknowns[: 3 * n].reshape(n, 3), unknowns[3 * n :]
        self.scale, self.wheel_scale, self.gyro_bias = given[0], given[1 : 1 + drives], given[1 + drives :]
        self._parts: list[tuple[sparse.csr_matrix, Array]] = []
        self.cost, pictures, wheels = 0.0, graph.pictures, graph.wheels
        # Comparisons: exp(scale) times the displacement.
        found, jacobians = _seen(self.poses, pictures, np.exp(np.full(len(pictures), self.scale)))
        own = np.zeros((len(pictures), 3, 1))
        own[:, :2, 0] = found[:, :2]
        columns = np.full((len(pictures), 1), 3 * n)
        self.weight = self._add(pictures, found, jacobians, own, columns, freedom, SHARED)
        # Odometry: its scale times the displacement, and a turn that grows with the distance.
        drive = graph.drive[wheels.second]
        found, jacobians = _seen(self.poses, wheels, np.exp(self.wheel_scale[drive]))
        own = np.zeros((len(wheels), 3, 2))
        own[:, :2, 0] = found[:, :2]
        own[:, 2, 1] = np.hypot(wheels.pose[:, 0], wheels.pose[:, 1])
        found[:, 2] += self.gyro_bias[drive] * own[:, 2, 1]
        columns = 3 * n + 1 + drive[:, None] + np.array([0, drives])
        self._add(wheels, found, jacobians, own, columns, freedom, 1.0)
        # What is known before: fixed poses, and the sizes of scales and biases.
        self._prior = np.full(len(unknowns), 1e-9)
        self._prior[(3 * graph.held[:, None] + np.arange(3)).ravel()] = _FIXED
        deviations = np.concatenate([[graph.scale], np.full(drives, WHEEL_SCALE), np.full(drives, GYRO_BIAS)])
        self._prior[3 * n :] = 1 / deviations**2
        self._pull = np.concatenate([np.zeros(3 * n), given / deviations**2])
        self.cost += 0.5 * float(np.square(given / deviations).sum())

    def _add(
        self,
        edges: Edges,
        found: Array,
        jacobians: tuple[Array, Array],
        own: Array,
        columns: NDArray[np.int64],
        freedom: float,
        shared: float,
    ) -> Array:
        """Add the rows of edges to the linear system, and their cost; return the weights of the edges (e,).

        Args:
            edges: the measurements (e).
            found: what they measure, at the state (e, 3).
            jacobians: derivatives of that by the poses of both frames (e, 3, 3).
            own: derivatives by further unknowns (e, 3, k).
            columns: the further unknowns (e, k).
            freedom: degrees of freedom of the errors.
            shared: how many measurements make the same errors.
        """
        error = found - edges.pose
        error[:, 2] = wrapped(error[:, 2])
        squared = np.einsum("ei,eij,ej->e", error, edges.information, error)
        weight = 1 / (1 + squared / freedom)
        self.cost += (freedom + 3) / 2 * float(np.log1p(squared / freedom).sum()) / shared
        if not len(edges):
            return weight
        factor = weight * (freedom + 3) / freedom / shared
        white = np.linalg.cholesky(edges.information * factor[:, None, None]).swapaxes(1, 2)
        values = white @ np.concatenate([*jacobians, own], axis=2)
        poses = [3 * one[:, None] + np.arange(3) for one in (edges.first, edges.second)]
        places = np.broadcast_to(np.concatenate([*poses, columns], axis=1)[:, None], values.shape)
        rows = np.broadcast_to(np.arange(3 * len(edges)).reshape(-1, 3, 1), values.shape)
        shape = 3 * len(edges), len(self.unknowns)
        matrix = sparse.csr_matrix((values.ravel(), (rows.ravel(), places.ravel())), shape=shape)
        self._parts.append((matrix, (white @ error[..., None])[..., 0].ravel()))
        return weight

    def normal(self, damping: float) -> sparse.csc_matrix:
        """Return the matrix of the normal equations, its diagonal enlarged by a share."""
        whole = sum((matrix.T @ matrix for matrix, _ in self._parts), start=sparse.diags(self._prior))
        return (whole + sparse.diags(damping * whole.diagonal())).tocsc()

    def step(self, damping: float) -> Array:
        """Return the step of all unknowns."""
        slope = sum((matrix.T @ error for matrix, error in self._parts), start=self._pull.copy())
        return np.asarray(_factors(self.normal(damping)).solve(-slope))


def _factors(matrix: sparse.csc_matrix) -> Any:
    """Return the factors of a positive definite matrix, in an order that keeps them sparse."""
    # Nodes of the elimination tree are not merged (relax=1): these graphs have few that are alike.
    options = {"SymmetricMode": True}
    return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, relax=1, options=options)


def _seen(poses: Array, edges: Edges, scale: Array) -> tuple[Array, tuple[Array, Array]]:
    """Return scaled displacements and turns (e, 3), and their derivatives by both poses (e, 3, 3)."""
    found = relative(poses, edges.first, edges.second)
    found[:, :2] *= scale[:, None]
    cosine, sine = np.cos(poses[edges.first, 2]), np.sin(poses[edges.first, 2])
    first, second = np.zeros((2, len(edges), 3, 3))
    second[:, 0, 0] = second[:, 1, 1] = scale * cosine
    second[:, 0, 1], second[:, 1, 0] = scale * sine, -scale * sine
    second[:, 2, 2] = 1
    first[:] = -second
    first[:, 0, 2], first[:, 1, 2] = found[:, 1], -found[:, 0]
    return found, (first, second)
