"""Augmentation on a GPU: few operations and transfers per batch, no wait, and the pictures of the CPU."""

from __future__ import annotations

import pytest

import augment
from siamloc.pretraining import RECIPE
from tests.augment.pictures import generator, panoramas
from tests.gpu.pretend import NAME

SIZE = (16, 64)
POLICIES = {name: augment.policy(name) for name in augment.POLICIES}
POLICIES["pretraining"] = augment.policy_from_config(dict(RECIPE.augmentation))
EFFECTS = {**{name: augment.effect(name) for name in augment.EFFECTS}, **POLICIES}
MOST = {"thesis": 150, "any_light": 250}  # operations for a batch in which every effect occurs
COMPRESSED = ("jpeg", "strong", "pretraining")


@pytest.mark.parametrize("name", EFFECTS)
def test_a_batch_is_augmented_without_a_wait(gpu, name):
    effect, batch = EFFECTS[name], panoramas(128, *SIZE)
    params = effect.draw(generator(), batch)
    program = effect.program(params, *SIZE)
    effect.play(batch.to(NAME), program)  # makes tables that are kept
    there = batch.to(NAME)
    gpu.clear()
    found = effect.play(there, program)
    assert not gpu.waits
    assert sum(gpu.copies.values()) <= 2
    assert sum(gpu.operations.values()) <= MOST.get(name, 10**9)
    apart = (found.cpu().int() - effect.apply(batch, params).int()).abs()
    # A coefficient of the compression near a half may be rounded either way, and then shows in 64 pixels.
    assert apart.float().mean() < 1 if name in COMPRESSED else apart.max() <= 2
