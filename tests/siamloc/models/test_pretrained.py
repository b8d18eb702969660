"""Weights in a file: whole, cut, edited; and the network that ships with siamloc."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from siamloc.errors import ConfigError, FormatError
from siamloc.models import as_descriptor, build, load, pretrained, save_weights
from siamloc.models.checkpoint import without_layer
from siamloc.models.network import Network
from siamloc.models.registry import PRETRAINED, PRETRAINED_SIZE

SIZE = (16, 64)


def network(**changes) -> Network:
    options = {"branch": "panoresnet", "head": "fourier", "image_size": SIZE, "circular": True, "canonical": True}
    return build(**{**options, **changes}).eval()


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    return save_weights(network(seed=3), tmp_path / "weights.safetensors")


def panoramas(count: int = 2, size=SIZE) -> np.ndarray:
    return np.random.default_rng(1).integers(0, 256, (count, 3, *size), dtype=np.uint8)


def test_a_saved_network_describes_as_before_up_to_half_precision(saved: Path):
    again, before = load(saved), network(seed=3)
    assert again.settings == before.settings
    described, expected = (as_descriptor(one).describe(panoramas()).position for one in (again, before))
    np.testing.assert_allclose(described, expected, atol=2e-3)  # descriptors of length 1, weights of 11 bits
    for name, value in before.state_dict().items():
        torch.testing.assert_close(again.state_dict()[name], value, rtol=2**-11, atol=1e-7)
    assert saved.stat().st_size < 0.55 * sum(value.nbytes for value in before.state_dict().values())


def test_equal_weights_give_equal_files(saved: Path, tmp_path: Path):
    other = save_weights(network(seed=3), tmp_path / "other.safetensors")
    assert other.read_bytes() == saved.read_bytes()
    assert save_weights(network(seed=4), tmp_path / "four.safetensors").read_bytes() != saved.read_bytes()


def test_the_layer_that_fits_the_training_buildings_is_dropped_and_nothing_else():
    trained = network(seed=3)
    ready = without_layer(trained)
    assert ready.settings == {**trained.settings, "head": "magnitudes", "outputs": ready.outputs}
    for name, value in trained.branch.state_dict().items():
        torch.testing.assert_close(ready.branch.state_dict()[name], value, rtol=0, atol=0)
    other = network(head="gem")
    assert without_layer(other) is other


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1000])


def edited(path: Path) -> None:
    raw = bytearray(path.read_bytes())
    raw[-100] ^= 1
    path.write_bytes(bytes(raw))


def with_record(**changes):
    """Return what changes keys of the record in a file, and removes those that are None."""

    def change(path: Path) -> None:
        raw = path.read_bytes()
        metadata = json.loads(raw[8 : 8 + int.from_bytes(raw[:8], "little")])["__metadata__"]
        about = {**json.loads(metadata["siamloc"]), **changes}
        kept = json.dumps({key: value for key, value in about.items() if value is not None})
        save_file(load_file(path), path, metadata={"siamloc": kept})

    return change


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (cut, "it is cut short or not a safetensors file, get it again"),
        (edited, "was altered since it was written"),
        (with_record(model={"branch": "panoresnet"}), "was altered since it was written"),
        (with_record(sha256=None), "was altered since it was written"),
        (with_record(version=99), "has format version 99, this siamloc reads version 1: update siamloc"),
    ],
)
@pytest.mark.parametrize("use", [load, lambda path: network(weights=path)])
def test_a_file_that_is_not_as_it_was_written_is_refused_in_one_sentence(saved: Path, spoil, message: str, use):
    spoil(saved)
    with pytest.raises(FormatError, match=message) as caught:
        use(saved)
    assert "\n" not in str(caught.value)
    assert str(saved) in str(caught.value)


def test_what_cannot_be_saved_is_refused(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"end in \.safetensors"):
        save_weights(network(), tmp_path / "weights.pt")
    with pytest.raises(ConfigError, match="network must be a Network, got Linear"):
        save_weights(torch.nn.Linear(2, 2), tmp_path / "weights.safetensors")


def test_tensors_without_a_record_are_no_network(tmp_path: Path):
    path = tmp_path / "plain.safetensors"
    save_file(network().state_dict(), path)
    with pytest.raises(FormatError, match="does not say of which network it is"):
        load(path)
    assert network(weights=path, seed=2).settings["weights"] == str(path)


def test_the_card_has_the_hash_of_the_weights_and_they_are_small():
    card = (PRETRAINED.parent / "README.md").read_text(encoding="utf-8")
    assert hashlib.sha256(PRETRAINED.read_bytes()).hexdigest() in card
    assert PRETRAINED.stat().st_size <= 8_000_000
    for words in ("licence", "seed", "limits", "siamloc pretrain"):
        assert re.search(words, card, re.IGNORECASE), words


@pytest.mark.parametrize("circular", [True, False])
def test_the_network_that_comes_along_is_ready(circular: bool):
    ready = pretrained(circular=circular)
    assert not ready.training
    assert ready.image_size == PRETRAINED_SIZE
    descriptor = as_descriptor(ready)
    assert descriptor.tells_heading is circular
    found = descriptor.describe(panoramas(2, PRETRAINED_SIZE)).position
    assert found.shape == (2, 2848)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.5, atol=1e-5)
    started = build(**{**ready.settings, "weights": "siamloc"})
    for name, value in ready.state_dict().items():
        torch.testing.assert_close(started.state_dict()[name], value, rtol=0, atol=0)


def test_turning_by_any_whole_column_changes_nothing_and_gives_the_heading():
    descriptor = as_descriptor(pretrained())
    noise = np.random.default_rng(0).random((2, 64, 3 * 256, 3), dtype=np.float32)
    noise[:, :, :256] = noise[:, :, 256:512] = noise[:, :, 512:]  # so that its blurred middle wraps around
    smooth = np.stack([cv2.GaussianBlur(one, (0, 0), 4)[:, 256:512] for one in noise]).transpose(0, 3, 1, 2)
    images = (255 * (smooth - smooth.min()) / np.ptp(smooth)).astype(np.uint8)
    known = descriptor.describe(images)
    apart = np.linalg.norm(known.position[0] - known.position[1])
    for columns in (1, 7, 16, 100, 255):
        there = descriptor.describe(np.roll(images, columns, axis=3))
        assert np.linalg.norm(there.position - known.position, axis=1).max() < 0.001 * apart
        found = np.degrees(descriptor.localize(there, known).heading)
        np.testing.assert_allclose((found - columns * 360 / 256 + 180) % 360 - 180, 0, atol=0.1)


def test_a_missing_file_says_what_to_do(monkeypatch, tmp_path: Path):
    for module in ("weights", "checkpoint"):
        monkeypatch.setattr(f"siamloc.models.{module}.PRETRAINED", tmp_path / "none.safetensors")
    with pytest.raises(FormatError, match="install siamloc again"):
        pretrained()
    with pytest.raises(FormatError, match="install siamloc again"):
        network(weights="siamloc")


def test_a_file_of_weights_fills_a_network_that_is_given_and_is_never_untrained(saved: Path, tmp_path: Path):
    mine = network(seed=8)
    assert load(saved, network=mine) is mine
    torch.testing.assert_close(mine.state_dict(), load(saved).state_dict(), rtol=0, atol=0)
    with pytest.raises(ConfigError, match="holds trained weights alone"):
        load(saved, which="untrained")
    with pytest.raises(FormatError, match="does not exist"):
        load(tmp_path / "none.safetensors")


@pytest.mark.parametrize("cast", [torch.nn.Module.float, torch.nn.Module.double])
def test_a_network_of_another_precision_turns_as_before(cast):
    images = torch.from_numpy(panoramas()).double() / 255
    with torch.no_grad():
        kept, turned = cast(network()), network().canonical(images)[1]
        assert torch.equal(kept.canonical(images)[1], turned)
        precision = next(kept.parameters()).dtype
        there = kept(images.to(precision).roll(5, dims=3))
        torch.testing.assert_close(kept(images.to(precision)), there, atol=1e-6, rtol=0)


def test_without_what_compares_it_describes_alike():
    whole, alone = pretrained(), pretrained(relative=False)
    assert alone.relative is None
    assert not as_descriptor(alone).compares
    image = torch.rand(1, 3, 64, 256, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(alone(image), whole(image))
