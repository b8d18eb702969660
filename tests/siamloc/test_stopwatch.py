"""The time that a step takes for one image."""

from __future__ import annotations

import pytest

from siamloc.stopwatch import Stopwatch


def test_it_is_the_median_of_the_batches_after_the_first():
    clock = Stopwatch({"describe": [(100.0, 2), (1.0, 10), (3.0, 10), (0.4, 1)]})
    assert clock.ms("describe") == pytest.approx(300)
    assert Stopwatch({"describe": [(100.0, 2)]}).ms("describe") == pytest.approx(50_000)
    with clock.of("search", images=0):
        pass
    assert clock.ms("search") is None
