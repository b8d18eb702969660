"""`chosen_device`: where images are described."""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.errors import ConfigError

if TYPE_CHECKING:
    import torch


def chosen_device(device: str | torch.device) -> str:
    """Return the name of a torch device, after checking that torch can compute there.

    Args:
        device: name such as "cpu", "cuda" or "cuda:1"; "auto" is the GPU if torch finds one, else the CPU.

    Raises:
        ConfigError: another name, or a device that this machine does not have.
    """
    import torch

    gpus = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if device == "auto":
        return "cuda" if gpus else "cpu"
    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        here = ", ".join(["auto", "cpu", *(f"cuda:{number}" for number in range(gpus))])
        raise ConfigError(f"torch cannot compute on device={str(device)!r} here: use one of {here}") from error
    return str(device)
