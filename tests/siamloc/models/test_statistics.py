"""The figures of an epoch against loops, over any cut into batches."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from siamloc.models.losses import ContrastiveLoss, pair_distance
from siamloc.models.siamese import PairStatistics
from tests.oracles.contrastive import pair_statistics

MARGIN = 2.0


def add(statistics, d0, d1, label, same):
    distance = pair_distance(d0, d1)
    loss = ContrastiveLoss(MARGIN)(d0, d1, label)
    statistics.update(torch.cat([d0, d1]), distance, loss, same, label)


def draw(pairs, dimensions, seed, same_share=0.5):
    generator = torch.Generator().manual_seed(seed)
    d0, d1 = 0.5 * torch.randn(2, pairs, dimensions, generator=generator) + 3
    label = (1.5 * torch.rand(pairs, generator=generator)).clamp(max=1)  # a third of the pairs are dissimilar
    return d0, d1, label, torch.rand(pairs, generator=generator) < same_share


@settings(deadline=None, max_examples=25)
@given(
    batches=st.lists(st.integers(1, 6), min_size=1, max_size=5),
    dimensions=st.integers(1, 8),
    same_share=st.sampled_from([0.0, 0.2, 0.5, 1.0]),
    seed=st.integers(0, 1000),
)
def test_agrees_with_loops_over_all_pairs_whatever_the_batches(batches, dimensions, same_share, seed):
    columns = draw(sum(batches), dimensions, seed, same_share)
    statistics = PairStatistics(MARGIN)
    for part in zip(*(column.split(batches) for column in columns), strict=True):
        add(statistics, *part)
    expected = pair_statistics(*(column.tolist() for column in columns), MARGIN)
    computed = {name: value.item() for name, value in statistics.compute().items()}
    assert computed == pytest.approx(expected, rel=1e-5, abs=1e-6)


def test_half_the_margin_already_counts_as_different():
    statistics = PairStatistics(MARGIN)
    d1 = torch.tensor([[0.999], [1.0], [7.0]])
    add(statistics, torch.zeros(3, 1), d1, torch.zeros(3), torch.tensor([True, True, True]))
    assert statistics.compute()["accuracy_same"] == pytest.approx(1 / 3)


def test_a_collapsed_network_has_no_spread_even_far_from_zero():
    statistics = PairStatistics(MARGIN)
    same_for_all = torch.full((50, 3), 12345.678)
    for _ in range(20):
        add(statistics, same_for_all, same_for_all, torch.ones(50), torch.zeros(50, dtype=torch.bool))
    assert statistics.compute()["spread"] < 1e-2


def test_a_loss_without_a_margin_has_no_accuracies():
    statistics = PairStatistics(None)
    add(statistics, *draw(5, 4, 0))
    assert set(statistics.compute()) == {"loss", "distance_same", "distance_different", "spread"}


def test_it_adds_nothing_to_a_state_dict():
    assert PairStatistics(MARGIN).state_dict() == {}
