"""Weights from torchvision and from files: what is accepted, and what is refused with which message."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from augment.torchvision_compat import ensure_torchvision
from siamloc.cli.compose import composed
from siamloc.errors import ConfigError, FormatError
from siamloc.models import build
from siamloc.runs import Run
from siamloc.training import recipe

ensure_torchvision()
from torchvision import models  # noqa: E402

SIZE = (32, 32)
HEAD = "fc500_100_10"


def torchvision_state(branch, seed=9):
    """Names and shapes of the features as in torchvision's published files, with our own values."""
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


def test_weights_that_see_other_images_than_they_were_trained_on_are_said(tmp_path, capsys):
    path = tmp_path / "alexnet.pth"
    torch.save(torchvision_state("alexnet"), path)
    build("alexnet", "flat", (64, 128), weights=path)
    assert not capsys.readouterr().err
    build("alexnet", "flat", (64, 128), weights=path, normalize="local")
    said = capsys.readouterr().err
    assert said.startswith(f"note: {path} was trained on images normalized by channels, and normalize=local shows it")
    assert "set model.normalize=channels (from Python normalize='channels')" in said


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
    """A torch hub folder for the test only, so that a file in it stands for a finished download."""
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
    with pytest.raises(ConfigError, match=r"downloaded from https://\S+alexnet\S+: fetch the file") as info:
        build("alexnet", HEAD, (64, 64), weights="imagenet")
    assert "\n" not in str(info.value)


@pytest.mark.parametrize(
    ("branch", "weights", "says"),
    [
        ("vgg16", "imagnet", r"'imagnet' for the branch 'vgg16': did you mean 'imagenet'\?.*or a path"),
        ("simple1", "imagenet", r"'simple1' has no weights called 'imagenet'.*alexnet"),
    ],
)
def test_unknown_weights_are_refused_with_the_nearest(branch, weights, says):
    with pytest.raises(ConfigError, match=says):
        build(branch, HEAD, SIZE, weights=weights)


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


@pytest.mark.parametrize("name", ["odd.pth", "odd.safetensors"])
@pytest.mark.parametrize("content", ["not weights", {}, [1, 2], {"a": 1}, 3])
def test_files_that_are_no_state_dict_are_refused(tmp_path, name, content):
    path, says = tmp_path / name, r"cannot be read .*: it is cut short"
    if content == "not weights" or path.suffix == ".safetensors":
        path.write_text(str(content))
    else:
        torch.save(content, path)
        says = "holds no state dict"
    with pytest.raises(FormatError, match=says) as info:
        build("simple1", HEAD, SIZE, weights=path)
    assert "\n" not in str(info.value)


def write_run(folder, network, *, model=None, best=True):
    """The folder that a training of this network would leave; `last.ckpt` has other weights than `best.ckpt`."""
    run = Run(folder)
    run.checkpoints.mkdir(parents=True)
    state = {f"network.{name}": tensor for name, tensor in network.state_dict().items()}
    about = {"format": 2, "model": network.settings if model is None else model, "loss": {"class": "Own"}}
    for name, shift in (("last", 1), *([("best", 0)] if best else [])):
        shifted = {key: tensor + shift for key, tensor in state.items()} | {"loss.scale": torch.ones(())}
        torch.save({"state_dict": shifted, "siamloc": about}, run.checkpoints / f"{name}.ckpt")
    return run


def same(network, source):
    """Names of the weights that two networks share."""
    other = source.state_dict()
    state = network.state_dict()
    return {name for name in state if name in other and torch.equal(state[name], other[name])}


def test_a_run_starts_the_whole_network_by_its_best_checkpoint(tmp_path, capsys):
    source = build("simple1", HEAD, SIZE, seed=4)
    source.branch.normalize_with((0.1, 0.2, 0.3), (1, 1, 1))
    run = write_run(tmp_path / "run", source)
    for given in (run, run.folder, str(run.folder), run.checkpoint("best")):
        network = build("simple1", HEAD, SIZE, weights=given)
        assert network.identity == source.identity
        assert network.settings["weights"] == str(given.folder if given is run else given)
        assert capsys.readouterr().err == f"note: the whole network starts from {run.checkpoint('best')}\n"
    last = build("simple1", HEAD, SIZE, weights=write_run(tmp_path / "last", source, best=False))
    assert torch.equal(last.head.layers[1].bias, source.head.layers[1].bias + 1)


