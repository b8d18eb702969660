"""Reading checkpoints of `SiameseModule` without running anything that may stand in them."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import torch

from siamloc.errors import FormatError

FORMAT_KEY = "siamloc_format"
FORMAT_VERSION = 1


def read_checkpoint(path: str | Path, mmap: bool = False) -> dict[str, Any]:
    """Read a checkpoint of `SiameseModule`: a dictionary with `state_dict` and `hyper_parameters`.

    Args:
        path: of the file that Lightning wrote.
        mmap: leave the weights on the disk until they are used.

    Raises:
        FormatError: the file is missing, not whole, not such a checkpoint, or of a newer version.
    """
    path = Path(path)
    if not path.is_file():
        raise FormatError(f"the checkpoint {path} does not exist")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what torch says of a foreign file would hide our own sentence
            content = torch.load(path, map_location="cpu", weights_only=True, mmap=mmap)
    except Exception as error:  # zip, pickle and torch each raise their own kinds
        raise FormatError(
            f"the checkpoint {path} cannot be read ({type(error).__name__}): it is cut short, or no file of plain "
            f"tensors and values; train again or take another checkpoint"
        ) from error
    keys = ("state_dict", "hyper_parameters")
    if not isinstance(content, dict) or not all(isinstance(content.get(key), dict) for key in keys):
        raise FormatError(f"{path} is no checkpoint of a siamese network: it has no weights or no hyper-parameters")
    version = content.get(FORMAT_KEY, 0)
    if not isinstance(version, int) or version > FORMAT_VERSION:
        raise FormatError(
            f"the checkpoint {path} has format {version}, this version of siamloc reads up to {FORMAT_VERSION}: "
            f"update siamloc"
        )
    return content


def read_hyperparameters(path: str | Path) -> dict[str, Any]:
    """Return the hyper-parameters of a checkpoint as plain values; the weights stay on the disk.

    Raises:
        FormatError: as `read_checkpoint`.
    """
    return dict(read_checkpoint(path, mmap=True)["hyper_parameters"])
