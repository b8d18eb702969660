"""Check what a network gives for images: one descriptor for each, which depends on that image alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from siamloc.errors import DataError, SiamlocError, in_one_line

_AGAIN = 0.01
"""Share of its length by which a descriptor may differ when it is computed again: a GPU may add up in another order,
and one rounding of bfloat16 is up to 0.004."""
_TOGETHER = 0.05
"""The same for an image alone and among others, which other kernels compute: bfloat16 and the 8-bit numbers of some
networks round by about a hundredth, and a network that depends on its batch differs by far more."""


def checked_descriptors(descriptors: Any, images: int) -> Tensor:
    """Check the output of a network for a number of images, and return it.

    Raises:
        DataError: the output is not one descriptor of real numbers per image.
    """
    if not isinstance(descriptors, Tensor) or descriptors.ndim != 2 or len(descriptors) != images:
        raise DataError(
            f"the network must give one descriptor per image, shape ({images}, D), got {shown(descriptors)}"
        )
    if descriptors.is_complex():
        raise DataError(
            "the network gives complex numbers, and descriptors are real: return their real and imaginary parts as "
            "further values, torch.view_as_real(descriptors).flatten(1)"
        )
    return descriptors


def check_repeatable(describes: Callable[[Tensor], tuple[Tensor, ...]], image: Tensor) -> None:
    """Check that a network gives an image the same descriptor again, and among other images.

    Args:
        describes: the network in evaluation mode: images to descriptors, and further parts, which are not checked.
        image: (1, 3, H, W), in [0, 1].

    Raises:
        DataError: descriptors that differ by more than rounding, or a network that does not take the images, or takes
            either one image or several.
    """
    several = torch.cat([image, image / 4, torch.zeros_like(image)])  # of other contrast, as statistics would tell

    def of_the_image(images: Tensor) -> Tensor:
        return checked_descriptors(describes(images)[0], len(images))[0].float()

    try:
        alone, again = of_the_image(image), of_the_image(image)
    except (SiamlocError, MemoryError, torch.OutOfMemoryError):
        raise
    except Exception as error:  # a custom module may raise anything
        try:
            of_the_image(several)
        except Exception:
            size = " x ".join(map(str, image.shape[1:]))
            raise DataError(f"the network cannot take panoramas of {size}: {in_one_line(error)}") from error
        raise DataError(
            f"the network describes several images together but not one alone ({in_one_line(error)}), as a robot "
            "does: use no statistics of the batch in evaluation mode, such as those of track_running_stats=False"
        ) from error
    _check_alike(
        alone,
        again,
        _AGAIN,
        "when it is described again: switch dropout and other random layers off in evaluation mode, as "
        "torch.nn.Dropout does, and torch.nn.functional.dropout(..., training=self.training)",
    )
    try:
        among = of_the_image(several)
    except (MemoryError, torch.OutOfMemoryError):
        raise
    except Exception as error:
        raise DataError(
            f"the network describes one image but not three at once ({in_one_line(error)}), as trainings and maps do: "
            "take the number of images from the input, panorama.shape[0]"
        ) from error
    _check_alike(
        alone,
        among,
        _TOGETHER,
        "when other images are in its batch, and a robot describes one at a time: compute each descriptor from its "
        "image alone, such as along dim=1 instead of dim=0, the images of the batch",
    )


def _check_alike(alone: Tensor, other: Tensor, tolerance: float, problem: str) -> None:
    """Raise DataError if two descriptors of one image differ by more than a share of the length of the first."""
    length, apart = alone.norm(), (alone - other).norm()
    if apart > tolerance * length:  # NaN passes, which is refused where it matters
        raise DataError(
            f"the network gives an image another descriptor, by {float(apart / length):.2g} of its length, {problem}"
        )


def shown(value: Any) -> str:
    """Return a description of the output of a network or a loss, for an error message."""
    return f"shape {tuple(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
