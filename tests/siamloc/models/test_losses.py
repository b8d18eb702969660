"""The contrastive loss against a loop, its gradient, and its refusals."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from siamloc.errors import DataError
from siamloc.models.losses import ContrastiveLoss, pair_distance
from tests.oracles.contrastive import contrastive_loss


def draw(pairs, dimensions, seed=0, dtype=torch.float64):
    generator = torch.Generator().manual_seed(seed)
    d0, d1 = torch.randn(2, pairs, dimensions, generator=generator, dtype=dtype)
    return d0, d1, torch.rand(pairs, generator=generator, dtype=dtype)


@settings(deadline=None, max_examples=40)
@given(pairs=st.integers(1, 9), dimensions=st.integers(1, 12), margin=st.floats(0.1, 20), seed=st.integers(0, 1000))
def test_agrees_with_a_loop_over_pairs(pairs, dimensions, margin, seed):
    d0, d1, y = draw(pairs, dimensions, seed)
    expected = contrastive_loss(d0.tolist(), d1.tolist(), y.tolist(), margin)
    assert ContrastiveLoss(margin)(d0, d1, y).item() == pytest.approx(expected, rel=1e-9)


def test_it_says_its_margin():
    assert repr(ContrastiveLoss(2.5)) == "ContrastiveLoss(margin=2.5)"


@pytest.mark.parametrize("label", [0.0, 0.5, 1.0])
def test_gradient_is_finite_where_both_descriptors_are_equal(label):
    d0 = torch.ones(2, 4, requires_grad=True)
    d1 = torch.ones(2, 4, requires_grad=True)
    ContrastiveLoss()(d0, d1, torch.full((2,), label)).backward()
    assert torch.equal(d0.grad, torch.zeros(2, 4))
    assert torch.equal(d1.grad, torch.zeros(2, 4))


def test_distance_is_computed_in_float32_under_autocast():
    # 1000 + 0.5 and 1000 are one number in bfloat16.
    first, second = torch.tensor([[1000.5]]), torch.tensor([[1000.0]])
    with torch.autocast("cpu", dtype=torch.bfloat16):
        apart = pair_distance(first, second)
        loss = ContrastiveLoss()(first, second, torch.zeros(1))
    assert apart.dtype == loss.dtype == torch.float32
    assert apart.item() == pytest.approx(0.5)
    assert loss.item() == pytest.approx(0.25)


ONE_SHAPE, RANGE = r"one shape \(B, D\)", r"must lie in \[0, 1\]"


@pytest.mark.parametrize(
    ("first", "second", "label", "says"),
    [
        ((4, 3), (4, 2), (4,), ONE_SHAPE),
        ((4, 3), (1, 3), (4,), ONE_SHAPE),
        ((4,), (4,), (4,), ONE_SHAPE),
        ((0, 3), (0, 3), (0,), ONE_SHAPE),
        ((4, 3), (4, 3), (4, 1), r"one label per pair, shape \(4,\), got \(4, 1\): drop its last axis"),
        ((4, 3), (4, 3), (3,), r"shape \(4,\), got \(3,\)$"),
        ((2, 3), (2, 3), [0.0, -0.1], RANGE),
        ((2, 3), (2, 3), [0.0, 1.1], RANGE),
        ((2, 3), (2, 3), [0.0, float("nan")], RANGE),
    ],
)
def test_what_is_no_batch_of_pairs_is_refused(first, second, label, says):
    labels = torch.tensor(label) if isinstance(label, list) else torch.zeros(label)
    with pytest.raises(DataError, match=says):
        ContrastiveLoss()(torch.zeros(first), torch.zeros(second), labels)
