"""Published weights of timm and torchvision, from the caches on this machine or from the network."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import torch
from torch import Tensor

from augment.torchvision_compat import ensure_torchvision
from foundation.extras import installing
from siamloc.errors import ConfigError, hint

CACHED, DOWNLOAD = "cached", "download"
"""Published weights by name: those in the cache of this machine; or the same, downloaded first if they are missing."""


def timm() -> Any:
    """Import timm.

    Raises:
        ConfigError: it is not installed.
    """
    ensure_torchvision()
    try:
        return import_module("timm")
    except ModuleNotFoundError as error:
        raise ConfigError(f"networks of timm need the package timm: {installing('timm')}") from error


def timm_file(name: str, weights: str) -> Path:
    """Return the file with the weights of a network of timm, in the cache of the Hugging Face hub.

    Args:
        name: name in timm, such as "resnet10t" or "vit_small_patch14_dinov2.lvd142m".
        weights: `CACHED` or `DOWNLOAD`.

    Raises:
        ConfigError: another name of weights, a network without published weights, or a file that is not in the cache
            or cannot be downloaded.
    """
    if weights not in (CACHED, DOWNLOAD):
        raise ConfigError(
            f"unknown weights {weights!r} for timm/{name}: cached takes them from the cache of the Hugging Face hub, "
            "download fetches them first; or give a path"
        )
    published = timm().get_pretrained_cfg(name)
    if published is None or not published.hf_hub_id:
        raise ConfigError(f"timm publishes no weights of {name}: give the path of a file, or weights=null")
    repository, file = published.hf_hub_id, published.hf_hub_filename or "model.safetensors"
    hub = import_module("huggingface_hub")
    found = hub.try_to_load_from_cache(repository, file)
    if isinstance(found, str):
        return Path(found)
    where = f"https://huggingface.co/{repository}/resolve/main/{file}"
    if weights == CACHED:
        raise ConfigError(
            f"the weights of timm/{name} are not in the cache {hub.constants.HF_HUB_CACHE}: fetch {where} and give the "
            "path of the file, or let weights=download fetch it"
        )
    try:
        return Path(hub.hf_hub_download(repository, file))
    except Exception as error:  # of requests, of the hub, and of the disk
        raise ConfigError(_not_fetched(f"the weights of timm/{name}", where)) from error


def torchvision_weights(name: str, weights: str) -> tuple[Mapping[str, Tensor], str, list[float], list[float]]:
    """Return published weights of a network of torchvision: the state dict, its origin in words, mean and deviation.

    Args:
        name: name in torchvision, such as "vgg16".
        weights: "imagenet" or the name of a torchvision weight enum; or `CACHED`, which never downloads, or `DOWNLOAD`.

    Raises:
        ConfigError: an unknown name, weights that are not in the cache, or a failed download.
    """
    ensure_torchvision()
    from torchvision import models

    enum = models.get_model_weights(name)
    names = dict.fromkeys(("imagenet", CACHED, DOWNLOAD), enum.DEFAULT)
    members = {**names, **{member.name.lower(): member for member in enum}}
    if (member := members.get(weights.lower())) is None:
        valid = ["imagenet", *(member.name for member in enum)]
        raise ConfigError(f"unknown weights {weights!r} for the branch {name!r}: {hint(weights, valid)}, or a path")
    file = Path(torch.hub.get_dir()) / "checkpoints" / Path(member.url).name
    if weights == CACHED and not file.is_file():
        raise ConfigError(
            f"the weights {member} are not on this machine: fetch {member.url} and put it at {file}, or let "
            "weights=download fetch it"
        )
    try:
        state = member.get_state_dict(progress=False, check_hash=True, weights_only=True)
    except (OSError, RuntimeError, EOFError, UnpicklingError) as error:
        if file.is_file():
            raise ConfigError(f"the file {file} with the weights {member} is damaged: remove it") from error
        raise ConfigError(_not_fetched(f"the weights {member}", member.url)) from error
    preset = member.transforms()
    return state, str(member), preset.mean, preset.std


def _not_fetched(what: str, where: str) -> str:
    return (
        f"{what} could not be downloaded from {where}: fetch the file elsewhere and give its path, or use weights=null"
    )
