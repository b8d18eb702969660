import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analytic import AnalyticError
from analytic.mapper.closure import node_level, node_levels, node_levels_of
from analytic.mapper.node import Mode, Node
from analytic.mapper.parameters import Parameters
from analytic.mapper.statistics import Factored, LowRank, Model, Moments
from tests.analytic.mapper.world import World, corridor_drive, rows

WIDE = World(size=64, steps=0, reach=4.0, seed=7)


def modelled(points, shrinkage="ledoit_wolf"):
    moments = Moments.none(points.shape[1])
    for x in points:
        moments = moments.add(x)
    return Model(moments, shrinkage)


def points_of(count, size, seed, offset=3.0):
    generator = np.random.default_rng(seed)
    mixing = generator.normal(size=(min(6, size), size))
    near = generator.normal(size=(count, len(mixing))) @ mixing + 0.3 * generator.normal(size=(count, size))
    return near + offset * generator.normal(size=size)


def by_definition(model, queries):
    away = queries - model.moments.mean
    return np.einsum("nd,de,ne->n", away, np.linalg.inv(model.covariance), away)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(2, 30),
    st.integers(60, 90),
    st.sampled_from(["ledoit_wolf", 1e-3, 0.3, 1.0]),
    st.sampled_from([0.0, 3.0, 1e3]),
    st.integers(0, 1000),
)
def test_few_frames_give_the_distances_of_the_whole_covariance(count, size, shrinkage, offset, seed):
    points = points_of(count, size, seed, offset)
    model = modelled(points, shrinkage)
    fast, plain = model.metric(points), model.factored
    assert isinstance(fast, LowRank)
    queries = np.concatenate([points, points_of(9, size, seed, offset), points_of(5, size, seed + 1, offset)])
    expected = by_definition(model, queries)
    # What rounding does to either form grows with the condition number, and with the offset, which costs the scatter
    # digits.
    rtol = 1e-9 * (1 + offset) + 16 * np.finfo(float).eps * np.linalg.cond(model.covariance)
    np.testing.assert_allclose(fast.distances(queries), expected, rtol=rtol)
    np.testing.assert_allclose(plain.distances(queries), expected, rtol=rtol)
    np.testing.assert_allclose([fast.distance(query) for query in queries], expected, rtol=rtol)
    np.testing.assert_allclose([plain.distance(query) for query in queries], expected, rtol=rtol)


def test_no_direction_has_less_than_the_least_variance():
    for count in (5, 200):
        points = points_of(count, 40, seed=count)
        model = modelled(points)
        least = np.linalg.eigvalsh(model.covariance)[0]
        metric = model.metric(points)
        assert isinstance(metric, LowRank if count == 5 else Factored)
        assert 0 < metric.least <= least * (1 + 1e-9)


def test_many_frames_take_the_factor():
    points = points_of(21, 40, seed=1)
    assert isinstance(modelled(points[:20]).metric(points[:20]), LowRank)
    model = modelled(points)
    assert model.metric(points) is model.factored


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_equal_frames_are_at_no_distance_and_others_far_away(value):
    points = np.full((6, 40), value)
    metric = modelled(points).metric(points)
    assert isinstance(metric, LowRank)
    at, off = metric.distances(np.stack([points[0], points[0] + 1]))
    assert at == metric.distance(points[0]) == 0
    assert np.isfinite(off)
    assert off > 1


@pytest.mark.parametrize("count", [10, 60])
def test_a_shrinkage_that_rounding_swallows_is_an_error(count):
    points = points_of(count, 40, seed=3)
    points[:, 20:] = points[:, :20]  # so that even many frames leave directions without variance
    with pytest.raises(AnalyticError, match="cannot be inverted"):
        modelled(points, 1e-25).metric(points)


def check(mode, queries):
    points = mode.rows.array[~mode.held]
    assert isinstance(mode.metric, LowRank)
    np.testing.assert_allclose(mode.metric.distances(queries), by_definition(modelled(points), queries), rtol=1e-9)
    held = by_definition(modelled(points), mode.rows.array[mode.held])
    assert mode.gaussian.mean == pytest.approx(held.mean(), rel=1e-9)
    assert mode.gaussian.std == pytest.approx(held.std(ddof=1), rel=1e-9)


def test_a_mode_s_distances_follow_what_joins_leaves_and_merges():
    description = WIDE.at(corridor_drive(60, seed=3), noise=0.2)
    frames = rows(description)
    queries = description.position[40:].astype(np.float64)
    mode = Mode.of(Parameters(), range(12), frames[:12])
    for frame in range(12, 24):
        check(mode, queries)
        mode = mode.add(frame, frames[frame])
    fewer = mode.remove([3, 4, 9, 20])
    check(fewer, queries)
    check(fewer.merge(Mode.of(Parameters(), range(24, 36), frames[24:36])), queries)
    check(mode, queries)


def some_nodes():
    frames = rows(WIDE.at(corridor_drive(200, seed=4), noise=0.2))
    modes = [Mode.of(Parameters(), range(s, s + 20), frames[s : s + 20]) for s in range(0, 160, 20)]
    many = Mode.of(Parameters(), range(100), frames[:100])
    nodes = [Node(3 * i, (mode,)) for i, mode in enumerate(modes[:5])]
    return [*nodes, Node(40, (modes[5], modes[6])), Node(41, (modes[7], many))], frames


@pytest.mark.parametrize("two_sided", [True, False])
def test_a_node_s_distance_does_not_depend_on_the_nodes_beside_it(two_sided):
    nodes, frames = some_nodes()
    for frame in frames[::9]:
        point = frame.position[0].astype(np.float64)
        whole = node_levels(point, nodes, two_sided)
        mixed = node_levels(point, nodes[::-2], two_sided)
        for row, node in enumerate(nodes):
            alone = node_level(point, node, two_sided)
            assert whole.row(row) == whole.of(node.id) == alone
            if node.id in mixed.nodes:
                assert mixed.of(node.id) == alone
            assert (row in whole.closing(1.85)) == alone.closes(1.85)
            best = [node_level(point, Node(0, (mode,)), two_sided).ratio for mode in node.modes]
            assert alone.mode == int(np.argmin(best))
            assert whole.scores()[str(node.id)] == [alone.distance, alone.mean, alone.std]
        assert whole.nearest().ratio == min(whole.row(row).ratio for row in range(len(nodes)))


def test_many_frames_at_once_stand_as_each_by_itself():
    nodes, frames = some_nodes()
    points = np.concatenate([frame.position for frame in frames[::9]]).astype(np.float64)
    for point, found in zip(points, node_levels_of(points, nodes, True), strict=True):
        alone = node_levels(point, nodes, True)
        np.testing.assert_allclose(found.distances, alone.distances, rtol=1e-9)
        assert found.modes.tolist() == alone.modes.tolist()
        assert found.closing(1.85).tolist() == alone.closing(1.85).tolist()
