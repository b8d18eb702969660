"""The network that ships with siamloc: trained on random buildings, it describes panoramas without further training."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from foundation.calls import typed
from siamloc.errors import ConfigError
from siamloc.models.checkpoint import load
from siamloc.models.network import Network, build
from siamloc.models.registry import PRETRAINED
from siamloc.models.weights import check_shipped
from siamloc.models.weights_file import write_weights


@typed
def pretrained(*, circular: bool = True, relative: bool = True) -> Network:
    """Make the network that ships with siamloc, in evaluation mode on the CPU; its model card is next to its weights.

    Args:
        circular: False for images whose columns are not a full turn, such as those of an ordinary camera: the same
            weights, without wrapping around and without headings.
        relative: False leaves out the part that compares images, for example to fine-tune on drives without headings.

    Raises:
        ConfigError: the weights file is cut short.
        FormatError: the weights file is missing or altered.

    Example:
        >>> network = pretrained()
        >>> network.image_size, network.outputs
        ((64, 256), 2048)
    """
    check_shipped()
    network = load(PRETRAINED)
    assert isinstance(network, Network)
    if not circular:
        network = _rebuilt(network, circular=False, canonical=False, relative=False)
    elif not relative:
        network = _rebuilt(network, relative=False)
    network.settings["weights"] = "siamloc"
    return network.eval()


def without_layer(network: Network) -> Network:
    """Replace the head `fourier` with `magnitudes`, which has no layer fitted to the training buildings.

    Other networks stay as they are.

    Raises:
        ConfigError: features of one column.
    """
    return _rebuilt(network, head="magnitudes", outputs=None) if network.head.name == "fourier" else network


def _rebuilt(network: Network, **changes: Any) -> Network:
    """Make a network that differs in some arguments of `build`; branch and comparing part keep their weights."""
    found = build(**{**network.settings, "weights": None, **changes})
    found.branch.load_state_dict(network.branch.state_dict())
    if found.relative is not None and network.relative is not None:
        for part in ("orientation", "relative"):
            found.get_submodule(part).load_state_dict(network.get_submodule(part).state_dict())
    return found


@typed
def save_weights(network: Network, path: str | Path) -> Path:
    """Write the weights of a network, at half their size, to a file that `load` and `build(weights=...)` can read.

    Args:
        network: from `siamloc.models.build`.
        path: of the file, ending in .safetensors.

    Returns:
        The path.

    Raises:
        ConfigError: another ending, or a custom module.
        StorageError: the disk refuses.
    """
    path = Path(path)
    if path.suffix != ".safetensors":
        raise ConfigError(f"weights are written as safetensors: let the name {path.name} end in .safetensors")
    if not isinstance(network, Network):
        raise ConfigError(f"only a network of siamloc.models.build can be made again, not a {type(network).__name__}")
    write_weights(path, network.state_dict(), {**network.settings, "weights": None})
    return path
