import numpy as np
import pytest
from scipy.spatial.distance import cdist

from analytic import DISTANCES, AnalyticError, distance
from analytic.distances import minkowski

SCIPY = {"manhattan": "cityblock", "euclidean": "euclidean", "minkowski": "euclidean"}
SCIPY |= {"correlation": "correlation", "cosine": "cosine"}


@pytest.mark.parametrize("name", DISTANCES)
def test_distances_are_those_of_scipy(name):
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(7, 12)), rng.normal(size=(5, 12))
    np.testing.assert_allclose(distance(name)(a, b), cdist(a, b, SCIPY[name]), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("p", [1, 1.5, 2, 3])
def test_weighted_minkowski_follows_its_equation(p):
    rng = np.random.default_rng(1)
    a, b, w = rng.normal(size=(4, 6)), rng.normal(size=(3, 6)), rng.uniform(0, 2, 6)
    slow = [[sum(w[i] * abs(x[i] - y[i]) ** p for i in range(6)) ** (1 / p) for y in b] for x in a]
    np.testing.assert_allclose(minkowski(a, b, p, w), slow, rtol=1e-12)


@pytest.mark.parametrize("name", DISTANCES)
def test_values_that_are_not_numbers_are_no_distance(name):
    assert np.isnan(distance(name)([[np.nan, 1.0, 2.0]], [[1.0, 2.0, 4.0]])).all()


def test_vectors_without_direction_are_at_one_from_everything():
    flat, other = np.full((1, 4), 3.7), np.array([[1.0, 2, 3, 4], [0, 0, 0, 0]])
    assert distance("correlation")(flat, other).tolist() == [[1, 1]]
    assert distance("cosine")(np.zeros((1, 4)), other).tolist() == [[1, 1]]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: distance("euclidian"), "did you mean 'euclidean'"),
        (lambda: distance("cosine")(np.zeros((2, 3)), np.zeros((2, 4))), r"\(2, 3\) and \(2, 4\)"),
        (lambda: distance("cosine")(np.zeros(3), np.zeros((2, 3))), r"\(n, D\)"),
        (lambda: minkowski(np.zeros((1, 2)), np.zeros((1, 2)), p=0.5), "p >= 1, got 0.5"),
        (lambda: minkowski(np.zeros((1, 2)), np.zeros((1, 2)), weights=[1]), "2 numbers that are not negative"),
        (lambda: minkowski(np.zeros((1, 2)), np.zeros((1, 2)), weights=[1, -1]), "not negative, got -1"),
        (lambda: minkowski(np.zeros((1, 2)), np.zeros((1, 2)), weights=[1, np.nan]), "not negative, got nan"),
    ],
)
def test_mistakes_are_one_sentence(call, says):
    with pytest.raises(AnalyticError, match=says):
        call()


@pytest.mark.parametrize("values", [[["a"]], [[1j]], [[None]], [[1], [1, 2]], "abc", {"a": 1}])
def test_only_real_numbers_have_distances(values):
    with pytest.raises(AnalyticError, match="must be an array of"):
        distance("euclidean")(values, [[1.0]])
