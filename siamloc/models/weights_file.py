"""A network in a safetensors file: its weights, the settings to rebuild it, and a hash of both."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from foundation.files import atomic_path, check_version, parsed_json
from siamloc.errors import ConfigError, FormatError

VERSION = 1
_KEY = "siamloc"


def state_hash(state: Mapping[str, Tensor], length: int = 16) -> str:
    """Return a short hash of the names, types, shapes and values in a state dict, the same on every device."""
    digest = hashlib.sha256()
    for name in sorted(state):
        tensor = state[name].detach().cpu().contiguous()
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()[:length]


def write_weights(path: str | Path, state: Mapping[str, Tensor], model: Mapping[str, Any]) -> None:
    """Write the weights of a network, with convolutions and layers in half precision.

    Equal weights give equal files.

    Args:
        path: of the file, ending in .safetensors.
        state: names and tensors.
        model: arguments of `siamloc.models.build` for the network, as plain values.

    Raises:
        StorageError: the disk refuses.
    """
    from safetensors.torch import save_file

    held = {
        name: (tensor.half() if tensor.ndim > 1 and tensor.is_floating_point() else tensor).cpu().contiguous()
        for name, tensor in state.items()
    }
    about = {"version": VERSION, "model": dict(model)}
    text = json.dumps({**about, "sha256": _hash(held, about)}, sort_keys=True)
    with atomic_path(path) as temporary:
        save_file(held, temporary, metadata={_KEY: text})


def read_weights_file(path: Path) -> tuple[dict[str, Tensor], dict[str, Any] | None]:
    """Return the tensors of a safetensors file in single precision, and the settings of their network.

    The settings are None for files that siamloc did not write.

    Raises:
        ConfigError: a file that is cut short or not a safetensors file.
        FormatError: a file that was altered since siamloc wrote it, or is of another version.
    """
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(path, framework="pt") as file:
            state = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  (it is no mapping)
            text = (file.metadata() or {}).get(_KEY)
    except (SafetensorError, OSError, ValueError) as error:
        raise ConfigError(
            f"the weights file {path} is not a whole state dict ({type(error).__name__}): it is cut short or not a "
            "safetensors file, get it again"
        ) from error
    if text is None:
        return state, None
    try:
        about = parsed_json(text)
        version, digest = about["version"], about.pop("sha256")
    except (ValueError, TypeError, KeyError) as error:
        raise FormatError(f"the weights file {path} was altered since it was written: get it again") from error
    check_version(version, VERSION, f"the weights file {path}", "get it again")
    if digest != _hash(state, about):
        raise FormatError(
            f"the weights file {path} was altered since it was written, its hash is another one: get it again"
        )
    return {name: tensor.float() if tensor.is_floating_point() else tensor for name, tensor in state.items()}, about[
        "model"
    ]


def _hash(state: Mapping[str, Tensor], about: Mapping[str, Any]) -> str:
    text = json.dumps({**about, "state": state_hash(state, 64)}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
