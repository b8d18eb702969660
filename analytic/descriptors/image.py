"""What the seven descriptors of images have in common: grey values in, parameters as fields, errors for bad sizes."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, fields
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.descriptors.base import Alignment, Description, Descriptor, joined, shaped, with_channels
from analytic.descriptors.threads import each
from analytic.errors import AnalyticError

if TYPE_CHECKING:
    from torch import Tensor

_LUMA = (0.299, 0.587, 0.114)
_PIXELS = 1 << 18  # in work at once on one thread: fewer would have the threads wait on one another for the next call
_KINDS: dict[str, tuple[type, type, str]] = {
    "bool": (bool, bool, "True or False"),
    "int": (Integral, int, "a whole number"),
    "float": (Real, float, "a number"),
    "str": (str, str, "a text"),
}
Part = Any  # a tensor, or an array


@dataclass(frozen=True, kw_only=True)
class ImageDescriptor(Descriptor):
    """A descriptor of grey images. Subclasses are frozen dataclasses whose fields are the parameters.

    Args:
        circular: whether columns are azimuth and wrap around. An ordinary camera's do not; it has no heading either.
        homomorphic: whether images go through `analytic.filters.homomorphic` first ([C] 2.4).
        device: where torch computes; it changes no result beyond rounding and is no part of the identity.
    """

    circular: bool = True
    homomorphic: bool = False
    device: str = "cpu"

    def __post_init__(self) -> None:
        for field in fields(self):
            kind, plain, wanted = _KINDS[str(field.type)]
            value = getattr(self, field.name)
            value = value.item() if isinstance(value, np.generic) else value
            if not isinstance(value, kind) or isinstance(value, bool) != (kind is bool):
                raise AnalyticError(f"{self.name} needs {wanted} for {field.name}, got {value!r}")
            object.__setattr__(self, field.name, plain(value))
        self._check_parameters()

    @property
    def identity(self) -> dict[str, Any]:
        """Name and parameters."""
        return {"name": self.name, **{f.name: getattr(self, f.name) for f in fields(self) if f.name != "device"}}

    @property
    def tells_heading(self) -> bool:
        """Whether columns wrap around; without that there is no heading."""
        return self.circular

    @abstractmethod
    def resolution(self, width: int) -> float:
        """Return the smallest turn that the orientation part tells, rad, on images of that many columns."""

    @abstractmethod
    def sizes(self, height: int, width: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the shapes of position and orientation of one image, as [T] table 3.2 writes them."""

    def describe(self, batch: ArrayLike) -> Description:
        """Describe grey or colour images (colour becomes BT.601 luma).

        Args:
            batch: (B, H, W), (B, 3, H, W) or one image (H, W), (3, H, W); uint8, or floating point in [0, 1]. A
                tensor may lie on any device.

        Raises:
            AnalyticError: another shape or type, images of different sizes, values that are not finite or out of
                range, a size that the parameters do not fit.
        """
        images = image_tensor(batch)
        height, width = int(images.shape[2]), int(images.shape[3])
        if width < 2:
            raise AnalyticError(f"a panorama needs at least 2 columns, got {height} x {width} pixels")
        self._check_size(height, width)
        # A few images at a time: they stay in the cache, and are enough work for a thread between two calls.
        few = max(1, _PIXELS // (height * width)) if self.device == "cpu" else len(images)
        parts = each(self._describe_part, images.split(few))
        return Description(*joined(parts), self.identity)

    def _describe_part(self, images: Tensor) -> tuple[NDArray[Any], NDArray[Any]]:
        import torch

        with torch.inference_mode():
            grey = grey_tensor(images, self.device)
            if self.homomorphic:
                from analytic.filters import homomorphic_tensor

                grey = homomorphic_tensor(grey, circular=self.circular)
            position, orientation = self._describe(grey)
            return _array(position), _array(orientation)

    def align(self, queries: Description, references: Description) -> Alignment:
        """Return the relative heading and the aligned distance of every query to every reference; see `Descriptor`."""
        self.check_turns()
        return super().align(queries, references)

    def check_turns(self) -> None:
        """Raise AnalyticError if columns do not wrap around, so that there is no heading to be found."""
        if not self.circular:
            raise AnalyticError(
                f"{self.name} was made with circular=False: the columns of an ordinary camera are no full turn, so "
                "there is no relative heading to be found"
            )

    @abstractmethod
    def _check_parameters(self) -> None:
        """Raise AnalyticError for parameters that fit no image."""

    @abstractmethod
    def _check_size(self, height: int, width: int) -> None:
        """Raise AnalyticError, naming sizes that would do, for images that the parameters do not fit."""

    @abstractmethod
    def _describe(self, grey: Tensor) -> tuple[Part, Part]:
        """Return position (B, D) and orientation (B, K, F) of grey images (B, H, W), float32 in [0, 1]."""


def image_tensor(images: Any) -> Tensor:
    """Return images as a tensor (B, C, H, W), where they lie. Errors as `ImageDescriptor.describe`."""
    import torch

    if not isinstance(images, torch.Tensor):
        return torch.from_numpy(_plain(with_channels(images)))
    tensor = shaped(images)
    if tensor.dtype != torch.uint8 and not tensor.is_floating_point():
        raise AnalyticError(f"images must be uint8 or floating point in [0, 1], got {tensor.dtype}")
    return tensor


def grey_tensor(tensor: Tensor, device: str) -> Tensor:
    """Return images (B, C, H, W) as luma (B, H, W), float32 in [0, 1], on a device. Errors as `describe`."""
    import torch

    tensor = _moved(tensor, device)
    if tensor.dtype == torch.uint8:
        values = tensor.to(torch.float32).mul_(1 / 255)
    else:
        values = tensor.to(torch.float32)
        low, high = (float(value) for value in values.aminmax())
        if not (low >= 0 and high <= 1):
            bad = "not finite" if not np.isfinite(low + high) else f"between {low:g} and {high:g}"
            raise AnalyticError(f"floating-point images must have values in [0, 1], got values {bad}")
    if values.shape[1] == 1:
        return values[:, 0]
    red, green, blue = values.unbind(1)
    return (red * _LUMA[0]).add_(green, alpha=_LUMA[1]).add_(blue, alpha=_LUMA[2])


def _moved(tensor: Tensor, device: str) -> Tensor:
    """Return a tensor on a device, which torch does not name in one sentence when it lacks it."""
    import torch

    try:
        return tensor.to(device)
    except (RuntimeError, AssertionError) as error:
        if isinstance(error, torch.OutOfMemoryError):
            raise
        raise AnalyticError(
            f"torch cannot compute on device={device!r} here: use 'cpu', or 'cuda' where there is a GPU"
        ) from error


def _plain(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array that torch takes without a warning: writable, of native byte order, with forward strides."""
    if array.flags.writeable and array.dtype.isnative and all(stride >= 0 for stride in array.strides):
        return array
    return np.array(array, dtype=array.dtype.newbyteorder("="), order="C")


def _array(part: Part) -> NDArray[Any]:
    return np.ascontiguousarray(part if isinstance(part, np.ndarray) else part.cpu().numpy())


def divisors_near(number: int, wanted: int) -> str:
    """Return, for an error, the divisors of a number next to one that does not divide it."""
    every = [d for d in range(1, number + 1) if number % d == 0]
    below = [d for d in every if d <= wanted][-1:]
    above = [d for d in every if d > wanted][:1]
    return " or ".join(map(str, below + above))
