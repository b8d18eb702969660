"""The picture of a sweep: a line for each combination of the other settings, and the best marked."""

from __future__ import annotations

import numpy as np
import pytest

from siamloc.errors import ConfigError, DataError
from siamloc.report.draw.curves import swept_curves

ROWS = [
    {"distance": distance, "seed": seed, "bins": bins, "error": bins / 10 + seed + len(distance)}
    for distance in ("cosine", "correlation")
    for seed in (0, 1)
    for bins in (32, 8, 4)
]


def lines(figure):
    return {line.get_label(): np.array(line.get_data()).T.tolist() for line in figure.axes[0].lines}


def test_a_line_for_each_combination_against_the_first_setting_with_numbers_that_is_no_seed():
    figure = swept_curves(ROWS, ["distance", "seed", "bins"], "error")
    assert figure.axes[0].get_xlabel() == "bins"
    assert figure.axes[0].get_xscale() == "log"
    found = lines(figure)
    assert set(found) == {f"distance={d}, seed={s}" for d in ("cosine", "correlation") for s in (0, 1)} | {"best: 6.4"}
    assert found["distance=cosine, seed=1"] == [[4, 7.4], [8, 7.8], [32, 10.2]]
    assert found["best: 6.4"] == [[4, 6.4]]


def test_the_highest_may_be_the_best_and_another_setting_may_be_chosen():
    found = lines(swept_curves(ROWS, ["distance", "seed", "bins"], "error", "seed", highest=True))
    assert found["best: 15.2"] == [[1, 15.2]]
    assert len(found) == 7


def test_texts_and_lists_are_put_side_by_side():
    rows = [{"ways": ["b"], "error": 1.0}, {"ways": None, "error": 2.0}, {"ways": ["a"], "error": float("nan")}]
    figure = swept_curves(rows, ["ways"], "error")
    assert [label.get_text() for label in figure.axes[0].get_xticklabels()] == ["['b']", "none"]


def test_there_has_to_be_something_to_draw():
    for rows, settings in ((ROWS, []), ([{"bins": 1, "error": float("nan")}], ["bins"])):
        with pytest.raises(DataError, match="nothing to draw"):
            swept_curves(rows, settings, "error")
    with pytest.raises(ConfigError, match="did you mean 'bins'"):
        swept_curves(ROWS, ["bins", "seed"], "error", "bin")
