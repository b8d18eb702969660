"""A training that is stopped within an epoch and resumed ends like one that was never stopped, bit by bit."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from types import SimpleNamespace

import pytest
import torch

import siamloc
from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError
from siamloc.models.weights import read_checkpoint
from siamloc.training.pair_batches import PairDataModule
from siamloc.training.run_folder import progress
from siamloc.training.stopping import StepCheckpoints
from tests.siamloc.training.conftest import SETTINGS, Small

ensure_torchvision()
from lightning.pytorch import Callback  # noqa: E402
from lightning.pytorch.callbacks import EarlyStopping  # noqa: E402

STEPS = 6
CASES = {
    "places": {
        **SETTINGS,
        "pairs": {"places": 4, "images": 2, "epoch_batches": STEPS},
        "loss": siamloc.models.SoftContrastiveLoss(sigma_start=3.0),
        "optimizer": {"name": "adamw", "schedule": "one_cycle"},
        "average": 0.9,
        "clip": 1.0,
        "augmentation": "lighting",
    },
    "pairs": {"batch_size": 5, "pairs": {"epoch_pairs": 28}, "optimizer": {"name": "adam"}, "augmentation": "lighting"},
}


class Stop(Callback):
    """Does something at the end of a batch, before checkpoints are written."""

    def __init__(self, step, action):
        self.step, self.action = step, action

    def on_train_batch_start(self, trainer, *_):
        if trainer.global_step == self.step:
            self.action()


class Killed(BaseException):
    pass


def kill():
    raise Killed


def same(one, other):
    assert one.metrics.read_text() == other.metrics.read_text()
    for which in ("best", "last"):
        a, b = (read_checkpoint(run.checkpoint(which)) for run in (one, other))
        assert a["epoch"] == b["epoch"]
        for part in ("state_dict", "current_model_state"):
            mine, theirs = a.get(part, {}), b.get(part, {})
            assert mine.keys() == theirs.keys()
            assert all(torch.equal(mine[name], theirs[name]) for name in mine)


@pytest.fixture
def train(images, drives, tmp_path):
    def call(name, kind, *callbacks, gathered=1, limits=None, **more):
        options = {"validation": drives[1], "epochs": 3, **CASES[kind], **more}
        trainer = {"accelerator": "cpu", "callbacks": list(callbacks), "accumulate_grad_batches": gathered}
        trainer |= limits or {}
        return siamloc.training.fit(Small(), images, drives[0], run=tmp_path / name, trainer=trainer, **options)

    return call


@pytest.mark.parametrize("kind", CASES)
@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_a_killed_training_goes_on_from_the_checkpoint_within_the_epoch(train, tmp_path, kind, workers):
    whole = train("whole", kind, workers=workers)
    options = {"checkpoint_every": 2, "workers": workers}
    with pytest.raises(Killed):
        train("cut", kind, Stop(STEPS + 5, kill), **options)
    run = siamloc.training.Run(tmp_path / "cut")
    assert progress(run) == (1, 4)
    same(whole, train("cut", kind, resume=True, **options))


REFUSED = {4: "was laid out for 3 epochs", 1: "has begun epoch 2 already, more than epochs=1"}


@pytest.mark.parametrize(
    ("sent", "kind", "step", "kept", "epochs"),
    [
        (signal.SIGINT, "places", 2, (0, 3), 4),
        (signal.SIGINT, "places", STEPS - 1, (1, 0), 4),
        (signal.SIGTERM, "pairs", STEPS + 2, (1, 3), 1),
    ],
)
def test_a_signal_ends_the_step_and_the_training_goes_on_there(train, tmp_path, capfd, sent, kind, step, kept, epochs):
    """In the last step of an epoch the validation and the checkpoint of the epoch come first."""
    whole = train("whole", kind)
    with pytest.raises(KeyboardInterrupt):
        train("cut", kind, Stop(step, lambda: os.kill(os.getpid(), sent)))
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    run = siamloc.training.Run(tmp_path / "cut")
    assert progress(run) == kept
    said = capfd.readouterr().err
    assert ("stopping at the next checkpoint; Ctrl-C again stops at once" in said) == (sent == signal.SIGINT)
    steps = f" and {kept[1]} of {STEPS} steps" if kept[1] else ""
    assert f"stopped after {kept[0]} of 3 epochs{steps}: go on with resume=true, run={run.folder}" in said
    with pytest.raises(ConfigError, match=REFUSED[epochs]):
        train("cut", kind, resume=True, epochs=epochs)
    same(whole, train("cut", kind, resume=True))


class Limit(Callback):
    """Ends the training after a step, as `max_time` does."""

    def on_train_batch_end(self, trainer, *_):
        trainer.should_stop |= trainer.global_step == STEPS // 2 + 1


@pytest.mark.parametrize(
    ("callbacks", "limits", "gathered", "kept", "says"),
    [
        ([Limit()], {}, 1, (0, 4), "epoch 0 of 3, by the trainer's max_time or a callback"),
        ([Limit()], {}, 2, (1, 2), "epoch 1 of 3, by the trainer's max_time or a callback"),
        ([], {"max_steps": STEPS + 2}, 1, (1, 2), "epoch 1 of 3, by the trainer's max_steps"),
        ([], {"max_steps": 2 * STEPS}, 1, (2, 0), "epoch 2 of 3, by the trainer's max_steps"),
    ],
)
def test_a_training_goes_on_where_a_limit_of_the_trainer_ended_it(
    train, tmp_path, capfd, callbacks, limits, gathered, kept, says
):
    whole = train("whole", "pairs", gathered=gathered)
    capfd.readouterr()
    train("cut", "pairs", *callbacks, gathered=gathered, limits=limits)
    assert f"stopped early after {says}" in capfd.readouterr().err
    assert progress(siamloc.training.Run(tmp_path / "cut")) == kept
    longer = {"max_steps": 10 * STEPS} if limits else {}
    same(whole, train("cut", "pairs", gathered=gathered, limits=longer, resume=True))


def test_callbacks_that_judge_validations_see_no_epoch_that_a_limit_ended(train, tmp_path):
    train("cut", "pairs", Limit(), EarlyStopping("val/loss"))
    assert progress(siamloc.training.Run(tmp_path / "cut")) == (0, STEPS // 2 + 1)


class StopAtValidation(Callback):
    def on_validation_end(self, trainer, *_):
        trainer.should_stop = True


def test_a_stop_at_a_validation_within_an_epoch_keeps_its_figures(train, tmp_path):
    run = train("cut", "pairs", StopAtValidation(), limits={"val_check_interval": 0.5})
    assert (run.checkpoints / "last.ckpt").is_file()
    assert run.curves()["step"].tolist() == [STEPS // 2]


def test_sigterm_before_the_first_step_ends_the_training_at_once(train, monkeypatch):
    """As while workers start, which may hang before they give the first batch."""

    class Hanging:
        def __len__(self):
            return STEPS

        def __iter__(self):
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(1)
            return iter(())

    monkeypatch.setattr(PairDataModule, "train_dataloader", lambda _: Hanging())
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt, match="stopped after 0 of 3 epochs"):
        train("cut", "pairs")
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_process_that_imports_the_script_trains_nothing(train, tmp_path, monkeypatch):
    monkeypatch.setattr(multiprocessing.current_process(), "_inheriting", True, raising=False)
    with pytest.raises(ConfigError, match=r"runs the whole script again.* under `if __name__ == "):
        train("cut", "pairs")
    assert not (tmp_path / "cut").exists()


def test_a_second_training_in_the_same_folder_is_refused(train):
    refused = []

    def second():
        for option in ("overwrite", "resume"):
            with pytest.raises(ConfigError, match="another process is writing into"):
                train("cut", "pairs", **{option: True})
            refused.append(option)

    whole = train("whole", "pairs")
    same(whole, train("cut", "pairs", Stop(2, second)))
    assert refused == ["overwrite", "resume"]


def test_an_exit_of_the_users_own_goes_through(train):
    with pytest.raises(SystemExit) as raised:
        train("cut", "pairs", Stop(2, lambda: sys.exit(3)))
    assert raised.value.code == 3


class StopValidation(Callback):
    """Sends a signal before the first batch of a validation."""

    def __init__(self, epoch, sent):
        self.epoch, self.sent = epoch, sent

    def on_validation_batch_start(self, trainer, module, batch, number, loader=0):
        if trainer.current_epoch == self.epoch and number == loader == 0:
            os.kill(os.getpid(), self.sent)


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_during_the_validation_leaves_the_checkpoint_of_the_epoch(train, tmp_path, sent):
    whole = train("whole", "pairs")
    with pytest.raises(KeyboardInterrupt):
        train("cut", "pairs", StopValidation(1, sent))
    assert progress(siamloc.training.Run(tmp_path / "cut")) == (2, 0)
    same(whole, train("cut", "pairs", resume=True))
    with pytest.raises(KeyboardInterrupt, match="finished before it could be stopped"):
        train("last", "pairs", StopValidation(2, sent))
    same(whole, siamloc.training.Run(tmp_path / "last"))


def test_gathered_gradients_write_no_checkpoint_of_their_own(train, tmp_path, monkeypatch):
    written = []

    def note(self, trainer, module, checkpoint):
        if self._saving:
            written.append(trainer.global_step)

    monkeypatch.setattr(StepCheckpoints, "on_save_checkpoint", note)
    pairs = {"batch_size": 2, "pairs": {"epoch_pairs": 28}, "epochs": 2}
    train("run", "pairs", gathered=2, checkpoint_every=3, **pairs)
    assert written == [3, 6, 9, 12]


def test_another_number_of_processes_cannot_go_on_within_an_epoch(tmp_path):
    checkpoints = StepCheckpoints(tmp_path / "last.ckpt", None, None)
    trainer = SimpleNamespace(world_size=2)
    checkpoints.on_load_checkpoint(trainer, None, {})
    with pytest.raises(ConfigError, match=r"within an epoch of 1 processes.*resume with trainer\.devices=1"):
        checkpoints.on_load_checkpoint(trainer, None, {"epoch_sums": [{}]})
