"""Effects on levels and colours that treat all pixels alike, wherever they are."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property, partial
from typing import Any, ClassVar

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from augment.base import Effect, Numbers, Params
from augment.brushes import Brush, Frame, flat
from augment.ranges import Range


class PointEffect(Effect):
    """An effect on levels alone: I' = curve(I). Each 8-bit frame goes through its own table of 256 levels."""

    @abstractmethod
    def curve(self, level: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the new levels of levels in [0, 1], (B, 3, H, W) or (1, 1, 1, 256); values as for `render`."""

    def brushes(self, params: Params, height: int, width: int) -> list[Brush]:
        """Return for each frame the function that looks its levels up in its table."""
        levels = (torch.arange(256, dtype=torch.float32) / 255).view(1, 1, 1, 256)
        curves = self.curve(levels, self.tensors(params, height, width))
        tables = (curves.clamp(0, 1) * 255).round().to(torch.uint8).squeeze(2).numpy()
        return [partial(_look_up, table) for table in tables]

    def render(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the batch with every level replaced by its value on the curve."""
        return self.curve(batch, values)


class Tone(PointEffect):
    """A power and a line: I' = gain I^gamma + offset. Subclasses with this curve are rendered together."""

    name = "tone"

    @cached_property
    def renderer(self) -> Effect:
        """The tone curve that all subclasses with this curve are rendered by."""
        return Tone() if type(self).curve is Tone.curve else self

    def curve(self, level: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return gain I^gamma + offset."""
        return level ** values["gamma"] * values["gain"] + values["offset"]


class Brighten(Tone):
    """More light everywhere: I' = I + c ([T] 5.3.2, global illumination, figure 5.4 b).

    Args:
        amount: c, whole levels of 0 ... 255. 35 ... 75 as published.
    """

    name = "brighten"
    RANGES: ClassVar[Mapping[str, Range]] = {"amount": Range(35, 75, minimum=0, maximum=255, neutral=0, whole=True)}
    sign: ClassVar[int] = 1

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return c as the offset of the tone curve, negative in `Darken`."""
        return _tone(offset=params["amount"] * (self.sign / 255))

    brushes = Effect.brushes  # a saturating addition is faster than the table

    def paint(self, params: Mapping[str, float], frame: Frame) -> None:
        """Add to the levels of a frame, or subtract from them."""
        change = cv2.add if self.sign > 0 else cv2.subtract
        change(flat(frame), int(params["amount"]), dst=flat(frame))  # type: ignore[call-overload]


class Darken(Brighten):
    """Less light everywhere: I' = I - c ([T] 5.3.2, global illumination, figure 5.4 c).

    Args:
        amount: c, whole levels of 0 ... 255. 35 ... 75 as published.
    """

    name = "darken"
    sign: ClassVar[int] = -1


class Contrast(Tone):
    """Contrast about a dark grey: I' = 64 + c (I - 64) ([T] 5.3.2, figure 5.4 f).

    Args:
        factor: c, above 1 for more contrast and below for less. The thesis gives no range.
        pivot: the level that stays the same; 64 as published.
    """

    name = "contrast"
    RANGES: ClassVar[Mapping[str, Range]] = {
        "factor": Range(0.5, 1.8, minimum=0, maximum=20, neutral=1),
        "pivot": Range(64, 64, minimum=0, maximum=255),
    }

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the gain c, and the offset that leaves the pivot unchanged."""
        return _tone(gain=params["factor"], offset=(1 - params["factor"]) * params["pivot"] / 255)

    brushes = Effect.brushes  # a saturating scaling is faster than the table

    def paint(self, params: Mapping[str, float], frame: Frame) -> None:
        """Scale the levels of a frame."""
        factor = params["factor"]
        cv2.addWeighted(flat(frame), factor, flat(frame), 0, params["pivot"] * (1 - factor), dst=flat(frame))


class Gamma(Tone):
    """A different tone curve of the camera: I' = I^gamma, on [0, 1].

    Args:
        gamma: below 1 for brighter shadows, above 1 for darker ones; drawn uniformly in the logarithm.
    """

    name = "gamma"
    RANGES: ClassVar[Mapping[str, Range]] = {"gamma": Range(0.5, 2.0, minimum=0.05, maximum=20, neutral=1, log=True)}

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the exponent gamma of the tone curve."""
        return _tone(gamma=params["gamma"])


class Exposure(PointEffect):
    """A longer or shorter exposure, clipped as by a sensor.

    I' = encode(min(1, 2^stops decode(I))) with the transfer curve of sRGB (IEC 61966-2-1): the light is scaled
    before the camera's curve, and everything above the sensor's range is white.

    Args:
        stops: binary logarithm of the change of light.
    """

    name = "exposure"
    RANGES: ClassVar[Mapping[str, Range]] = {"stops": Range(-1.5, 1.5, minimum=-10, maximum=10, neutral=0)}

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the gain of the light, 2^stops."""
        return {"gain": np.exp2(params["stops"])}

    def curve(self, level: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the levels after decoding to light, applying the gain and encoding; clipping to 1 comes afterwards."""
        light = torch.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
        light = light * values["gain"]
        return torch.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)


class WhiteBalance(PointEffect):
    """Light of another colour, or a camera that misjudges it.

    I'_k = g_k I_k with log2 g = temperature (1/2, 0, -1/2) + tint (1/3, -2/3, 1/3) for red, green, blue. The
    geometric mean of the three gains is 1.

    Args:
        temperature: stops between red and blue; positive is warmer.
        tint: stops between magenta and green; positive is more magenta.
    """

    name = "white_balance"
    RANGES: ClassVar[Mapping[str, Range]] = {
        "temperature": Range(-0.6, 0.6, minimum=-4, maximum=4, neutral=0),
        "tint": Range(-0.15, 0.15, minimum=-4, maximum=4, neutral=0),
    }

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the gains of red, green and blue."""
        warm, magenta = np.outer([0.5, 0.0, -0.5], params["temperature"]), np.outer([1, -2, 1], params["tint"] / 3)
        return {"gain": np.exp2(warm + magenta)}

    def curve(self, level: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the levels multiplied by the gain of their colour."""
        return level * values["gain"]


def _tone(gamma: Any = 1.0, gain: Any = 1.0, offset: Any = 0.0) -> Numbers:
    """Return the coefficients of `Tone`; coefficients left out are neutral."""
    neutral = 0 * (gamma + gain + offset)
    return {"gamma": gamma + neutral, "gain": gain + neutral, "offset": offset + neutral}


class Equalize(Effect):
    """Spread the histogram of each channel evenly ([T] 5.3.2).

    I' = I + strength (eq(I) - I), eq being torchvision's `equalize`: with the cumulative histogram C and the step
    q = (pixels - pixels of the last occupied level) // 255, level i becomes (C(i - 1) + q // 2) // q. Float batches
    are equalized in 256 levels.

    Args:
        strength: 1 as published; less mixes it with the original.
    """

    name = "equalize"
    RANGES: ClassVar[Mapping[str, Range]] = {"strength": Range(1, 1, minimum=0, maximum=1, neutral=0)}

    def paint(self, params: Mapping[str, float], frame: Frame) -> None:
        """Equalize the histogram of each channel of a frame."""
        tables = np.empty((3, 256), dtype=np.uint8)
        levels = np.arange(256)
        for channel in range(3):
            counts = cv2.calcHist([frame[channel]], [0], None, [256], [0, 256]).ravel().astype(np.int64)
            step = (counts.sum() - counts[np.flatnonzero(counts)[-1]]) // 255
            table = np.minimum((counts.cumsum() - counts + step // 2) // max(step, 1), 255)
            tables[channel] = np.rint(levels + params["strength"] * (step > 0) * (table - levels))
        _look_up(tables, frame)

    def render(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the equalized images, mixed with the originals by strength; a channel of one level stays as it is."""
        levels = (batch * 255).round().long().flatten(2)
        counts = torch.zeros(*batch.shape[:2], 256, dtype=torch.int64, device=batch.device)
        counts.scatter_add_(2, levels, counts.new_ones(()).expand_as(levels))
        reached = counts.cumsum(2)
        below_last = reached.masked_fill(reached == levels.shape[2], 0).amax(2, keepdim=True)
        step = below_last // 255
        tables = ((reached - counts + step // 2) // step.clamp(min=1)).clamp(max=255).float() / 255
        return torch.lerp(batch, tables.gather(2, levels).view_as(batch), values["strength"] * (step > 0)[..., None])


class Saturate(Effect):
    """Stronger or weaker colours: S' = min(1, c S) in HSV ([T] 5.3.2, figure 5.4 g).

    Hue and value stay the same, so no conversion is needed: with V = max(R, G, B) and m = min(R, G, B), each channel
    becomes I' = V - k (V - I), k = min(c, V / (V - m)).

    Args:
        factor: c, above 1 for more colour, 0 for grey. The thesis gives no range.
    """

    name = "saturate"
    RANGES: ClassVar[Mapping[str, Range]] = {"factor": Range(0.2, 2.0, minimum=0, maximum=20, neutral=1)}

    def paint(self, params: Mapping[str, float], frame: Frame) -> None:
        """Change the saturation of a frame."""
        factor, value = params["factor"], np.maximum(np.maximum(frame[0], frame[1]), frame[2])
        if factor < 1:
            for channel in range(3):
                cv2.addWeighted(value, 1 - factor, frame[channel], factor, 0, dst=frame[channel])
            return
        least = np.minimum(np.minimum(frame[0], frame[1]), frame[2])
        scale = np.divide(value, np.maximum(value - least, 1), dtype=np.float32)
        np.minimum(scale, np.float32(factor), out=scale)
        for channel in range(3):
            below = cv2.multiply(value - frame[channel], scale, dtype=cv2.CV_8U)
            np.subtract(value, below, out=frame[channel])

    def render(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the images with changed saturation; grey pixels keep their exact values."""
        least, value = batch.aminmax(dim=1, keepdim=True)
        scale = torch.minimum(values["factor"], value / (value - least).clamp(min=1e-6))
        return torch.addcmul(batch, 1 - scale, value - batch)


def _look_up(table: NDArray[np.uint8], frame: Frame) -> None:
    """Look up every level of a frame in a table: (1, 256) for all channels, or (3, 256), one for each."""
    for channel, levels in zip(frame, np.broadcast_to(table, (3, 256)), strict=True):
        cv2.LUT(channel, levels, dst=channel)
