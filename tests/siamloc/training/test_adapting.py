"""Learning from the order of a drive: its steps, what is held out, and that the better weights are kept."""

from __future__ import annotations

from unittest.mock import Mock

import cv2
import numpy as np
import pytest
import torch

import siamloc
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.errors import ConfigError, DataError
from siamloc.training import Training, recipe
from siamloc.training.adapting import Adapting, clearly_smaller, steps_of

FRAMES, CELLS = 96, (2, 8)
CHANGES = {
    "augmentation": None,
    "pairs": {"places": 8, "images": 2, "epoch_batches": 60},
    "optimizer": {"frozen_stages": 0, "learning_rate": 0.02},
}


class Cells(torch.nn.Module):
    """Descriptors of the mean grey levels of the image's cells; before the training, each with the same weight."""

    def __init__(self):
        super().__init__()
        self.pool, self.weight = torch.nn.AdaptiveAvgPool2d(CELLS), torch.nn.Parameter(torch.ones(CELLS))

    def forward(self, panorama):
        return torch.nn.functional.normalize((self.weight * (self.pool(panorama.mean(1)) - 0.5)).flatten(1))


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """Images whose upper cells show how far the robot has come; the lower ones are noise, as lights or people are.

    `still` has the first image again and again.
    """
    folder, noise = tmp_path_factory.mktemp("images"), np.random.default_rng(0)
    far = 2 * np.pi * np.arange(FRAMES)[:, None] / FRAMES * np.array([0.5, 1, 2, 3])
    upper = 0.5 * np.concatenate([np.cos(far), np.sin(far)], axis=1)
    cells = np.stack([upper, noise.uniform(-1, 1, upper.shape)], axis=1)
    rows = []
    for sequence, shown in (("drive", cells), ("still", cells[:1].repeat(FRAMES, axis=0))):
        for number, one in enumerate(shown):
            path = folder / f"{sequence}{number:03d}.png"
            image = cv2.resize(128 + 120 * one, (64, 16), interpolation=cv2.INTER_NEAREST)
            cv2.imwrite(str(path), np.repeat(image[..., None], 3, axis=2).astype(np.uint8))
            rows.append({"path": str(path), "sequence": sequence})
    return PanoramaLibrary(FrameTable.from_rows(rows), tmp_path_factory.mktemp("cache"), image_size=(16, 64))


@pytest.fixture
def adapt(drives, tmp_path):
    def call(network, frames=None, run="run", **options):
        frames = drives.frames.select(sequence="drive") if frames is None else frames
        return recipe("adapt").fit(network, drives, frames, run=tmp_path / run, **{**CHANGES, **options})

    return call


def test_a_step_begins_where_the_similarity_to_its_first_frame_falls_below_the_level():
    noise = np.random.default_rng(1)
    walk = np.cumsum(noise.normal(size=(200, 16)), axis=0)
    walk /= np.linalg.norm(walk, axis=1, keepdims=True)
    level = (1 + np.median([[one @ other for one in walk] for other in walk])) / 2
    wanted, first = [0], walk[0]
    for one in walk[1:]:
        new = one @ first < level
        first = one if new else first
        wanted.append(wanted[-1] + int(new))
    np.testing.assert_array_equal(steps_of(walk), wanted)
    assert 5 < wanted[-1] < 190


def test_it_learns_what_the_order_shows_and_the_run_holds_what_is_kept(adapt, drives, tmp_path, capsys):
    network = Cells()
    run = adapt(network)
    assert "which is kept" in capsys.readouterr().err
    weight = network.weight.detach().abs()
    assert weight[0].min() > weight[1].max()
    np.testing.assert_array_equal(siamloc.models.load(run, network=Cells()).weight.detach(), network.weight.detach())
    assert "checkpoints/best.ckpt" in run.load_record()["written"]
    check = run.load_record()["check"]
    assert check["kept"] > 0
    assert check["errors"][check["shares"].index(check["kept"])] < check["errors"][0]
    again = Cells()
    adapt(again, run="again")
    np.testing.assert_array_equal(again.weight.detach(), network.weight.detach())


def test_a_training_that_does_not_help_keeps_the_weights(adapt, capsys):
    network = Cells()
    run = adapt(network, optimizer={**CHANGES["optimizer"], "learning_rate": 1e-6})
    said = capsys.readouterr().err
    assert "the weights from before are kept" in said
    assert said.count("checkpoint: ") == 1
    assert f"checkpoint: {run.checkpoint()}\n" in said
    assert run.checkpoint().name == "best.ckpt"
    assert (network.weight == 1).all()
    assert (siamloc.models.load(run, network=Cells()).weight == 1).all()
    assert (siamloc.models.load(run, which="last", network=Cells()).weight != 1).any()


