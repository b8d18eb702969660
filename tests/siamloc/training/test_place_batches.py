"""What batches of places hold, and a training on them from the draw to the checkpoint."""

from __future__ import annotations

import re
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import augment
import siamloc
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.places import PlaceSampler, PlaceSettings
from siamloc.errors import ConfigError, SiamlocError
from siamloc.models import build
from siamloc.models.drive_figures import DriveFigures
from siamloc.models.origins import Origins
from siamloc.training import callbacks
from siamloc.training.batches import BatchAugmentation, Panoramas
from siamloc.training.checks import check_batches
from siamloc.training.place_batches import PlaceBatches, origins_of
from tests.siamloc.training.conftest import SIZE, network


def test_batches_hold_the_images_of_their_frames_and_where_those_come_from(images):
    frames = images.frames.take(slice(None, None, -1))
    sampler = PlaceSampler(frames, PlaceSettings(places=3, images=2), seed=2)
    item = PlaceBatches(Panoramas(images, frames), sampler)[1, 0]
    rows = sampler.batch(1, 0)
    assert np.array_equal(item["images"].numpy(), images.batch(images.rows(frames)[rows]))
    assert np.allclose(item["xy"].numpy(), frames.xy[rows] - frames.xy.mean(axis=0))
    assert item["frame"].tolist() == rows.tolist()
    same = item["room"][:, None] == item["room"][None]
    assert np.array_equal(same.numpy(), frames.room[rows][:, None] == frames.room[rows][None])


def test_augmentation_follows_from_the_numbers_of_the_batch_and_is_shared_by_processes(images):
    sampler = PlaceSampler(images.frames, PlaceSettings(places=4, images=2))
    change = BatchAugmentation(augment.effect("noise", variance=0.01), seed=3)
    panoramas, both = Panoramas(images, images.frames), PlaceSampler(images.frames, PlaceSettings(places=8, images=2))
    whole = PlaceBatches(panoramas, both, change)[2, 1]["images"]
    shares = [PlaceBatches(panoramas, sampler, change, rank, 2)[2, 1]["images"] for rank in (0, 1)]
    assert torch.equal(torch.cat(shares), whole)
    assert not torch.equal(PlaceBatches(panoramas, sampler, change, 0, 2)[1, 1]["images"], shares[0])


def test_a_training_learns_where_pictures_were_taken(train, images, drives, capfd):
    net = network()
    run = train(net, validation=drives[1], epochs=3, clip=1.0, average=0.9)
    curves = run.curves()
    assert {"train/loss", "train/spread", "val/error", "val/median", "val/room"} <= set(curves)
    assert np.isfinite(curves["val/error"]).all()
    said = capfd.readouterr().err
    assert "6 batches of 4 places x 2 images per epoch" in said
    best = int(curves["val/error"].argmin()) + 1
    assert f"best epoch {best} by val/error {curves['val/error'].min():.4f}" in said
    assert re.search(r"trained in (\d+ s|[1-9]\d*\.\d min), .*, \d+ images/s, \d+% of the time waiting for", said)
    others = {name: curves[name][best - 1] for name in ("val/median", "val/recall", "val/room")}
    assert f"({', '.join(f'{name[4:]} {value:.4f}' for name, value in others.items())})" in said
    assert f"checkpoint: {run.checkpoint()}; curves: tensorboard --logdir {run.tensorboard}" in said
    best = siamloc.models.load(run)
    known = siamloc.maps.build(best, images, drives[0], progress=False)
    result = siamloc.evaluation.localization(known, images, drives[1], names=("absolute",))
    # What chose the checkpoint is what the evaluation measures.
    assert result.measures["error"]["mean"] == pytest.approx(curves["val/error"].min(), abs=1e-5)
    again = best.state_dict()
    assert all(torch.equal(value, again[name]) for name, value in net.state_dict().items())


