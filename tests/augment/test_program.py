"""Rendering a batch from a program: effects that exclude each other share a step."""

import pytest
import torch

import augment
from augment import Policy
from augment.sensor import _constants, compressed
from tests.augment.pictures import generator, panoramas

SPOTS = [{"effect": "bulb"}, {"effect": "square"}, {"effect": "trapezoid"}]


def all_on(policy, batch):
    params = policy.at(1, batch)
    return {key: torch.ones(len(batch)) if key.endswith(".on") else value for key, value in params.items()}


def names(policy):
    return [sorted({policy.effects[slot].name for slot in stage}) for stage in policy.stages]


def test_alternatives_share_steps():
    spot = {"one_of": SPOTS}
    assert names(Policy({"all_of": [spot, {"effect": "blur"}]})) == [["bulb", "square", "trapezoid"], ["blur"]]
    tree = {"one_of": [{"effect": "blur"}, {"all_of": [spot, {"effect": "blur"}]}, {"all_of": [spot, spot]}]}
    assert names(Policy(tree)) == [["bulb", "square", "trapezoid"], ["blur"], ["bulb", "square", "trapezoid"]]
    assert names(Policy({"all_of": [{"effect": "darken"}, {"effect": "contrast"}]})) == [["darken"], ["contrast"]]
    sizes = {"one_of": [{"effect": "blur", "size": 3}, {"effect": "blur", "size": 5}, {"effect": "blur"}]}
    assert names(Policy(sizes)) == [["blur"], ["blur"]]
    assert sum(map(len, Policy(sizes).stages)) == 3


@pytest.mark.parametrize("name", [*augment.POLICIES, "bulb", "noise"])
def test_a_program_can_wait_and_gives_the_same_pictures(name):
    effect = augment.effect(name) if name in augment.EFFECTS else augment.policy(name)
    batch = panoramas(12, 32, 64)
    params = effect.draw(generator(), batch)
    for dtype in (torch.uint8, torch.float32):
        pictures = batch if dtype == torch.uint8 else batch / 255
        played = effect.play(pictures, effect.program(params, 32, 64))
        assert played.dtype == dtype
        if dtype == torch.float32:
            assert torch.equal(played, effect.apply(pictures, params))
        else:
            # Every effect rounds to whole levels, as painting does; a tie may fall either way, and the next effect
            # may show it.
            apart = (played.int() - effect.apply(pictures, params).int()).abs()
            assert float(apart.float().mean()) < 0.01


def test_parameters_by_hand_may_take_effects_that_exclude_each_other():
    policy = Policy({"one_of": [{"effect": "darken", "amount": 30}, {"effect": "contrast", "factor": 2}]})
    batch = panoramas(2, dtype=torch.float32)
    one_by_one = batch
    for effect in policy.effects:
        one_by_one = effect.apply(one_by_one, effect.at(1, batch))
    assert torch.allclose(policy.apply(batch, all_on(policy, batch)), one_by_one, atol=1e-6)


def test_parameters_by_hand_may_take_alternatives_whose_steps_are_in_another_order():
    late = {"all_of": [{"effect": "darken"}, {"effect": "contrast", "factor": 1.5}]}
    policy = Policy({"one_of": [{"effect": "blur"}, late]})
    assert names(policy) == [["darken"], ["contrast"], ["blur"]]
    batch = panoramas(2)
    params = all_on(policy, batch)
    apart = policy.apply(batch / 255, params) * 255 - policy.apply(batch, params)
    assert apart.abs().max() <= 0.5 * 1.5 + 0.5 + 1e-3  # painting rounds the blur, and contrast scales that


def test_an_empty_batch_has_an_empty_program():
    policy, batch = augment.policy("thesis"), panoramas(0)
    program = policy.program(policy.draw(generator(), batch), 24, 64)
    assert policy.play(batch, program).shape == batch.shape


def coefficients(effect, batch):
    return effect.tensors(effect.draw(generator(), batch), *batch.shape[2:])


@pytest.mark.parametrize("quality", [10, 35, 60, 90])
def test_compression_on_a_gpu_is_that_of_the_codec(quality):
    """Coefficients near a half round either way; everything else agrees."""
    smooth = torch.nn.functional.interpolate(torch.rand(4, 3, 4, 8, generator=generator()), (40, 72), mode="bicubic")
    batch = (smooth.clamp(0, 1) * 255).round().to(torch.uint8)
    effect = augment.effect("jpeg", quality=quality)
    params = effect.draw(generator(), batch)
    values = coefficients(effect, batch)
    found = compressed(batch / 255, values["brightness"], values["colour"]) * 255
    codec = effect.apply(batch, params).float()
    loss = (codec - batch).abs().mean()
    assert (found - codec).abs().mean() < max(0.2 * loss, 0.3)


def test_compression_is_as_precise_where_a_network_is_not():
    batch = panoramas(2, dtype=torch.float32)
    values = coefficients(augment.effect("jpeg"), batch)
    wanted = compressed(batch, values["brightness"], values["colour"])
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(compressed(batch, values["brightness"], values["colour"]), wanted)


def test_tables_made_in_inference_mode_serve_gradients():
    _constants.cache_clear()
    batch = panoramas(1, dtype=torch.float32)
    values = coefficients(augment.effect("jpeg"), batch)
    with torch.inference_mode():
        compressed(batch, values["brightness"], values["colour"])
    pictures = batch.clone().requires_grad_()
    compressed(pictures, values["brightness"], values["colour"]).sum().backward()
    assert pictures.grad is not None
