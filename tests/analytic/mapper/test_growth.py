from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from analytic.mapper.growth import distinctness


def node(*centres):
    return SimpleNamespace(modes=[SimpleNamespace(centre=np.array(centre, dtype=float)) for centre in centres])


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