@pytest.mark.parametrize(
    ("name", "loss", "given"),
    [
        ("sigma", siamloc.models.SoftContrastiveLoss, {"sigma_start": 3.0}),
        ("far", siamloc.models.TripletLoss, {"far_start": 3.0, "miner": "batch_hard", "distance": "cosine"}),
    ],
)
def test_a_width_that_changes_was_laid_out_for_its_epochs(train, name, loss, given):
    options = {"loss": loss(**given), "pairs": {"epoch_batches": 1}}
    assert given.items() <= train(**options).settings["loss"].items()
    with pytest.raises(ConfigError, match=rf"the {name} of .* was laid out for 1 epochs: resume with epochs=1"):
        train(epochs=2, resume=True, **options)


def test_a_loss_of_ones_own_gets_descriptors_and_origins(train):
    seen = []

    def loss(descriptors, origins):
        seen.append(type(origins))
        return (torch.cdist(descriptors, descriptors) - origins.distances().clamp(max=2) / 2).square().mean()

    train(loss=loss)
    assert set(seen) == {Origins}


TWO = {"workers": 1, "trainer": {"accelerator": "cpu", "devices": 2, "strategy": "ddp"}}
ORDER = {"by": "sequence", "radius": 1}
ROOMS = siamloc.models.SoftContrastiveLoss(room=0.5)


def stripped(table, *columns):
    """The frames with some of their columns only."""
    return FrameTable(path=table.path, sequence=table.sequence, **{name: getattr(table, name) for name in columns})


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"pairs": {"places": 40, "images": 1}}, "a batch of 40 places, .*, cannot be drawn from 16 frames"),
        ({"known": ()}, r"have no position, which places need .*experiment=photographs"),
        ({"pairs": {"places": 10}, **TWO}, r"a batch of 20 places, 10 for each process, .* set pairs.places lower"),
        ({"pairs": ORDER, "asked": ()}, "the checkpoint is chosen by the error of localization or by the rooms found"),
        # The map has rooms and the queries positions: nothing can be judged.
        ({"pairs": ORDER, "known": ("room",), "asked": ("x", "y")}, "do not both have positions in one building, or b"),
        ({"pairs": ORDER, "monitor": "recall", "asked": ("room",)}, "monitor=recall needs training and validation fr"),
        ({"pairs": ORDER, "monitor": "room", "asked": ("x", "y")}, "monitor=room needs validation frames with rooms, "),
        ({"monitor": "loss"}, "monitor=loss is the loss of pairs, and batches of places have no loss of"),
        ({"loss": lambda d0, d1, y: d0.sum()}, "a loss of batches of places takes"),
        ({"batch_size": 8}, "batch_size is of pairs, and batches of places have"),
        ({"margin": 1.0}, "margin is of pairs, and batches of places have"),
        ({"net": build("simple1", "fc500_500_5", SIZE)}, r"needs descriptors of length 1.*flat, gem, bands, fourier"),
    ],
)
def test_mistakes_are_found_before_anything_is_written(train, drives, tmp_path, given, says):
    given = dict(given)
    if "known" in given:
        given["frames"] = stripped(drives[0], *given.pop("known"))
    if "asked" in given:
        given["validation"] = stripped(drives[1], *given.pop("asked"))
    with pytest.raises(SiamlocError, match=says):
        train(**given)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("loss", "drawn", "says"),
    [
        (siamloc.models.SoftContrastiveLoss(sigma=0.01), 1, r"near enough for loss\.sigma=0\.01; the nearest"),
        (siamloc.models.SoftContrastiveLoss(room=1), 2, r"two frames of one room, for loss\.room=1;"),
        (siamloc.models.TripletLoss(near=0.1), 2, r"up to loss\.near=0\.1 apart; the nearest are 0\.25 apart"),
        (siamloc.models.CircleLoss(far=50.0), 2, r"two frames more than loss\.far=50 apart;"),
        (siamloc.models.MetricCalibratedLoss(cap=0.1), 1, r"two frames less than loss\.cap=0\.1 apart"),
    ],
)
def test_batches_that_teach_the_loss_nothing_are_refused(train, drives, tmp_path, loss, drawn, says):
    monday = drives[0].with_columns(room=[str(number) for number in range(len(drives[0]))])
    with pytest.raises(ConfigError, match=f"8 of 8 drawn have no .*{says}"):
        train(frames=monday, loss=loss, pairs={"images": drawn, "epoch_batches": 2})
    assert not (tmp_path / "run").exists()


