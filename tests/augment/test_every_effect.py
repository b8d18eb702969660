"""What holds for every effect and every policy."""

import json

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

import augment
from augment import ranges, sensor
from tests.augment.pictures import generator, panoramas, turned

NAMES = [*augment.EFFECTS, *(f"policy {name}" for name in augment.POLICIES)]
DTYPES = [torch.uint8, torch.float32]


def build(name, **params):
    kind, _, policy = name.partition(" ")
    return augment.policy(policy, **params) if policy else augment.effect(kind, **params)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", NAMES)
def test_keeps_shape_dtype_range_and_the_batch_given(name, dtype):
    batch = panoramas(dtype=dtype)
    before = batch.clone()
    out = build(name)(batch, generator())
    assert out.shape == batch.shape
    assert out.dtype == dtype
    assert 0 <= float(out.min()) <= float(out.max()) <= (255 if dtype == torch.uint8 else 1)
    assert torch.equal(batch, before)
    assert out.data_ptr() != batch.data_ptr()


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", augment.EFFECTS)
def test_changes_pictures_at_full_strength_and_leaves_them_at_zero(name, dtype):
    effect, batch = augment.effect(name), panoramas(height=32, width=128, dtype=dtype)
    assert torch.equal(effect.apply(batch, effect.at(0, batch)), batch)
    assert not torch.equal(effect.apply(batch, effect.at(0.9, batch)), batch)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", NAMES)
def test_replay_from_plain_values_is_exact(name, dtype):
    effect, batch = build(name), panoramas(5, dtype=dtype)
    params = effect.draw(generator(3), batch)
    stored = json.loads(json.dumps({key: value.tolist() for key, value in params.items()}))
    assert torch.equal(effect.apply(batch, params), effect.apply(batch, stored))


@pytest.mark.parametrize("name", NAMES)
def test_one_generator_state_gives_one_draw_for_both_dtypes(name):
    effect = build(name)
    first = effect.draw(generator(5), panoramas())
    second = effect.draw(generator(5), panoramas(dtype=torch.float32))
    other = effect.draw(generator(6), panoramas())
    assert first.keys() == second.keys()
    assert all(torch.equal(first[key], second[key]) for key in first)
    if name not in ("policy none", "sharpen", "blur", "equalize"):  # published with fixed strengths
        assert any(not torch.equal(first[key], other[key]) for key in first)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", NAMES)
def test_every_frame_has_its_own_parameters_and_is_treated_alone(name, dtype):
    effect, batch = build(name), panoramas(4, dtype=dtype)
    params = effect.draw(generator(1), batch)
    together = effect.apply(batch, params)
    for frame in range(4):
        own = {key: value[frame : frame + 1] for key, value in params.items()}
        alone = effect.apply(batch[frame : frame + 1], own)[0]
        assert torch.allclose(alone.float(), together[frame].float(), atol=1e-6)
    assert all(value.shape == (4,) for value in params.values())
    spread = [value for key, value in params.items() if key not in ("rim", "pivot", "horizon", "level")]
    if name not in ("policy none", "sharpen", "blur", "equalize"):
        assert any(len(value.unique()) > 1 for value in spread)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", [name for name in NAMES if name not in ("jpeg", "policy strong")])
def test_turning_before_equals_turning_after(name, dtype):
    """Turning the panorama, then the effect with turned parameters = the effect, then turning."""
    effect, batch = build(name), panoramas(8, dtype=dtype)
    params = effect.draw(generator(2), batch)
    for columns in (1, 13, 63):
        before = effect.apply(batch.roll(columns, 3), turned(params, columns, 64))
        after = effect.apply(batch, params).roll(columns, 3)
        assert torch.allclose(before.float(), after.float(), atol=1e-6 if dtype == torch.float32 else 0)


def test_jpeg_turns_by_whole_blocks():
    effect, batch = augment.effect("jpeg"), panoramas(4, 32, 128)
    params = effect.draw(generator(2), batch)
    inner = slice(8, -8)  # the codec smooths colours between neighbouring blocks, but not across the seam
    before = effect.apply(batch.roll(16, 3), params).roll(-16, 3)[..., 24:-24].float()
    after = effect.apply(batch, params)[..., 24:-24].float()
    assert torch.equal(before[:, :, inner], after[:, :, inner])