@pytest.mark.parametrize(
    ("head", "changes", "says"),
    [
        ("flat", {"head": "fourier"}, "head is flat there and fourier here"),
        ("flat", {"outputs": 7}, "outputs is 5 there and 7 here"),
        ("flat", {"image_size": (64, 32)}, "image_size is [32, 32] there and [64, 32] here"),
        ("fc500_500_5", {"head": "gem"}, "head is fc500_500_5 there and gem here; outputs is None there and 5 here"),
        ("flat", {"head": "gem", "normalize": "image"}, "gem here; normalize is channels there and image here"),
    ],
)
def test_another_head_or_size_takes_the_branch_alone_and_says_so(tmp_path, capsys, head, changes, says):
    source = build("simple1", head, SIZE, seed=4, outputs=5 if head == "flat" else None)
    run = write_run(tmp_path / "run", source)
    options = {"head": head, "image_size": SIZE, "outputs": 5, "seed": 1, **changes}
    network, untrained = build("simple1", **options, weights=run), build("simple1", **options)
    assert {name for name in same(network, source) if name.startswith("branch.")} == {
        name for name in network.state_dict() if name.startswith("branch.")
    }
    assert {name for name in same(network, untrained) if name.startswith("head.")} == {
        name for name in network.state_dict() if name.startswith("head.")
    }
    said = capsys.readouterr().err
    assert said.startswith(f"note: the branch alone starts from {run.checkpoint('best')}; ")
    assert said.endswith(f"{says}\n")


def test_a_head_that_takes_any_size_and_another_padding_start_whole(tmp_path, capsys):
    source = build("simple1", "gem", SIZE, seed=4, outputs=5)
    run = write_run(tmp_path / "run", source)
    network = build("simple1", "gem", (64, 128), weights=run, outputs=5, circular=True)
    assert same(network, source) == set(network.state_dict())
    said = capsys.readouterr().err
    assert "the whole network starts from" in said
    assert said.endswith("image_size is [32, 32] there and [64, 128] here; circular is False there and True here\n")


@pytest.mark.parametrize(
    ("source", "model", "says"),
    [
        ("simple2", None, r"another architecture than simple1 \+ fc500_100_10 at 32 x 32: their branch is simple2"),
        ("simple1", {"class": "Small"}, r"are of a module of your own, Small, and not of simple1 \+"),
        ("simple2", {"branch": "simple1", "head": "flat", "image_size": [9, 9]}, "simple1 .*: of another shape"),
    ],
)
def test_the_run_of_another_network_is_refused(tmp_path, source, model, says):
    run = write_run(tmp_path / "run", build(source, HEAD, SIZE), model=model)
    with pytest.raises(ConfigError, match=says) as info:
        build("simple1", HEAD, SIZE, weights=run.folder)
    assert "\n" not in str(info.value)


def test_a_folder_called_like_weights_does_not_hide_them(hub, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "imagenet").mkdir()
    state = torchvision_state("alexnet")
    torch.save(state, hub / Path(models.AlexNet_Weights.DEFAULT.url).name)
    assert_holds(build("alexnet", HEAD, (64, 64), weights="imagenet"), state)


def test_recipes_and_the_command_line_start_from_a_run(tmp_path):
    used = recipe("photographs")
    run = write_run(tmp_path / "run", used.build((32, 32), seed=3))
    wanted = used.build((32, 32), weights=run).state_dict()
    words = ["experiment=photographs", "data.manifest=a.csv", f"model.branch.weights={run.folder}"]
    found = build(**composed("train", words).model.arguments(), image_size=(32, 32)).state_dict()
    assert all(torch.equal(found[name], wanted[name]) for name in wanted)
    content = torch.load(run.checkpoint("best"), weights_only=True)["state_dict"]
    assert all(torch.equal(wanted[name], content[f"network.{name}"]) for name in wanted)
