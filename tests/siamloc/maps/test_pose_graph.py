"""Poses that follow from measured displacements: against a plain minimization, and by property."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from siamloc.data.moves import chained, composed, relative, wrapped
from siamloc.maps.pose_graph import (
    GYRO_BIAS,
    SCALE,
    SHARED,
    WHEEL_SCALE,
    Edges,
    PoseGraph,
    covariances,
    of_shape,
    solve,
)


def loop_drive(rounds: int = 2, per_round: int = 12) -> np.ndarray:
    """A robot that drives in circles of 2 m."""
    angle = 2 * np.pi * np.arange(rounds * per_round) / per_round
    return np.column_stack([2 * np.cos(angle), 2 * np.sin(angle), angle + np.pi / 2])


def edges_of(poses, first, second, rng=None, noise=(0.0, 0.0), scale=1.0) -> Edges:
    first, second = np.asarray(first), np.asarray(second)
    pose = relative(poses, first, second)
    pose[:, :2] *= scale
    if rng is not None:
        pose += rng.normal(size=pose.shape) * [noise[0], noise[0], noise[1]]
    sure = np.diag([100.0, 100.0, 400.0])
    return Edges(first, second, pose, np.tile(sure, (len(first), 1, 1)))


def graph_of(poses, rng=None, noise=(0.0, 0.0), scale=1.0, wheels=True, apart=12) -> PoseGraph:
    n = len(poses)
    first = np.concatenate([np.arange(n - 1), np.arange(n - apart)])
    second = np.concatenate([np.arange(1, n), np.arange(apart, n)])
    pictures = edges_of(poses, first, second, rng, noise, scale)
    odometry = edges_of(poses, np.arange(n - 1), np.arange(1, n), rng, noise)
    odometry = odometry if wheels else odometry.take(slice(0, 0))
    return PoseGraph(pictures, odometry, np.zeros(n, dtype=np.int64), np.empty(0, np.int64))


def plain_cost(unknowns, graph, start):
    """The negative log likelihood, edge by edge; the first pose is the start's."""
    n = len(start)
    poses = np.concatenate([start[:1], unknowns[: 3 * n - 3].reshape(-1, 3)])
    scale, wheels, bias = unknowns[3 * n - 3 :]
    cost = ((scale / SCALE) ** 2 + (wheels / WHEEL_SCALE) ** 2 + (bias / GYRO_BIAS) ** 2) / 2
    for edges, share in ((graph.pictures, 1 / SHARED), (graph.wheels, 1.0)):
        for a, b, measured, information in zip(edges.first, edges.second, edges.pose, edges.information, strict=True):
            cosine, sine = np.cos(poses[a, 2]), np.sin(poses[a, 2])
            x, y = poses[b, :2] - poses[a, :2]
            found = np.array([cosine * x + sine * y, cosine * y - sine * x, poses[b, 2] - poses[a, 2]])
            found[:2] *= np.exp(scale if edges is graph.pictures else wheels)
            if edges is graph.wheels:
                found[2] += bias * np.hypot(*measured[:2])
            error = found - measured
            error[2] = np.angle(np.exp(1j * error[2]))
            cost += share * 3.5 * np.log1p(error @ information @ error / 4)
    return cost


@pytest.mark.parametrize("seed", range(3))
def test_the_solution_has_the_smallest_cost(seed):
    rng = np.random.default_rng(seed)
    true = loop_drive(1, 7)
    graph = graph_of(true, rng, (0.1, 0.05), apart=5)
    start = true + rng.normal(size=true.shape) * 0.05
    found = solve(graph, start)
    ours = np.concatenate(
        [found.poses[1:].ravel(), [np.log(found.scale), np.log(found.wheel_scale[0]), found.gyro_bias[0]]]
    )
    best = minimize(plain_cost, ours + 0.02 * rng.normal(size=len(ours)), args=(graph, start), method="BFGS")
    assert plain_cost(ours, graph, start) <= best.fun + 1e-6
    np.testing.assert_allclose(ours, best.x, atol=2e-3)
    np.testing.assert_array_equal(found.poses[0], start[0])


