import math

import pytest
import torch

import augment
from augment import Policy
from tests.augment.pictures import described, generator, panoramas


def shares(policy, count=4000):
    labels = described(policy, policy.draw(generator(), panoramas(count, 2, 8)))
    return {label: labels.count(label) / count for label in set(labels)}


def test_all_of_is_one_effect_after_the_other():
    batch = panoramas(4)
    policy = Policy({"all_of": [{"effect": "darken", "amount": 40}, {"effect": "contrast", "factor": 1.5}]})
    wanted = augment.effect("contrast", factor=1.5)(
        augment.effect("darken", amount=40)(batch, generator()), generator()
    )
    assert torch.equal(policy(batch, generator()), wanted)


def test_one_of_takes_one_by_weight():
    policy = Policy({"one_of": [{"effect": "darken", "weight": 3}, {"effect": "blur"}, {"all_of": [], "weight": 0}]})
    found = shares(policy)
    assert set(found) == {"darken", "blur"}
    assert found["darken"] == pytest.approx(0.75, abs=0.03)


def test_probabilities_of_steps_and_of_groups_multiply():
    inner = {"all_of": [{"effect": "darken", "probability": 0.5}, {"effect": "blur"}], "probability": 0.4}
    found = shares(Policy({"all_of": [inner, {"effect": "gamma", "probability": 0.25}]}))
    assert found["darken + blur"] == pytest.approx(0.4 * 0.5 * 0.75, abs=0.02)
    assert found["blur + gamma"] == pytest.approx(0.4 * 0.5 * 0.25, abs=0.02)
    assert found["original"] == pytest.approx(0.6 * 0.75, abs=0.03)
    assert "darken" not in found


def test_frames_that_did_not_get_an_effect_stay_as_they_are():
    batch = panoramas(40, 8, 16)
    policy = Policy({"effect": "darken", "probability": 0.5})
    for pictures in (batch, batch.float() / 255):
        params = policy.draw(generator(), pictures)
        out, on = policy.apply(pictures, params), params["0.darken.on"]
        assert 5 < int(on.sum()) < 35
        assert torch.equal(out[~on], pictures[~on])
        assert not torch.equal(out[on], pictures[on])


def test_headings_add_up_over_the_rotations_a_frame_got():
    policy = Policy({"all_of": [{"effect": "rotate", "probability": 0.5}, {"effect": "rotate", "probability": 0.5}]})
    batch = panoramas(60, 2, 64)
    params = policy.draw(generator(), batch)
    shift = torch.zeros(60, dtype=torch.int64)
    for slot in range(2):
        shift += params[f"{slot}.rotate.shift"] * params[f"{slot}.rotate.on"]
    out = policy.apply(batch, params)
    for frame in range(60):
        columns = int(shift[frame])
        assert torch.equal(out[frame], batch[frame].roll(columns, 2))
        heading = float(params["heading"][frame])
        assert -math.pi < heading <= math.pi + 1e-6
        assert math.cos(heading - columns * 2 * math.pi / 64) == pytest.approx(1, abs=1e-6)


def test_effects_inherit_circular_from_the_policy():
    policy = Policy({"all_of": [{"effect": "bulb"}, {"effect": "blur", "circular": True}]}, circular=False)
    assert [effect.circular for effect in policy.effects] == [False, True]


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        ({"effect": "blurr"}, "unknown effect 'blurr': did you mean 'blur'"),
        ({"effect": "blur", "sise": 3}, "blur has no parameter 'sise': did you mean 'size'"),
        ({"effect": "blur", "probability": 1.5}, "a probability of policy test must be a number from 0 to 1, got 1.5"),
        ({"effect": "blur", "probability": float("nan")}, "must be a number from 0 to 1, got nan"),
        ({"effect": "blur", "weight": -1}, "a weight of policy test must be a number from 0, got -1"),
        ({"effect": "bulb", "radius": [40, 15]}, "radius of bulb must lie in"),
        ({"all_of": [], "one_of": []}, "exactly one of effect, all_of, one_of, got {'all_of': "),
        ({}, "exactly one of effect, all_of, one_of, got {}"),
        ({"all_of": [], "probabilty": 0.5}, "has no key 'probabilty': did you mean 'probability'"),
        ({"all_of": "blur"}, "all_of in policy test must be a list of steps, got 'blur'"),
        ({"all_of": ["blur"]}, "a step of policy test has exactly one of effect, all_of, one_of, got 'blur'"),
        ({"one_of": []}, "one_of in policy test needs at least one step with a weight above 0"),
    ],
)
def test_trees_that_make_no_sense(tree, message):
    with pytest.raises(augment.AugmentError, match=message):
        Policy(tree, name="test")
