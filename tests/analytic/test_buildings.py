import numpy as np
import pytest

from analytic import AnalyticError, clustering
from analytic.buildings import choose_building
from tests.oracles.search import between

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("distance", ["cosine", "euclidean", "correlation", "manhattan"])
def test_the_building_of_the_nearest_representative_is_chosen(distance):
    maps = [RNG.normal(size=(k, 8)) for k in (3, 1, 6)]
    queries = RNG.normal(size=(25, 8))
    found = choose_building(queries, maps, distance)
    for i, query in enumerate(queries.tolist()):
        every = [
            (between(query, row, distance), building, place)
            for building, one in enumerate(maps)
            for place, row in enumerate(one.tolist())
        ]
        nearest = min(every)
        assert (found.building[i], found.representative[i]) == nearest[1:]
        for building in range(3):
            assert found.apart[i, building] == pytest.approx(min(d for d, b, _ in every if b == building))


def test_queries_from_two_buildings_find_home_through_compact_maps():
    centres = [3 * RNG.normal(size=(6, 32)), 3 * RNG.normal(size=(9, 32))]
    maps = []
    for one in centres:
        frames = np.repeat(one, 20, axis=0) + RNG.normal(size=(20 * len(one), 32))
        maps.append(clustering.representatives(frames, clustering.spectral(frames, len(one))))
    queries = np.concatenate([one + RNG.normal(size=one.shape) for one in centres])
    truth = np.repeat([0, 1], [6, 9])
    np.testing.assert_array_equal(choose_building(queries, maps).building, truth)


def test_of_equally_near_buildings_the_first_counts():
    found = choose_building([[1.0, 0]], [[[0, 1.0]], [[2.0, 0]], [[3.0, 0], [1.0, 0]]])
    assert found.building.tolist() == [1]
    assert found.apart.tolist() == [[1, 0, 0]]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: choose_building(np.ones((2, 3)), []), "no map to choose from"),
        (lambda: choose_building(np.ones((2, 3)), np.ones((4, 3))), "list .* got a single array"),
        (lambda: choose_building(np.ones((2, 3)), [np.ones((4, 2))]), "building 0 has descriptors of 2 numbers"),
        (lambda: choose_building(np.ones(3), [np.ones((4, 3))]), r"queries must have shape \(n, D\)"),
        (lambda: choose_building(np.ones((2, 3)), [np.full((1, 3), np.nan)]), "1 of 1 representatives of building 0"),
        (lambda: choose_building(np.ones((2, 3)), [np.ones((1, 3))], "cosin"), "did you mean 'cosine'"),
    ],
)
def test_mistakes_are_one_sentence(call, says):
    with pytest.raises(AnalyticError, match=says):
        call()
