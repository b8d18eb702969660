"""Naming rooms: the loss against loops, its class layer without torch, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from siamloc.errors import ConfigError, DataError
from siamloc.models import CrossEntropyLoss, Origins, RoomClassifier, as_descriptor, build
from siamloc.models.batch_losses import make_loss

ROOMS = ["hall", "kitchen", "office"]


def origins(room):
    count = len(room)
    return Origins(torch.full((count, 2), math.nan), torch.zeros(count), torch.tensor(room), torch.arange(count))


def opened(width=4, seed=0, **settings):
    loss = CrossEntropyLoss(**settings)
    loss.open(ROOMS, width, seed)
    return loss


def shares(loss, descriptor):
    """The softmax of one descriptor, number by number."""
    weight, bias = loss.layer.weight.tolist(), loss.layer.bias.tolist()
    pairs = zip(weight, bias, strict=True)
    scores = [sum(w * x for w, x in zip(row, descriptor, strict=True)) + b for row, b in pairs]
    powers = [math.exp(score / loss.temperature) for score in scores]
    return [power / sum(powers) for power in powers]


def test_the_layer_follows_from_the_seed_also_from_one_of_numpy():
    assert torch.equal(opened(seed=np.int64(3)).layer.weight, opened(seed=3).layer.weight)
    assert not torch.equal(opened(seed=3).layer.weight, opened().layer.weight)


@pytest.mark.parametrize("temperature", [1.0, 0.2])
def test_the_loss_is_that_of_a_loop_over_images_with_a_room(temperature):
    loss, descriptors, room = opened(temperature=temperature), torch.randn(6, 4), [0, 2, -1, 1, 2, -1]
    torch.nn.init.normal_(loss.layer.bias)
    told = zip(descriptors.tolist(), room, strict=True)
    costs = [-math.log(shares(loss, one)[number]) for one, number in told if number >= 0]
    assert loss(descriptors, origins(room)).item() == pytest.approx(sum(costs) / len(costs), rel=1e-5)
    unknown = loss(descriptors, origins([-1] * 6))
    unknown.backward()
    assert unknown.item() == 0
    assert not loss.layer.weight.grad.any()


def test_the_accuracy_counts_rooms_without_a_class_as_wrong_and_unknown_ones_not_at_all():
    loss, descriptors = opened(), torch.randn(5, 4)
    named = [int(np.argmax(shares(loss, one))) for one in descriptors.tolist()]
    asked = torch.tensor([*named[:2], (named[2] + 1) % 3, 3, -1])
    assert loss.accuracy(descriptors, asked).item() == pytest.approx(2 / 4)
    assert loss.accuracy(descriptors, torch.full((5,), -1)).isnan()


def test_weights_are_drawn_from_the_seed_alone():
    state = torch.get_rng_state()
    assert torch.equal(opened(seed=3).layer.weight, opened(seed=3).layer.weight)
    assert not torch.equal(opened(seed=3).layer.weight, opened(seed=4).layer.weight)
    assert torch.equal(state, torch.get_rng_state())


def test_the_class_layer_names_the_same_rooms_without_torch():
    loss, descriptors = opened(), torch.randn(7, 4)
    rooms = RoomClassifier(ROOMS, loss.layer.weight.detach().numpy(), loss.layer.bias.detach().numpy())
    named = rooms.named(descriptors.numpy())
    expected = loss.scores(descriptors).softmax(dim=1)
    np.testing.assert_allclose(named.probabilities, expected.detach().numpy(), rtol=1e-5)
    assert named.room.tolist() == [ROOMS[number] for number in expected.argmax(dim=1).tolist()]
    assert len(rooms) == 3
    some = rooms.of(["office", "hall"])
    assert some.names.tolist() == ["office", "hall"]
    np.testing.assert_array_equal(some.scores(descriptors), rooms.scores(descriptors)[:, [2, 0]])
    np.testing.assert_allclose(rooms.named(1e4 * descriptors.numpy()).probabilities.sum(axis=1), 1)


def test_mistakes_are_one_sentence():
    with pytest.raises(ConfigError, match="has no rooms to name yet"):
        CrossEntropyLoss()(torch.rand(2, 4), origins([0, 1]))
    with pytest.raises(DataError, match="needs two of them at least, got 1"):
        CrossEntropyLoss().open(["hall"], 4)
    with pytest.raises(ConfigError, match=r"loss\.temperature must be a number above 0"):
        make_loss("cross_entropy", temperature=0)
    with pytest.raises(DataError, match=r"got \(3, 2\) and \(2, 2\)"):
        opened()(torch.rand(3, 2), origins([0, 1]))
    rooms = RoomClassifier(ROOMS, np.eye(3), np.zeros(3))
    with pytest.raises(DataError, match=r"descriptors of 3 numbers \(n, 3\), got \(2, 4\)"):
        rooms.named(np.zeros((2, 4)))
    with pytest.raises(DataError, match="no room cellar: it was trained on hall, kitchen, office"):
        rooms.of(["cellar", "hall"])
    with pytest.raises(DataError, match="a name, a row of weights and a bias for each room"):
        RoomClassifier(ROOMS, np.eye(2), np.zeros(2))
    with pytest.raises(DataError, match="names a room twice"):
        RoomClassifier(["hall", "hall"], np.eye(2), np.zeros(2))


def test_a_network_that_was_not_trained_to_name_rooms_says_so():
    network = build("simple1", "fc500_500_5", (32, 64))
    assert as_descriptor(network).rooms is None
    with pytest.raises(ConfigError, match="does not name rooms: train one with loss=cross_entropy"):
        as_descriptor(network).classify(np.zeros((1, 3, 32, 64), np.uint8))
