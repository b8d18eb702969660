"""`fit`: what it writes into a run, what it refuses, how it resumes, and custom networks and losses."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import textwrap
import time
from functools import partial

import cv2
import numpy as np
import pytest
import torch
from torch import nn

import augment
from foundation import files
from foundation.files import read_json, write_json
from siamloc.data import FrameTable, PanoramaLibrary, Protocol, read
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.models import SoftContrastiveLoss, as_descriptor, build, load
from siamloc.progress import hidden
from siamloc.runs import Run
from siamloc.training import PairSettings, Training, fit
from siamloc.training.checks import monitored
from siamloc.training.run_folder import check_folder
from tests.drawn import write_manifest
from tests.siamloc.training.conftest import Small

SIZE = (32, 128)


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    """The manifest of a drawn flat."""
    return write_manifest(tmp_path_factory.mktemp("flat"), {"cloudy1": "cloudy", "night1": "night"}, frames_per_room=4)


@pytest.fixture(scope="module")
def frames(flat):
    return read("manifest", manifest=flat)


@pytest.fixture(scope="module")
def images(flat, frames):
    return PanoramaLibrary(frames, flat.parent / "cache", image_size=SIZE)


@pytest.fixture
def day(frames):
    return frames.select(sequence="cloudy1")


@pytest.fixture
def train(images, day, tmp_path):
    """A call of `fit` that a test completes."""

    def call(name="run", network=None, images=images, frames=day, **keywords):
        network = build("simple1", "fc500_500_5", SIZE) if network is None else network
        options = {"epochs": 1, "batch_size": 8, "trainer": {"accelerator": "cpu"}, **keywords}
        return fit(network, images, frames, run=tmp_path / name, **options)

    return call


def curve(run):
    with run.metrics.open(newline="") as file:
        return list(csv.DictReader(file))


def listing(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())


def test_a_run_holds_its_settings_and_what_was_written(train, frames, day, flat, capsys):
    network = build("simple1", "fc500_500_5", SIZE)
    night = frames.select(sequence="night1")
    run = train(network=network, validation=night, epochs=2, pairs=PairSettings(label="room"))
    record = read_json(run.record)
    assert (record["format"], record["version"]) == ("siamloc-run", 2)
    assert {*record["written"], "run.json"} == set(listing(run.folder))
    settings = run.settings
    options = {"epochs": 2, "batch_size": 8, "pairs": PairSettings(label="room")}
    assert Training.of(settings["training"]) == Training(monitor="error", **options)  # what "auto" came to
    assert settings["data"]["manifest"] == str(flat)
    assert settings["data"]["image_size"] == list(SIZE)
    roles = {"train": {"sequences": ["cloudy1"]}, "validation": {"sequences": ["night1"]}}
    assert settings["protocol"] == Protocol.of(roles).plain()
    assert settings["model"] == network.settings
    assert settings["loss"] == {"class": "ContrastiveLoss", "margin": 2.0}
    assert settings["augment"] == {"name": "none"}
    assert settings["frames"]["train"]["count"] == len(day)
    assert as_descriptor(load(run)).identity == as_descriptor(network).identity
    assert (as_descriptor(network).margin, network.training) == (2.0, False)
    said = capsys.readouterr()
    assert said.out == ""
    assert f"training simple1 + fc500_500_5 on {len(day)} frames, 12 room pairs per epoch, epochs: 2" in said.err
    assert "epoch 2 of 2: train/loss" in said.err
    assert "GPU" not in said.err


def test_the_best_weights_are_kept_not_the_last(train, frames):
    """Best by where another drive is located; as published by the loss, and then nothing is located."""
    night = frames.select(sequence="night1")
    for monitor, figure in (("auto", "val/error"), ("loss", "val/loss")):
        network = build("simple1", "fc500_500_5", SIZE)
        options = {"optimizer": {"name": "adam"}, "epochs": 3, "monitor": monitor}
        run = train(monitor, network=network, validation=night, **options)
        best = int(np.argmin(run.curves()[figure]))
        assert torch.load(run.checkpoint("best"), weights_only=True)["epoch"] == best
        assert as_descriptor(load(run)).identity == as_descriptor(network).identity
        assert ("val/recall" in run.curves()) == (monitor == "auto")


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({}, "error"),
        ({"sequence": ["cloudy1"] * 12}, "loss"),  # frames between those of the training
        ({"building": ["annex"] * 12}, "loss"),
        ({"x": [np.nan] * 12}, "loss"),
    ],
)
def test_pairs_are_judged_by_another_drive_only(frames, day, changed, expected):
    validation = frames.select(sequence="night1").with_columns(**changed)
    assert monitored(Training(), day, validation, nn.Identity()) == expected


def test_a_run_goes_on_with_what_its_checkpoint_was_chosen_by(train, frames):
    night = frames.select(sequence="night1")
    run = train(validation=night, epochs=1, monitor="loss")
    assert train(validation=night, epochs=2, resume=True).settings["training"]["monitor"] == "loss"
    assert "val/error" not in run.curves()
    with pytest.raises(ConfigError, match="trained with monitor=loss and cannot be resumed with monitor=error"):
        train(validation=night, epochs=3, resume=True, monitor="error")


def test_one_seed_gives_one_curve_and_the_random_state_stays_as_it_was(train):
    torch.manual_seed(5)
    before = torch.random.get_rng_state()
    a, b, c = (curve(train(name, seed=seed, epochs=2)) for name, seed in (("a", 0), ("b", 0), ("c", 1)))
    assert a == b != c
    assert torch.equal(torch.random.get_rng_state(), before)


def test_a_run_that_is_resumed_says_whether_anything_is_left_to_train(train, capsys):
    train(epochs=1)
    says = "was trained for all its epochs already (1): nothing is left to train"
    for epochs, finished in ((1, True), (2, False)):
        capsys.readouterr()
        run = train(epochs=epochs, resume=True)
        shown = capsys.readouterr().err
        assert (says in shown, "training simple1" in shown) == (finished, not finished)
        assert len(curve(run)) == epochs


@pytest.fixture(scope="module")
def trained(images, frames, tmp_path_factory):
    """A run of one epoch that tests only try to resume."""
    network = build("simple1", "fc500_500_5", SIZE)
    day, folder = frames.select(sequence="cloudy1"), tmp_path_factory.mktemp("trained") / "run"
    return fit(network, images, day, run=folder, epochs=1, batch_size=8, trainer={"accelerator": "cpu"})


@pytest.mark.parametrize(
    ("other", "key"),
    [
        ({"seed": 7}, "seed=0"),
        ({"batch_size": 4}, "batch_size=8"),
        ({"optimizer": {"learning_rate": 5.0}}, "optimizer.learning_rate=0.001"),
        ({"pairs": {"same_room_share": 0.3}}, "pairs.same_room_share=None"),
        ({"margin": 1.0}, "loss.margin=2.0"),
        ({"augmentation": "thesis"}, "augment.name=none"),
        ({"protocol": {"kind": "same_run"}}, "protocol.kind=cross_run"),
        ({"network": build("simple2", "fc500_500_5", SIZE)}, "model.branch=simple1"),
        ({"network": build("simple1", "fc500_500_5", SIZE, seed=3)}, "seed=0"),
        ({"trainer": {"accelerator": "cpu", "precision": "bf16-mixed"}}, "trainer.precision=32-true"),
        ({"trainer": {"accelerator": "cpu", "gradient_clip_val": 1e-9}}, "trainer.gradient_clip_val=None"),
        ({"trainer": {"accelerator": "cpu", "accumulate_grad_batches": 3}}, "trainer.accumulate_grad_batches=1"),
    ],
)
def test_other_settings_are_not_resumed(train, trained, other, key):
    with pytest.raises(ConfigError, match=f"was trained with {key} and cannot be resumed with"):
        train(trained.folder, epochs=2, resume=True, **other)
    assert len(curve(trained)) == 1


def test_the_same_frames_may_be_named_in_another_way(train, day):
    run = train(epochs=1)
    named = Protocol.of({"train": {"sequences": ["*"], "every": 1}, "leave_one_out": True}).plain()
    assert len(curve(train(epochs=2, resume=True, protocol=named))) == 2
    other = {**named, "train": {**named["train"], "every": 2}}
    with pytest.raises(ConfigError, match=r"\.train\.every=1 and cannot be resumed with protocol\.train\.every=2"):
        train(run.folder, frames=day.every(2), epochs=3, resume=True, protocol=other)


def test_a_record_that_holds_only_the_class_of_a_handed_in_network_is_resumed(train):
    """As written before the arguments of `build` were recorded for modules that are handed in."""

    def network():
        return build(nn.Conv2d(3, 8, 8, 8), "gem", SIZE)

    run = train(network=network())
    record = read_json(run.record)
    record["settings"]["model"] = {"class": "Network"}
    write_json(run.record, record)
    resumed = train(network=network(), epochs=2, resume=True)
    assert len(curve(resumed)) == 2
    assert resumed.settings["model"]["class"] == "Conv2d"


def test_other_frames_are_not_resumed_and_fewer_epochs_neither(train, day):
    train(epochs=2)
    with pytest.raises(ConfigError, match="with other data: there were 12 training frames, and now there are 6; give"):
        train(frames=day.every(2), epochs=3, resume=True)
    with pytest.raises(ConfigError, match="has 2 epochs already, more than epochs=1"):
        train(epochs=1, resume=True)


@pytest.mark.parametrize("column", ["lighting", "room", "building", "x"])
def test_frames_of_other_columns_are_not_resumed(train, trained, day, column):
    other = day.with_columns(**{column: np.arange(12.0) if column == "x" else ["other"] * 12})
    what = "positions" if column == "x" else "labels"
    with pytest.raises(ConfigError, match=f"was trained with other data: the {what} of the training frames differ"):
        train(trained.folder, frames=other, epochs=2, resume=True)


def copied(folder, frames, change):
    """The frames with their pictures in another folder, changed."""
    paths = [folder / path.rpartition("/")[2] for path in frames.path.tolist()]
    for old, new in zip(frames.path.tolist(), paths, strict=True):
        new.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(new), change(cv2.imread(old)))
    return frames.with_columns(path=[str(path) for path in paths])


def test_data_may_move_but_not_become_others(train, day, tmp_path):
    """Pictures that were copied, or saved again, are the same; others under the same names are not."""

    def again(name, change):
        frames = copied(tmp_path / name, day, change)
        images = PanoramaLibrary(frames, tmp_path / "cache", image_size=SIZE)
        return train(frames=frames, images=images, epochs=2, resume=True)

    def saved(picture):
        return cv2.imdecode(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95])[1], cv2.IMREAD_COLOR)

    run = train(epochs=1)
    with pytest.raises(ConfigError, match="the images of the training frames differ"):
        again("mirrored", lambda picture: picture[:, ::-1])
    assert len(curve(run)) == 1
    assert len(curve(again("saved", saved))) == 2


def test_a_schedule_goes_on_with_the_steps_that_it_was_laid_out_for(train):
    """With others it would end too early, or with an error of torch in the middle of the training."""
    few = {"accelerator": "cpu", "limit_train_batches": 1}
    train(epochs=1, trainer=few)
    train(epochs=2, resume=True)  # nothing is laid out
    options = {"epochs": 2, "optimizer": {"schedule": "one_cycle"}}
    run = train("laid out", **options)
    for other in ({"limit_train_batches": 1}, {"max_steps": 2}):
        key = next(iter(other))
        says = rf"the learning rate of .* for the steps of an epoch with trainer\.{key}=.* with trainer\.{key}="
        with pytest.raises(ConfigError, match=says):
            train("laid out", resume=True, trainer={"accelerator": "cpu", **other}, **options)
    record = read_json(run.record)
    record["settings"]["trainer"]["processes"] = 2
    write_json(run.record, record)
    with pytest.raises(ConfigError, match=r"with processes=2, and their number would differ with processes=1: leave"):
        train("laid out", resume=True, **options)


def test_a_run_is_written_over_only_when_told(train, tmp_path):
    with pytest.raises(ConfigError, match="no run to resume"):
        train(resume=True)
    assert not (tmp_path / "run").exists()
    run = train()
    before = curve(run)
    with pytest.raises(ConfigError, match="holds a run already: go on with it by resume=true"):
        train()
    with pytest.raises(ConfigError, match="choose one"):
        train(resume=True, overwrite=True)
    assert curve(run) == before
    assert curve(train(seed=3, overwrite=True)) != before


def test_files_that_siamloc_did_not_write_are_never_removed(train):
    run = train()
    theirs = ["notes.txt", "checkpoints/mine.ckpt", "bundle/robot.onnx", "evaluation/hog/results.json"]
    theirs += ["tensorboard/other.txt", "map.npz", "layers/a/layer.npz"]
    ours = ["locations.csv", "evaluation/network/queries.csv"]
    for name in [*theirs, *ours]:
        (run.folder / name).parent.mkdir(parents=True, exist_ok=True)
        (run.folder / name).write_text(name)
    run.record_written([ours[0], run.folder / ours[1]])
    events = list(run.tensorboard.glob("events*"))
    train(overwrite=True, seed=1)
    assert all((run.folder / name).read_text() == name for name in theirs)
    assert not any((run.folder / name).exists() for name in [*ours, "evaluation/network"])
    assert not any(path.exists() for path in events)


@pytest.mark.parametrize("name", ["map.npz", "checkpoints/last.ckpt", "bundle/model.onnx", "photo.jpeg"])
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_that_is_no_run_is_refused(train, tmp_path, name, overwrite):
    mine = tmp_path / "mine" / name
    mine.parent.mkdir(parents=True)
    mine.write_text("precious")
    with pytest.raises(ConfigError, match="mine is not a run and holds other files, such as"):
        train("mine", overwrite=overwrite)
    assert listing(tmp_path / "mine") == [name]
    assert mine.read_text() == "precious"


def test_a_process_killed_right_when_it_began_does_not_block_the_folder(tmp_path):
    (tmp_path / f".run.json.{files._HOST}-999999999-0.tmp.json").write_text("{")
    check_folder(Run(tmp_path), resume=False, overwrite=False)
    (tmp_path / ".notes.json").write_text("{")
    with pytest.raises(ConfigError, match="holds other files"):
        check_folder(Run(tmp_path), resume=False, overwrite=False)


def test_a_file_in_the_way_is_not_replaced(train, tmp_path):
    run = train()
    record = read_json(run.record)
    write_json(run.record, {**record, "written": [name for name in record["written"] if name != "metrics.csv"]})
    with pytest.raises(ConfigError, match=r"metrics\.csv would be replaced, but siamloc did not write it"):
        train(overwrite=True)
    (tmp_path / "file").touch()
    with pytest.raises(ConfigError, match="is a file"):
        train("file")


class Squared(nn.Module):
    """A custom loss with a learned weight."""

    def __init__(self):
        super().__init__()
        self.scale = nn.Parameter(torch.ones(()))

    def forward(self, d0, d1, y):
        return (self.scale * (d0 - d1).square().sum(1) - y).square().mean()


def test_a_network_and_a_loss_of_ones_own_are_trained_resumed_and_loaded(train):
    whole = train("whole", network=Small(), loss=Squared(), epochs=3)
    network = Small()
    begun = train("part", network=Small(), loss=Squared(), epochs=1)
    write_json(begun.record, {**begun.load_record(), "created": "2020-02-29T12:00:00+0000"})
    torch.manual_seed(99)
    run = train("part", network=network, loss=Squared(), epochs=3, resume=True)
    assert curve(run) == curve(whole)
    assert run.load_record()["created"] == "2020-02-29T12:00:00+0000"
    assert run.settings["model"] == {"class": "Small"}
    assert run.settings["loss"] == {"class": "Squared"}
    assert "train/accuracy" not in run.curves()
    assert as_descriptor(load(run, network=Small())).identity == as_descriptor(network).identity
    for which, says in (
        ("best", r"a module of your own, Small, which .*load\(run, network=\.\.\.\)"),
        ("untrained", "untrained"),
    ):
        with pytest.raises(ConfigError, match=says):
            load(run, which=which)
    with pytest.raises(ConfigError, match=r"loss\.class=Squared and cannot be resumed with loss\.class=Contrastive"):
        train("part", network=Small(), epochs=4, resume=True)


def test_a_network_of_ones_own_goes_on_with_its_width(train):
    run = train(network=Small(3), epochs=1)
    with pytest.raises(FormatError, match=r"last\.ckpt are of another architecture than .*Small: of another shape: 2"):
        train(network=Small(5), epochs=2, resume=True)
    assert len(curve(run)) == 1


def test_augmentation_by_name_by_plain_values_and_by_hand_is_the_same(train):
    plain = curve(train("none"))
    named = curve(train("named", augmentation="thesis"))
    values = curve(train("values", augmentation={"name": "thesis"}, augment_where="gpu"))
    made = train("made", augmentation=augment.policy("thesis"))
    assert named == values == curve(made) != plain
    assert made.settings["augment"]["name"] == "thesis"
    assert curve(train("off", augmentation="none")) == plain
    assert curve(train("effect", augmentation=augment.effect("exposure"))) != plain
    with pytest.raises(ConfigError, match="augmentation must be an Effect"):
        train("wrong", augmentation=3)


def test_frames_without_position_are_left_out_for_distance_labels(train, frames, flat, day, caplog):
    x = day.x.copy()
    x[:2] = np.nan
    holes = day.with_columns(x=x)
    run = train("a", frames=holes, pairs={"label": "distance", "same_room_share": 0.5})
    assert run.settings["frames"]["train"]["count"] == len(day) - 2
    assert "2 of 12 training frames have no position, which distance labels need" in caplog.text
    assert "needs several rooms instead; experiment=adapt, for panoramas" in caplog.text
    assert train("b", frames=holes, pairs={"label": "room"}).settings["frames"]["train"]["count"] == len(day)
    strict = PanoramaLibrary(frames, flat.parent / "cache", image_size=SIZE, on_error="raise")
    with pytest.raises(DataError, match="2 of 12 training frames have no position"):
        train("c", images=strict, frames=holes, pairs={"label": "distance"})


def test_frames_without_a_room_are_left_out_of_pairs_where_others_have_one(train, frames, day, tmp_path, caplog):
    room = day.room.copy()
    room[:2] = ""
    holes = day.with_columns(room=room)
    for label, count in (("auto", len(day) - 2), ("distance", len(day))):
        assert train(label, frames=holes, pairs={"label": label}).settings["frames"]["train"]["count"] == count
    assert "2 of 12 training frames have no room label, which others have, the first: " in caplog.text
    night = frames.select(sequence="night1")
    nameless, one = (night.with_columns(room=[room] * len(night)) for room in ("", "office"))
    for given, says in (
        ({"frames": nameless}, r"all 12 frames belong to one room, \(no label\)"),
        ({"frames": one}, "all 12 frames belong to one room, office"),
    ):
        with pytest.raises(ConfigError, match=says):
            train("refused", pairs={"label": "room"}, **given)
    assert not (tmp_path / "refused").exists()
    train("one_room", pairs={"label": "room"}, validation=one)  # a drive through one room validates all the same


@pytest.mark.parametrize(
    ("wrong", "error", "says"),
    [
        ({"loss": "contrastive"}, ConfigError, "loss must be"),
        ({"loss": SoftContrastiveLoss()}, ConfigError, "a loss of batches of places takes"),
        ({"loss": SoftContrastiveLoss}, ConfigError, r"is a class: make an object of it, SoftContrastiveLoss\(\)"),
        ({"loss": nn.TripletMarginLoss()}, ConfigError, "TripletMarginLoss of torch takes other targets than"),
        ({"loss": partial(nn.functional.cosine_embedding_loss, margin=0.5)}, ConfigError, "of torch takes other"),
        ({"network": "alexnet"}, ConfigError, "network must be a Module"),
        ({"epochs": 0}, ConfigError, "epochs must be a whole number from 1 to 10 million, got 0"),
        ({"batch_size": 1.5}, ConfigError, "batch_size must be a whole number from 1"),
        ({"seed": None}, ConfigError, "seed must be a whole number from 0 to 4,294,967,295, got None"),
        ({"margin": 0}, ConfigError, "margin must be a number above 0"),
        ({"augment_where": "tpu"}, ConfigError, "augment_where must be auto or cpu or gpu"),
        ({"epoch": 3}, ConfigError, r"fit has no setting 'epoch': did you mean 'epochs'\?"),
        ({"pairs": {"same_room_share": 7}}, ConfigError, r"pairs\.same_room_share must be a number from 0 to 1"),
        ({"trainer": {"accelerator": "quantum"}}, ConfigError, "the trainer cannot be set up"),
        ({"trainer": {"precision": "bf"}}, ConfigError, "the trainer cannot be set up"),
        ({"clip": 0.5, "trainer": {"gradient_clip_val": 5}}, ConfigError, r"clip=0\.5 and trainer\.gradient_clip_val"),
        ({"trainer": {"max_epochs": 2}}, ConfigError, r"trainer\.max_epochs is set by siamloc itself"),
        ({"augmentation": "thesys"}, Exception, "did you mean 'thesis'"),
        ({"network": build("simple1", "fc500_500_5", (32, 64))}, DataError, r"\(B, 3, 32, 64\), got \(1, 3, 32, 128"),
        ({"network": nn.Linear(5, 2)}, DataError, "cannot take panoramas of 3 x 32 x 128: RuntimeError: mat1 and"),
        ({"network": nn.Identity()}, DataError, r"per image, shape \(1, D\), got shape \(1, 3, 32, 128\)"),
        ({"network": nn.Sequential(nn.AdaptiveAvgPool2d(4), nn.Flatten())}, ConfigError, "its loss have no weights"),
        ({"network": Small().requires_grad_(False)}, ConfigError, "only frozen ones, 2 with requires_grad=False"),
        ({"frames": FrameTable(path=["a.png"])}, DataError, "make the library from all needed frames"),
    ],
)
@pytest.mark.parametrize("start", ["empty", "overwrite"])
def test_mistakes_are_found_before_the_folder_is_touched(train, tmp_path, wrong, error, says, start):
    run = Run(tmp_path / "run")
    if start == "overwrite":
        run.start({}, ["metrics.csv"])
        run.metrics.write_text("kept")
    before = listing(tmp_path)
    with pytest.raises(error, match=says):
        train(overwrite=start == "overwrite", **wrong)
    assert listing(tmp_path) == before


def test_nothing_is_trained_or_made_for_training_under_inference_mode(train):
    network = build("simple1", "fc500_500_5", SIZE)
    with torch.inference_mode():
        made_there = build("simple1", "fc500_500_5", SIZE)
        with pytest.raises(ConfigError, match=r"under torch.inference_mode\(\): make it and train it outside"):
            train(network=network)
    with pytest.raises(ConfigError, match=r"under torch.inference_mode\(\): make it and train it outside"):
        train(network=made_there)


def test_a_training_says_nothing_where_progress_is_hidden(train, capsys):
    with hidden():
        train()
    assert capsys.readouterr().err == ""


def test_validation_frames_must_not_be_trained_on(train, frames):
    with pytest.raises(ConfigError, match="12 validation frames are training frames too"):
        train(validation=frames)


def test_further_arguments_reach_the_trainer(train, caplog):
    from lightning.pytorch import Callback

    class Count(Callback):
        steps = 0

        def on_train_batch_end(self, *_):
            self.steps += 1

    count = Count()
    options = {"accelerator": "cpu", "limit_train_batches": 1, "callbacks": count, "profiler": "simple"}
    train(trainer=options, epochs=2)
    assert count.steps == 2
    assert "SiameseModule.optimizer_step" in caplog.text


FIT = textwrap.dedent(
    """
    import signal
    import sys
    from unittest import mock
    import torch
    from siamloc.data import PanoramaLibrary, read
    from siamloc.models import build
    from siamloc.models.batch_losses import make_loss
    from siamloc.training import fit
    from lightning.pytorch import Callback

    class Unhindered(Callback):
        # It refuses to wait for the other processes from the first step of an epoch to the last.
        refused = mock.patch("torch.distributed.barrier", side_effect=AssertionError("a step waits for all processes"))

        def on_train_batch_start(self, trainer, module, batch, batch_idx):
            if batch_idx == 0:
                self.refused.start()

        def on_train_batch_end(self, trainer, module, outputs, batch, batch_idx):
            if batch_idx == trainer.num_training_batches - 1:
                self.refused.stop()

    # A shell starts background jobs with Ctrl-C switched off, and the tests may be in one.
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def main(manifest, run, **options):
        frames = read("manifest", manifest=manifest)
        images = PanoramaLibrary(frames, manifest + ".cache", image_size=(32, 128))
        day = frames.select(sequence="cloudy1")
        parts = options.pop("branch", "simple1"), options.pop("head", "fc500_500_5")
        network = build(*parts, image_size=(32, 128))
        if "loss" in options:
            options["loss"] = make_loss(**options["loss"])
        trainer = {"accelerator": "cpu", "callbacks": [Unhindered()], **options.pop("trainer", {})}
        return fit(network, images, day, run=run, trainer=trainer, **options)

    if __name__ == "__main__":
        main(sys.argv[1], sys.argv[2], **eval(sys.argv[3]))
    """
)
EPOCHS = 15  # long enough that a busy machine stops a training before its end
LONG = {"epochs": EPOCHS, "batch_size": 8, "pairs": {"epoch_pairs": 200}}


@pytest.fixture
def script(flat, tmp_path):
    """A way to run `fit` in a separate process."""
    (tmp_path / "own.py").write_text(FIT)

    def start(name, **options):
        words = [sys.executable, str(tmp_path / "own.py"), str(flat), str(tmp_path / name), repr(options)]
        return subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ)

    return start


def finished(process):
    _, error = process.communicate(timeout=200)
    assert process.returncode == 0, error
    return error


def wait_for_epochs(process, run, count):
    deadline = time.monotonic() + 120
    last = run.checkpoints / "last.ckpt"
    while not run.metrics.is_file() or len(curve(run)) < count or not last.is_file():
        assert process.poll() is None, "the run ended before it could be stopped"
        assert time.monotonic() < deadline
        time.sleep(0.005)


@pytest.mark.slow
def test_a_killed_run_goes_on_where_its_last_checkpoint_was(script, tmp_path):
    finished(script("whole", **LONG))
    run = Run(tmp_path / "killed")
    with script("killed", **LONG) as process:
        wait_for_epochs(process, run, 2)
        process.send_signal(signal.SIGKILL)
    assert 2 <= len(curve(run)) < EPOCHS
    finished(script("killed", resume=True, **LONG))
    assert curve(run) == curve(Run(tmp_path / "whole"))
    assert {*read_json(run.record)["written"], "run.json"} == set(listing(run.folder))


PLACES = {"head": "fourier", "augmentation": "lighting", "optimizer": {"learning_rate": 0.05}}
SOFT, TRIPLET = {"name": "soft_contrastive"}, {"name": "triplet", "near": 2.0, "far": 2.5, "miner": "multi_similarity"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("common", "alone", "each"),
    [
        ({"pairs": {"epoch_pairs": 48}}, {"batch_size": 8}, {"batch_size": 4}),
        ({**PLACES, "branch": "simple1", "loss": SOFT}, {"pairs": {"places": 8}}, {"pairs": {"places": 4}}),
        ({**PLACES, "branch": "panoresnet", "loss": TRIPLET}, {"pairs": {"places": 8}}, {"pairs": {"places": 4}}),
    ],
    ids=["pairs", "places", "normalized"],
)
def test_two_processes_train_on_what_one_would(script, tmp_path, common, alone, each):
    """Of places each describes its half, and both compute the loss of the whole: gradients flow back to the other half.

    `panoresnet` normalizes by the statistics of both halves, and the miner sees both.
    """
    trainer = {"accelerator": "cpu", "log_every_n_steps": 1}
    if "head" in common:
        places = {"images": 2, "radius": 2.0, "epoch_batches": 5 if common["loss"] == SOFT else 2}
        alone, each = ({"pairs": {**given["pairs"], **places}} for given in (alone, each))
    finished(script("one", epochs=2, trainer=trainer, **common, **alone))
    both = {**trainer, "devices": 2, "strategy": "ddp"}
    said = finished(script("two", epochs=2, trainer=both, **common, **each))
    assert said.count("epoch 2 of 2:") == 1, "one process speaks"
    runs = [Run(tmp_path / name) for name in ("one", "two")]
    for a, b in zip(*map(curve, runs), strict=True):
        assert a["step"] == b["step"]
        assert float(a["train/loss"]) == pytest.approx(float(b["train/loss"]), rel=1e-3)
        assert float(a["train/loss"]) > 0
    if "head" not in common:
        return
    one, two = (load(run, which="last").state_dict() for run in runs)
    start = build(common["branch"], "fourier", SIZE).state_dict()
    # Statistics of batch normalizations move by far more than weights, so that each kind is compared by its own.
    for kind in ("weight", "running_mean", "running_var"):
        names = [name for name in one if name.endswith(kind)]
        moved = max((float((one[name] - start[name]).abs().max()) for name in names), default=1.0)
        # Sums in another order, over some steps: far less than what was learned.
        assert max((float((one[name] - two[name]).abs().max()) for name in names), default=0.0) < 1e-3 * moved


def test_the_figures_of_an_epoch_appear_above_a_progress_bar_too(train, capfd):
    train(epochs=2, trainer={"accelerator": "cpu", "enable_progress_bar": True})
    said = capfd.readouterr()
    assert "epoch 2 of 2: train/loss" in said.err
    assert "loss_step" in said.out + said.err, "there is a bar"
