"""Convolutions and pooling around the azimuth: the columns of a panorama are a full turn, so nothing ends at its sides.

A layer of stride s gives W / s columns, rounded up. If s divides W, turning the panorama by s columns turns the output
by one column.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn


class CircularConv2d(nn.Conv2d):
    """A convolution whose columns wrap around; rows are padded with zeros."""

    def _conv_forward(self, input: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        input = _wrapped(input, self.kernel_size[1], self.stride[1], int(self.padding[1]), self.dilation[1])
        rows = int(self.padding[0])
        return F.conv2d(input, weight, bias, self.stride, (rows, 0), self.dilation, self.groups)


class CircularMaxPool2d(nn.MaxPool2d):
    """Max pooling whose columns wrap around."""

    def forward(self, input: Tensor) -> Tensor:
        """Return the pooled features of features (B, C, H, W)."""
        kernel, stride, padding = (_pair(value) for value in (self.kernel_size, self.stride, self.padding))
        input = _wrapped(input, kernel[1], stride[1], padding[1])
        return F.max_pool2d(input, kernel, stride, (padding[0], 0), ceil_mode=self.ceil_mode)


def circular(module: nn.Module) -> nn.Module:
    """Make all convolutions and pools of a module wrap around the azimuth, in place; names and weights stay.

    Returns:
        The module.

    Example:
        >>> from torch import nn
        >>> layer = circular(nn.Sequential(nn.Conv2d(3, 8, kernel_size=5, stride=2, padding=2)))
        >>> panorama = torch.rand(1, 3, 32, 64)
        >>> turned = layer(panorama.roll(2, dims=3))
        >>> torch.allclose(turned, layer(panorama).roll(1, dims=3), atol=1e-6)
        True
    """
    kinds = {nn.Conv2d: CircularConv2d, nn.MaxPool2d: CircularMaxPool2d}
    for part in module.modules():
        if type(part) in kinds and not isinstance(part.padding, str):  # "same" or "valid"
            part.__class__ = kinds[type(part)]
    return module


def _wrapped(features: Tensor, kernel: int, stride: int, left: int, dilation: int = 1) -> Tensor:
    """Pad features with columns from the other side: `left` on the left, and on the right those of the last window."""
    surplus = -features.shape[-1] % stride  # the last window starts before the end of the turn
    right = max(dilation * (kernel - 1) + 1 - stride - left + surplus, 0)
    parts = [features]
    if left:
        parts.insert(0, features[..., -left:])
    if right:
        parts.append(features[..., :right])
    return torch.cat(parts, dim=-1) if len(parts) > 1 else features


def _pair(value: int | tuple[int, ...]) -> tuple[int, int]:
    return (value, value) if isinstance(value, int) else (int(value[0]), int(value[1]))
