"""Weights of networks: checkpoints, safetensors and torchvision's files. No code in a file is run."""

from __future__ import annotations

import hashlib
import json
import re
import sys
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from foundation.files import atomic_path, check_version, expanded, parsed_json
from siamloc.errors import ConfigError, FormatError, OldFormatError
from siamloc.models.heads import GeneralizedMean, Magnitudes
from siamloc.models.hub import timm_file, torchvision_weights
from siamloc.models.registry import BRANCHES, PRETRAINED
from siamloc.runs import Run

CONTENT_KEY = "siamloc"
FORMAT_VERSION = 2
"""Version of the format of checkpoints."""
VERSION = 1
"""Version of the format of weights files."""

# The published DenseNet files number the layers "norm.1"; the class has called them "norm1" for years.
_OLD_DENSENET = re.compile(r"(denselayer\d+\.(?:norm|relu|conv))\.([12])\.")
_NAMES = re.compile("imagenet(1k_.*)?", re.IGNORECASE)
_SUFFIXES = (".pth", ".pt", ".bin", ".ckpt", ".safetensors")


@dataclass(frozen=True)
class Weights:
    """Weights and their origin.

    Attributes:
        state: names and tensors.
        origin: where the weights come from, in words.
        mean: means of red, green and blue in the training images, in [0, 1]; None if unknown.
        std: standard deviations of red, green and blue; None if unknown.
        model: description of the network in the settings of its run; None unless the weights are of a training.
    """

    state: Mapping[str, Tensor]
    origin: str
    mean: list[float] | None = None
    std: list[float] | None = None
    model: Mapping[str, Any] | None = None

    @property
    def of_a_network(self) -> bool:
        """Whether these are weights of a network of siamloc, and not of a branch alone."""
        return self.model is not None or any(key.startswith("branch.") for key in self.state)


def read_checkpoint(path: str | Path, mmap: bool = False) -> dict[str, Any]:
    """Read a checkpoint of a training: a dictionary with `state_dict` and, under "siamloc", what was trained.

    Args:
        path: path of the file that Lightning wrote.
        mmap: leave the weights on the disk until they are used.

    Raises:
        FormatError: the file is missing, incomplete, not such a checkpoint, or of another version.
    """
    return _checked_content(_torch_file(Path(path), mmap), path)


def network_state(content: Mapping[str, Any]) -> dict[str, Tensor]:
    """Return the network's weights in the content of a checkpoint, by their names in the network."""
    states = content["state_dict"].items()
    return {name.removeprefix("network."): tensor for name, tensor in states if name.startswith("network.")}


def read_weights(path: Path) -> Weights:
    """Read a checkpoint, a safetensors file or a state dict.

    Raises:
        FormatError: the file is missing, cut short, altered since siamloc wrote it, of another version, or holds
            anything but named tensors.
    """
    if path.suffix == ".safetensors":
        return _safetensors(path)
    state: Any = _torch_file(path)
    if isinstance(state, Mapping) and CONTENT_KEY in state:
        content = _checked_content(state, path)
        return Weights(network_state(content), str(path), model=content[CONTENT_KEY]["model"])
    if isinstance(state, Mapping) and isinstance(state.get("state_dict"), Mapping):
        state = {str(key).removeprefix("network."): value for key, value in state["state_dict"].items()}
    if not isinstance(state, Mapping) or not state or not all(isinstance(value, Tensor) for value in state.values()):
        raise FormatError(f"the weights file {path} holds no state dict (names with tensors)")
    return Weights({str(key): value for key, value in state.items()}, str(path))


def write_weights(path: str | Path, state: Mapping[str, Tensor], model: Mapping[str, Any]) -> None:
    """Write the weights of a network to a safetensors file, with convolutions and layers in half precision.

    The file also holds the settings to rebuild the network, and a hash of both. Equal weights give equal files.

    Args:
        path: path of the file, ending in .safetensors.
        state: names and tensors.
        model: arguments of `siamloc.models.build` for the network, as plain values.

    Raises:
        StorageError: the disk refuses.
    """
    from safetensors.torch import save_file

    halved = {
        name: (tensor.half() if tensor.ndim > 1 and tensor.is_floating_point() else tensor).cpu().contiguous()
        for name, tensor in state.items()
    }
    about = {"version": VERSION, "model": dict(model)}
    text = json.dumps({**about, "sha256": _hash(halved, about)}, sort_keys=True)
    with atomic_path(path) as temporary:
        save_file(halved, temporary, metadata={CONTENT_KEY: text})


def state_hash(state: Mapping[str, Tensor], length: int = 16) -> str:
    """Return a short hash of the names, types, shapes and values in a state dict, the same on every device."""
    digest = hashlib.sha256()
    for name in sorted(state):
        tensor = state[name].detach().cpu().contiguous()
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()[:length]


