"""Heads: turn the features of a panorama, (B, C, h, w), into its descriptor, (B, D)."""

from __future__ import annotations

from itertools import pairwise
from typing import ClassVar

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

from siamloc.errors import ConfigError
from siamloc.models.registry import HEADS, head_widths

_SMALLEST = 1e-6
_POWER = 0.7  # of the magnitudes; stored maps depend on it


class Head(nn.Module):
    """Base of all heads; made by `make_head`.

    Attributes:
        name: a name in `HEADS`.
        outputs: length D of a descriptor.
    """

    name: str
    outputs: int


class FullyConnected(Head):
    """A head of two or three fully connected layers with a ReLU between them ([T] table 5.2).

    Nothing follows the last layer, as in the published code of the thesis; see `SoftmaxHead` for the text's softmax.

    Args:
        shape: (C, h, w) of the features.
        widths: neurons of the layers; the last number is D.
    """

    def __init__(self, shape: tuple[int, int, int], widths: tuple[int, ...]) -> None:
        super().__init__()
        self.outputs = widths[-1]
        layers: list[nn.Module] = [nn.Flatten()]
        for inputs, outputs in pairwise((shape[0] * shape[1] * shape[2], *widths)):
            layers += [nn.Linear(inputs, outputs), nn.ReLU(inplace=True)]
        self.layers = nn.Sequential(*layers[:-1])

    def forward(self, features: Tensor) -> Tensor:
        """Return the descriptors of features (B, C, h, w)."""
        return self.layers(features)


class SoftmaxHead(FullyConnected):
    """Two or three fully connected layers, and a softmax after the last: our literal reading of [T] 5.3.

    The text names "a softmax layer and a few fully connected layers" without saying where the softmax is, and the
    published code has none. So this head can be chosen, but is no default, and no published table is measured with it.

    Descriptors are positive and sum to 1. They lie at most sqrt(2) apart, so that no two places ever reach the thesis's
    margin of 2.
    """

    def forward(self, features: Tensor) -> Tensor:
        """Return the descriptors of features (B, C, h, w)."""
        return super().forward(features).softmax(dim=1)


class UnitHead(Head):
    """Base of the heads that end in one layer and give descriptors of unit length.

    Args:
        inputs: number of inputs of the layer.
        outputs: length D of a descriptor.
    """

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.outputs = outputs
        self.layer = nn.Linear(inputs, outputs)

    def unit(self, values: Tensor) -> Tensor:
        """Return descriptors (B, D) of unit length: the layer applied to values (B, inputs), and normalized."""
        return F.normalize(self.layer(values))


class Flat(UnitHead):
    """One fully connected layer over all features, scaled to unit length: what is seen where, relative to the robot.

    Args:
        shape: (C, h, w) of the features.
        outputs: length D of a descriptor.
    """

    def __init__(self, shape: tuple[int, int, int], outputs: int) -> None:
        super().__init__(shape[0] * shape[1] * shape[2], outputs)

    def forward(self, features: Tensor) -> Tensor:
        """Return the descriptors of features (B, C, h, w)."""
        return self.unit(features.flatten(1))


class GeneralizedMean(UnitHead):
    """The generalized mean of each channel over the panorama, then one layer, scaled to unit length [Radenovic 2018].

    The mean of the p-th powers, to the power 1 / p; p is learned and starts at 3. p = 1 is the average, a large p the
    maximum. The head discards where in the panorama something is.

    Args:
        shape: (C, h, w) of the features.
        outputs: length D of a descriptor.
    """

    _over: ClassVar[tuple[int, ...]] = (2, 3)  # the dimensions that the mean goes over

    def __init__(self, shape: tuple[int, int, int], outputs: int) -> None:
        channels, rows, _ = shape
        super().__init__(channels if 2 in self._over else channels * rows, outputs)
        self.power = nn.Parameter(torch.empty(1))

    def reset(self) -> None:
        """Set the power to 3, its initial value."""
        nn.init.constant_(self.power, 3.0)

    def forward(self, features: Tensor) -> Tensor:
        """Return the descriptors of features (B, C, h, w)."""
        powers = features.clamp(min=_SMALLEST) ** self.power
        return self.unit((powers.mean(dim=self._over) ** (1 / self.power)).flatten(1))


class Bands(GeneralizedMean):
    """The generalized mean of each channel over each row of the features, then one layer, scaled to unit length.

    Like `gem`, but for each row of the features separately: it discards the direction of things and keeps their height.
    For cameras that stay level and turn, even if the columns of an image do not wrap around.

    Args:
        shape: (C, h, w) of the features.
        outputs: length D of a descriptor.
    """

    _over = (3,)


class Spectrum(nn.Module):
    """The squared Fourier magnitudes of each row of each channel along the azimuth.

    Turning a signal changes only the phases of its Fourier series.

    Args:
        columns: number of columns w of the features.
    """

    cosine: Tensor
    sine: Tensor

    def __init__(self, columns: int) -> None:
        super().__init__()
        self.frequencies = columns // 2 + 1
        for part in ("cosine", "sine"):
            self.register_buffer(part, torch.empty(columns, self.frequencies), persistent=False)

    def reset(self) -> None:
        """Fill in the Fourier basis, scaled so that the transform preserves lengths."""
        columns, frequencies = self.cosine.shape
        angle = torch.arange(columns, dtype=torch.float64)[:, None] * torch.arange(frequencies, dtype=torch.float64)
        angle = (angle % columns) * (2 * torch.pi / columns)
        with torch.no_grad():
            self.cosine.copy_(angle.cos() / columns**0.5)
            self.sine.copy_(angle.sin() / columns**0.5)

    def forward(self, features: Tensor) -> Tensor:
        """Return (B, C, h, w // 2 + 1) of features (B, C, h, w); above 0, so that its square root has a gradient."""
        # As a product with the basis: w is small, and every device and runtime supports it.
        return (features @ self.cosine) ** 2 + (features @ self.sine) ** 2 + _SMALLEST


