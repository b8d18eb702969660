from __future__ import annotations

import numpy as np
import pytest

from siamloc.data.moves import chained, composed, inverse, moves, wrapped


def test_a_move_is_seen_from_the_pose_before():
    poses = [[1, 2, np.pi / 2], [1, 5, np.pi], [0, 5, -np.pi / 2], [0, 5, np.pi / 2]]
    found = moves(poses)
    assert np.isnan(found[0]).all()
    np.testing.assert_allclose(found[1:], [[3, 0, np.pi / 2], [1, 0, np.pi / 2], [0, 0, np.pi]], atol=1e-12)


@pytest.mark.parametrize("column", [0, 1, 2])
def test_what_is_unknown_hides_the_moves_on_both_of_its_sides(column):
    poses = np.random.default_rng(0).normal(size=(6, 3))
    poses[2, column] = np.nan
    assert np.isnan(moves(poses)).all(axis=1).tolist() == [True, False, True, True, False, False]


def test_chained_moves_are_the_poses_seen_from_the_first():
    rng = np.random.default_rng(1)
    poses = np.column_stack([rng.normal(size=(50, 2)), rng.uniform(-9, 9, 50)])
    np.testing.assert_allclose(moves(chained(moves(poses)))[1:], moves(poses)[1:], atol=1e-9)
    poses[:, :2] -= poses[0, :2]
    poses[:, 2] -= poses[0, 2]
    assert chained(moves(poses)).shape == (50, 3)
    first = chained(moves(poses))[0]
    assert first.tolist() == [0, 0, 0]
    np.testing.assert_allclose(chained(moves(poses))[:, :2], poses[:, :2], atol=1e-9)


def test_one_pose_and_none():
    assert moves([[1, 2, 3]]).shape == chained(moves([[1, 2, 3]])).shape == (1, 3)
    assert moves(np.zeros((0, 3))).shape == (0, 3)


def test_the_inverse_leads_back():
    rng = np.random.default_rng(2)
    poses = rng.normal(size=(30, 3)) * [4, 4, 9]
    back = composed(poses, inverse(poses))
    np.testing.assert_allclose(back[:, :2], 0, atol=1e-12)
    np.testing.assert_allclose(wrapped(back[:, 2]), 0, atol=1e-12)