def load_whole(module: nn.Module, state: Mapping[str, Tensor], what: str, error: type[Exception] = FormatError) -> None:
    """Load a state dict that must have exactly the weights of a module.

    Raises:
        FormatError: other weights, in a sentence that begins with `what`; or another `error`.
    """
    if difference := mismatch(module, state):
        raise error(f"{what}: {difference}")
    module.load_state_dict(state)


def mismatch(module: nn.Module, state: Mapping[str, Tensor]) -> str | None:
    """Return how a state dict differs from the weights that a module needs; None if it fits."""
    own = module.state_dict()
    missing = [key for key in own if key not in state]
    surplus = [key for key in state if key not in own]
    shapes = [key for key in own if key in state and own[key].shape != state[key].shape]
    parts = [f"missing: {len(missing)} of {len(own)} tensors, first {missing[0]!r}"] if missing else []
    parts += [f"unknown: {len(surplus)}, first {surplus[0]!r}"] if surplus else []
    for key in shapes[:1]:
        expected, got = tuple(own[key].shape), tuple(state[key].shape)
        parts.append(f"of another shape: {len(shapes)}, first {key!r} with {got} for {expected}")
    return "; ".join(parts) or None


def _torch_file(path: Path, mmap: bool = False) -> Any:
    _check_there(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings of torch about a foreign file would hide our own message
            return torch.load(path, map_location="cpu", weights_only=True, mmap=mmap)
    except Exception as error:  # zip, pickle and torch each raise their own errors
        raise FormatError(
            f"the file {path} cannot be read ({type(error).__name__}): it is cut short, or holds more than tensors and "
            "plain values; take another file, or train again"
        ) from error


def _check_there(path: Path) -> None:
    if not path.is_file():
        todo = "install siamloc again" if path == PRETRAINED else "check the path"
        raise FormatError(f"the file {path} does not exist: {todo}")


def _checked_content(content: Any, path: str | Path) -> dict[str, Any]:
    """Return the contents of a checkpoint, unless they are not of a training of siamloc, or of another version."""
    if isinstance(content, dict) and "siamloc_format" in content:
        raise OldFormatError(f"the checkpoint {path} was written by an older siamloc: train again")
    about = content.get(CONTENT_KEY) if isinstance(content, dict) else None
    needs = {"format", "model", "loss"}
    if not isinstance(about, dict) or not needs <= set(about) or not isinstance(content.get("state_dict"), dict):
        raise FormatError(f"{path} is not a checkpoint of a siamese network: it lacks weights, or what was trained")
    check_version(about["format"], FORMAT_VERSION, f"the checkpoint {path}", "train again")
    return content


def _safetensors(path: Path) -> Weights:
    """Read the tensors of a safetensors file in single precision; of a file that siamloc wrote, also its network."""
    from safetensors import SafetensorError, safe_open

    _check_there(path)
    try:
        with safe_open(path, framework="pt") as file:
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  (it is no mapping)
            text = (file.metadata() or {}).get(CONTENT_KEY)
    except (SafetensorError, OSError, ValueError) as error:
        raise FormatError(
            f"the weights file {path} cannot be read ({type(error).__name__}): it is cut short or not a safetensors "
            "file, get it again"
        ) from error
    if text is None:
        return Weights(state, str(path))
    altered = f"the weights file {path} was altered since it was written: get it again"
    try:
        about = parsed_json(text)
        version, digest = about["version"], about.pop("sha256")
    except (ValueError, TypeError, KeyError) as error:
        raise FormatError(altered) from error
    check_version(version, VERSION, f"the weights file {path}", "get it again")
    if digest != _hash(state, about):
        raise FormatError(altered)
    single = {name: tensor.float() if tensor.is_floating_point() else tensor for name, tensor in state.items()}
    return Weights(single, str(path), model=about["model"])


def _hash(state: Mapping[str, Tensor], about: Mapping[str, Any]) -> str:
    text = json.dumps({**about, "state": state_hash(state, 64)}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def find_weights(branch: str, weights: str | PathLike[str] | Run) -> Weights:
    """Find weights for a branch by their name or path.

    Args:
        branch: name of the branch.
        weights: "imagenet", the name of a torchvision weight enum, "cached", "download", "siamloc", a path, or a run;
            see `siamloc.models.build`.

    Raises:
        ConfigError: an unknown name, a failed download, or a run without a checkpoint.
        FormatError: a file that is missing, cut short or altered, or of another version.
    """
    if isinstance(weights, Run):
        return read_weights(weights.checkpoint())
    if weights == "siamloc":
        return replace(read_weights(PRETRAINED), origin="the network that ships with siamloc")
    path = expanded(weights)
    if path.is_dir() and not _NAMES.fullmatch(str(weights)):
        return read_weights(Run(path).checkpoint())
    if isinstance(weights, PathLike) or path.suffix in _SUFFIXES or path.is_file():
        return read_weights(path)
    if len(path.parts) > 1:
        raise ConfigError(
            f"there is no file and no run at {weights}, from which weights were asked for: check the path"
        )
    return _published(branch, weights)


def fill(network: nn.Module, weights: Weights, what: str) -> None:
    """Load weights into a network, in place: into all of it, or only into its branch if they are from torchvision.

    Weights of a training also go into the whole network; if they belong to another head, or to features of another
    size, only the branch is loaded, and a printed note says why.

    Args:
        network: branch and head, from `siamloc.models.build`.
        weights: weights of this network, or of another network with the same branch.
        what: description of the network.

    Raises:
        ConfigError: weights of another architecture.
    """
    if weights.model is not None:
        target, state = _of_training(network, weights, weights.model, what)
    elif weights.of_a_network:
        target, state = network, _comparing_as_here(network, weights.state, keep=True)
    else:
        target, state = _of_torchvision(network, weights)
        what = what.partition(" ")[0]
    of = f"the weights of {weights.origin} are of another architecture than {what}"
    load_whole(target, state, of, ConfigError)


def _of_torchvision(network: nn.Module, weights: Weights) -> tuple[nn.Module, Mapping[str, Tensor]]:
    """Return the features of a network, and their weights by the names that the network has for them."""
    target = network.get_submodule("branch.features")
    normalize = getattr(network.get_submodule("branch"), "normalize", "channels")
    if normalize != "channels":
        print(
            f"note: {weights.origin} was trained on images normalized by channels, and normalize={normalize} shows it "
            "other ones: set model.normalize=channels (from Python normalize='channels') to start from what it learned",
            file=sys.stderr,
        )
    state = {
        _OLD_DENSENET.sub(r"\1\2.", key.removeprefix("features.")): value
        for key, value in weights.state.items()
        if key.startswith("features.")
    }
    # Older files lack this counter, which only matters for averaging without momentum.
    own = target.state_dict().items()
    counters = {key: value for key, value in own if key.endswith("num_batches_tracked") and key not in state}
    return target, state | counters


def _of_training(
    network: nn.Module, weights: Weights, model: Mapping[str, Any], what: str
) -> tuple[nn.Module, Mapping[str, Tensor]]:
    """Return the part of a network that starts from a training, all of it if the heads agree, and its weights."""
    here: Mapping[str, Any] = network.settings  # type: ignore[assignment]
    if "branch" not in model:
        raise ConfigError(
            f"the weights of {weights.origin} are of a module of your own, {model.get('class')}, and not of {what}: "
            "load them with siamloc.models.load(..., network=...)"
        )
    if model["branch"] != here.get("branch"):
        raise ConfigError(
            f"the weights of {weights.origin} are of another architecture than {what}: their branch is "
            f"{model['branch']}"
        )
    there = {**here, **model}
    keys = ("head", "outputs", "image_size", "circular", "normalize", "canonical", "relative")
    differing = [f"{key} is {there[key]} there and {here[key]} here" for key in keys if there[key] != here[key]]
    sizes = () if isinstance(network.get_submodule("head"), (GeneralizedMean, Magnitudes)) else ("image_size",)
    same = all(there[key] == here[key] for key in ("relative", "circular"))
    same &= there["image_size"][1] == here["image_size"][1]
    target, state = network, _comparing_as_here(network, weights.state, keep=same)
    if any(there[key] != here[key] for key in ("head", "outputs", *sizes)) or mismatch(network, state) is not None:
        target = network.get_submodule("branch")
        state = {name.removeprefix("branch."): value for name, value in state.items() if name.startswith("branch.")}
    taken = "the whole network" if target is network else "the branch alone"
    print("; ".join([f"note: {taken} starts from {weights.origin}", *differing]), file=sys.stderr)
    return target, state


def _comparing_as_here(network: nn.Module, state: Mapping[str, Tensor], keep: bool) -> Mapping[str, Tensor]:
    """Return a state with the network's own weights for comparing images, unless the state has them and `keep`."""

    def compares(name: str) -> bool:
        return name.startswith(("orientation.", "relative."))

    own = {name: value for name, value in network.state_dict().items() if compares(name)}
    if keep and all(name in state for name in own):
        return state
    return {**{name: value for name, value in state.items() if not compares(name)}, **own}


def _published(branch: str, name: str) -> Weights:
    """Return published weights of a network of torchvision or timm by their name."""
    if branch.startswith("timm/"):
        file = timm_file(branch.removeprefix("timm/"), name)
        return replace(read_weights(file), origin=f"the published weights of {branch}")
    ours = [name for name, spec in BRANCHES.items() if spec.kind == "torchvision"]
    if branch not in ours and not branch.startswith("torchvision/"):
        raise ConfigError(
            f"the branch {branch!r} has no weights called {name!r}: give none or a path "
            f"(ImageNet weights exist for {', '.join(ours)}, torchvision/NAME)"
        )
    return Weights(*torchvision_weights(branch.removeprefix("torchvision/"), name))
