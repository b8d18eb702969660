"""Textures of lived-in buildings: they continue at their edges, and their pieces are laid as they should be."""

from __future__ import annotations

import numpy as np
import pytest

from siamloc.simulate.natural import bond, flagstones, herringbone, natural_textures
from siamloc.simulate.textures import SIZE, base_textures, pattern_textures


def test_each_replaces_a_texture_and_continues_at_its_edges() -> None:
    known = set(base_textures(np.random.default_rng(0))) | set(pattern_textures(np.random.default_rng(0)))
    for seed in range(4):
        for name, texture in natural_textures(np.random.default_rng(seed)).items():
            assert name in known
            for axis in (0, 1):
                image = np.moveaxis(texture.image.astype(float), axis, 0)
                steps = np.abs(image - np.roll(image, 1, axis=0)).mean(axis=(1, 2))
                assert steps[0] <= steps[1:].max() * 1.3 + 1, (seed, name, axis)


def boxes(labels: np.ndarray) -> set[tuple[int, int]]:
    """Return height and width of all pieces, across the edges; each piece must be a full rectangle."""
    found = set()
    for label in np.unique(labels):
        inside = labels == label
        size = int(inside.any(axis=1).sum()), int(inside.any(axis=0).sum())
        assert inside.sum() == size[0] * size[1], "a rectangle"
        found.add(size)
    return found


@pytest.mark.parametrize(("count", "long"), [(16, 4), (16, 2), (32, 4)])
def test_a_herringbone_consists_of_equal_pieces_that_lie_and_stand(count: int, long: int) -> None:
    cell = SIZE // count
    labels = herringbone(count, long)
    assert boxes(labels) == {(cell, long * cell), (long * cell, cell)}
    assert {bool(label % 2) for label in np.unique(labels)} == {False, True}


def test_bonds_shift_their_rows() -> None:
    rng = np.random.default_rng(0)
    assert boxes(bond(rng, 8, 4, 0.5)) == {(32, 64)}
    assert len(np.unique(bond(rng, 8, 4, 0.5))) == 32
    joints = [np.flatnonzero(np.diff(bond(rng, 8, 4, 0.5)[row])) for row in (0, 40)]
    assert (joints[0][:3] - joints[1][:3] != 0).all()


def test_flagstones_are_nearest_to_their_own_points() -> None:
    labels = flagstones(np.random.default_rng(1), 9)
    points = np.random.default_rng(1).uniform(0, SIZE, (9, 2))
    shifted = np.concatenate([points + np.array((dy, dx)) for dy in (-SIZE, 0, SIZE) for dx in (-SIZE, 0, SIZE)])
    for y, x in ((0, 0), (3, 250), (128, 77), (255, 255)):
        assert labels[y, x] == np.argmin(np.linalg.norm(shifted - (y, x), axis=1)) % 9
