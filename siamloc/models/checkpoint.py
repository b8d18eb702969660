"""Networks in files: load trained ones without running any code in the file, the shipped one, and save weights."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor, nn

from foundation.calls import typed
from foundation.files import expanded
from siamloc.errors import ConfigError, DataError, FormatError, SiamlocError
from siamloc.models.describing import network_of
from siamloc.models.network import Network, build
from siamloc.models.registry import PRETRAINED, PRETRAINED_ELEVATIONS
from siamloc.models.room_classifier import RoomClassifier
from siamloc.models.weights import (
    CONTENT_KEY,
    load_whole,
    mismatch,
    network_state,
    read_checkpoint,
    read_weights,
    write_weights,
)
from siamloc.runs import Run

_BUILT = ("head", "outputs", "circular", "normalize", "canonical", "relative", "colours")
"""Arguments of `build` that change what a network computes with its weights."""


@typed
def load(run_or_checkpoint: str | Path | Run, *, which: str = "best", network: nn.Module | None = None) -> nn.Module:
    """Load a trained network, on the CPU and in evaluation mode.

    No code in the file is run, and nothing is downloaded, whatever weights the training started from. The network's
    `rooms` is the `RoomClassifier` of a training with `CrossEntropyLoss`, and None after others.

    Args:
        run_or_checkpoint: a run, its folder, a checkpoint file, or a file written by `save_weights`.
        which: the checkpoint of a run: "best" (by the validation; the last if nothing was validated) or "last".
            "untrained" gives the network as it was before the training.
        network: a custom module to load the weights into; if None, the network is rebuilt with `build`.

    Raises:
        ConfigError: a folder without a checkpoint, an unknown `which`, or a checkpoint of a custom module without
            `network`.
        FormatError: the file is missing, incomplete, altered, not such a checkpoint, or of another architecture, or
            its network was built with other arguments than `network`.

    Example:
        >>> network = load("runs/robot")  # doctest: +SKIP
        >>> network = load("runs/own", network=MyNetwork())  # doctest: +SKIP
    """
    if which not in ("best", "last", "untrained"):
        raise ConfigError(f"which must be best, last or untrained, got {which!r}")
    path = _checkpoint_of(run_or_checkpoint, "best" if which == "untrained" else which)
    if path.suffix == ".safetensors":
        weights = read_weights(path)
        content, model, state = None, weights.model, weights.state
    else:
        content = read_checkpoint(path)
        model, state = content[CONTENT_KEY]["model"], network_state(content)
    if which == "untrained" and content is None:
        raise ConfigError(f"the weights file {path} holds trained weights alone: take a run for which='untrained'")
    if network is None or which == "untrained":
        if model is None:
            raise FormatError(f"the weights file {path} does not say of which network it is: build one with weights=")
        if "branch" not in model:
            raise ConfigError(
                f"the network of {path} is a module of your own, {_name(model)}, which no command can make: in "
                "Python, make one and load its weights by siamloc.models.load(run, network=...), or leave it untrained"
            )
        if which == "untrained":
            return _made(path, dict(model)).eval()
        network = _made(path, {**model, "weights": None})
        network.settings = dict(model)  # type: ignore[assignment]
    if isinstance(network, Network) and model is not None and "head" in model:
        _check_built_alike(path, model, network.settings)
        if "elevations" in model:
            network.settings["elevations"] = model["elevations"]
    load_whole(network, state, _another_architecture(path, network))
    if content is not None:
        about = content[CONTENT_KEY]
        # Losses over batches have a name; a triplet margin is not a margin of pairs.
        margin: Any = None if "name" in about["loss"] else about["loss"].get("margin")
        network.trained_margin = margin
        network.rooms = _rooms_in(path, about, content["state_dict"])  # type: ignore[assignment]
    return network.eval()


@typed
def pretrained(*, circular: bool = True, relative: bool = True) -> Network:
    """Make the network that ships with siamloc, in evaluation mode on the CPU; its model card is next to its weights.

    It was trained on random buildings, and describes panoramas without further training.

    Args:
        circular: False for images whose columns are not a full turn, such as those of an ordinary camera: the same
            weights, without wrapping around, headings and the part that compares images.
        relative: False leaves out the part that compares images, for example to fine-tune on drives without headings.

    Raises:
        FormatError: the weights file is missing, cut short or altered.

    Example:
        >>> network = pretrained()
        >>> network.image_size, network.outputs
        ((64, 256), 2048)
    """
    network = load(PRETRAINED)
    assert isinstance(network, Network)
    network.settings["elevations"] = list(PRETRAINED_ELEVATIONS)
    if not circular:
        network = _rebuilt(network, circular=False, canonical=False, relative=False)
    elif not relative:
        network = _rebuilt(network, relative=False)
    network.settings["weights"] = "siamloc"
    return network.eval()


@typed
def save_weights(network: Network, path: str | Path) -> Path:
    """Write the weights of a network, at half their size, to a file that `load` and `build(weights=...)` can read.

    Args:
        network: from `siamloc.models.build`.
        path: path of the file, ending in .safetensors.

    Returns:
        The path.

    Raises:
        ConfigError: another ending, or a custom module.
        StorageError: the disk refuses.
    """
    path = Path(path)
    if path.suffix != ".safetensors":
        raise ConfigError(f"weights are written as safetensors: let the name {path.name} end in .safetensors")
    write_weights(path, network.state_dict(), {**network.settings, "weights": None})
    return path


def without_layer(network: Network) -> Network:
    """Return a network with the head `magnitudes` instead of `fourier`, whose layer fits its training buildings.

    Other networks stay as they are.

    Raises:
        ConfigError: features of one column.
    """
    return _rebuilt(network, head="magnitudes", outputs=None) if network.head.name == "fourier" else network


def _rebuilt(network: Network, **changes: Any) -> Network:
    """Make a network that differs in some arguments of `build`; branch and comparing part keep their weights."""
    settings = dict(network.settings)
    if settings.pop("class", None) is not None:
        settings["branch"] = deepcopy(network.branch.features)
    made = build(**{**settings, "weights": None, **changes})
    for part in ("branch", "orientation", "relative"):
        if part == "branch" or made.relative is not None:
            made.get_submodule(part).load_state_dict(network.get_submodule(part).state_dict())
    return made


def check_architecture(path: Path, module: nn.Module) -> None:
    """Make sure that a module, with its network and its loss, can continue from a checkpoint.

    Raises:
        FormatError: the file is not a checkpoint, or has other weights.
    """
    content = read_checkpoint(path, mmap=True)
    if difference := mismatch(module, content["state_dict"]):
        raise FormatError(f"{_another_architecture(path, network_of(module))}: {difference}")


def _another_architecture(path: Path, network: nn.Module) -> str:
    name = _name(network.settings) if isinstance(network, Network) else type(network).__qualname__
    return f"the weights in the file {path} are of another architecture than {name}"


def _check_built_alike(path: Path, model: Mapping[str, Any], here: Mapping[str, Any]) -> None:
    """Raise FormatError if two networks with the same weights were built with other arguments, which they hold apart.

    The branches may differ: a network by its name may also be handed in as a module. So may the image sizes, if the
    weights fit.
    """
    there, here = ({"colours": False, **settings} for settings in (model, here))
    for key in (key for key in _BUILT if key in there and key in here):
        if there[key] != here[key]:
            raise FormatError(
                f"the network of {path} was built with {key}={there[key]!r}, and the given one with "
                f"{key}={here[key]!r}: build it with the same arguments, or another one from its weights by "
                "siamloc.models.build(..., weights=...)"
            )


def _rooms_in(path: Path, about: dict[str, Any], state: dict[str, Tensor]) -> RoomClassifier | None:
    """Return the class layer that was trained with the network; None if there was none.

    Raises:
        FormatError: the layer is incomplete.
    """
    if "rooms" not in about:
        return None
    try:
        temperature = float(about["loss"]["temperature"])
        weight, bias = ((state[f"loss.layer.{part}"].float() / temperature).numpy() for part in ("weight", "bias"))
        return RoomClassifier(np.array(about["rooms"], dtype=np.str_), weight, bias)
    except (KeyError, TypeError, ValueError, ZeroDivisionError, DataError) as error:
        raise FormatError(f"the checkpoint {path} names rooms without a whole class layer: train again") from error


def _checkpoint_of(source: str | Path | Run, which: str) -> Path:
    if isinstance(source, Run):
        return source.checkpoint(which)
    path = expanded(source)
    return Run(path).checkpoint(which) if path.is_dir() else path


def _made(path: Path, model: dict[str, Any]) -> nn.Module:
    try:
        return build(**model)
    except (TypeError, SiamlocError) as error:
        raise FormatError(f"the file {path} names a network that cannot be made: {error}") from error


def _name(model: Mapping[str, Any]) -> str:
    name = str(model.get("branch", model.get("class")))
    size = " x ".join(map(str, model.get("image_size", [])))
    return f"{name} + {model['head']} at {size}" if "head" in model else name
