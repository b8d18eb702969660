"""Comparing vectors that turn with the robot: against turning them one by one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from analytic import AnalyticError, descriptor
from analytic.descriptors.base import AlignedDescriptor

STEPS, FEATURES = 12, 5


@dataclass(frozen=True, kw_only=True)
class Columns(AlignedDescriptor):
    """The columns of an image."""

    name = "columns"
    default_distance = "cosine"

    def _check_size(self, height, width):
        pass

    def sizes(self, height, width):
        return (height * width,), (width, height)

    def _describe(self, grey):
        return grey.ravel(), grey.T


MADE = Columns()


def images(seed, count):
    return np.random.default_rng(seed).random((count, 1, FEATURES, STEPS), dtype=np.float32)


def test_small_parts_give_the_same(monkeypatch):
    def compared():
        q, r = MADE.describe(images(0, 4)), MADE.describe(images(1, 7))
        phases = hog.align(hog.describe(images(0, 4)), hog.describe(images(1, 7)))
        return [MADE.pairwise(q, r, "manhattan"), MADE.pairwise(q, r, "correlation"), phases.heading, phases.distance]

    hog = descriptor("hog", rows=5, window=4, step=1)
    whole = compared()
    for held in (1, STEPS * 3, STEPS * 15):
        monkeypatch.setattr("analytic.alignment._VALUES", held)
        monkeypatch.setattr("analytic.description._VALUES", held)
        for part, expected in zip(compared(), whole, strict=True):
            np.testing.assert_allclose(part, expected, rtol=1e-5)


def test_mistakes_are_one_sentence():
    q, r = MADE.describe(images(0, 2)), MADE.describe(images(1, 3))
    with pytest.raises(AnalyticError, match="unknown distance 'euclid': did you mean 'euclidean'"):
        MADE.pairwise(q, r, "euclid")
    other = MADE.describe(np.zeros((1, FEATURES, STEPS + 2)))
    for compare in (MADE.pairwise, MADE.align, MADE.localize):
        with pytest.raises(AnalyticError, match="different sizes"):
            compare(q, other)
