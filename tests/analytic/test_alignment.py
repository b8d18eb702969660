"""Comparing vectors that turn with the robot: against turning them one by one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from analytic import DISTANCES, AnalyticError, Description, description, descriptor, distance
from analytic.description import spectrum
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
    """Return steps and distances (n, m), turning each reference to each query in every way."""
    step = np.zeros((len(queries), len(references)), dtype=int)
    apart = np.zeros(step.shape)
    for i, query in enumerate(queries.astype(np.float64)):
        for j, reference in enumerate(references.astype(np.float64)):
            ways = [np.roll(reference, s, axis=-1) for s in range(STEPS)]
            step[i, j] = np.argmin([np.linalg.norm(way - query) for way in ways])
            apart[i, j] = distance(name)(query.reshape(1, -1), ways[step[i, j]].reshape(1, -1))[0, 0]
    return step, apart


@pytest.mark.parametrize("name", [*DISTANCES, None])
@pytest.mark.parametrize("offset", [0.0, 30.0])
def test_distances_are_those_at_the_best_turn(name, offset):
    queries, references = images(0, 4) + np.float32(offset), images(1, 7) + np.float32(offset)
    references[2] = np.roll(queries[3], 5, axis=-1)
    references[4] = np.roll(queries[1], -1, axis=-1) + np.float32(0.01)
    q, r = (Description(i.reshape(len(i), -1), i[:, 0].transpose(0, 2, 1)) for i in (queries, references))
    _, expected = slowly(queries, references, name or "cosine")
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
        for part, expected in zip(compared(), whole, strict=True):
            np.testing.assert_allclose(part, expected, rtol=1e-5)


def test_a_reference_that_is_the_query_turned_is_found_with_its_heading():
    references = images(2, 6)
    turn = np.array([3, 11, 6])
    queries = np.stack([np.roll(references[i], s, axis=-1) for i, s in zip([4, 0, 2], turn, strict=True)])
    found = MADE.localize(MADE.describe(queries), MADE.describe(references), "euclidean")
    assert found.index.tolist() == [4, 0, 2]
    np.testing.assert_allclose(found.distance, 0, atol=1e-6)
    np.testing.assert_allclose(found.heading, np.array([3, -1, 6]) * 2 * np.pi / STEPS)
    headings = MADE.relative_heading(MADE.describe(queries), MADE.describe(references[[4, 0, 2]]))
    np.testing.assert_allclose(headings, found.heading)


def test_alignment_has_heading_and_distance_of_every_pair():
    queries, references = images(0, 3), images(1, 4)
    found = MADE.align(MADE.describe(queries), MADE.describe(references))
    step, apart = slowly(queries, references, "euclidean")
    np.testing.assert_allclose(found.heading % (2 * np.pi), step * 2 * np.pi / STEPS)
    np.testing.assert_allclose(found.distance, apart, rtol=1e-4)


def test_a_zero_vector_is_at_one_from_everything():
    flat, other = MADE.describe(np.zeros((2, FEATURES, STEPS))), MADE.describe(images(0, 2))
    for name in ("cosine", "correlation"):
        np.testing.assert_allclose(MADE.pairwise(flat, other, name), 1)
        np.testing.assert_allclose(MADE.pairwise(flat, flat, name), 1)


def test_without_wrap_around_nothing_is_turned():
    made = Columns(circular=False)
    image = images(3, 1)
    there, turned = made.describe(image), made.describe(np.roll(image, 2, axis=-1))
    plain = distance("euclidean")(turned.position, there.position)
    np.testing.assert_allclose(made.pairwise(turned, there, "euclidean"), plain)
    assert plain[0, 0] > 0.1
    with pytest.raises(AnalyticError, match="circular=False"):
        made.localize(turned, there)
    with pytest.raises(AnalyticError, match="circular=False"):
        made.align(turned, there)


def test_mistakes_are_one_sentence():
    q, r = MADE.describe(images(0, 2)), MADE.describe(images(1, 3))
    with pytest.raises(AnalyticError, match="unknown distance 'euclid': did you mean 'euclidean'"):
        MADE.pairwise(q, r, "euclid")
    with pytest.raises(AnalyticError, match="no reference to localize in"):
        MADE.localize(q, r.take([]))
    other = MADE.describe(np.zeros((1, FEATURES, STEPS + 2)))
    for compare in (MADE.pairwise, MADE.align, MADE.localize):
        with pytest.raises(AnalyticError, match="different sizes"):
            compare(q, other)


@pytest.mark.parametrize("shape", [(7, 12, 5), (1, 9, 4), (3, 1, 2), (0, 8, 3)])
@pytest.mark.parametrize("values", [1, 100, 1 << 20])
def test_a_spectrum_of_a_few_rows_at_a_time_is_that_of_all(monkeypatch, shape, values):
    columns = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    monkeypatch.setattr(description, "_VALUES", values)
    found = spectrum(columns)
    assert found.dtype == np.complex64
    # Sums of at most 12 numbers of about 1 in float32 are within 1e-5 of those in float64.
    np.testing.assert_allclose(found, np.fft.rfft(columns.astype(np.float64), axis=1).transpose(1, 0, 2), atol=1e-5)
