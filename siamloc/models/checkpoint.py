"""Load a trained network from a run or a checkpoint, without running any code in the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor, nn

from foundation.calls import typed
from siamloc.errors import ConfigError, DataError, FormatError, SiamlocError
from siamloc.models.checkpoint_file import CONTENT_KEY, network_state, read_checkpoint
from siamloc.models.network import build
from siamloc.models.room_classifier import RoomClassifier
from siamloc.models.weights import mismatch, read_weights
from siamloc.runs import Run


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
        ConfigError: a folder without a checkpoint, an unknown `which`, a checkpoint of a custom module without
            `network`, or a weights file that is cut short.
        FormatError: the file is missing, incomplete, altered, not such a checkpoint, or of another architecture.

    Example:
        >>> network = load("runs/robot")  # doctest: +SKIP
        >>> network = load("runs/own", network=MyNetwork())  # doctest: +SKIP
    """
    path = _checkpoint_of(run_or_checkpoint, "best" if which == "untrained" else which)
    if path.suffix == ".safetensors":
        return _from_weights(path, which, network)
    content = read_checkpoint(path)
    about = content[CONTENT_KEY]
    if which == "untrained":
        if "branch" not in about["model"]:
            raise ConfigError(
                f"the network of {path} is a module of your own, {_name(about)}: make it again to have it untrained"
            )
        return _made(path, about["model"]).eval()
    if network is None and "branch" not in about["model"]:
        raise ConfigError(
            f"the network of {path} is a module of your own, {_name(about)}: make one and give it as network=..."
        )
    if network is None:
        network = _made(path, {**about["model"], "weights": None})
        network.settings = dict(about["model"])  # type: ignore[assignment]
    state = network_state(content)
    difference = mismatch(network, state)
    if difference is not None:
        raise FormatError(_other_architecture(path, about, difference))
    network.load_state_dict(state)
    # Losses over batches have a name; a triplet margin is not a margin of pairs.
    pairs: Any = about["loss"] if "name" not in about["loss"] else {}
    network.trained_margin = pairs.get("margin")
    network.rooms = _rooms_in(path, about, content["state_dict"])  # type: ignore[assignment]
    return network.eval()


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


def check_architecture(path: Path, module: nn.Module) -> None:
    """Make sure that a module, with its network and its loss, can continue from a checkpoint.

    Raises:
        FormatError: the file is not a checkpoint, or has other weights.
    """
    content = read_checkpoint(path, mmap=True)
    difference = mismatch(module, content["state_dict"])
    if difference is not None:
        raise FormatError(_other_architecture(path, content[CONTENT_KEY], difference))


def _other_architecture(path: Path, about: dict[str, Any], difference: str) -> str:
    return f"the weights in the checkpoint {path} are of another architecture than {_name(about)}: {difference}"


def _checkpoint_of(source: str | Path | Run, which: str) -> Path:
    if isinstance(source, Run):
        return source.checkpoint(which)
    path = Path(source).expanduser()
    return Run(path).checkpoint(which) if path.is_dir() else path


def _from_weights(path: Path, which: str, network: nn.Module | None) -> nn.Module:
    """Return the network in a weights file, or the given one with these weights."""
    if which == "untrained":
        raise ConfigError(f"the weights file {path} holds trained weights alone: take a run for which='untrained'")
    if not path.is_file():
        raise FormatError(f"the weights file {path} does not exist")
    weights = read_weights(path)
    if network is None and weights.model is None:
        raise FormatError(f"the weights file {path} does not say of which network it is: build one with weights=FILE")
    if network is None:
        network = _made(path, dict(weights.model or {}))
    difference = mismatch(network, weights.state)
    if difference is not None:
        raise FormatError(f"the weights file {path} is of another network than it says: {difference}")
    network.load_state_dict(weights.state)
    return network.eval()


def _made(path: Path, model: dict[str, Any]) -> nn.Module:
    try:
        return build(**model)
    except (TypeError, SiamlocError) as error:
        raise FormatError(f"the checkpoint {path} names a network that cannot be made: {error}") from error


def _name(about: dict[str, Any]) -> str:
    model = about["model"]
    if "branch" not in model:
        return str(model.get("class"))
    size = " x ".join(map(str, model.get("image_size", [])))
    return f"{model['branch']} + {model.get('head')} at {size}"
