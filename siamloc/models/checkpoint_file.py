"""Read a checkpoint file without running any code in it."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from foundation.files import check_version
from siamloc.errors import FormatError

CONTENT_KEY = "siamloc"
FORMAT_VERSION = 2


def read_checkpoint(path: str | Path, mmap: bool = False) -> dict[str, Any]:
    """Read a checkpoint of `SiameseModule`: a dictionary with `state_dict` and, under "siamloc", what was trained.

    Args:
        path: of the file that Lightning wrote.
        mmap: leave the weights on the disk until they are used.

    Raises:
        FormatError: the file is missing, incomplete, not such a checkpoint, or of another version.
    """
    path = Path(path)
    if not path.is_file():
        raise FormatError(f"the checkpoint {path} does not exist")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings of torch about a foreign file would hide our own message
            content = torch.load(path, map_location="cpu", weights_only=True, mmap=mmap)
    except Exception as error:  # zip, pickle and torch each raise their own errors
        raise FormatError(
            f"the checkpoint {path} cannot be read ({type(error).__name__}): it is cut short, or holds more than "
            f"tensors and plain values; train again or take another checkpoint"
        ) from error
    return checked_content(content, path)


def checked_content(content: Any, path: Path) -> dict[str, Any]:
    """Check the contents of a checkpoint, and return them.

    Raises:
        FormatError: the checkpoint is not from `SiameseModule`, or of another version.
    """
    if not isinstance(content, dict) or not isinstance(content.get("state_dict"), dict):
        raise FormatError(f"{path} is not a checkpoint of a siamese network: it has no weights")
    about = content.get(CONTENT_KEY)
    if not isinstance(about, dict) or not {"format", "model", "loss"} <= set(about):
        raise FormatError(f"{path} is not a checkpoint of a siamese network: it does not say what was trained")
    check_version(about["format"], FORMAT_VERSION, f"the checkpoint {path}", "train again")
    return content


def network_state(content: Mapping[str, Any]) -> dict[str, Tensor]:
    """Return only the weights of the network, by their names in it."""
    states = content["state_dict"].items()
    return {name.removeprefix("network."): tensor for name, tensor in states if name.startswith("network.")}