def test_views_of_one_image_are_enough_where_they_are_asked_for(images, drives):
    data = siamloc.training.PlaceDataModule(images, drives[0], places=PlaceSettings(places=4, images=2, radius=0))
    check_batches(data, siamloc.models.TripletLoss(near=0.1))
    alone = siamloc.training.PlaceDataModule(images, drives[0], places=PlaceSettings(places=2, images=1))
    check_batches(alone, siamloc.models.SoftContrastiveLoss(sigma=0.4))
    check_batches(alone, lambda descriptors, origins: descriptors.sum())  # what it learns from is unknown


def test_what_frames_lack_is_said(train, frames, drives, capfd):
    nameless = drives[0].with_columns(room=["", "", *drives[0].room[2:].tolist()])
    apart = drives[0].with_columns(x=[0.25 * number + 5 * (number > 13) * (number - 13) for number in range(16)])
    order = {**ORDER, "epoch_batches": 1}
    notes = {
        "2 of 16 training frames have no room label: the loss learns rooms": {"frames": nameless, "loss": ROOMS},
        "2 of 16 frames have no other one within pairs.radius=0.3 m: ": {"frames": apart},
        "2 drives are used by the order of their frames alone": {"frames": frames, "pairs": order},
    }
    for number, (says, given) in enumerate(notes.items()):
        train(run=str(number), **given)
        assert f"note: {says}" in capfd.readouterr().err


