"""The branch: normalization, then the convolutional layers that extract features ([T] 5.3.1, table 5.1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import torch
from torch import Tensor, nn

from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError
from siamloc.models.registry import branch_spec

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)
SIMPLE_GRID = (4, 16)


class Branch(nn.Module):
    """A feature extractor: (B, 3, H, W) in [0, 1] -> (B, C, h, w).

    The channels are normalized first, with the mean and standard deviation of ImageNet unless the loaded weights
    say otherwise. Branches without ImageNet weights use the same numbers: they bring indoor images close to zero
    mean and unit variance, which is what He initialization counts on, and one input convention serves all.

    The torchvision networks keep their own stride: nothing is pooled or scaled to a fixed grid after them. At
    128 x 512 VGG and DenseNet give 4 x 16, AlexNet 3 x 15. DenseNet ends in a ReLU as it does in its paper. The
    simple branches keep the full resolution through three 3 x 3 convolutions and then average it to 4 x 16.

    Args:
        name: a name in `BRANCHES`.

    Raises:
        ConfigError: an unknown name.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name
        self.features = _features(name)
        self.register_buffer("mean", torch.empty(1, 3, 1, 1))
        self.register_buffer("std", torch.empty(1, 3, 1, 1))
        self.normalize_with(IMAGENET_MEAN, IMAGENET_STD)

    def normalize_with(self, mean: Sequence[float], std: Sequence[float]) -> None:
        """Set what the red, green and blue channels are normalized with, in units of [0, 1]."""
        for buffer, values in ((self.mean, mean), (self.std, std)):
            with torch.no_grad():
                buffer.copy_(torch.tensor(list(values), dtype=buffer.dtype, device="cpu").view(1, 3, 1, 1))

    def forward(self, panorama: Tensor) -> Tensor:
        """Return the features of panoramas (B, 3, H, W) in [0, 1]."""
        return self.features((panorama - self.mean) / self.std)


@lru_cache(maxsize=256)
def feature_shape(name: str, image_size: tuple[int, int]) -> tuple[int, int, int]:
    """Return channels, rows and columns of the features at an image size (H, W); computes shapes only.

    Raises:
        ConfigError: an unknown branch, or an image smaller than the branch can take.
    """
    shape = _shape_or_none(name, *image_size)
    if shape is None:
        rows, columns = smallest_size(name)
        raise ConfigError(
            f"an image of {image_size[0]} x {image_size[1]} pixels is too small for the branch {name!r}: "
            f"it needs at least {rows} x {columns}"
        )
    return shape


@lru_cache(maxsize=64)
def smallest_size(name: str) -> tuple[int, int]:
    """Return the smallest image (H, W) that the branch can take; each side alone may be as small as that."""
    if branch_spec(name).widths is not None:
        return SIMPLE_GRID
    side = _first(lambda side: _shape_or_none(name, side, side) is not None, enough=256)
    return side, side  # their kernels are square, so that rows and columns are treated alike


def _features(name: str) -> nn.Sequential:
    widths = branch_spec(name).widths
    if widths is not None:
        layers: list[nn.Module] = []
        for inputs, outputs in zip((3, *widths), widths, strict=False):
            layers += [nn.Conv2d(inputs, outputs, kernel_size=3, padding=1), nn.ReLU(inplace=True)]
        return nn.Sequential(*layers, nn.AdaptiveAvgPool2d(SIMPLE_GRID))
    ensure_torchvision()
    from torchvision import models

    # The classifier, most of such a network, is thrown away: on the meta device it is never allocated.
    with torch.device("meta"):
        features = models.get_model(name, weights=None).features
    device = torch.empty(0).device
    features = features.to_empty(device=device)
    if name.startswith("densenet"):
        features.append(nn.ReLU(inplace=True))
    return features


@lru_cache(maxsize=32)
def _weightless(name: str) -> nn.Module:
    with torch.device("meta"):
        return _features(name).eval()


def _shape_or_none(name: str, rows: int, columns: int) -> tuple[int, int, int] | None:
    if branch_spec(name).widths is not None and (rows < SIMPLE_GRID[0] or columns < SIMPLE_GRID[1]):
        return None
    try:
        with torch.no_grad():
            channels, height, width = _weightless(name)(torch.empty(1, 3, rows, columns, device="meta")).shape[1:]
    except RuntimeError:
        return None
    return (channels, height, width) if height > 0 and width > 0 else None


def _first(holds: Callable[[int], bool], enough: int) -> int:
    below = 0
    while enough - below > 1:
        middle = (below + enough) // 2
        below, enough = (below, middle) if holds(middle) else (middle, enough)
    return enough