def test_a_gain_within_the_spread_of_the_queries_is_none():
    noise, frame = np.random.default_rng(3), np.arange(256) % 32
    before = noise.integers(0, 60, 256).astype(float)
    assert not clearly_smaller(before - 0.2 + 5 * noise.normal(size=32)[frame], before, frame)
    assert clearly_smaller(before - 5 + 5 * noise.normal(size=32)[frame], before, frame)
    assert not clearly_smaller(before, before, frame)


def test_an_interrupted_check_leaves_the_weights_from_before(adapt, tmp_path, monkeypatch, capsys):
    with monkeypatch.context() as patch:
        patch.setattr(Adapting, "_check", Mock(side_effect=KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt, match="go on with resume=true"):
            adapt(Cells())
    assert "go on with resume=true" in capsys.readouterr().err
    run = siamloc.runs.Run(tmp_path / "run")
    assert (siamloc.models.load(run, network=Cells()).weight == 1).all()


def test_the_check_asks_for_frames_that_are_not_learned_from(drives):
    frames, settings = drives.frames.select(sequence="drive"), Training(pairs={"by": "steps"})
    adapting = Adapting.begun(Cells(), drives, frames, None, None, settings)
    known, asked, queries = adapting._check(drives, None)
    learned = set(adapting.learned.path.tolist())
    assert len(learned) + len({path for path in frames.path.tolist() if path not in learned}) == FRAMES
    assert not learned & set(asked.path.tolist())
    assert not set(known.path.tolist()) & set(asked.path.tolist())
    assert 0 < len(set(asked.path.tolist())) < FRAMES / 2
    assert np.abs(known.x[:, None] - asked.x).min(axis=0).max() <= 8
    np.testing.assert_array_equal(queries, drives.batch(drives.rows(asked)))


def test_frames_of_a_robot_that_stands_still_change_nothing(drives):
    frames, settings = drives.frames.select(sequence="drive"), Training(pairs={"by": "steps"})
    parked = frames.take(np.sort(np.r_[np.arange(FRAMES), np.full(4 * FRAMES, 30)]))
    moving, standing = (Adapting.begun(Cells(), drives, one, None, None, settings) for one in (frames, parked))
    assert standing.drive.path.tolist() == moving.drive.path.tolist() == frames.path.tolist()
    np.testing.assert_array_equal(standing.drive.x, moving.drive.x)


def test_a_run_continues_as_if_it_had_never_stopped(adapt):
    whole, parts = (siamloc.models.build("simple1", "magnitudes", (16, 64), circular=True) for _ in range(2))
    options = {"optimizer": {**CHANGES["optimizer"], "schedule": "constant"}, "pairs": {"epoch_batches": 4}}
    options = {**options, "trainer": {"precision": "32-true"}}
    adapt(whole, epochs=2, **options)
    adapt(parts, run="parts", epochs=1, **options)
    adapt(parts, run="parts", epochs=2, resume=True, **options)  # with the weights that the first part left
    for name, value in whole.state_dict().items():
        np.testing.assert_array_equal(parts.state_dict()[name], value)


def test_the_comparison_stays_as_it_is_and_needs_no_headings(adapt):
    network = siamloc.models.build("simple1", "magnitudes", (16, 64), circular=True, relative=True)
    torch.nn.init.ones_(network.relative.first.bias)  # as if it had learned
    before = {name: value.clone() for name, value in network.state_dict().items()}
    run = adapt(network, pairs={"epoch_batches": 4}, trainer={"precision": "32-true"})
    after = siamloc.models.load(run, which="last").state_dict()
    kept = ("orientation.", "relative.", "branch.mean", "branch.std")
    for name, value in before.items():
        assert torch.equal(after[name], value) == name.startswith(kept)
    assert all(weight.requires_grad for weight in network.parameters())
    assert siamloc.models.as_descriptor(siamloc.models.load(run)).compares


def test_a_comparison_that_has_learned_nothing_is_refused(adapt, drives, tmp_path):
    shipped = recipe("adapt")
    for changes in ({"circular": False, "canonical": False}, {"image_size": (64, 512)}):
        with pytest.raises(ConfigError, match=r"has learned nothing yet.*model.relative=false"):
            adapt(shipped.build(**changes))
    assert not (tmp_path / "run").exists()


def test_drives_without_an_order_to_learn_from_are_refused(adapt, drives):
    frames = drives.frames
    with pytest.raises(DataError, match=r"order of one drive, and the training frames are of 2 \(drive, still\)"):
        adapt(Cells(), frames)
    with pytest.raises(DataError, match="50 frames of a drive or more, and there are 49"):
        adapt(Cells(), frames.take(slice(49)))
    with pytest.raises(DataError, match="look so alike that their number of steps is 1"):
        adapt(Cells(), frames.select(sequence="still"))
    mixed = np.random.default_rng(2).permutation(FRAMES)
    with pytest.raises(DataError, match="Give them in the order in which they were taken"):
        adapt(Cells(), frames.select(sequence="drive").take(mixed))
    with pytest.raises(ConfigError, match="leave the validation out"):
        adapt(Cells(), frames.select(sequence="drive"), validation=frames.select(sequence="still"))
