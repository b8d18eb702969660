"""Describing images with a network: the mode, the types and the chunks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from siamloc.errors import DataError

CHUNK = 64
_ROUNDING = 1e-3


@contextmanager
def evaluating(module: nn.Module) -> Iterator[None]:
    """Put a module into evaluation mode without gradients; afterwards every part has the mode it had before."""
    modes = [(part, part.training) for part in module.modules()]
    module.eval()
    try:
        with torch.inference_mode():
            yield
    finally:
        for part, training in modes:
            part.training = training


def as_float(images: Tensor) -> Tensor:
    """Return images as floating point in [0, 1]: uint8 divided by 255, floating point as it is.

    Raises:
        DataError: another type.
    """
    if images.dtype == torch.uint8:
        return images.float() / 255
    if not images.is_floating_point():
        raise DataError(f"images must be uint8 or floating point in [0, 1], got {images.dtype}")
    return images


def describe(network: nn.Module, batch: Any, chunk: int = CHUNK) -> NDArray[np.float32]:
    """Return the descriptors (B, D) of images in evaluation mode and full precision.

    Args:
        network: (B, 3, H, W) in [0, 1] -> (B, D).
        batch: array or tensor (B, 3, H, W), (3, H, W), (B, H, W) or (H, W), uint8 or floating point in [0, 1];
            grey images are repeated over the three channels.
        chunk: images in one pass. It bounds the memory and changes no result beyond rounding.

    Raises:
        DataError: another shape or type, values that are not finite or outside [0, 1].
    """
    images = _as_images(batch)
    parameter = next(network.parameters())
    with evaluating(network), torch.autocast(device_type=parameter.device.type, enabled=False):
        parts = [network(_ready(part, parameter)).float().cpu() for part in images.split(chunk)]
    return torch.cat(parts).numpy()


def _as_images(batch: Any) -> Tensor:
    images = batch.detach() if isinstance(batch, Tensor) else torch.from_numpy(np.ascontiguousarray(batch))
    if images.ndim == 3 and images.shape[0] != 3:
        images = images.unsqueeze(1)
    while images.ndim < 4:
        images = images.unsqueeze(0)
    if images.ndim != 4 or images.shape[1] not in (1, 3) or 0 in images.shape:
        shape = tuple(np.shape(batch))
        raise DataError(f"images must have shape (H, W), (3, H, W), (B, H, W) or (B, 3, H, W), got {shape}")
    return images.expand(-1, 3, -1, -1)


def _ready(images: Tensor, parameter: Tensor) -> Tensor:
    images = as_float(images.to(parameter.device))
    # Written so that NaN fails it too.
    if not bool((images.min() >= -_ROUNDING) & (images.max() <= 1 + _ROUNDING)):
        raise DataError("floating point images must lie in [0, 1]: divide them by 255, or clean them of NaN")
    return images.to(parameter.dtype)
