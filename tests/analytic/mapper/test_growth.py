from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from analytic.mapper import IncrementalMapper, steps
from analytic.mapper.growth import distinctness, merge_alike
from tests.analytic.mapper.world import World, corridor_drive, rows


def node(*centres):
    return SimpleNamespace(modes=[SimpleNamespace(centre=np.array(centre, dtype=float)) for centre in centres])


def test_a_place_is_as_far_as_the_nearest_of_its_modes():
    place, other = node([0, 0], [10, 0]), node([4, 0])
    assert distinctness(np.array([9.0, 0]), [place, other]) == ({"distance": 3, "least_distance": 4}, False)
    assert distinctness(np.array([9.0, 0]), [place]) == ({"distance": 1, "least_distance": 0}, True)


@pytest.mark.parametrize("most_modes", [1, 3])
def test_mean_distances_are_those_of_all_pairs(most_modes):
    generator = np.random.default_rng(most_modes)
    nodes = [node(*generator.normal(size=(generator.integers(1, most_modes + 1), 7))) for _ in range(12)]
    centre = generator.normal(size=7)

    def apart(first, second):
        return min(np.linalg.norm(a.centre - b.centre) for a in first.modes for b in second.modes)

    away = np.mean([apart(node(centre), other) for other in nodes])
    among = np.mean([apart(*pair) for pair in combinations(nodes, 2)])
    measured, distinct = distinctness(centre, nodes)
    assert list(measured.values()) == pytest.approx([away, among], rel=1e-12)
    assert distinct == (away >= among)


@pytest.mark.parametrize("size", [16, 64])
def test_what_is_merged_is_the_same_without_anything_known(size, monkeypatch):
    world = World(size=size, steps=0, reach=6.0, seed=2)
    frames = rows(world.at(corridor_drive(400, seed=5, rooms=6), noise=0.2, seed=3))

    def events():
        mapper = IncrementalMapper(world, 2, y=2.5)
        for frame in frames:
            mapper.add(frame)
        return mapper.events

    found = events()
    monkeypatch.setattr(steps, "merge_alike", lambda state, changed, known: merge_alike(state, changed))
    assert events() == found
    assert any("NODES_MERGED" in event and "NEW_NODE" not in event for event in found)