def test_a_network_that_wraps_around_is_not_trained_on_what_does_not(train, images, drives, tmp_path):
    flat = PanoramaLibrary(images.frames, tmp_path / "cache", image_size=SIZE, circular=False)
    recipe = siamloc.training.recipe("modern")
    says = r"the network wraps around .* \(data\.circular=false\): set model\.circular"
    with pytest.raises(ConfigError, match=says):
        train(images=flat)
    with pytest.raises(ConfigError, match=says):
        recipe.fit(recipe.build(SIZE), flat, drives[0], run=tmp_path / "run")
    with pytest.raises(ConfigError, match="this recipe is for images whose columns do not wrap around"):
        siamloc.training.recipe("rooms").fit(network(), images, drives[0], run=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_rooms_and_the_order_of_the_frames_are_enough(train, images, drives):
    """The same drives as photographs at unknown positions."""
    monday, tuesday = (stripped(drive, "lighting", "room") for drive in drives)
    loss = siamloc.models.SoftContrastiveLoss(sigma=1, room=0.5)
    run = train(frames=monday, validation=tuesday, loss=loss, epochs=3, pairs={**ORDER, "reach": 3})
    curves = run.curves()
    assert "val/error" not in curves
    known = siamloc.maps.build(siamloc.models.load(run), images, monday, progress=False)
    rooms = siamloc.evaluation.rooms(known, images, tuesday)
    # The checkpoint is the one that finds the most rooms.
    assert rooms.measures["accuracy"] == pytest.approx(curves["val/room"].max(), abs=1e-6)


def test_the_user_says_by_what_the_checkpoint_is_chosen(train, drives):
    """Where there are positions, too, rooms may be what counts; and a wider radius finds more."""
    run = train(validation=drives[1], monitor="room", epochs=3)
    curves = run.curves()
    assert torch.load(run.checkpoint("best"), weights_only=True)["epoch"] == int(curves["val/room"].argmax())
    assert run.settings["training"]["monitor"] == "room"
    assert siamloc.training.compare([run]).by == "val/room"
    wide = train(validation=drives[1], run="wide", monitor="recall", recall_radius=100.0)
    assert wide.curves()["val/recall"].tolist() == [1.0]


def test_the_pace_counts_images_and_the_time_without_work(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(callbacks.time, "monotonic", lambda: clock[0])
    pace, module = callbacks.Pace(), SimpleNamespace(device=torch.device("cpu"))
    assert np.isnan(pace.images_per_second)
    trainer, batch = SimpleNamespace(world_size=2), {"images": torch.zeros(8, 3, 2, 2), "xy": torch.zeros(8, 2)}
    for _ in range(2):
        pace.on_train_epoch_start(trainer, module)
        clock[0] += 100  # a validation
        for number in range(5):
            clock[0] += 1 if number >= 2 else 50  # the first batches take long
            pace.on_train_batch_start(trainer, module, batch, number)
            clock[0] += 3
            pace.on_train_batch_end(trainer, module, None, batch, number)
    assert pace.waiting == 0.25
    assert pace.images_per_second == 2 * 8 / 4


def test_pairs_are_judged_by_a_margin_that_the_map_teaches(train, images, drives):
    """The margin of a triplet is not a margin of pairs."""
    run = train(loss=siamloc.models.TripletLoss(near=0.6, far=1.0))
    assert 0 < run.curves()["train/active"][0] <= 1
    known = siamloc.maps.build(siamloc.models.load(run), images, drives[0], progress=False)
    result = siamloc.evaluation.localization(known, images, drives[1])
    pairs = result.parts["room_pairs"]
    assert "room_pairs" not in result.skipped
    assert result.about["pairs"]["margin"].startswith(f"{pairs['margin']:.4g}, learned from 7000 pairs")


def test_a_network_that_tells_nothing_apart_is_said(train, capfd):
    def loss(descriptors, origins):
        return torch.cdist(descriptors, descriptors).mean()

    train(loss=loss, epochs=8, optimizer={"name": "adamw", "learning_rate": 0.03})
    said = capfd.readouterr().err
    assert "warning: the network gives nearly every image the same descriptor, train/spread is" in said


def test_a_misspelt_key_is_compared_with_the_group_that_was_meant():
    for key, meant in (("placs", "places"), ("labl", "label")):
        with pytest.raises(ConfigError, match=f"unknown key pairs.{key}: did you mean '{meant}'"):
            siamloc.training.Training(pairs={key: 4})


def test_positions_far_from_the_origin_keep_their_distances():
    x = 5_372_000.0 + np.array([0.0, 0.2, 0.4])
    xy = origins_of(FrameTable(path=["a", "b", "c"], x=x, y=x))["xy"]
    assert torch.allclose(torch.cdist(xy, xy)[0, 1:], 2**0.5 * torch.tensor([0.2, 0.4]), atol=1e-3)


def test_surveyed_poses_say_how_uncertain_they_are(images):
    frames = images.frames.with_columns(deviation=0.05 + 0.01 * np.arange(len(images.frames)))
    sampler = PlaceSampler(frames, PlaceSettings(places=3, images=2), seed=2)
    item = PlaceBatches(Panoramas(images, frames), sampler)[0, 0]
    rows = sampler.batch(0, 0)
    assert np.allclose(item["deviation"].numpy(), np.column_stack([frames.deviation[rows], np.zeros(6)]))
    assert "deviation" not in origins_of(frames, by="sequence")
    assert "deviation" not in origins_of(images.frames)


def test_queries_found_in_another_building_are_far_off():
    figures, xy = DriveFigures(), torch.tensor([[0.0, 0], [1, 0], [0, 0], [1, 0]])
    known, building = torch.tensor([True, True, False, False]), torch.tensor([0, 1, 0, 0])
    figures.add({"xy": xy, "building": building, "room": torch.full((4,), -1), "known": known}, descriptors=xy)
    found = figures.compute()
    # One is right, the other in another building.
    assert {name: float(value) for name, value in found.items()} == {"error": 50, "median": 50, "recall": 0.5}