@pytest.mark.parametrize("circular", [True, False])
@pytest.mark.parametrize("name", augment.EFFECTS)
def test_8_bit_and_float_follow_one_formula_for_every_camera(name, circular):
    effect, batch = augment.effect(name, circular=circular), panoramas(6)
    params = effect.draw(generator(4), batch)
    bits = effect.apply(batch, params).float()
    exact = effect.apply(batch.float() / 255, params) * 255
    assert float((bits - exact).abs().max()) <= 0.5 + 1e-3


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
@pytest.mark.parametrize("name", NAMES)
def test_the_gpu_gives_the_same_pictures(name):
    effect, batch = build(name), panoramas(4, dtype=torch.float32)
    params = effect.draw(generator(1), batch)
    there, here = effect.apply(batch.cuda(), params).cpu(), effect.apply(batch, params)
    if name == "jpeg":  # the codec in main memory rounds coefficients near a half the other way
        assert (there - here).abs().mean() < 0.2 * (here - batch).abs().mean()
    else:
        assert torch.allclose(there, here, atol=1e-3)


class Watched(TorchDispatchMode):
    """Raises where the program waits for a device, or takes a number to it and waits until that has arrived."""

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        if func is torch.ops.aten._to_copy.default and kwargs.get("device", args[0].device) != args[0].device:
            assert args[0].device.type == "cpu"
            assert kwargs.get("non_blocking")
        return func(*args, **kwargs)


@pytest.mark.parametrize("name", NAMES)
def test_the_program_never_waits_for_the_device_of_a_batch(name):
    """On the device meta there is nothing to wait for: reading a number, or counting what is true, fails."""
    effect, batch = build(name), panoramas(6, dtype=torch.float32).to("meta")
    program = effect.program(effect.draw(generator(), batch), *batch.shape[2:])
    effect.play(batch, program)  # tables are made once for a device
    with Watched():
        out = effect.play(batch, program)
    assert (out.device.type, out.dtype, out.shape) == ("meta", torch.float32, batch.shape)


@pytest.mark.parametrize("name", ["bulb", "equalize", "noise", "policy strong"])
def test_an_empty_batch_stays_empty(name):
    effect, batch = build(name), panoramas(0)
    assert effect(batch, generator()).shape == (0, 3, 24, 64)


@pytest.mark.parametrize("name", ["blur", "bulb", "policy thesis"])
def test_any_memory_layout(name):
    effect, batch = build(name), panoramas(3)
    params = effect.draw(generator(), batch)
    other = batch.to(memory_format=torch.channels_last)
    assert torch.equal(effect.apply(other, params), effect.apply(batch, params))


@pytest.mark.parametrize("name", ["gamma", "policy thesis"])
@pytest.mark.parametrize(
    ("batch", "message"),
    [
        (torch.zeros(3, 8, 8), r"a batch is a tensor \(B, 3, H, W\), uint8, or float32 in .0, 1., got \(3, 8, 8\) "),
        (torch.zeros(1, 1, 8, 8), r"got \(1, 1, 8, 8\)"),
        (torch.zeros(1, 3, 0, 8), r"got \(1, 3, 0, 8\)"),
        (torch.zeros(1, 3, 8, 8, dtype=torch.float64), "got .* torch.float64"),
        (torch.full((1, 3, 8, 8), 7.0), "got values from 7 to 7: divide levels by 255"),
        (torch.full((1, 3, 8, 8), -0.5), "got values from -0.5 to -0.5: clamp it"),
        (torch.full((1, 3, 8, 8), float("nan")), "got values from nan to nan: mend NaN and infinite values"),
        (torch.full((1, 3, 8, 8), 2.5) - torch.eye(8) * 4, r"from -1\.5 to 2\.5: clamp it, or normalize it later"),
        ([[1]], "a batch is a tensor .*, got list"),
    ],
)
def test_wrong_batches(name, batch, message):
    with pytest.raises(augment.AugmentError, match=message):
        build(name)(batch, generator())


def test_unknown_names():
    with pytest.raises(augment.AugmentError, match="unknown effect 'bulp': did you mean 'bulb'"):
        augment.effect("bulp")
    with pytest.raises(augment.AugmentError, match=r"unknown effect \['bulb'\]: .*valid: bulb, "):
        augment.effect(["bulb"])
    with pytest.raises(augment.AugmentError, match=r"bulb draws from a torch.Generator, such as .*, got 7"):
        augment.effect("bulb").draw(7, panoramas(1))
    with pytest.raises(AttributeError, match="efect"):
        _ = augment.efect


