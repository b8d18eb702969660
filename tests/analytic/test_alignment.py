"""Comparing vectors that turn with the robot: against turning them one by one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from analytic import DISTANCES, AnalyticError, Description, descriptor, distance
from analytic.descriptors.base import AlignedDescriptor

STEPS, FEATURES = 12, 5


@dataclass(frozen=True, kw_only=True)
class Columns(AlignedDescriptor):
    """The columns of an image."""

    name = "columns"
    default_distance = "cosine"

    def _check_size(self, height, width):
        pass

    def resolution(self, width):
        return 2 * np.pi / width

    def sizes(self, height, width):
        return (height * width,), (width, height)

    def _describe(self, grey):
        return grey.ravel(), grey.T


MADE = Columns()


def images(seed, count):
    return np.random.default_rng(seed).random((count, 1, FEATURES, STEPS), dtype=np.float32)


def slowly(queries, references, name):
    """Return the distances (n, m) at the turn of each reference that is nearest to the query, of all turns."""
    apart = np.zeros((len(queries), len(references)))
    for i, query in enumerate(queries.astype(np.float64)):
        for j, reference in enumerate(references.astype(np.float64)):
            ways = [np.roll(reference, s, axis=-1) for s in range(STEPS)]
            nearest = min(ways, key=lambda way: np.linalg.norm(way - query))
            apart[i, j] = distance(name)(query.reshape(1, -1), nearest.reshape(1, -1))[0, 0]
    return apart


@pytest.mark.parametrize("name", [*DISTANCES, None])
@pytest.mark.parametrize("offset", [0.0, 30.0])
def test_distances_are_those_at_the_best_turn(name, offset):
    queries, references = images(0, 4) + np.float32(offset), images(1, 7) + np.float32(offset)
    references[2] = np.roll(queries[3], 5, axis=-1)
    references[4] = np.roll(queries[1], -1, axis=-1) + np.float32(0.01)
    q, r = (Description(i.reshape(len(i), -1), i[:, 0].transpose(0, 2, 1)) for i in (queries, references))
    expected = slowly(queries, references, name or "cosine")
    np.testing.assert_allclose(MADE.pairwise(q, r, name), expected, rtol=2e-4, atol=1e-6)


def test_small_parts_give_the_same(monkeypatch):
    def compared():
        q, r = MADE.describe(images(0, 4)), MADE.describe(images(1, 7))
        phases = hog.align(hog.describe(images(0, 4)), hog.describe(images(1, 7)))
        return [MADE.pairwise(q, r, "manhattan"), MADE.pairwise(q, r, "correlation"), phases.heading, phases.distance]

    hog = descriptor("hog", rows=5, window=4, step=1)
    whole = compared()
    for held in (1, STEPS * 3, STEPS * 15):
        monkeypatch.setattr("analytic.alignment._VALUES", held)
        monkeypatch.setattr("analytic.description._VALUES", held)
        for part, expected in zip(compared(), whole, strict=True):
            np.testing.assert_allclose(part, expected, rtol=1e-5)


def test_a_zero_vector_is_at_one_from_everything():
    flat, other = MADE.describe(np.zeros((2, FEATURES, STEPS))), MADE.describe(images(0, 2))
    for name in ("cosine", "correlation"):
        np.testing.assert_allclose(MADE.pairwise(flat, other, name), 1)
        np.testing.assert_allclose(MADE.pairwise(flat, flat, name), 1)


def test_mistakes_are_one_sentence():
    q, r = MADE.describe(images(0, 2)), MADE.describe(images(1, 3))
    with pytest.raises(AnalyticError, match="unknown distance 'euclid': did you mean 'euclidean'"):
        MADE.pairwise(q, r, "euclid")
    other = MADE.describe(np.zeros((1, FEATURES, STEPS + 2)))
    for compare in (MADE.pairwise, MADE.align, MADE.localize):
        with pytest.raises(AnalyticError, match="different sizes"):
            compare(q, other)
