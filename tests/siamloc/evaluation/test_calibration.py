from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from siamloc.evaluation.calibration import calibration_curve, calibration_measures, lost_measures
from tests.oracles import calibration as oracle


@given(seed=st.integers(0, 2**32 - 1), bins=st.integers(1, 12))
def test_every_query_is_in_one_bin_and_the_bins_are_in_order(seed: int, bins: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 60))
    predicted, error = rng.integers(0, 6, n) / 2, rng.random(n)  # equal predictions occur
    curve = calibration_curve(predicted, error, bins)
    assert sum(part["count"] for part in curve) == n
    assert len(curve) <= bins
    means = [part["predicted"] for part in curve]
    assert means == sorted(means)
    for name, values in (("predicted", predicted), ("observed", error)):
        assert math.fsum(part["count"] * part[name] for part in curve) == pytest.approx(values.sum())


def test_bins_of_distinct_predictions_hold_equally_many() -> None:
    curve = calibration_curve(np.arange(100)[::-1], np.arange(100)[::-1] + 1.0, 10)
    assert [part["count"] for part in curve] == [10] * 10
    for part in curve:
        assert part["observed"] - part["predicted"] == pytest.approx(1)
    assert calibration_curve([], []) == []


@given(seed=st.integers(0, 2**32 - 1), threshold=st.sampled_from([0.5, 1.0, 2.0]))
def test_lost_equals_the_loop(seed: int, threshold: float) -> None:
    rng = np.random.default_rng(seed)
    predicted, error = rng.integers(0, 6, (2, int(rng.integers(0, 30)))) / 2
    measures = lost_measures(predicted > threshold, error, threshold)
    called, lost, both = oracle.lost(predicted, error, threshold)
    assert (measures["called"], measures["lost"], measures["both"]) == (called, lost, both)
    assert measures["precision"] == both / called if called else math.isnan(measures["precision"])
    assert measures["recall"] == both / lost if lost else math.isnan(measures["recall"])


def test_perfect_and_reversed_predictions() -> None:
    error = np.random.default_rng(0).exponential(1, 2000)
    reverse = np.sort(error)[::-1][np.argsort(np.argsort(error))]
    columns = {"error": error, "lighting": np.full(2000, ""), "room": np.full(2000, "")}
    perfect, turned = (
        calibration_measures({**columns, "error_m": expected, "lost": expected > 1}, 1.0)["overall"]
        for expected in (error, reverse)
    )
    assert perfect["gap"] == 0
    assert (perfect["lost"]["precision"], perfect["lost"]["recall"]) == (1, 1)
    assert turned["gap"] > 1
    assert turned["lost"]["both"] < 0.2 * turned["lost"]["lost"]
