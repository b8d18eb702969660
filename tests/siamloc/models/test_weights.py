"""Weights from torchvision and from files: what is taken, and what is refused in which words."""

from __future__ import annotations

import pickle
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError
from siamloc.models import build

ensure_torchvision()
from torchvision import models  # noqa: E402

SIZE = (32, 32)
HEAD = "fc500_100_10"


def torchvision_state(branch, seed=9):
    """Names and shapes of the features as torchvision's published files have them, with values of our own."""
    features = build(branch, HEAD, (64, 64), seed=seed).branch.features.state_dict()
    state = {f"features.{name}": tensor for name, tensor in features.items()}
    return state | {"classifier.6.weight": torch.zeros(2, 2)}


def assert_holds(network, state):
    for name, tensor in network.branch.features.state_dict().items():
        assert torch.equal(tensor, state[f"features.{name}"]), name


@pytest.mark.parametrize("suffix", [".pth", ".safetensors"])
def test_own_state_dict_comes_back_whole(tmp_path, suffix):
    source = build("simple1", HEAD, SIZE, seed=4)
    source.branch.normalize_with((0.1, 0.2, 0.3), (1, 1, 1))
    path = tmp_path / f"weights{suffix}"
    save_file(source.state_dict(), path) if suffix == ".safetensors" else torch.save(source.state_dict(), path)
    assert build("simple1", HEAD, SIZE, weights=path).identity == source.identity
    assert build("simple1", HEAD, SIZE, weights=str(path)).identity == source.identity


@pytest.mark.parametrize("branch", ["alexnet", "vgg11_bn"])
def test_torchvision_state_dict_fills_the_branch_and_leaves_the_head_to_the_seed(tmp_path, branch):
    state = torchvision_state(branch)
    torch.save(state, tmp_path / "published.pth")
    network = build(branch, HEAD, (64, 64), weights=tmp_path / "published.pth", seed=1)
    assert_holds(network, state)
    untrained = build(branch, HEAD, (64, 64), seed=1)
    assert torch.equal(network.head.layers[1].weight, untrained.head.layers[1].weight)


def test_densenet_files_with_the_old_names_are_read(tmp_path):
    state = torchvision_state("densenet121")
    old = {}
    for name, tensor in state.items():
        if not name.endswith("num_batches_tracked"):
            parts = name.split(".")
            dense = "denselayer" in name
            old[".".join(part[:-1] + "." + part[-1] if dense and part in OLD else part for part in parts)] = tensor
    assert "features.denseblock1.denselayer1.norm.1.weight" in old
    torch.save(old, tmp_path / "old.pth")
    assert_holds(build("densenet121", HEAD, SIZE, weights=tmp_path / "old.pth"), state)


OLD = ("norm1", "norm2", "conv1", "conv2")


@pytest.fixture
def hub(tmp_path):
    """A torch hub folder of the test's own, so that a file in it stands for a finished download."""
    before = torch.hub.get_dir()
    torch.hub.set_dir(tmp_path)
    (tmp_path / "checkpoints").mkdir()
    yield tmp_path / "checkpoints"
    torch.hub.set_dir(before)


@pytest.mark.parametrize("name", ["imagenet", "IMAGENET1K_V1", "imagenet1k_v1"])
def test_imagenet_weights_by_name(hub, name):
    state = torchvision_state("alexnet")
    torch.save(state, hub / Path(models.AlexNet_Weights.DEFAULT.url).name)
    network = build("alexnet", HEAD, (64, 64), weights=name)
    assert_holds(network, state)
    torch.testing.assert_close(network.branch.mean.flatten(), torch.tensor([0.485, 0.456, 0.406]))


def test_normalization_goes_with_the_weights(hub):
    member = models.VGG16_Weights.IMAGENET1K_FEATURES
    torch.save(torchvision_state("vgg16"), hub / Path(member.url).name)
    network = build("vgg16", HEAD, SIZE, weights="IMAGENET1K_FEATURES")
    torch.testing.assert_close(network.branch.std.flatten(), torch.full((3,), 1 / 255))
    torch.testing.assert_close(network.branch.mean.flatten(), torch.tensor(member.transforms().mean))


@pytest.mark.parametrize("failure", [OSError("no route to host"), RuntimeError("invalid hash value")])
def test_a_failed_download_is_one_sentence(monkeypatch, hub, failure):
    def refuse(*arguments, **options):
        raise failure

    monkeypatch.setattr(torch.hub, "download_url_to_file", refuse)
    with pytest.raises(
        ConfigError, match=r"could not be downloaded from https://\S+alexnet\S+: fetch the file"
    ) as info:
        build("alexnet", HEAD, (64, 64), weights="imagenet")
    assert "\n" not in str(info.value)


def test_unknown_weights_are_refused_with_the_nearest():
    with pytest.raises(ConfigError, match=r"'imagnet' for the branch 'vgg16': did you mean 'imagenet'\?.*or a path"):
        build("vgg16", HEAD, SIZE, weights="imagnet")


def test_simple_branches_have_no_imagenet_weights():
    with pytest.raises(ConfigError, match=r"'simple1' has no weights called 'imagenet'.*alexnet"):
        build("simple1", HEAD, SIZE, weights="imagenet")


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.pth does not exist"):
        build("simple1", HEAD, SIZE, weights=tmp_path / "none.pth")


def test_a_state_dict_of_another_branch_is_refused(tmp_path):
    path = tmp_path / "other.pth"
    torch.save(build("simple2", HEAD, SIZE).state_dict(), path)
    with pytest.raises(ConfigError, match=r"another architecture than simple1 \+ fc500_100_10 at 32 x 32: .*shape"):
        build("simple1", HEAD, SIZE, weights=path)
    torch.save(torchvision_state("vgg13"), path)
    with pytest.raises(ConfigError, match=r"another architecture than vgg11: .*unknown: 18, first"):
        build("vgg11", HEAD, SIZE, weights=path)
    with pytest.raises(ConfigError, match=r"another architecture than vgg16: missing: 12 of 26 tensors"):
        build("vgg16", HEAD, SIZE, weights=path)


def test_a_state_dict_for_another_image_size_is_refused(tmp_path):
    path = tmp_path / "other.pth"
    torch.save(build("vgg11", HEAD, (64, 64)).state_dict(), path)
    with pytest.raises(ConfigError, match=r"at 32 x 32: of another shape: 1, first 'head\.layers\.1\.weight'"):
        build("vgg11", HEAD, SIZE, weights=path)


class Attack:
    def __reduce__(self):
        return (Path.touch, (Path("attack"),))


@pytest.mark.parametrize("name", ["cut.pth", "attack.pth", "text.pth", "text.safetensors"])
def test_files_that_are_no_state_dict_are_refused_without_running_them(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / name
    if name == "cut.pth":
        torch.save(build("simple1", HEAD, SIZE).state_dict(), path)
        path.write_bytes(path.read_bytes()[:2000])
    elif name == "attack.pth":
        path.write_bytes(pickle.dumps(Attack()))
    else:
        path.write_text("not weights")
    with pytest.raises(ConfigError, match="is not a whole state dict") as info:
        build("simple1", HEAD, SIZE, weights=path)
    assert "\n" not in str(info.value)
    assert not (tmp_path / "attack").exists()


@pytest.mark.parametrize("content", [{}, [1, 2], {"a": 1}, 3])
def test_files_without_named_tensors_are_refused(tmp_path, content):
    torch.save(content, tmp_path / "odd.pth")
    with pytest.raises(ConfigError, match="holds no state dict"):
        build("simple1", HEAD, SIZE, weights=tmp_path / "odd.pth")
