"""Checkpoints load unchanged, execute nothing, and are refused with one sentence when damaged."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from siamloc.errors import ConfigError, FormatError
from siamloc.models import ContrastiveLoss, Optimizer, SiameseModule, as_descriptor, build, load
from siamloc.runs import Run
from tests.siamloc.models.conftest import trainer

SIZE = (32, 64)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """A module trained for one step, and its checkpoint."""
    path = tmp_path_factory.mktemp("checkpoint") / "last.ckpt"
    network = build("vgg11_bn", "fc500_100_10", SIZE, seed=7)
    module = SiameseModule(network, ContrastiveLoss(1.5), Optimizer(momentum=0.5))
    images = torch.randint(0, 256, (2, 3, 3, *SIZE), dtype=torch.uint8)
    batch = {"first": images[0], "second": images[1], "label": torch.ones(3), "same": torch.zeros(3, dtype=torch.bool)}
    training = trainer()
    training.fit(module, DataLoader([batch], batch_size=None), DataLoader([batch], batch_size=None))
    training.save_checkpoint(path)
    return module, path


def altered(path, target, **changes):
    content = torch.load(path, weights_only=True)
    torch.save({key: value for key, value in (content | changes).items() if value is not None}, target)
    return target


def about(path):
    return torch.load(path, weights_only=True)["siamloc"]


def test_a_loaded_network_describes_like_the_trained_one(trained):
    module, path = trained
    loaded = load(path)
    images = np.random.default_rng(0).random((3, 3, *SIZE), dtype=np.float32)
    described, expected = (as_descriptor(one).describe(images).position for one in (loaded, module.network))
    np.testing.assert_array_equal(described, expected)
    assert as_descriptor(loaded).identity == module.network.identity
    assert loaded.settings == module.network.settings
    assert not loaded.training
    assert as_descriptor(loaded).margin == 1.5


def test_what_was_trained_stands_in_plain_values(trained):
    _, path = trained
    assert about(path) == {
        "format": 2,
        "model": {
            **{"branch": "vgg11_bn", "head": "fc500_100_10", "image_size": [32, 64], "outputs": None, "weights": None},
            **{"seed": 7, "circular": False, "normalize": "channels", "canonical": False, "relative": False},
        },
        "loss": {"class": "ContrastiveLoss", "margin": 1.5},
        "optimizer": {**Optimizer().plain(), "momentum": 0.5},
    }


def test_loading_downloads_and_reads_nothing_else(trained, tmp_path):
    module, path = trained
    for weights in ("imagenet", "/nowhere/weights.pth"):
        changed = {**about(path), "model": {**about(path)["model"], "weights": weights}}
        loaded = load(altered(path, tmp_path / "a.ckpt", siamloc=changed))
        assert loaded.identity == module.network.identity
        assert loaded.settings["weights"] == weights


def test_the_untrained_network_can_be_had_again(trained):
    _, path = trained
    assert load(path, which="untrained").identity == build("vgg11_bn", "fc500_100_10", SIZE, seed=7).identity


def test_a_run_gives_its_best_checkpoint_or_the_last(trained, tmp_path):
    module, path = trained
    run = Run(tmp_path / "run")
    run.checkpoints.mkdir(parents=True)
    (run.checkpoints / "last.ckpt").write_bytes(path.read_bytes())
    for source in (run, run.folder, str(run.folder)):
        assert load(source).identity == module.network.identity
    (run.checkpoints / "best.ckpt").write_text("broken")
    assert load(run, which="last").identity == module.network.identity
    with pytest.raises(FormatError, match=r"best\.ckpt"):
        load(run)
    with pytest.raises(ConfigError, match=r"^which must be best, last or untrained, got 'first'"):
        load(run, which="first")
    with pytest.raises(ConfigError, match=r"^which must be best or last, got 'untrained'"):
        run.checkpoint("untrained")
    with pytest.raises(ConfigError, match="holds no checkpoint"):
        load(tmp_path)


class Attack:
    def __reduce__(self):
        return (Path.touch, (Path("attack"),))


@pytest.mark.parametrize("damage", ["missing", "cut", "empty", "text", "attack"])
def test_damaged_files_are_refused_in_one_sentence(trained, tmp_path, monkeypatch, damage):
    monkeypatch.chdir(tmp_path)
    file, attack = tmp_path / "model.ckpt", pickle.dumps({"state_dict": Attack(), "siamloc": {}})
    damaged = {"cut": trained[1].read_bytes()[:-1000], "empty": b"", "text": b"a checkpoint", "attack": attack}
    if damage in damaged:
        file.write_bytes(damaged[damage])
    with pytest.raises(FormatError, match=r"model\.ckpt (does not exist|cannot be read)") as info:
        load(file)
    assert "\n" not in str(info.value)
    assert not (tmp_path / "attack").exists()


def test_other_files_of_torch_are_no_checkpoints(trained, tmp_path):
    module, path = trained
    torch.save(module.network.state_dict(), tmp_path / "weights.pth")
    with pytest.raises(FormatError, match="not a checkpoint of a siamese network"):
        load(tmp_path / "weights.pth")
    with pytest.raises(FormatError, match="not a checkpoint of a siamese network"):
        load(altered(path, tmp_path / "a.ckpt", siamloc=None))
    with pytest.raises(FormatError, match="was written by an older siamloc: train again"):
        load(altered(path, tmp_path / "a.ckpt", siamloc_format=1))
    with pytest.raises(FormatError, match="has format version 99, this siamloc reads version 2: update siamloc"):
        load(altered(path, tmp_path / "a.ckpt", siamloc=about(path) | {"format": 99}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"branch": "vgg13_bn"}, r"another architecture than vgg13_bn \+ fc500_100_10"),
        ({"head": "fc500_500_5"}, "another architecture.*of another shape"),
        ({"branch": "resnet50"}, "names a network that cannot be made: unknown branch 'resnet50'"),
        ({"flavour": 3}, "names a network that cannot be made: .*flavour"),
    ],
)
def test_weights_that_do_not_fit_the_network_are_refused(trained, tmp_path, changes, message):
    _, path = trained
    changed = {**about(path), "model": about(path)["model"] | changes}
    with pytest.raises(FormatError, match=message):
        load(altered(path, tmp_path / "a.ckpt", siamloc=changed))


@pytest.mark.filterwarnings("ignore:.*script_method")  # in torch itself
def test_a_compiled_network_is_recorded_as_it_was_built(trained):
    network = trained[0].network
    assert SiameseModule(torch.compile(network)).content()["model"] == network.settings


def test_a_given_network_of_another_class_is_named(trained):
    with pytest.raises(FormatError, match=r"of another architecture than Linear: missing: 2 of 2"):
        load(trained[1], network=torch.nn.Linear(3, 4))
