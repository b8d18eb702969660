"""Weights from other sources: ImageNet weights of torchvision, a state dict on disk, or another training."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError, FormatError, hint
from siamloc.models.checkpoint_file import CONTENT_KEY, checked_content, network_state
from siamloc.models.heads import GeneralizedMean, Magnitudes
from siamloc.models.registry import BRANCHES, PRETRAINED, branch_spec, whole_model
from siamloc.models.weights_file import read_weights_file
from siamloc.runs import Run

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
        mean: of the red, green and blue channels of the training images, in [0, 1]; None if unknown.
        std: standard deviations, likewise.
        model: for weights of a training, the network as described in the settings of its run.
    """

    state: Mapping[str, Tensor]
    origin: str
    mean: list[float] | None = None
    std: list[float] | None = None
    model: Mapping[str, Any] | None = None


def find_weights(branch: str, weights: str | PathLike[str] | Run) -> Weights:
    """Find weights for a branch by their name or path.

    Args:
        branch: a name in `BRANCHES`.
        weights: "imagenet", the name of a torchvision weight enum, "siamloc", a path, or a run; see
            `siamloc.models.build`.

    Raises:
        ConfigError: an unknown name, a failed download, a file that cannot be read, or a run without a checkpoint.
        FormatError: a checkpoint of another version, or a weights file that was altered.
    """
    if isinstance(weights, Run):
        return read_weights(weights.checkpoint())
    if weights == "siamloc":
        check_shipped()
        return replace(read_weights(PRETRAINED), origin="the weights that ship with siamloc")
    path = Path(weights).expanduser()
    if path.is_dir() and not _NAMES.fullmatch(str(weights)):
        return read_weights(Run(path).checkpoint())
    if isinstance(weights, PathLike) or path.suffix in _SUFFIXES or path.is_file():
        return read_weights(path)
    if len(path.parts) > 1:
        raise ConfigError(
            f"there is no file and no run at {weights}, from which weights were asked for: check the path"
        )
    return _imagenet(branch, weights)


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
        _fill_as_trained(network, weights, weights.model, what)
        return
    state = _comparing_as_here(network, weights.state, keep=True)
    target: nn.Module = network
    if not any(key.startswith("branch.") for key in state):
        what = what.partition(" ")[0]
        target = network.get_submodule("branch.features")
        normalize = getattr(network.get_submodule("branch"), "normalize", "channels")
        if normalize != "channels":
            print(
                f"note: {weights.origin} was trained on images normalized by channels, and normalize={normalize} shows "
                "it other ones: set model.normalize=channels (from Python normalize='channels') to start from what it "
                "learned",
                file=sys.stderr,
            )
        state = {
            _OLD_DENSENET.sub(r"\1\2.", key.removeprefix("features.")): value
            for key, value in state.items()
            if key.startswith("features.")
        }
        # Older files lack this counter, which only matters for averaging without momentum.
        counters = [key for key in target.state_dict() if key.endswith("num_batches_tracked") and key not in state]
        state |= {key: target.state_dict()[key] for key in counters}
    difference = mismatch(target, state)
    if difference is not None:
        raise ConfigError(f"the weights of {weights.origin} are of another architecture than {what}: {difference}")
    target.load_state_dict(state)


def check_shipped() -> None:
    """Raise FormatError if the weights that ship with siamloc are missing."""
    if not PRETRAINED.is_file():
        raise FormatError(f"the weights that ship with siamloc are missing at {PRETRAINED}: install siamloc again")


def read_weights(path: Path) -> Weights:
    """Read a state dict or a checkpoint without running any code in the file.

    Raises:
        ConfigError: the file is missing, incomplete, or holds anything but named tensors.
        FormatError: a checkpoint or a weights file of another version, or a weights file that was altered.
    """
    if not path.is_file():
        raise ConfigError(f"the weights file {path} does not exist")
    if path.suffix == ".safetensors":
        held, model = read_weights_file(path)
        return Weights(held, str(path), model=model)
    try:
        state: Any = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # zip, pickle and torch each raise their own errors
        raise ConfigError(f"the weights file {path} is not a whole state dict ({type(error).__name__})") from error
    if isinstance(state, Mapping) and CONTENT_KEY in state:
        content = checked_content(state, path)
        return Weights(network_state(content), str(path), model=content[CONTENT_KEY]["model"])
    if isinstance(state, Mapping) and isinstance(state.get("state_dict"), Mapping):
        state = {str(key).removeprefix("network."): value for key, value in state["state_dict"].items()}
    if not isinstance(state, Mapping) or not state or not all(isinstance(value, Tensor) for value in state.values()):
        raise ConfigError(f"the weights file {path} holds no state dict (names with tensors)")
    return Weights({str(key): value for key, value in state.items()}, str(path))


