"""Turns between the columns of an orientation part, compared with sums over cosines."""

from __future__ import annotations

import numpy as np
import pytest

from analytic import AnalyticError, Description
from analytic.descriptors.between_columns import BetweenColumns


class Columns(BetweenColumns):
    """Parts are given as they are."""

    name = "columns"

    @property
    def identity(self):
        return {"name": self.name}

    def describe(self, batch):
        return Description(np.zeros((len(batch), 1)), np.asarray(batch), self.identity)


def correlation(query, reference, turn: float) -> float:
    """Correlate two parts (K, F) with the query turned back by some columns, term by term of the Fourier series."""
    columns, total = len(query), 0.0
    for value in range(query.shape[1]):
        a, b = np.fft.fft(query[:, value]), np.fft.fft(reference[:, value])
        for k in range(columns):
            # The highest frequency of an even number of columns is half a positive and half a negative one.
            for sign, share in ((1, 0.5), (-1, 0.5)) if 2 * k == columns else ((1, 1.0),):
                frequency = sign * (k if 2 * k <= columns else k - columns)
                total += share * (a[k] * b[k].conj() * np.exp(2j * np.pi * frequency * turn / columns)).real
    return total / columns


@pytest.mark.parametrize("columns", [5, 8, 16])
def test_turn_and_distance_are_those_of_the_fourier_series(columns):
    draw = np.random.default_rng(columns)
    queries, references = draw.normal(size=(3, columns, 2)), draw.normal(size=(2, columns, 2))
    one = Columns()
    found = one.align(one.describe(queries), one.describe(references))
    turns = columns * -(-1024 // columns)
    for i, query in enumerate(queries):
        for j, reference in enumerate(references):
            values = [correlation(query, reference, step * columns / turns) for step in range(turns)]
            apart = (query**2).sum() + (reference**2).sum() - 2 * max(values)
            # Parts are kept in single precision.
            assert found.distance[i, j] ** 2 == pytest.approx(apart, abs=1e-4)
            told = round(found.heading[i, j] * turns / (2 * np.pi)) % turns
            assert values[told] == pytest.approx(max(values), abs=1e-4)


def test_a_part_turned_by_whole_columns_is_as_near_as_if_it_were_compared_there():
    """Alternating columns hold the highest frequency alone, which must not count twice."""
    one, signal = Columns(), ((-1.0) ** np.arange(16))[None, :, None]
    found = one.align(one.describe(signal), one.describe(signal / 2))
    assert found.distance.item() == pytest.approx(2.0, abs=1e-6)


def test_all_pairs_and_single_pairs_agree():
    draw, one = np.random.default_rng(0), Columns()
    queries, references = (one.describe(draw.normal(size=(4, 8, 3))) for _ in range(2))
    np.testing.assert_array_equal(
        one.relative_heading(queries, references), np.diagonal(one.align(queries, references).heading)
    )


def test_two_columns_have_no_turn():
    one = Columns()
    with pytest.raises(AnalyticError, match="three columns or more, got 2"):
        one.align(one.describe(np.ones((1, 2, 1))), one.describe(np.ones((1, 2, 1))))
