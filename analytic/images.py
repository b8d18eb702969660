"""Check batches of images and bring them into a common shape, for descriptors, filters and disturbances."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic.errors import AnalyticError

if TYPE_CHECKING:
    from torch import Tensor

LUMA = (0.299, 0.587, 0.114)  # ITU-R BT.601


def shaped(array: Any) -> Any:
    """Return an array or tensor with shape (B, C, H, W), C being 1 or 3.

    Three planes (3, H, W) are one colour image, not three grey ones.

    Raises:
        AnalyticError: any other shape.

    Example:
        >>> shaped(np.zeros((128, 512))).shape, shaped(np.zeros((3, 128, 512))).shape
        ((1, 1, 128, 512), (1, 3, 128, 512))
    """
    shape = tuple(array.shape)
    if array.ndim == 2:
        array = array[None, None]
    elif array.ndim == 3:
        if shape[2] == 3 and shape[0] != 3:
            raise AnalyticError(f"a colour image must have its channels first, (3, H, W), got {shape}: transpose it")
        array = array[None] if shape[0] == 3 else array[:, None]
    if array.ndim != 4 or array.shape[1] not in (1, 3) or 0 in shape:
        raise AnalyticError(f"images must have shape (H, W), (3, H, W), (B, H, W) or (B, 3, H, W), got {shape}")
    return array


def with_channels(images: ArrayLike) -> NDArray[Any]:
    """Return images with unchanged values and shape (B, C, H, W), C being 1 or 3.

    Raises:
        AnalyticError: any other shape, images of different sizes, or neither uint8 nor floating point.

    Example:
        >>> with_channels(np.zeros((5, 128, 512), dtype=np.uint8)).shape
        (5, 1, 128, 512)
    """
    try:
        array = np.asarray(images)
    except ValueError as error:
        raise AnalyticError("the images of a batch must have the same size: resize them first") from error
    array = shaped(array)
    if array.dtype != np.uint8 and array.dtype.kind != "f":
        raise AnalyticError(_wrong_type(array.dtype))
    return array


def as_grey(images: ArrayLike) -> NDArray[np.float32]:
    """Return images as luma, float32 in [0, 1] of shape (B, H, W), without torch.

    Raises:
        AnalyticError: as `with_channels`, or values that are not finite.

    Example:
        >>> as_grey(np.full((3, 2, 2), 51, dtype=np.uint8)).round(3)
        array([[[0.2, 0.2],
                [0.2, 0.2]]], dtype=float32)
    """
    array = with_channels(images)
    if array.dtype == np.uint8:
        array = array / np.float32(255)
    elif not np.isfinite(array).all():
        raise AnalyticError("an image holds values that are not finite: clean it before describing it")
    array = array.astype(np.float32, copy=False)
    return array[:, 0] if array.shape[1] == 1 else np.einsum("bchw,c->bhw", array, np.array(LUMA, dtype=np.float32))


def image_tensor(images: Any) -> Tensor:
    """Return images as a tensor (B, C, H, W) with unchanged values; a tensor stays on its device.

    Raises:
        AnalyticError: as `with_channels`.

    Example:
        >>> image_tensor(np.zeros((3, 128, 512), dtype=np.uint8)).shape
        torch.Size([1, 3, 128, 512])
    """
    import torch

    if not isinstance(images, torch.Tensor):
        return torch.from_numpy(_plain(with_channels(images)))
    tensor = shaped(images)
    if tensor.dtype != torch.uint8 and not tensor.is_floating_point():
        raise AnalyticError(_wrong_type(tensor.dtype))
    return tensor


def unit_tensor(tensor: Tensor, device: str) -> Tensor:
    """Return images (B, C, H, W) as float32 in [0, 1] on a device.

    Raises:
        AnalyticError: floating-point values out of range or not finite, or a device that is not available.

    Example:
        >>> unit_tensor(image_tensor(np.full((1, 2), 51, dtype=np.uint8)), "cpu")
        tensor([[[[0.2000, 0.2000]]]])
    """
    import torch

    tensor = _moved(tensor, device)
    if tensor.dtype == torch.uint8:
        return tensor.to(torch.float32).mul_(1 / 255)
    values = tensor.to(torch.float32)
    low, high = values.aminmax()
    _check_range(float(low), float(high))
    return values


def unit_array(images: ArrayLike) -> NDArray[np.float32]:
    """Return images as float32 in [0, 1] of shape (B, C, H, W), without torch.

    Raises:
        AnalyticError: as `with_channels`, or values out of range or not finite.

    Example:
        >>> unit_array(np.full((1, 2), 51, dtype=np.uint8)).round(3)
        array([[[[0.2, 0.2]]]], dtype=float32)
    """
    array = with_channels(images)
    if array.dtype == np.uint8:
        return array * np.float32(1 / 255)
    values = array.astype(np.float32)
    _check_range(float(values.min()), float(values.max()))
    return values


def grey_array(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the luma (B, H, W) of images (B, C, H, W), without torch."""
    if values.shape[1] == 1:
        return values[:, 0]
    red, green, blue = (values[:, channel] * np.float32(share) for channel, share in enumerate(LUMA))
    return np.asarray(red + green + blue, dtype=np.float32)


@cache
def torch_is_there() -> bool:
    """Check whether torch is installed, without loading it."""
    return find_spec("torch") is not None


def _check_range(low: float, high: float) -> None:
    if not (low >= 0 and high <= 1):
        bad = "not finite" if not np.isfinite(low + high) else f"between {low:g} and {high:g}"
        raise AnalyticError(f"floating-point images must have values in [0, 1], got values {bad}")


def grey_tensor(values: Tensor) -> Tensor:
    """Return the luma (B, H, W) of images (B, C, H, W).

    Example:
        >>> grey_tensor(unit_tensor(image_tensor(np.full((3, 1, 2), 255, dtype=np.uint8)), "cpu"))
        tensor([[[1., 1.]]])
    """
    if values.shape[1] == 1:
        return values[:, 0]
    red, green, blue = values.unbind(1)
    return (red * LUMA[0]).add_(green, alpha=LUMA[1]).add_(blue, alpha=LUMA[2])


def _wrong_type(found: Any) -> str:
    return f"images must be uint8 or floating point in [0, 1], got {found}"


def _moved(tensor: Tensor, device: str) -> Tensor:
    """Return a tensor on a device; torch's own errors for a missing device take several sentences."""
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
