import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.covariance import ledoit_wolf

from analytic import AnalyticError
from analytic.descriptors.base import Description
from analytic.mapper.node import Mode, every_few
from analytic.mapper.parameters import Parameters
from tests.analytic.mapper.world import World, corridor_drive, rows


def mode_of(points, **parameters):
    return Mode.of(Parameters(**parameters), range(len(points)), rows(Description(points)))


def points_of(count, size, seed, offset=3.0):
    generator = np.random.default_rng(seed)
    mixing = generator.normal(size=(min(6, size), size))
    near = generator.normal(size=(count, len(mixing))) @ mixing + 0.3 * generator.normal(size=(count, size))
    return near + offset * generator.normal(size=size)


def check(mode, points, tolerance=1e-9):
    """All statistics against those of scikit-learn and numpy, from the points themselves."""
    model, held = points[~mode.held], points[mode.held]
    shrinkage = mode.rules.shrinkage
    covariance, intensity = np.cov(model.T, bias=True), shrinkage
    if shrinkage == "ledoit_wolf":
        _, intensity = ledoit_wolf(model)
    size = points.shape[1]
    covariance = (1 - intensity) * covariance + intensity * np.trace(covariance) / size * np.eye(size)
    inverse = np.linalg.inv(covariance)

    def distances(queries):
        return np.einsum("nd,de,ne->n", queries - model.mean(axis=0), inverse, queries - model.mean(axis=0))

    np.testing.assert_allclose(mode.centre, points.mean(axis=0), rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(mode.mean, model.mean(axis=0), rtol=tolerance, atol=tolerance)
    queries = np.concatenate([points, points + 1])
    rtol = tolerance + 16 * np.finfo(float).eps * np.linalg.cond(covariance)
    np.testing.assert_allclose(mode.metric.distances(queries), distances(queries), rtol=rtol)
    found = [mode.metric.distances(query[None])[0] for query in queries]
    np.testing.assert_allclose(found, distances(queries), rtol=rtol)
    few = np.column_stack([queries[:, every_few(size)], np.ones(len(queries))])
    assert (np.square(few @ mode.metric.bound.T).sum(axis=1) <= distances(queries) * (1 + rtol) + 1e-6).all()
    assert mode.usual[0] == pytest.approx(distances(held).mean(), rel=rtol)
    assert mode.usual[1] == pytest.approx(distances(held).std(ddof=1), abs=4 * rtol * distances(held).max())
    assert 0 < mode.metric.least <= np.linalg.eigvalsh(covariance)[0] * (1 + rtol)
    away = np.linalg.norm(points - points.mean(axis=0), axis=1)
    assert mode.reach == pytest.approx(away.max() / (len(points) - 1), rel=tolerance)
    x = points[0] + 2
    moved = np.concatenate([points, x[None]]).mean(axis=0) - points.mean(axis=0)
    assert mode.shift(x) == pytest.approx(np.linalg.norm(moved), rel=tolerance)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(10, 60),
    st.integers(2, 90),
    st.sampled_from(["ledoit_wolf", 1e-3, 0.3, 1.0]),
    st.sampled_from([0.0, 3.0, 1e3]),
    st.integers(0, 1000),
)
def test_statistics_are_those_of_the_frames(count, size, shrinkage, offset, seed):
    points = points_of(count, size, seed, offset)
    # The offset costs the squared lengths digits, twice as many as it has itself.
    check(mode_of(points, shrinkage=shrinkage), points, 1e-9 + 1e-14 * offset**2)


@pytest.mark.parametrize("size", [6, 60, 400])
def test_statistics_follow_what_joins_leaves_and_merges(size):
    """With frames few for the size of their descriptor, many, and on both sides of the line between them."""
    points = points_of(300, size, seed=size)
    frames = rows(Description(points))
    mode = mode_of(points[:12])
    for frame in range(12, 120):
        mode = mode.add(frame, frames[frame])
        if frame % 20 == 0:
            check(mode, points[: frame + 1])
    other = mode_of(points[120:])
    check(mode.merge(other), np.concatenate([points[:120], points[120:]]))
    gone = [3, 4, 9, 20, *range(40, 90)]
    fewer = mode.remove(gone)
    assert fewer.frames.tolist() == [frame for frame in range(120) if frame not in gone]
    check(fewer, points[fewer.frames])
    assert mode.remove([500]) is mode


def test_frames_are_held_out_again_if_too_few_of_either_kind_are_left():
    points = points_of(20, 5, seed=0)
    mode = mode_of(points)
    left = mode.remove(np.flatnonzero(mode.held).tolist())
    assert left.held.sum() == int(0.2 * len(left))
    check(left, points[left.frames])


@pytest.mark.parametrize("count", [12, 60])
@pytest.mark.parametrize("value", [0.0, 1.0])
def test_equal_frames_are_at_no_distance_and_others_far_away(count, value):
    mode = mode_of(np.full((count, 40), value))
    at, off = mode.metric.distances(value + np.repeat([[0.0], [1.0]], 40, axis=1))
    assert at == 0
    assert np.isfinite(off)
    assert off > 1
    assert mode.reach == 0


def test_a_shrinkage_that_rounding_swallows_is_an_error():
    points = points_of(75, 40, seed=3)
    points[:, 20:] = points[:, :20]  # so that even many frames leave directions without variance
    with pytest.raises(AnalyticError, match="cannot be inverted"):
        _ = mode_of(points, shrinkage=1e-25).metric


@pytest.mark.parametrize("size", [4, 20])
@pytest.mark.parametrize("noise", [0.0, 1e-5])
def test_frames_that_are_nearly_equal_keep_their_model_when_others_leave(size, noise):
    generator = np.random.default_rng(size)
    place = generator.normal(size=size)
    points = np.concatenate([place + generator.normal(size=(40, size)), np.tile(place, (20, 1))])
    points[40:] += noise * generator.normal(size=(20, size))
    left = mode_of(points).remove(range(40))
    assert np.isfinite(left.usual).all()
    for x in points[40:][~left.held]:
        assert np.diff(left.metric.distances(np.stack([x, x + 0.1])))[0] >= 0


def test_a_full_gallery_keeps_frames_apart_and_their_spectra():
    world = World()
    frames = rows(world.at(corridor_drive(80)))
    mode = Mode.of(Parameters(exemplars=8), range(60), frames[:60])
    for frame in range(60, 80):
        mode = mode.add(frame, frames[frame])
    gallery = mode.gallery
    assert len(gallery) == 8
    expected = Description.concatenate([frames[frame] for frame in gallery.frames])
    assert np.array_equal(gallery.shown.position, expected.position)
    np.testing.assert_allclose(gallery.shown.spectrum, expected.spectrum, rtol=1e-5, atol=1e-5)
    whole = Mode.of(Parameters(), range(80), frames).gallery
    assert whole.closest[0] < gallery.closest[0]
    assert whole.thin(None) is whole
    assert len(whole.thin(5)) == 5


def test_which_frames_a_full_gallery_keeps():
    points = [[0], [1], [1.5], [1.6], [10], [1.7], [20], [0.2], [20.1], [19.9]]
    mode = mode_of(np.array(points, dtype=np.float32), exemplars=4)
    assert mode.gallery.frames.tolist() == [0, 1, 4, 6]
