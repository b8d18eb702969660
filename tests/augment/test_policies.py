import json
from pathlib import Path

import pytest
import torch

import augment
from augment.combinations import combinations, variants
from tests.augment.pictures import described, generator, panoramas

PACKAGED = sorted(Path(augment.__file__).parent.glob("policies/*.yaml"))
CONFIGS = [*PACKAGED, *sorted((Path(__file__).parents[2] / "conf" / "augment").glob("*.yaml"))]

# (policy, rotate, circular): number of parameters, and the sum over them of position times mean
GOLDEN = {
    ("none", None, True): (1, 0.0),
    ("none", 0.3, True): (4, 119.14614074677229),
    ("thesis", None, True): (147, 298850.59229654726),
    ("thesis", None, False): (147, 290135.812463182),
    ("thesis", 0.0, True): (147, 298788.69006175455),
    ("thesis", 0.3, True): (147, 298819.8765778551),
    ("thesis", 1.0, True): (147, 300553.3913752581),
    ("lighting", None, True): (118, 114400.62840767554),
    ("lighting", 0.3, True): (121, 121945.30536770448),
    ("lighting", 1.0, True): (121, 123128.27685318142),
    ("strong", None, True): (147, 294060999.8093273),
    ("strong", 0.0, True): (147, 295271944.04326344),
    ("strong", 0.3, True): (147, 295271982.73435354),
    ("any_light", None, True): (152, 306264276.74249184),
    ("any_light", 1.0, True): (155, 310937907.6734415),
}


def unordered(label):
    """Two spots, or contrast raised and lowered, are one combination however they were drawn."""
    words = label.replace(" up", "").replace(" down", "").split(" + ")
    return tuple(sorted(words))


def test_the_policy_of_the_thesis_draws_exactly_its_combinations():
    policy = augment.policy("thesis")
    drawn = {unordered(label) for label in described(policy, policy.draw(generator(), panoramas(20000, 2, 8)))}
    assert drawn == {unordered(label) for label in combinations()}


@pytest.mark.parametrize(("name", "rotate", "circular"), GOLDEN)
def test_draws_stay_what_they_were(name, rotate, circular):
    """Data sets that were expanded, and runs that were trained, can be repeated."""
    batch = torch.empty(64, 3, 32, 128, dtype=torch.uint8)
    params = augment.policy(name, rotate=rotate, circular=circular).draw(generator(7), batch)
    total = sum((i + 1) * float(value.double().mean()) for i, value in enumerate(params.values()))
    assert (len(params), total) == (GOLDEN[name, rotate, circular][0], pytest.approx(GOLDEN[name, rotate, circular][1]))


def test_what_the_published_depths_hold():
    labels = [v.label for v in variants(246)]
    spots = [f"{shape} {tone}" for shape in ("bulb", "square", "trapezoid") for tone in ("light", "dark")]
    plain = ("brighten", "darken", "sharpen", "blur", "contrast up", "contrast down", "equalize", "saturate", "rotate")
    singles = {*spots, *plain}
    for depth in (1, 16, 44, 128, 129):
        assert [(v.number, v.label) for v in variants(depth)] == list(enumerate(labels[:depth]))
    assert labels[:104] == list(combinations())
    assert set(labels) >= {f"{change} + {spot}" for change in ("brighten", "darken") for spot in spots}
    assert set(labels) >= {f"{label} + rotate" for label in labels[1:104] if "rotate" not in label}
    assert {"bulb dark + square light", "square light + bulb dark"} & set(labels)
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
    assert {unordered(label) for label in described(variant.policy, params)} == {unordered(variant.label)}
    assert torch.equal(variant.policy.apply(batch, params), batch) == (variant.label == "original")


@pytest.mark.parametrize("depth", [0, -3, 2.5, True])
def test_depths_that_make_no_sense(depth):
    with pytest.raises(augment.AugmentError, match="depth must be a whole number from 1 to 10 million, got"):
        augment.variants(depth)


def test_lighting_does_not_turn_and_strong_always_does():
    batch = panoramas(50, 4, 64)
    assert not augment.policy("lighting").draw(generator(), batch)["heading"].any()
    assert bool((augment.policy("strong").draw(generator(), batch)["heading"] != 0).all())
    turned = augment.policy("lighting", rotate=1.0).draw(generator(), batch)["heading"]
    assert bool((turned != 0).all())


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def labels(policy):
    return set(described(policy, policy.draw(generator(), panoramas(50, 4, 64))))


