"""A training that learns to name rooms, from the draw to the class layer of the best checkpoint."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import siamloc
from siamloc.data.frames import FrameTable, concatenate
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.models import CrossEntropyLoss, as_descriptor, build
from siamloc.training.place_batches import origins_of, rooms_of, validation_drive
from tests.siamloc.training.conftest import SIZE

BATCHES = {"by": "sequence", "places": 8, "images": 1, "radius": 0.0, "epoch_batches": 6}
SETTINGS = {"pairs": BATCHES, "optimizer": {"name": "adamw"}}


def network(head="fc500_500_5", **more):
    return build("simple1", head, SIZE, normalize="image", **more)


def trained(images, frames, folder, net=None, **options):
    given = {"loss": CrossEntropyLoss(), "epochs": 2, **SETTINGS, **options}
    return siamloc.training.fit(network() if net is None else net, images, frames, run=folder, **given)


def relabelled(frames, room, keep=0):
    """Return frames in another room, but for the first ones."""
    names = [*frames.room[:keep].tolist(), *[room] * (len(frames) - keep)]
    return FrameTable(**{**frames.columns(), "room": names})


@pytest.fixture(scope="module")
def run(images, drives, tmp_path_factory):
    monday, tuesday = drives
    folder = tmp_path_factory.mktemp("trained") / "run"
    return trained(images, monday, folder, validation=tuesday, epochs=5, average=0.9)


def test_a_training_learns_to_name_rooms_and_keeps_the_best_class_layer(run, images, drives):
    curves, tuesday = run.curves(), drives[1]
    assert {"train/loss", "train/accuracy", "val/accuracy", "val/room", "val/error"} <= set(curves)
    assert run.settings["training"]["monitor"] == "accuracy"
    assert curves["train/accuracy"][-1] > 0.9
    best = siamloc.models.load(run)
    named = as_descriptor(best).classify(images.batch(images.rows(tuesday)))
    assert named.names.tolist() == best.rooms.names.tolist() == ["a", "b"]
    assert (named.room == tuesday.room).mean() == pytest.approx(curves["val/accuracy"].max())
    np.testing.assert_allclose(named.probabilities.sum(axis=1), 1)
    last = siamloc.models.load(run, which="last")
    assert last.rooms.names.tolist() == ["a", "b"]
    assert siamloc.models.load(run, which="untrained").rooms is None


def test_the_descriptor_is_what_comes_before_the_class_layer(run, images, drives):
    best = siamloc.models.load(run)
    assert not [name for name in best.state_dict() if "layer.weight" in name or "rooms" in name]
    known = siamloc.maps.build(best, images, drives[0], progress=False)
    assert known.width == 5
    scores = best.rooms.scores(known.descriptors)
    assert (best.rooms.names[scores.argmax(axis=1)] == drives[0].room).mean() > 0.9
    again = build("simple1", "fc500_500_5", SIZE, normalize="image", weights=run)
    assert again.identity == best.identity


def test_the_class_layer_holds_the_temperature(images, drives, tmp_path):
    loss = CrossEntropyLoss(temperature=0.1)
    net = network("flat", outputs=8)
    run = trained(images, drives[0], tmp_path / "run", net, loss=loss, epochs=1)
    weight = siamloc.models.load(run).rooms.weight
    np.testing.assert_allclose(weight, loss.layer.weight.detach().numpy() / 0.1, rtol=1e-5)
    assert net.rooms.names.tolist() == ["a", "b"]  # the network that was handed in has it as well


def test_a_resumed_training_is_the_one_that_never_stopped(images, drives, tmp_path):
    monday, tuesday = drives
    options = {"validation": tuesday, "average": 0.9}
    whole = trained(images, monday, tmp_path / "whole", epochs=3, **options)
    trained(images, monday, tmp_path / "cut", epochs=1, **options)
    cut = trained(images, monday, tmp_path / "cut", epochs=3, resume=True, **options)
    assert whole.metrics.read_text() == cut.metrics.read_text()
    one, other = (siamloc.models.load(run, which="last") for run in (whole, cut))
    assert all(torch.equal(value, other.state_dict()[name]) for name, value in one.state_dict().items())
    np.testing.assert_array_equal(one.rooms.weight, other.rooms.weight)
    with pytest.raises(ConfigError, match=r"loss\.temperature=1\.0 and cannot be resumed with loss\.temperature=0\.5"):
        trained(images, monday, cut, epochs=4, resume=True, loss=CrossEntropyLoss(temperature=0.5), **options)


def test_another_loss_afterwards_names_no_rooms(run, images, drives, tmp_path):
    net = siamloc.models.load(run)
    assert net.rooms is not None
    siamloc.training.fit(net, images, drives[0], run=tmp_path / "run", epochs=1, pairs={"epoch_pairs": 16})
    assert net.rooms is None


def test_a_module_of_ones_own_names_rooms(images, drives, tmp_path):
    own = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(3 * SIZE[0] * SIZE[1], 3))
    trained(images, drives[0], tmp_path / "run", own, epochs=1)
    assert as_descriptor(own).classify(images.batch([0])).probabilities.shape == (1, 2)


def test_a_damaged_class_layer_is_refused(run, tmp_path):
    content = torch.load(run.checkpoint(), weights_only=True)
    for damage in ({"rooms": ["a"]}, {"rooms": 3}, {"loss": {"name": "cross_entropy"}}):
        torch.save(content | {"siamloc": content["siamloc"] | damage}, tmp_path / "model.ckpt")
        with pytest.raises(FormatError, match="names rooms without a whole class layer: train again"):
            siamloc.models.load(tmp_path / "model.ckpt")


def test_rooms_of_the_validation_have_the_numbers_of_the_training(images, drives):
    monday, tuesday = drives
    first, middle, last = (tuesday.take(slice(*ends)) for ends in ((0, 4), (4, 12), (12, 16)))
    asked = concatenate([relabelled(first, "attic"), middle, relabelled(last, "")])
    batch = validation_drive(images, monday, asked)[0, 0]
    room, known = batch["room"], batch["known"]
    assert torch.equal(room[known], origins_of(monday)["room"])
    assert rooms_of(monday) == ["a", "b"]
    assert room[~known].tolist() == [2] * 4 + [0] * 4 + [1] * 4 + [-1] * 4


def test_frames_without_a_room_and_rooms_that_are_not_trained_are_noted(images, drives, tmp_path, capfd):
    monday, tuesday = drives
    run = trained(images, relabelled(monday, "", 12), tmp_path / "run", validation=relabelled(tuesday, "attic", 8))
    said = capfd.readouterr().err
    assert "note: 4 of 16 training frames have no room label" in said
    assert "note: 8 of 16 validation frames are in rooms that the training frames lack (attic): they count as" in said
    assert run.curves()["val/accuracy"].max() <= 0.5


@pytest.mark.parametrize(
    ("train", "validation", "says"),
    [
        ("", None, "learns from rooms, and the training frames have 0: give the labels of 2 rooms or more"),
        ("a", None, "the training frames have 1: give"),
        (None, "attic", r"are in other rooms \(attic\) than the training frames \(a, b\)"),
    ],
)
def test_rooms_that_cannot_be_learned_are_refused_before_anything_is_written(
    images, drives, tmp_path, train, validation, says
):
    monday, tuesday = drives
    frames = monday if train is None else relabelled(monday, train)
    asked = None if validation is None else relabelled(tuesday, validation)
    with pytest.raises(DataError, match=says):
        trained(images, frames, tmp_path / "run", validation=asked)
    assert not (tmp_path / "run").exists()


def test_the_accuracy_needs_rooms_and_this_loss(images, drives, tmp_path):
    monday, tuesday = drives
    for options in (
        {"validation": relabelled(tuesday, "")},
        {"validation": tuesday, "loss": siamloc.models.TripletLoss(near=0.5)},
    ):
        with pytest.raises(ConfigError, match="monitor=accuracy needs loss=cross_entropy, and"):
            trained(images, monday, tmp_path / "run", monitor="accuracy", **options)
    run = trained(images, monday, tmp_path / "run", validation=relabelled(tuesday, ""), epochs=1)
    assert run.settings["training"]["monitor"] == "error"
