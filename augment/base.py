"""`Effect`: parameters are drawn first and applied second, so that a draw can be saved and repeated."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any, ClassVar

import torch
from torch import Tensor

from augment.brushes import Brush, paint
from augment.errors import AugmentError, nearest
from augment.ranges import Range, spread

Params = dict[str, Tensor]

_FARTHEST = 1e6  # no column, row or angle that makes sense lies beyond
_ROUNDING = 1e-5  # relative, of values that were drawn in float32 from the logarithm


class Effect(ABC):
    """Something that happens to panoramas.

    A batch is a tensor (B, 3, H, W), RGB, uint8 or float32 in [0, 1], on any device; the result has the same shape,
    dtype, range and device. Parameters are a dictionary of tensors (B,), so every frame has its own; they live in
    the main memory and may be stored as plain lists.

    8-bit batches in the main memory are painted frame by frame; all others go through tensor operations. Both
    follow the same formula; 8-bit results are rounded to the nearest level.

    Args:
        **params: ranges (one number or a pair) and options of the effect.

    Attributes:
        name: what configurations call it.
        ranges: what its parameters are drawn from.
        options: its other settings; `circular=False` says that the columns do not wrap around.

    Raises:
        AugmentError: an unknown parameter, or a value that makes no sense.
    """

    name: ClassVar[str]
    RANGES: ClassVar[Mapping[str, Range]] = {}
    OPTIONS: ClassVar[Mapping[str, Any]] = {}

    def __init__(self, **params: Any) -> None:
        options = {"circular": True, **self.OPTIONS}
        valid = [*self.RANGES, *options]
        for key in params:
            if key not in valid:
                raise AugmentError(f"{self.name} has no parameter {key!r}: {nearest(key, valid)}")
        self.ranges: dict[str, Range] = {
            key: base.narrowed(params[key], f"{key} of {self.name}") if key in params else base
            for key, base in self.RANGES.items()
        }
        self.options: dict[str, Any] = {key: params.get(key, value) for key, value in options.items()}
        if not isinstance(self.options["circular"], bool):
            raise AugmentError(f"circular of {self.name} must be true or false, got {self.options['circular']!r}")
        self._spans: dict[tuple[int, int], dict[str, Range]] = {}
        self._limits: dict[tuple[int, int], tuple[dict[str, Range], Tensor, Tensor]] = {}

    def __repr__(self) -> str:
        ranges = [f"{key}=({value.low:g}, {value.high:g})" for key, value in self.ranges.items()]
        return f"{self.name}({', '.join([*ranges, *(f'{key}={value!r}' for key, value in self.options.items())])})"

    def __call__(self, batch: Tensor, generator: torch.Generator) -> Tensor:
        """Draw and apply."""
        return self.apply(batch, self.draw(generator, batch))

    @property
    def circular(self) -> bool:
        """Whether columns wrap around."""
        return bool(self.options["circular"])

    def draw(self, generator: torch.Generator, batch: Tensor) -> Params:
        """Return parameters for every frame of a batch; they follow from the generator and the batch's shape.

        Raises:
            AugmentError: the batch has another shape or dtype than (B, 3, H, W) uint8 or float32, or the generator
                is none.
        """
        check_shape(batch)
        if not isinstance(generator, torch.Generator):
            raise AugmentError(
                f"{self.name} draws from a torch.Generator, such as torch.Generator().manual_seed(0), got {generator!r}"
            )
        height, width = batch.shape[2:]
        spans = self.spans(height, width)
        uniform = torch.rand(len(batch), len(spans), generator=generator, device=generator.device).cpu()
        return self.complete(spread(uniform, spans), height, width)

    def at(self, strength: float, batch: Tensor) -> Params:
        """Return parameters of a given strength, places in the middle, the same for every frame.

        Args:
            strength: 0 leaves the pictures as they are; 1 is the far end of the ranges; negative strengths go the
                other way in effects that have two ways.
            batch: what they will be applied to.

        Raises:
            AugmentError: a strength outside [-1, 1].
        """
        check_shape(batch)
        if not -1 <= strength <= 1:
            raise AugmentError(f"the strength of {self.name} must lie in [-1, 1], got {strength}")
        height, width = batch.shape[2:]
        values = {key: span.at(strength) for key, span in self.spans(height, width).items()}
        return self.complete({key: torch.tensor([value] * len(batch)) for key, value in values.items()}, height, width)

    def apply(self, batch: Tensor, params: Mapping[str, Any]) -> Tensor:
        """Return the altered batch; the same parameters give the same pictures.

        Args:
            batch: (B, 3, H, W).
            params: as `draw` returned them; lists of plain values will do.

        Raises:
            AugmentError: a batch of another shape, dtype or range, with NaN, or parameters that do not fit it.
        """
        check_batch(batch)
        checked = self.checked(params, len(batch), *batch.shape[2:])
        if len(batch) == 0:
            return batch.clone()
        if batch.dtype == torch.uint8 and batch.device.type == "cpu":
            frames = batch.clone(memory_format=torch.contiguous_format)
            paint(frames.numpy(), self.brushes(checked, *batch.shape[2:]))
            return frames
        if batch.dtype == torch.uint8:
            return (self.render(batch.float().div_(255), checked).clamp_(0, 1).mul_(255)).round_().to(torch.uint8)
        return self.render(batch, checked).clamp(0, 1)

    def turned(self, params: Mapping[str, Tensor], columns: int, width: int) -> Params:
        """Return the parameters that have the same effect on the batch shifted right by some columns."""
        return {
            key: (value + columns) % width if key.rpartition(".")[2] == "column" else value
            for key, value in params.items()
        }

    def describe(self, params: Mapping[str, Tensor]) -> list[str]:
        """Return what happens to each frame, in words."""
        count = len(next(iter(params.values())))
        return [self.name] * count

    def spans(self, height: int, width: int) -> dict[str, Range]:
        """Return what each parameter is drawn from for frames of a size."""
        key = (height, width)
        if key not in self._spans:
            self._spans[key] = {**self.ranges, **self.places(height, width)}
        return self._spans[key]

    def places(self, height: int, width: int) -> dict[str, Range]:
        """Return the parameters that are no ranges of the user's: where and in which form. None by default."""
        return {}

    def complete(self, params: Params, height: int, width: int) -> Params:
        """Return the drawn parameters with those that follow from them."""
        return params

    @abstractmethod
    def brushes(self, params: Params, height: int, width: int) -> list[Sequence[Brush]]:
        """Return for each frame what alters it in place, 8 bits a pixel."""

    @abstractmethod
    def render(self, batch: Tensor, params: Params) -> Tensor:
        """Return the altered batch: float32, 1 is full white, values beyond [0, 1] will be clipped."""

    def checked(self, params: Mapping[str, Any], count: int, height: int, width: int) -> Params:
        """Return parameters as tensors (B,) in the main memory.

        Raises:
            AugmentError: names, lengths or values that do not fit.
        """
        valid, low, high = self._bounds(height, width)
        for key in params:
            if key not in valid:
                raise AugmentError(f"the parameters of {self.name} hold {key!r}, which it has not: valid: {[*valid]}")
        checked = {}
        for key, span in valid.items():
            if key not in params:
                raise AugmentError(f"the parameters of {self.name} lack {key!r}: they need {', '.join(valid)}")
            checked[key] = self._values(key, params[key], span, count)
        if count and checked:
            together = torch.cat(list(checked.values())).view(len(checked), count)
            fits = ((together >= low) & (together <= high)).all(1)  # NaN fits nowhere
            if not fits.all():
                key = list(checked)[fits.tolist().index(False)]
                least, most = _ends(valid[key])
                raise AugmentError(
                    f"parameter {key!r} of {self.name} must lie in [{least:.7g}, {most:.7g}], "
                    f"got {checked[key].tolist()}"
                )
        return checked

    def limits(self, height: int, width: int) -> dict[str, Range]:
        """Return the parameters that `draw` gives, each with the values that `apply` takes: minimum to maximum."""
        return self.spans(height, width)

    def _bounds(self, height: int, width: int) -> tuple[dict[str, Range], Tensor, Tensor]:
        size = (height, width)
        if size not in self._limits:
            valid = self.limits(height, width)
            ends = torch.tensor([_ends(span) for span in valid.values()]).view(-1, 2)
            low, high = (ends + ends.abs() * torch.tensor([-_ROUNDING, _ROUNDING])).split(1, dim=1)
            self._limits[size] = (valid, low, high)
        return self._limits[size]

    def _values(self, key: str, given: Any, span: Range, count: int) -> Tensor:
        """Return one parameter as a tensor (B,), int64 if it counts in whole numbers, else float32."""
        try:
            value = torch.as_tensor(given, device="cpu")
        except (TypeError, ValueError, RuntimeError) as error:
            raise AugmentError(f"parameter {key!r} of {self.name} must be a list of numbers, got {given!r}") from error
        if value.shape != (count,):
            raise AugmentError(
                f"parameter {key!r} of {self.name} has shape {tuple(value.shape)}, expected ({count},): "
                "one value for each frame of the batch"
            )
        if value.is_complex() or (span.whole and value.is_floating_point() and not value.equal(value.floor())):
            kind = "whole" if span.whole else "real"
            raise AugmentError(f"parameter {key!r} of {self.name} must be made of {kind} numbers, got {value.tolist()}")
        return value.long() if span.whole else value.float()