def mismatch(module: nn.Module, state: Mapping[str, Tensor]) -> str | None:
    """Describe how a state dict differs from what the module needs; None if it fits."""
    own = module.state_dict()
    missing = [key for key in own if key not in state]
    surplus = [key for key in state if key not in own]
    shapes = [key for key in own if key in state and own[key].shape != state[key].shape]
    parts = []
    if missing:
        parts.append(f"missing: {len(missing)} of {len(own)} tensors, first {missing[0]!r}")
    if surplus:
        parts.append(f"unknown: {len(surplus)}, first {surplus[0]!r}")
    if shapes:
        key = shapes[0]
        expected, got = tuple(own[key].shape), tuple(state[key].shape)
        parts.append(f"of another shape: {len(shapes)}, first {key!r} with {got} for {expected}")
    return "; ".join(parts) or None


def _fill_as_trained(network: nn.Module, weights: Weights, model: Mapping[str, Any], what: str) -> None:
    """Load the weights of a training: all of them if the heads agree, else only those of the branch."""
    here: Mapping[str, Any] = network.settings  # type: ignore[assignment]
    if "branch" not in model:
        raise ConfigError(
            f"the weights of {weights.origin} are of a module of your own, {model.get('class')}, and not of {what}: "
            "load them with siamloc.models.load(..., network=...)"
        )
    if model["branch"] != here["branch"]:
        raise ConfigError(
            f"the weights of {weights.origin} are of another architecture than {what}: their branch is "
            f"{model['branch']}"
        )
    there = whole_model(model)
    keys = ("head", "outputs", "image_size", "circular", "normalize", "canonical", "relative")
    differing = [f"{key} is {there[key]} there and {here[key]} here" for key in keys if there[key] != here[key]]
    sizes = () if isinstance(network.get_submodule("head"), (GeneralizedMean, Magnitudes)) else ("image_size",)
    same = there["relative"] == here["relative"] and there["image_size"][1] == here["image_size"][1]
    target, state = network, _comparing_as_here(network, weights.state, keep=same)
    if any(there[key] != here[key] for key in ("head", "outputs", *sizes)) or mismatch(network, state) is not None:
        target = network.get_submodule("branch")
        state = {name.removeprefix("branch."): value for name, value in state.items() if name.startswith("branch.")}
    difference = mismatch(target, state)
    if difference is not None:
        raise ConfigError(f"the weights of {weights.origin} are of another architecture than {what}: {difference}")
    target.load_state_dict(state)
    taken = "the whole network" if target is network else "the branch alone"
    print("; ".join([f"note: {taken} starts from {weights.origin}", *differing]), file=sys.stderr)


def _comparing_as_here(network: nn.Module, state: Mapping[str, Tensor], keep: bool) -> Mapping[str, Tensor]:
    """Return a state with the network's own weights for comparing images, unless the state has them and `keep`."""

    def compares(name: str) -> bool:
        return name.startswith(("orientation.", "relative."))

    own = {name: value for name, value in network.state_dict().items() if compares(name)}
    if keep and all(name in state for name in own):
        return state
    return {**{name: value for name, value in state.items() if not compares(name)}, **own}


def _imagenet(branch: str, name: str) -> Weights:
    if branch_spec(branch).kind != "torchvision":
        trained = ", ".join(spec.name for spec in BRANCHES.values() if spec.kind == "torchvision")
        raise ConfigError(
            f"the branch {branch!r} has no weights called {name!r}: give none or a path "
            f"(ImageNet weights exist for {trained})"
        )
    ensure_torchvision()
    from torchvision import models

    enum = models.get_model_weights(branch)
    names = {member.name.lower(): member for member in enum}
    if name.lower() == "imagenet":
        member = enum.DEFAULT
    elif name.lower() in names:
        member = names[name.lower()]
    else:
        valid = ["imagenet", *(member.name for member in enum)]
        raise ConfigError(f"unknown weights {name!r} for the branch {branch!r}: {hint(name, valid)}, or a path")
    try:
        state = member.get_state_dict(progress=False, check_hash=True, weights_only=True)
    except (OSError, RuntimeError) as error:
        raise ConfigError(
            f"the weights {member} could not be downloaded from {member.url}: fetch the file elsewhere and give its "
            f"path, or use weights=null"
        ) from error
    preset = member.transforms()
    return Weights(state, str(member), preset.mean, preset.std)