class Fourier(UnitHead):
    """The Fourier magnitudes of each row of each channel along the azimuth, then one layer, scaled to unit length.

    Turning a signal changes only the phases of its Fourier series. So if the branch wraps around
    (`siamloc.models.build(..., circular=True)`), turning the robot by a whole column of the features leaves the
    descriptor unchanged. Turns in between change it; training with random turns keeps that change small. The rows still
    encode the elevation of things. How far the robot has turned, which the magnitudes leave out, is kept separately by
    `siamloc.models.orientation`.

    Args:
        shape: (C, h, w) of the features.
        outputs: length D of a descriptor.
    """

    def __init__(self, shape: tuple[int, int, int], outputs: int) -> None:
        channels, rows, columns = shape
        spectrum = Spectrum(columns)
        super().__init__(channels * rows * spectrum.frequencies, outputs)
        self.spectrum = spectrum

    def forward(self, features: Tensor) -> Tensor:
        """Return the descriptors of features (B, C, h, w)."""
        return self.unit(self.spectrum(features).sqrt().flatten(1))


class Magnitudes(Head):
    """The Fourier magnitudes of each row of each channel along the azimuth, in sums with random signs, of unit length.

    The head has no weights. A final layer, such as that of `fourier`, fits the buildings that it was trained in;
    elsewhere the input of the layer distinguishes places better ([Chen 2020] drop their final layers, too). The mean
    over the azimuth, frequency 0, is left out: it changes most with the light. The other magnitudes are taken to the
    power 0.7, so that a few strong magnitudes do not dominate ([Perronnin 2010]). Each magnitude is then added to one
    of D sums with a random sign, which nearly preserves the distances between descriptors at a fraction of the size
    ([Charikar 2002]).

    Args:
        shape: (C, h, w) of the features, which have C * h * (w // 2) magnitudes.
        outputs: length D of a descriptor, at most the number of magnitudes.

    Raises:
        ConfigError: features of one column, or more outputs than magnitudes.
    """

    order: Tensor
    signs: Tensor

    def __init__(self, shape: tuple[int, int, int], outputs: int) -> None:
        super().__init__()
        channels, rows, columns = shape
        self.spectrum = Spectrum(columns)
        count = channels * rows * (self.spectrum.frequencies - 1)
        if columns < 2:
            raise ConfigError("the head magnitudes needs features of 2 columns, and these have 1: take larger images")
        if outputs > count:
            raise ConfigError(
                f"the head magnitudes has at most {count} outputs here, one for each magnitude, got {outputs}"
            )
        self.outputs = outputs
        padded = -(-count // self.outputs) * self.outputs
        self.spare = padded - count
        self.register_buffer("order", torch.empty(padded, dtype=torch.int64), persistent=False)
        self.register_buffer("signs", torch.empty(padded), persistent=False)

    def reset(self) -> None:
        """Fill in the buffers: which magnitudes are summed, and with which signs, the same on every machine."""
        with torch.no_grad():
            self.order.copy_(torch.from_numpy(_random_bits(len(self.order), seed=1).argsort()))
            self.signs.copy_(random_signs(1, len(self.signs))[0])

    def forward(self, features: Tensor) -> Tensor:
        """Return the descriptors of features (B, C, h, w)."""
        values = self.spectrum(features)[..., 1:] ** (_POWER / 2)
        shuffled = F.pad(values.flatten(1), (0, self.spare)).index_select(1, self.order) * self.signs
        return F.normalize(shuffled.unflatten(1, (self.outputs, -1)).sum(dim=2))


def random_signs(rows: int, columns: int) -> Tensor:
    """Return a matrix of random signs, -1 and 1, the same on every machine."""
    bits = _random_bits(rows * columns) >> np.uint64(63)
    return torch.from_numpy(bits.astype(np.float32) * 2 - 1).view(rows, columns)


def _random_bits(count: int, seed: int = 0) -> NDArray[np.uint64]:
    # Raw bits, since NumPy guarantees their order for all versions; stored maps depend on them.
    return np.random.PCG64(seed).random_raw(count)


def make_head(name: str, shape: tuple[int, int, int], outputs: int | None = None) -> Head:
    """Make a head by its name for features of shape (C, h, w).

    Raises:
        ConfigError: an unknown name, outputs for a head with a fixed number, or features too small for the head.
    """
    widths = head_widths(name, outputs)
    kind = globals()[HEADS[name].kind]
    if kind is Magnitudes and outputs is None:  # small images have fewer
        widths = (min(widths[0], shape[0] * shape[1] * max(1, shape[2] // 2)),)
    head: Head = kind(shape, widths[0] if len(widths) == 1 else widths)
    head.name = name
    return head
