"""The time that a step takes for one image."""

from __future__ import annotations

import time

import pytest

from siamloc.stopwatch import Stopwatch


def test_it_is_the_median_of_the_batches_after_the_first():
    clock = Stopwatch({"describe": [(100.0, 2), (1.0, 10), (3.0, 10), (0.4, 1)]})
    assert clock.ms("describe") == pytest.approx(300)
    assert Stopwatch({"describe": [(100.0, 2)]}).ms("describe") == pytest.approx(50_000)
    assert clock.ms("search") is None


def test_it_counts_the_time_of_the_block_for_the_images_in_it():
    clock = Stopwatch()
    with clock.of("search", images=2):
        time.sleep(0.02)
    with clock.of("search", images=0):
        pass
    assert 10 <= clock.ms("search") < 1000
    assert len(clock.batches["search"]) == 1