def test_strengths_go_both_ways_up_to_one():
    batch = panoramas(1)
    with pytest.raises(augment.AugmentError, match=r"strength of gamma must lie in \[-1, 1\], got 2"):
        augment.effect("gamma").at(2, batch)
    assert float(augment.effect("gamma").at(-1, batch)["gamma"]) == pytest.approx(0.5)
    assert float(augment.effect("gamma").at(1, batch)["gamma"]) == pytest.approx(2.0)
    assert float(augment.effect("darken").at(-1, batch)["amount"]) == 75


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", NAMES)
def test_another_default_device_of_torch_changes_nothing(name, dtype):
    batch = panoramas(dtype=dtype)
    torch.set_default_device("meta")
    try:
        effect = build(name)
        params = effect.draw(torch.Generator(device="cpu").manual_seed(3), batch)
        out, middle = effect.apply(batch, params), effect.at(0.5, batch)
    finally:
        torch.set_default_device(None)
    again = build(name)
    assert torch.equal(out, again.apply(batch, again.draw(generator(3), batch)))
    assert all(torch.equal(value, again.at(0.5, batch)[key]) for key, value in middle.items())


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", NAMES)
def test_another_default_dtype_of_torch_changes_nothing(name, dtype):
    batch = panoramas(dtype=dtype)

    def run():
        for cached in (ranges._tables, sensor._stretches):
            cached.cache_clear()
        effect = build(name)
        middle = effect.at(0.5, batch)
        return effect.apply(batch, effect.draw(generator(3), batch)), effect.apply(batch, middle), middle

    expected = run()
    torch.set_default_dtype(torch.float64)
    try:
        found = run()
    finally:
        torch.set_default_dtype(torch.float32)
    torch.testing.assert_close(found, expected, rtol=0, atol=0)  # dtypes, too


NO_VALUES = [float("nan"), float("inf"), -1e9, 1e9, "high", None, 3 + 4j]


@pytest.mark.parametrize("value", NO_VALUES, ids=repr)
@pytest.mark.parametrize("name", NAMES)
def test_values_that_no_parameter_takes(name, value):
    effect, batch = build(name), panoramas(2)
    params = effect.draw(generator(), batch)
    for key in list(params)[:30]:
        with pytest.raises(augment.AugmentError, match=f"parameter '{key}' of .* must (be|lie)"):
            effect.apply(batch, {**params, key: [value, value]})


@pytest.mark.parametrize(
    ("name", "key", "value", "message"),
    [
        ("noise", "first", -5, r"'first' of noise must lie in \[0, 2097151\]"),
        ("brighten", "amount", 2.5, "'amount' of brighten must be whole numbers .*, got .2.5"),
        ("jpeg", "quality", 500, r"'quality' of jpeg must lie in \[1, 100\], got \[500"),
        ("policy thesis", "0.bulb.radius", 0, r"'0.bulb.radius' of thesis must lie in \[0.5, "),
        ("brighten", "amuont", 1, "brighten has no parameter 'amuont': did you mean 'amount'"),
    ],
)
def test_values_outside_of_what_makes_sense(name, key, value, message):
    effect, batch = build(name), panoramas(2)
    params = effect.draw(generator(), batch)
    with pytest.raises(augment.AugmentError, match=message):
        effect.apply(batch, {**params, key: [value, value]})
    with pytest.raises(augment.AugmentError, match=f"the parameters of .* lack '{next(iter(params))}'"):
        effect.apply(batch, {})
    with pytest.raises(augment.AugmentError, match=r"numbers \(2,\), one for each frame of the batch, got "):
        effect.apply(batch, {**params, next(iter(params)): [0, 1, 0]})


@pytest.mark.parametrize(
    ("name", "params"), [("gamma", {"gamma": 20}), ("gamma", {"gamma": 0.05}), ("bulb", {"aspect": (0.05, 20)})]
)
def test_what_is_drawn_at_the_ends_of_the_permitted_is_applied(name, params):
    effect, batch = augment.effect(name, **params), panoramas(200, 4, 8)
    for dtype in DTYPES:
        pictures = batch if dtype == torch.uint8 else batch.float() / 255
        assert effect(pictures, generator()).shape == batch.shape
