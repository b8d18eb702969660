"""Checks of what a network and a loss return, so that a mistake in them is one sentence."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from siamloc.errors import DataError


def name_of(thing: object) -> str:
    """Return the qualified name of a function, or of the class of an object."""
    return str(getattr(thing, "__qualname__", type(thing).__qualname__))


def shown(value: Any) -> str:
    """Describe the output of a network or a loss for an error message."""
    return f"shape {tuple(value.shape)}" if isinstance(value, Tensor) else type(value).__name__


def checked_descriptors(descriptors: Any, images: int) -> Tensor:
    """Check the output of a network for a number of images, and return it.

    Raises:
        DataError: the output is not one descriptor per image.
    """
    if not isinstance(descriptors, Tensor) or descriptors.ndim != 2 or len(descriptors) != images:
        raise DataError(
            f"the network must give one descriptor per image, shape ({images}, D), got {shown(descriptors)}"
        )
    return descriptors


def checked_loss(loss: Any, kind: object, training: bool) -> Tensor:
    """Check the output of a loss, and return it as a scalar.

    Raises:
        DataError: the output is not one number, or in training a number without a gradient.
    """
    if not isinstance(loss, Tensor) or loss.numel() != 1:
        raise DataError(f"the loss {name_of(kind)} must give one number, got {shown(loss)}")
    if training and not loss.requires_grad:
        raise DataError(
            f"the loss {name_of(kind)} gives a number without a gradient, so nothing can be learned from it: compute "
            "it from the descriptors without detach(), item() or NumPy"
        )
    return loss.squeeze()
