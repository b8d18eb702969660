"""A small residual network for panoramas that trains from random weights in minutes ([He 2016], at low resolution)."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor, nn

BLOCKS = (1, 2, 2, 1)  # in each stage
STRIDES = (1, 2, 2, 1)  # of each stage, after the stem has halved rows and columns twice


def residual_features(widths: Sequence[int]) -> nn.Sequential:
    """Make the layers: a stem, then four stages of residual blocks. Rows and columns shrink to a sixteenth.

    Args:
        widths: channels of the four stages.
    """
    layers: list[nn.Module] = [
        nn.Conv2d(3, widths[0], kernel_size=5, stride=2, padding=2, bias=False),
        nn.BatchNorm2d(widths[0]),
        nn.ReLU(inplace=True),
        nn.AvgPool2d(2),
    ]
    channels = widths[0]
    for width, blocks, stride in zip(widths, BLOCKS, STRIDES, strict=True):
        for number in range(blocks):
            layers.append(ResidualBlock(channels, width, stride if number == 0 else 1))
            channels = width
    return nn.Sequential(*layers)


class ResidualBlock(nn.Module):
    """Two 3 x 3 convolutions, added to the input.

    Args:
        inputs: number of input channels.
        outputs: number of output channels.
        stride: factor by which rows and columns shrink.
    """

    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.first = nn.Sequential(
            nn.Conv2d(inputs, outputs, kernel_size=3, stride=stride, padding=1, bias=False), nn.BatchNorm2d(outputs)
        )
        self.second = nn.Sequential(
            nn.Conv2d(outputs, outputs, kernel_size=3, padding=1, bias=False), nn.BatchNorm2d(outputs)
        )
        self.shortcut: nn.Module = nn.Identity()
        if stride > 1 or inputs != outputs:
            # Averaging before the 1 x 1 convolution uses every pixel.
            self.shortcut = nn.Sequential(
                nn.AvgPool2d(stride, ceil_mode=True) if stride > 1 else nn.Identity(),
                nn.Conv2d(inputs, outputs, kernel_size=1, bias=False),
                nn.BatchNorm2d(outputs),
            )
        self.relu = nn.ReLU(inplace=True)

    def forward(self, features: Tensor) -> Tensor:
        """Return features (B, outputs, h / stride, w / stride)."""
        return self.relu(self.second(self.relu(self.first(features))) + self.shortcut(features))