def test_exact_measurements_give_the_true_poses_and_scales():
    true = loop_drive()
    graph = graph_of(true, scale=1.1)
    graph = replace(graph, wheels=replace(graph.wheels, pose=graph.wheels.pose * [1.02, 1.02, 1.0]))
    graph.wheels.pose[:, 2] += np.radians(0.5) * np.hypot(*graph.wheels.pose[:, :2].T)
    many = Edges.concatenate([graph.wheels] * 40)  # so that they outweigh what is expected of their scale
    fixed = np.array([0, 5])
    start = chained(np.concatenate([np.zeros((1, 3)), graph.wheels.pose]))
    start = composed(np.tile(true[0], (len(start), 1)), start)
    start[fixed] = true[fixed]
    found = solve(replace(graph, wheels=many, fixed=fixed), start)
    np.testing.assert_allclose(found.poses[:, :2], true[:, :2], atol=0.01)  # what is expected of scales pulls a little
    np.testing.assert_allclose(wrapped(found.poses[:, 2] - true[:, 2]), 0, atol=3e-3)
    assert found.scale == pytest.approx(1.1, abs=0.03)  # expected to be 1
    assert found.wheel_scale[0] == pytest.approx(1.02, abs=0.003)
    assert np.degrees(found.gyro_bias[0]) == pytest.approx(0.5, abs=0.05)
    assert (found.weight > 0.9).all()


def test_a_wrong_measurement_is_weighted_down():
    true = loop_drive()
    graph = graph_of(true)
    graph.pictures.pose[-1, 0] += 5.0
    found = solve(graph, true)
    assert found.weight[-1] < 0.01
    assert (found.weight[:-1] > 0.9).all()
    np.testing.assert_allclose(found.poses, true, atol=0.02)


def test_covariances_are_the_inverse_of_the_curvature():
    true = loop_drive(1, 6)
    graph = graph_of(true, apart=4)
    found = solve(graph, true)
    made = covariances(graph, found)
    # Without errors the likelihood is quadratic; a central difference of it gives its curvature.
    ours = np.concatenate([found.poses[1:].ravel(), np.zeros(3)])
    step, n = 1e-4, len(ours)
    curvature = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            corners = [plain_cost(ours + step * (a * np.eye(n)[i] + b * np.eye(n)[j]), graph, true)
                       for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))]  # fmt: skip
            curvature[i, j] = (corners[0] - corners[1] - corners[2] + corners[3]) / (4 * step**2)
    expected = np.linalg.inv(curvature)
    for frame in range(1, len(true)):
        part = slice(3 * frame - 3, 3 * frame)
        np.testing.assert_allclose(made[frame], expected[part, part], rtol=0.02, atol=1e-6)
    assert np.abs(made[0]).max() < 1e-6
    # After the best motion and scale: of draws with small errors, aligned one by one.
    shape, scale = of_shape(made, graph, found)
    drawn = 0.01 * np.random.default_rng(0).multivariate_normal(np.zeros(n), expected, 20_000)[:, :15]
    poses = true + np.concatenate([np.zeros((20_000, 1, 3)), drawn.reshape(-1, 5, 3)], axis=1)
    given, wanted = (one[..., 0] + 1j * one[..., 1] for one in (poses, true))
    given -= given.mean(axis=1, keepdims=True)
    wanted -= wanted.mean()
    turn = (given.conj() @ wanted) / np.square(np.abs(given)).sum(axis=1)  # and scale, as a complex number
    apart = turn[:, None] * given - wanted
    errors = np.stack([apart.real, apart.imag, poses[..., 2] + np.angle(turn)[:, None] - true[:, 2]], axis=2)
    np.testing.assert_allclose(np.square(errors).mean(axis=0), 1e-4 * np.einsum("nii->ni", shape), rtol=0.05)
    assert np.std(np.abs(turn)) == pytest.approx(0.01 * scale, rel=0.05)


def test_the_shape_is_as_exact_whichever_pose_is_given():
    rng = np.random.default_rng(3)
    true = loop_drive(1, 8)
    graph = graph_of(true, rng, (0.02, 0.01), apart=5)
    found = solve(graph, true)
    made = []
    for given in (0, 5):
        fixed = replace(graph, fixed=np.array([given]))
        made.append(of_shape(covariances(fixed, found), fixed, found))
    np.testing.assert_allclose(made[0][0], made[1][0], rtol=1e-4, atol=1e-9)
    assert made[0][1] == pytest.approx(made[1][1], rel=1e-4)
