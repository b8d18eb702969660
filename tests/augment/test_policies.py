from pathlib import Path

import pytest
import torch
import yaml

import augment
from augment.thesis import combinations, variants
from tests.augment.pictures import generator, panoramas

CONFIGS = sorted((Path(__file__).parents[2] / "conf" / "augment").glob("*.yaml"))


def unordered(label):
    """Two spots, or contrast raised and lowered, are one combination however they were drawn."""
    words = label.replace(" up", "").replace(" down", "").split(" + ")
    return tuple(sorted(words))


def test_the_policy_of_the_thesis_draws_exactly_its_combinations():
    policy = augment.policy("thesis")
    drawn = {unordered(label) for label in policy.describe(policy.draw(generator(), panoramas(20000, 2, 8)))}
    assert drawn == {unordered(label) for label in combinations()}


def test_combinations_of_the_thesis():
    labels = list(combinations())
    assert len(labels) == 104
    assert labels[0] == "original"
    spots = [f"{shape} {tone}" for shape in ("bulb", "square", "trapezoid") for tone in ("light", "dark")]
    for change in ("brighten", "darken"):
        for spot in spots:
            assert f"{change} + {spot}" in labels
    for label in labels:
        if "rotate" not in label and label != "original":
            assert f"{label} + rotate" in labels
    assert "bulb light + bulb light + bulb light" in labels
    assert "bulb dark + square light" in labels or "square light + bulb dark" in labels


@pytest.mark.parametrize("depth", [1, 16, 44, 128, 129, 246])
def test_depths_hold_each_other(depth):
    listed, most = variants(depth), variants(246)
    assert [v.number for v in listed] == list(range(depth))
    assert [v.label for v in listed] == [v.label for v in most[:depth]]


def test_what_the_published_depths_hold():
    labels = [v.label for v in variants(246)]
    singles = {
        *(f"{shape} {tone}" for shape in ("bulb", "square", "trapezoid") for tone in ("light", "dark")),
        *("brighten", "darken", "sharpen", "blur", "contrast up", "contrast down", "equalize", "saturate", "rotate"),
    }
    assert set(labels[:16]) == {"original", *singles}
    assert set(labels[:44]) >= {f"{single} + rotate" for single in singles - {"rotate"}}
    assert labels[42:44] == ["bulb light + bulb light + bulb light", "bulb dark + bulb dark + bulb dark"]
    assert len(set(labels[:104])) == 104
    assert labels[104:207] == labels[1:104]
    assert labels[207:246] == labels[1:40]


@pytest.mark.parametrize("variant", variants(44), ids=lambda v: v.label)
def test_a_variant_is_what_its_label_says(variant):
    batch = panoramas(2, 16, 32)
    params = variant.policy.draw(generator(), batch)
    described = variant.policy.describe(params)
    assert {unordered(label) for label in described} == {unordered(variant.label)}
    assert torch.equal(variant.policy.apply(batch, params), batch) == (variant.label == "original")


@pytest.mark.parametrize("depth", [0, -3, 2.5, True])
def test_depths_that_make_no_sense(depth):
    with pytest.raises(augment.AugmentError, match="depth must be a whole number of variants per frame, at least 1"):
        augment.variants(depth)


def test_lighting_does_not_turn_and_strong_always_does():
    batch = panoramas(50, 4, 64)
    assert not augment.policy("lighting").draw(generator(), batch)["heading"].any()
    assert bool((augment.policy("strong").draw(generator(), batch)["heading"] != 0).all())
    turned = augment.policy("lighting", rotate=1.0).draw(generator(), batch)["heading"]
    assert bool((turned != 0).all())


def test_none_leaves_every_picture():
    batch = panoramas(3)
    policy = augment.policy("none")
    params = policy.draw(generator(), batch)
    assert torch.equal(policy.apply(batch, params), batch)
    assert policy.describe(params) == ["original"] * 3


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_configuration_draws_and_applies(path):
    policy = augment.policy_from_config(yaml.safe_load(path.read_text(encoding="utf-8")))
    batch = panoramas(6, 32, 128)
    assert policy.name == path.stem
    assert policy(batch, generator()).shape == batch.shape


def test_every_policy_has_a_configuration():
    assert set(augment.POLICIES) <= {path.stem for path in CONFIGS}


def test_a_policy_by_name_is_the_policy_from_its_configuration():
    batch = panoramas(8)
    named = augment.policy("thesis", rotate=0.9, circular=False)
    configured = augment.policy_from_config({"name": "thesis", "rotate": 0.9, "circular": False})
    assert torch.equal(named(batch, generator()), configured(batch, generator()))


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"name": "thesys"}, "unknown policy 'thesys': did you mean 'thesis'"),
        ({"name": "thesis", "rotat": 1}, "policy thesis has no parameter 'rotat': did you mean 'rotate'"),
        ({"name": "thesis", "rotate": 2}, r"a probability of policy thesis must be a number in \[0, 1\], got 2"),
        ({"name": "thesis", "circular": "no"}, "circular of a policy must be true or false, got 'no'"),
        ({}, "a policy needs a name, or its own tree"),
        ([1], "a policy is a mapping with a name"),
        ({"name": "mine", "all_of": [], "rotate": 1}, "all_of in policy mine has no key 'rotate'"),
    ],
)
def test_configurations_that_make_no_sense(config, message):
    with pytest.raises(augment.AugmentError, match=message):
        augment.policy_from_config(config)