def test_a_policy_of_ones_own_is_a_file(tmp_path):
    steps = "all_of:\n  - {effect: darken, amount: 50}\n  - {effect: blur}\n"
    path = write(tmp_path / "dusk.yaml", steps + "circular: false\n")
    policy = augment.policy(path)
    assert policy.name == "dusk"
    assert [effect.circular for effect in policy.effects] == [False, False]
    assert labels(policy) == {"darken + blur"}
    turned = augment.policy(str(path), rotate=1, circular=True)
    assert labels(turned) == {"darken + blur + rotate"}
    assert turned.circular
    named = augment.policy(write(tmp_path / "one.yml", "effect: blur\nname: mine\nrotate: 1"))
    assert (named.name, labels(named)) == ("mine", {"blur + rotate"})
    assert augment.policy(CONFIGS[0].with_name("thesis.yaml"), rotate=0.2).name == "thesis"


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_a_policy_can_be_stored_as_plain_values(path):
    policy, batch = augment.policy(path, rotate=0.3, circular=False), panoramas(8)
    stored = json.loads(json.dumps(policy.config))
    again = augment.policy_from_config(stored)
    assert (again.name, again.circular, again.config) == (path.stem, False, stored)
    assert torch.equal(policy(batch, generator()), again(batch, generator()))
    assert augment.policy(stored, circular=True).circular


def test_rotate_sets_the_probability_of_the_rotation_that_is_there():
    tree = {"all_of": [{"effect": "rotate", "degrees": 90, "probability": 0.5}, {"effect": "blur"}]}
    assert labels(augment.policy_from_config({**tree, "rotate": 0})) == {"blur"}
    assert labels(augment.policy_from_config({**tree, "rotate": 1})) == {"rotate + blur"}


def test_a_policy_may_be_a_step_of_another():
    step = {"policy": "lighting", "probability": 0.5}
    policy = augment.policy_from_config({"all_of": [step, {"effect": "blur"}]})
    assert [effect.name for effect in policy.effects[:-1]] == [e.name for e in augment.policy("lighting").effects]
    drawn = described(policy, policy.draw(generator(), panoramas(400, 4, 64)))
    assert 0.4 < drawn.count("blur") / 400 < 0.65
    assert augment.policy_from_config({"policy": "lighting", "name": "mine"}).name == "mine"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("all_of: [\n", r"my.yaml, line 2, is not YAML: expected the node content"),
        ("- effect: blur\n", r"my.yaml must contain a mapping with one of all_of, .*, got \[\{'effect': 'blur'\}\]"),
        ("", "my.yaml must contain a mapping with one of all_of, .*, got None"),
        ("name: my.yaml\n", "my.yaml describes no policy: it needs one of all_of, one_of, effect, policy"),
        ("all_of: blur\nrotate: 1\n", "my.yaml: all_of in policy my must be a list of steps, got 'blur'"),
        ("effect: noise\nvariance: 1e-3\n", "my.yaml: variance of noise must be a number or a pair .*, got '1e-3'"),
        ("policy: night\n", "my.yaml: unknown policy of a step 'night': "),
    ],
)
def test_files_that_make_no_sense(tmp_path, text, message):
    with pytest.raises(augment.AugmentError, match=message):
        augment.policy(write(tmp_path / "my.yaml", text))


def test_files_that_cannot_be_read(tmp_path):
    with pytest.raises(augment.AugmentError, match=r"gone.yaml cannot be read: No such file"):
        augment.policy(tmp_path / "gone.yaml")
    (tmp_path / "my.yaml").write_bytes(b"\xff\xfe\xfa")
    with pytest.raises(augment.AugmentError, match=r"my.yaml is not YAML"):
        augment.policy(tmp_path / "my.yaml")
    with pytest.raises(augment.AugmentError, match=r"unknown policy 'my.txt': valid: none, .*, or a .yaml file"):
        augment.policy("my.txt")


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"name": "thesys"}, "unknown policy 'thesys': did you mean 'thesis'"),
        ({"name": "thesis", "rotat": 1}, "policy thesis has no parameter 'rotat': did you mean 'rotate'"),
        ({"name": "thesis", "rotate": 2}, "a probability of policy thesis must be a number from 0 to 1, got 2"),
        ({"name": "thesis", "circular": "no"}, "circular of a policy must be true or false, or null, got 'no'"),
        ({}, "a policy needs a name, or its own tree"),
        ([1], "a policy is a mapping with a name"),
        ({"name": "mine", "all_of": [], "rotat": 1}, "all_of in policy mine has no key 'rotat'"),
        ({"all_of": [{"policy": "thesys"}]}, "unknown policy of a step 'thesys': did you mean 'thesis'"),
        ({"one_of": [{"policy": "thesis", "rotate": 1}]}, "all_of in policy own has no key 'rotate'"),
        ({"effect": "blur", 3: 4}, "blur has no parameter '3'"),
    ],
)
def test_configurations_that_make_no_sense(config, message):
    with pytest.raises(augment.AugmentError, match=message):
        augment.policy_from_config(config)
