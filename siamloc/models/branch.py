"""The branches: the convolutional part of a network, and the shapes of its features ([T] 5.3)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import cast

import numpy as np
import torch
from torch import Tensor, nn

from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError
from siamloc.models.circular import circular as around
from siamloc.models.registry import branch_spec

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)
SIMPLE_GRID = (4, 16)
BLOCKS = (1, 2, 2, 1)  # in each stage
STRIDES = (1, 2, 2, 1)  # of each stage, after the stem has halved rows and columns twice
DARK = 1e-3  # avoids division by 0 for an image without contrast
SURROUNDINGS = 0.15  # reach of the surroundings of a pixel, in image heights
FAINT = 0.02  # keeps the noise of dark pixels small in their logarithm
LEAST_CONTRAST = 0.03  # of the surroundings, in units of [0, 1]: anything below is noise, which must not be amplified


class Branch(nn.Module):
    """A feature extractor: (B, 3, H, W) in [0, 1] -> (B, C, h, w).

    The images are normalized first. "channels" uses the mean and standard deviation of ImageNet unless the loaded
    weights say otherwise; branches without ImageNet weights use the same numbers, which bring indoor images close to
    zero mean and unit variance, as He initialization assumes. "image" normalizes each image by its own mean and
    deviation, so that neither exposure nor contrast matters. "local" and "local_brightness" normalize the surroundings
    of each pixel, see `by_surroundings`. "local_and_colours" gives the first layer six channels: those of "local", and
    `logarithms`, in which the colours and brightness of large surfaces remain.

    The torchvision networks keep their own stride: their output is not pooled or scaled to a fixed grid. At 128 x 512
    VGG and DenseNet give 4 x 16, AlexNet 3 x 15. DenseNet ends in a ReLU, as in its paper. The simple branches keep
    the full resolution through three 3 x 3 convolutions and then average it to 4 x 16. If the columns wrap around,
    AlexNet gives 3 x 16.

    Args:
        name: a name in `BRANCHES`.
        circular: whether convolutions and pools wrap around the azimuth.
        normalize: a name in `NORMALIZATIONS`.
        features: the layers; those of the name if None.

    Raises:
        ConfigError: an unknown name.
    """

    mean: Tensor
    std: Tensor

    def __init__(
        self, name: str, circular: bool = False, normalize: str = "channels", features: nn.Sequential | None = None
    ) -> None:
        super().__init__()
        self.name, self.circular, self.normalize = name, circular, normalize
        self.features = _features(name, circular, channels_of(normalize)) if features is None else features
        self.register_buffer("mean", torch.empty(1, 3, 1, 1))
        self.register_buffer("std", torch.empty(1, 3, 1, 1))
        self.normalize_with(IMAGENET_MEAN, IMAGENET_STD)

    def normalize_with(self, mean: Sequence[float], std: Sequence[float]) -> None:
        """Set the normalization of the red, green and blue channels, in units of [0, 1]."""
        for buffer, values in ((self.mean, mean), (self.std, std)):
            with torch.no_grad():
                buffer.copy_(torch.tensor(list(values), dtype=buffer.dtype, device="cpu").view(1, 3, 1, 1))

    def shapes(self, image_size: tuple[int, int]) -> list[tuple[int, int, int]]:
        """Return channels, rows and columns after each layer at an image size (H, W).

        Raises:
            ConfigError: an image too small for the branch.
        """
        return layer_shapes(self.name, image_size, self.circular)

    @property
    def stages(self) -> list[list[nn.Module]]:
        """The layers by resolution; a layer without weights counts with the layer before it."""
        stages: list[list[nn.Module]] = [[]]
        before: list[int] | None = None
        shapes = layer_shapes(self.name, (256, 256), self.circular)
        for layer, (_, *resolution) in zip(self.features, shapes, strict=True):
            if next(layer.parameters(), None) is not None:
                if before not in (None, resolution):
                    stages.append([])
                before = resolution
            stages[-1].append(layer)
        return stages

    def forward(self, panorama: Tensor) -> Tensor:
        """Return the features of panoramas (B, 3, H, W) in [0, 1]."""
        return self.features(self.normalized(panorama))

    def both(self, panorama: Tensor, level: int) -> tuple[Tensor, Tensor]:
        """Return two outputs of one pass: of the first `level` layers, and of all layers (the features)."""
        first = self.features[:level](self.normalized(panorama))
        return first, self.features[level:](first)

    def normalized(self, panorama: Tensor) -> Tensor:
        """Return panoramas (B, 3, H, W) in [0, 1] normalized for the first layer, as `normalize` says."""
        if self.normalize == "channels":
            return (panorama - self.mean) / self.std
        if self.normalize == "image":
            return by_image(panorama)
        if self.normalize == "local_and_colours":
            return torch.cat([by_surroundings(panorama, self.circular), logarithms(panorama)], dim=1)
        return by_surroundings(panorama, self.circular, colours=self.normalize == "local")


def channels_of(normalize: str) -> int:
    """Return the number of channels of normalized images, by a name in `NORMALIZATIONS`."""
    return 6 if normalize == "local_and_colours" else 3


def finer_features(branch: Branch, image_size: tuple[int, int]) -> tuple[int, tuple[int, int, int]] | None:
    """Return where a branch has features with at least twice as many columns as its output.

    Args:
        branch: the branch.
        image_size: rows and columns of the images.

    Returns:
        The number of layers up to the last features with so many columns, 0 for the image itself; and the channels,
        rows and columns of these features. None if not even the image has so many columns.
    """
    found = [(channels_of(branch.normalize), *image_size), *branch.shapes(image_size)]
    finer = [number for number, one in enumerate(found) if one[2] >= 2 * found[-1][2]]
    return (finer[-1], found[finer[-1]]) if finer else None


@lru_cache(maxsize=256)
def layer_shapes(name: str, image_size: tuple[int, int], circular: bool) -> list[tuple[int, int, int]]:
    """Return channels, rows and columns after each layer of a branch; only shapes are computed.

    Args:
        name: a name in `BRANCHES`.
        image_size: rows and columns of the images.
        circular: whether convolutions and pools wrap around the azimuth.

    Raises:
        ConfigError: an unknown branch, or an image too small for it.
    """
    small = branch_spec(name).kind == "simple" and any(np.less(image_size, SIMPLE_GRID))
    found, features = [], torch.empty(1, 3, *image_size, device="meta")
    try:
        with torch.no_grad():
            for layer in _weightless(name, circular):
                features = layer(features)
                channels, rows, columns = features.shape[1:]
                found.append((channels, rows, columns))
    except RuntimeError:  # a layer has no pixel to give
        small = True
    if small or min(found[-1]) < 1:
        raise ConfigError(
            f"an image of {image_size[0]} x {image_size[1]} pixels is too small for the branch {name!r}: take larger "
            "images, or a branch that shrinks them less"
        )
    return found


def _features(name: str, circular: bool = False, channels: int = 3) -> nn.Sequential:
    spec = branch_spec(name)
    if spec.kind == "residual":
        features: nn.Sequential = residual_features(spec.widths, channels)
    elif spec.kind == "simple":
        layers: list[nn.Module] = []
        for inputs, outputs in zip((channels, *spec.widths), spec.widths, strict=False):
            layers += [nn.Conv2d(inputs, outputs, kernel_size=3, padding=1), nn.ReLU(inplace=True)]
        pool = nn.AdaptiveAvgPool2d(SIMPLE_GRID)
        pool.register_forward_hook(_keep_layout)
        features = nn.Sequential(*layers, pool)
    elif channels == 3:
        ensure_torchvision()
        from torchvision import models

        features = models.get_model(name, weights=None).features
        if name.startswith("densenet"):
            features.append(nn.ReLU(inplace=True))
    else:
        raise ConfigError(f"the first layer of {name} has three channels: leave normalize=local_and_colours out")
    return cast(nn.Sequential, around(features)) if circular else features


def _keep_layout(_pool: nn.Module, inputs: tuple[Tensor], pooled: Tensor) -> None:
    """Put the gradient of what was pooled into the memory layout of the features.

    If it has another one, a CPU copies the gradients of all layers before, which takes a quarter of a training step.
    """
    (features,) = inputs
    if pooled.requires_grad and features.is_cpu and features.is_contiguous(memory_format=torch.channels_last):
        pooled.register_hook(lambda gradient: gradient.contiguous(memory_format=torch.channels_last))


@lru_cache(maxsize=32)
def _weightless(name: str, circular: bool) -> nn.Sequential:
    with torch.device("meta"):
        return _features(name, circular).eval()


def residual_features(widths: Sequence[int], inputs: int = 3) -> nn.Sequential:
    """Make the layers of a residual branch: a stem, then four stages of residual blocks. Rows and columns shrink
    to a sixteenth.

    Args:
        widths: channels of the four stages.
        inputs: channels of the normalized images.
    """
    layers: list[nn.Module] = [
        nn.Conv2d(inputs, widths[0], kernel_size=5, stride=2, padding=2, bias=False),
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
        inputs: channels of the input.
        outputs: channels of the output.
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


def by_image(panorama: Tensor) -> Tensor:
    """Give each image (B, 3, H, W) zero mean and unit variance: neither exposure nor contrast matters."""
    centred = panorama - panorama.mean(dim=(1, 2, 3), keepdim=True)
    deviation = centred.square().mean(dim=(1, 2, 3), keepdim=True).sqrt()
    return centred / (deviation + DARK)


def logarithms(panorama: Tensor) -> Tensor:
    """Return log(I + 0.02) minus its mean over each image (B, 3, H, W): a gain of the whole image changes nothing."""
    found = (panorama.clamp(min=0) + FAINT).log()
    return found - found.mean(dim=(1, 2, 3), keepdim=True)


def by_surroundings(panorama: Tensor, circular: bool, *, colours: bool = True) -> Tensor:
    """Give the surroundings of each pixel zero mean and unit contrast, which removes even uneven light.

        (I - m) / (s + s0),   s^2 = mean over the surroundings and the colours of (I - m)^2,

    with m the mean over a square around the pixel that reaches 0.15 H to each side, and s0 = 0.03 ([Jarrett 2009], with
    a square instead of a Gaussian). A room twice as bright looks the same, even if another part of the image keeps its
    brightness. The result shows edges and textures.

    Args:
        panorama: (B, 3, H, W), floating point in [0, 1].
        circular: whether the columns wrap around; if not, and at the top and bottom, the edge is repeated.
        colours: if True, m is the mean of each colour, which also removes the colour of the light. Otherwise m is the
            mean of all three: a coloured wall keeps its colour.
    """
    height, width = panorama.shape[-2:]
    reach = max(round(SURROUNDINGS * height), 1)
    rows = _means(height, reach, False, panorama)
    columns = _means(width, reach, circular, panorama).T
    # The means of a square are products with a matrix from each side, much faster than pooling on a CPU. They stay in
    # full precision, since they are subtracted from nearly equal numbers.
    with torch.autocast(device_type=panorama.device.type, enabled=False):
        level = panorama if colours else panorama.mean(dim=1, keepdim=True)
        centred = panorama - rows @ (level @ columns)
        square = centred.square().mean(dim=1, keepdim=True)
        return centred / ((rows @ (square @ columns)).clamp(min=0).sqrt() + LEAST_CONTRAST)


def _means(size: int, reach: int, wraps: bool, like: Tensor) -> Tensor:
    """Return the matrix (size, size) that averages each place with those up to `reach` away."""
    beside = torch.arange(size, device=like.device)[:, None] + torch.arange(-reach, reach + 1, device=like.device)
    source = beside % size if wraps else beside.clamp(0, size - 1)
    weight = torch.full(source.shape, 1 / source.shape[1], dtype=like.dtype, device=like.device)
    return torch.zeros(size, size, dtype=like.dtype, device=like.device).scatter_add(1, source, weight)