def _ends(span: Range) -> tuple[float, float]:
    """Return the least and the greatest value that `apply` takes of a parameter."""
    return (
        span.minimum if isfinite(span.minimum) else -_FARTHEST,
        span.maximum if isfinite(span.maximum) else _FARTHEST,
    )


def check_shape(batch: Tensor) -> None:
    """Raise AugmentError if a batch is no tensor (B, 3, H, W) of uint8 or float32."""
    if not isinstance(batch, Tensor):
        raise AugmentError(f"a batch is a torch tensor of shape (B, 3, H, W), got {type(batch).__name__}")
    if batch.ndim != 4 or batch.shape[1] != 3 or 0 in batch.shape[2:]:
        raise AugmentError(f"a batch has shape (B, 3, H, W), got {tuple(batch.shape)}")
    if batch.dtype not in (torch.uint8, torch.float32):
        raise AugmentError(f"a batch is uint8, or float32 in [0, 1], got {batch.dtype}")


def check_batch(batch: Tensor) -> None:
    """Raise AugmentError as `check_shape`, or if values of a float batch are NaN or lie outside [0, 1]."""
    check_shape(batch)
    if batch.dtype == torch.uint8 or batch.numel() == 0:
        return
    low, high = (float(value) for value in batch.aminmax())
    if low != low or high != high:
        raise AugmentError("the batch holds NaN: clean it before augmenting it")
    if low < 0 or high > 1:
        raise AugmentError(
            f"a float batch lies in [0, 1], this one runs from {low:g} to {high:g}: divide 8-bit values by 255"
        )


def column_of(values: Tensor, like: Tensor) -> Tensor:
    """Return parameters (B,) as (B, 1, 1, 1), float32, where a batch is."""
    return values.to(device=like.device, dtype=torch.float32).view(-1, 1, 1, 1)
