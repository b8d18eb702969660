import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.covariance import ledoit_wolf

from analytic.descriptors.base import Description
from analytic.mapper.node import Mode
from analytic.mapper.parameters import Parameters
from analytic.mapper.statistics import Model, Moments
from tests.analytic.mapper.world import rows


def added(points, moments=None):
    moments = moments or Moments.none(points.shape[1])
    for x in points:
        moments = moments.add(x)
    return moments


def check(moments, points):
    """All sums against the points themselves, to 1e-6 of their size."""
    apart = points - points.mean(axis=0)
    squares = (apart**2).sum(axis=1)
    assert moments.count == len(points)
    np.testing.assert_allclose(moments.mean, points.mean(axis=0), rtol=1e-6, atol=1e-9)
    scatter = apart.T @ apart
    np.testing.assert_allclose(moments.scatter, scatter, rtol=1e-6, atol=1e-6 * np.abs(scatter).max() + 1e-12)
    third = squares @ apart
    np.testing.assert_allclose(moments.third, third, rtol=1e-6, atol=1e-6 * (squares**1.5).sum() + 1e-12)
    assert moments.fourth == pytest.approx((squares**2).sum(), rel=1e-6, abs=1e-9)
    _, intensity = ledoit_wolf(points)
    assert moments.ledoit_wolf() == pytest.approx(intensity, abs=1e-6)


def points_of(count, size, seed, offset=3.0):
    generator = np.random.default_rng(seed)
    mixing = generator.normal(size=(size, size)) * np.linspace(0.1, 2, size)
    return generator.normal(size=(count, size)) @ mixing + offset * generator.normal(size=size)


@pytest.mark.parametrize(("count", "size"), [(12, 40), (1000, 24), (1000, 3)])
def test_after_many_updates_the_moments_are_those_of_the_vectors(count, size):
    points = points_of(count, size, seed=count)
    check(added(points), points)


def test_vectors_that_are_far_from_the_origin_lose_nothing():
    points = points_of(1000, 8, seed=1, offset=1e4)
    check(added(points), points)


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 30), st.integers(2, 30), st.integers(2, 12), st.integers(0, 1000))
def test_merging_is_adding_and_removing_takes_back(first, second, size, seed):
    a, b = points_of(first, size, seed), points_of(second, size, seed + 1)
    merged = added(a).merge(added(b))
    check(merged, np.concatenate([a, b]))
    for x in a:
        merged = merged.remove(x)
    check(merged, b)


def test_merging_with_nothing_and_removing_everything():
    points = points_of(5, 3, seed=0)
    moments = added(points)
    assert moments.merge(Moments.none(3)) is moments
    assert Moments.none(3).merge(moments) is moments
    for x in points:
        moments = moments.remove(x)
    assert moments.count == 0
    assert not moments.scatter.any()


def test_mahalanobis_distances_are_those_of_the_shrunk_covariance():
    points, queries = points_of(15, 40, seed=2), points_of(9, 40, seed=3)
    model = Model(added(points), "ledoit_wolf")
    covariance, intensity = ledoit_wolf(points)
    np.testing.assert_allclose(model.covariance, covariance, rtol=1e-9, atol=1e-12)
    assert model.intensity == pytest.approx(intensity)
    away = queries - points.mean(axis=0)
    expected = np.einsum("nd,de,ne->n", away, np.linalg.inv(covariance), away)
    np.testing.assert_allclose(model.factored.distances(queries), expected, rtol=1e-8)


def test_a_fixed_shrinkage_is_taken_as_it_is():
    points = points_of(15, 4, seed=2)
    s = np.cov(points.T, bias=True)
    expected = 0.7 * s + 0.3 * np.trace(s) / 4 * np.eye(4)
    np.testing.assert_allclose(Model(added(points), 0.3).covariance, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("points", [np.ones((6, 5)), np.zeros((6, 5)), np.tile([[1.0, 2, 3], [2, 2, 3]], (3, 1))])
def test_frames_that_hardly_differ_still_give_finite_distances(points):
    model = Model(added(points), "ledoit_wolf")
    at, off = model.factored.distances(np.stack([points.mean(axis=0), points.mean(axis=0) + 1]))
    assert at == pytest.approx(0, abs=1e-9)
    assert np.isfinite(off)
    assert off > 1


@pytest.mark.parametrize("size", [4, 20])
@pytest.mark.parametrize("noise", [0.0, 1e-5])
def test_frames_that_are_nearly_equal_keep_their_model_when_others_leave(size, noise):
    """Taking the spread of the others from all sums at once would leave rounding, and a singular covariance."""
    for seed in range(10):
        generator = np.random.default_rng(seed)
        place = generator.normal(size=size)
        points = np.concatenate([place + generator.normal(size=(40, size)), np.tile(place, (20, 1))])
        points[40:] += noise * generator.normal(size=(20, size))
        frames = rows(Description(points))
        left = Mode.of(Parameters(), range(60), frames).remove(range(40))
        alone = Mode.of(Parameters(), range(40, 60), frames[40:])
        model = points[40:][~left.held]
        assert left.model.intensity == pytest.approx(max(ledoit_wolf(model)[1], 1e-6), rel=1e-6)
        assert left.model.least == pytest.approx(alone.model.least, rel=0.5)
        assert np.isfinite(left.gaussian.mean)
        for x in model:
            assert left.metric.distance(x) <= left.metric.distance(x + 0.1)
