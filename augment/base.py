"""`Effect`: parameters are drawn first and applied second, so that a draw can be saved and repeated."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from functools import cached_property, lru_cache, partial
from typing import Any, ClassVar, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from augment.brushes import Brush, Frame, paint
from augment.errors import AugmentError, hint
from augment.ranges import Range, spread
from foundation.settings import checked, shortened

Params = dict[str, Tensor]
Numbers = dict[str, NDArray[np.float64]]
"""Numbers by name, (B,) or (k, B): one for each of B frames, or k of them."""

_ROUNDING = torch.tensor([-1e-5, 1e-5], dtype=torch.float32)  # relative, of values drawn from the logarithm


@contextmanager
def on_host() -> Iterator[None]:
    """Make tensors in main memory, whatever torch's default device is."""
    with nullcontext() if torch.get_default_device().type == "cpu" else torch.device("cpu"):
        yield


class Program(NamedTuple):
    """The effects to apply to a batch, packed so that their parameters reach a device in two transfers.

    Attributes:
        numbers: (P,) float32, the coefficients of all steps, one after the other.
        frames: (F,) int64, the numbers of the frames that each step alters, step after step.
        steps: for each step the index of its effect in `Effect.effects`, how many frames it alters, and name and
            length of each of its coefficients.
    """

    numbers: Tensor
    frames: Tensor
    steps: tuple[tuple[int, int, tuple[tuple[str, int], ...]], ...]


class Effect(ABC):
    """An effect on panoramas, such as a lamp, a shadow or a blur.

    A batch is a tensor (B, 3, H, W), RGB, uint8 or float32 in [0, 1], on any device; the result has the same shape,
    dtype, range and device. Parameters are a dictionary of tensors (B,), one value per frame; they stay in
    main memory and may be stored as plain lists.

    8-bit batches in main memory are painted frame by frame; all others go through tensor operations. Both follow
    the same formula; 8-bit results are rounded to the nearest level.

    Args:
        **params: ranges (one number or a pair) and options of the effect.

    Attributes:
        name: the name used in configurations.
        moves: whether it moves what the image shows, so that masks and boxes of the image no longer fit.
        ranges: ranges that the parameters are drawn from, by name.
        options: settings of the effect apart from ranges.
        circular: whether the columns wrap around.
        effects: the single effects in their order.
        stages: for each step of `program`, the indices of its effects in `effects`.

    Raises:
        AugmentError: an unknown parameter, or an invalid value.

    Example:
        >>> import torch, augment
        >>> effect = augment.effect("brighten", amount=(35, 75))
        >>> batch = torch.full((2, 3, 128, 512), 100, dtype=torch.uint8)
        >>> params = effect.draw(torch.Generator().manual_seed(0), batch)
        >>> params["amount"]
        tensor([55, 66])
        >>> effect.apply(batch, params)[:, 0, 0, 0]
        tensor([155, 166], dtype=torch.uint8)
    """

    name: ClassVar[str]
    moves: ClassVar[bool] = False
    RANGES: ClassVar[Mapping[str, Range]] = {}
    OPTIONS: ClassVar[Mapping[str, Any]] = {}

    def __init__(self, **params: Any) -> None:
        if not hasattr(self, "name"):
            raise AugmentError(f"the effect {type(self).__name__} has no name: set `name` in the class")
        options = {"circular": True, **self.OPTIONS}
        valid = [*self.RANGES, *options]
        for key in params:
            if key not in valid:
                raise AugmentError(f"{self.name} has no parameter {key!r}: {hint(key, valid)}")
        self.ranges: dict[str, Range] = {
            key: base.narrowed(params[key], f"{key} of {self.name}") if key in params else base
            for key, base in self.RANGES.items()
        }
        self.options: dict[str, Any] = {key: params.get(key, value) for key, value in options.items()}
        self.circular = checked(self.options["circular"], bool, f"circular of {self.name}", AugmentError)
        self.effects: tuple[Effect, ...] = (self,)
        self.stages = [[0]]
        self._spans: dict[tuple[int, int], dict[str, Range]] = {}
        self._limits: dict[tuple[int, int], Any] = {}

    def __repr__(self) -> str:
        ranges = [f"{key}=({value.low:g}, {value.high:g})" for key, value in self.ranges.items()]
        return f"{self.name}({', '.join([*ranges, *(f'{key}={value!r}' for key, value in self.options.items())])})"

    def __call__(self, batch: Tensor, generator: torch.Generator) -> Tensor:
        """Draw and apply."""
        return self.apply(batch, self.draw(generator, batch))

    def draw(self, generator: torch.Generator, batch: Tensor) -> Params:
        """Return parameters for every frame of a batch; they depend only on the generator and the batch's shape.

        Raises:
            AugmentError: the batch is not (B, 3, H, W) uint8 or float32, or the generator is not a torch.Generator.
        """
        check_shape(batch)
        if not isinstance(generator, torch.Generator):
            raise AugmentError(
                f"{self.name} draws from a torch.Generator, such as torch.Generator(), got {generator!r}"
            )
        height, width = batch.shape[2:]
        shape = (len(batch), len(self.spans(height, width)))
        uniform = torch.rand(shape, generator=generator, device=generator.device, dtype=torch.float32).cpu()
        params = self.values(uniform, height, width)
        if not params:
            raise AugmentError(f"{self.name} draws nothing: give it at least one range, such as that of its strength")
        return params

    @on_host()
    def values(self, uniform: Tensor, height: int, width: int) -> Params:
        """Turn uniform numbers in [0, 1), (B, number of parameters drawn), into the parameters of B frames."""
        return self.complete(spread(uniform, self.spans(height, width)), len(uniform), height, width)

    @on_host()
    def at(self, strength: float, batch: Tensor) -> Params:
        """Return parameters of a given strength, the same for every frame, with all places in the middle.

        Args:
            strength: 0 leaves the images as they are; 1 is the far end of the ranges; negative strengths go in the
                opposite direction in effects that have two.
            batch: the batch that they will be applied to.

        Raises:
            AugmentError: a strength outside [-1, 1].
        """
        check_shape(batch)
        if not -1 <= strength <= 1:
            raise AugmentError(f"the strength of {self.name} must lie in [-1, 1], got {strength}")
        height, width = batch.shape[2:]
        spans, count = self.spans(height, width), len(batch)
        params = {key: self._values(key, [span.at(strength)] * count, span, count) for key, span in spans.items()}
        return self.complete(params, count, height, width)

    @on_host()
    def apply(self, batch: Tensor, params: Mapping[str, Any]) -> Tensor:
        """Return the altered batch; the same parameters give the same images.

        Args:
            batch: (B, 3, H, W).
            params: as returned by `draw`; lists of plain values work too.

        Raises:
            AugmentError: a batch of the wrong shape, dtype or range, or with NaN, or parameters that do not fit it.
        """
        check_batch(batch)
        height, width = batch.shape[2:]
        fitting = self.checked(params, len(batch), height, width)
        if len(batch) == 0:
            return batch.clone()
        if batch.dtype != torch.uint8 or batch.device.type != "cpu":
            return self.play(batch, self.program(fitting, height, width))
        frames = batch.clone(memory_format=torch.contiguous_format)
        brushes: list[list[Brush]] = [[] for _ in frames]
        for effect, own, changed in self.parts(fitting):
            rows = np.flatnonzero(changed)
            if len(rows):
                some = effect.brushes({key: value[rows] for key, value in own.items()}, height, width)
                for row, brush in zip(rows.tolist(), some, strict=True):
                    brushes[row].append(brush)
        paint(frames.numpy(), brushes)
        return frames

    def program(self, params: Mapping[str, Tensor], height: int, width: int) -> Program:
        """Pack drawn parameters for `play`: a loader can do so, while a device is busy.

        Effects of one kind that exclude each other share a step, as far as the order of all effects allows: five
        alternatives with a lamp need one step for lamps. If parameters made by hand give a frame two effects of a
        step, every effect is a step of its own.

        Args:
            params: as returned by `draw`.
            height: rows of the frames.
            width: columns of the frames.
        """
        parts = self.parts(params)
        stages, place = self.stages, np.zeros(len(parts), dtype=int)
        for number, stage in enumerate(stages, 1):
            place[stage] = number
        changed = np.array([part[2] for part in parts], dtype=bool)
        reached = np.maximum.accumulate(place[:, None] * changed)
        if (changed[1:] & (place[1:, None] <= reached[:-1])).any():
            stages = [[slot] for slot in range(len(parts))]
        numbers, frames, steps = [np.zeros(0)], [np.zeros(0, dtype=np.int64)], []
        for stage in stages:
            values: Numbers = {}
            for effect, own, here in (parts[slot] for slot in stage):
                if here.any():
                    for name, value in effect.coefficients(as_numbers(own), height, width).items():
                        values[name] = np.where(here, value, values.get(name, 0.0))
            rows = np.flatnonzero(changed[stage].any(axis=0))
            if len(rows):
                wide = {name: np.atleast_2d(value) for name, value in values.items()}
                numbers += [value[:, rows].ravel() for value in wide.values()]
                frames.append(rows)
                steps.append((stage[0], len(rows), tuple((name, len(value)) for name, value in wide.items())))
        together = torch.from_numpy(np.concatenate(numbers).astype(np.float32))
        return Program(together, torch.from_numpy(np.concatenate(frames)), tuple(steps))

    def play(self, batch: Tensor, program: Program) -> Tensor:
        """Return the altered batch on its device, without waiting for it.

        Args:
            batch: (B, 3, H, W), uint8, or float32 in [0, 1], which is not checked.
            program: from `program`, on any device.
        """
        coded = batch.dtype == torch.uint8
        out = batch.float().div_(255) if coded else batch.clone(memory_format=torch.contiguous_format)
        numbers, frames = beside(program.numbers, batch), beside(program.frames, batch)
        for number, count, names in program.steps:
            lengths = [length for _, length in names]
            mine, numbers = numbers.split([count * sum(lengths), len(numbers) - count * sum(lengths)])
            taken, frames = frames.split([count, len(frames) - count])
            parts = mine.view(-1, count).split(lengths)
            values = {name: part.T[..., None, None] for (name, _), part in zip(names, parts, strict=True)}
            some = out if count == len(out) else out.index_select(0, taken)
            some = self.effects[number].renderer.rendered(some, values)
            # Every effect gives whole levels, as in main memory: the next one may make a thousandth visible.
            some = torch.fake_quantize_per_tensor_affine(some, 1 / 255, 0, 0, 255) if coded else some.clamp_(0, 1)
            out = some if count == len(out) else out.index_copy_(0, taken, some)
        return out.mul_(255).round_().to(torch.uint8) if coded else out

    def parts(self, params: Mapping[str, Tensor]) -> list[tuple[Effect, Params, NDArray[np.bool_]]]:
        """Return the effects, the parameters of each, and which frames (B,) each of them changes."""
        return [(self, dict(params), self.active(params))]

    @cached_property
    def renderer(self) -> Effect:
        """The effect whose `render` is used; effects with a common renderer are rendered together."""
        return self

    def active(self, params: Mapping[str, Tensor]) -> NDArray[np.bool_]:
        """Return which frames (B,) the effect changes: the frames whose strength is not neutral."""
        strengths = {key: span.neutral for key, span in self.ranges.items() if span.neutral is not None}
        changed = [(params[key] != neutral).numpy() for key, neutral in strengths.items()]
        return np.any(changed, axis=0) if changed else np.ones(len(next(iter(params.values()))), dtype=bool)

    def coefficients(self, params: Numbers, height: int, width: int) -> Numbers:
        """Return the numbers in the formula of the effect, for each frame; by default the parameters themselves."""
        return params

    def spans(self, height: int, width: int) -> dict[str, Range]:
        """Return the range that each parameter is drawn from, by name, for frames of this size."""
        key = (height, width)
        if key not in self._spans:
            self._spans[key] = {**self.ranges, **self.places(height, width)}
        return self._spans[key]

    def places(self, height: int, width: int) -> dict[str, Range]:
        """Return the ranges of parameters that users cannot set, such as a place in the image; none by default."""
        return {}

    def complete(self, params: Params, count: int, height: int, width: int) -> Params:
        """Return the drawn parameters of `count` frames, and the parameters that follow from the drawn ones."""
        return params

    def brushes(self, params: Params, height: int, width: int) -> list[Brush]:
        """Return for each frame the function that alters the frame in place: by default `paint` with its parameters."""
        return [partial(self.paint, values) for values in by_frame(params)]

    def paint(self, params: Mapping[str, float], frame: Frame) -> None:
        """Alter one frame in place, as 8-bit levels, with parameters in plain numbers; by default as `render` does."""
        numbers = {name: np.array([value], dtype=np.float64) for name, value in params.items()}
        values = _as_tensors(self.coefficients(numbers, *frame.shape[1:]))
        done = self.rendered(torch.from_numpy(frame)[None].float().div_(255), values)[0]
        frame[:] = done.mul(255).round_().clamp_(0, 255).to(torch.uint8).numpy()

    @abstractmethod
    def render(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return the altered batch as a new tensor, float32, 1 being white; the caller clips values outside [0, 1].

        Only the options and the coefficients may matter: effects of a policy with equal options are rendered together.

        Args:
            batch: (b, 3, H, W).
            values: the coefficients, (b, 1, 1, 1) or (b, k, 1, 1) each, on the device of the batch.
        """

    def rendered(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Return what `render`, which may be the user's own, makes of a batch, after checking its shape and numbers.

        Effects of one's own are searched for NaN on a CPU; on a GPU, each search would wait for the device.
        """
        made = self.render(batch, values)
        if not isinstance(made, Tensor) or made.shape != batch.shape:
            got = tuple(made.shape) if isinstance(made, Tensor) else type(made).__name__
            raise AugmentError(f"`render` of {self.name} must return a tensor {tuple(batch.shape)}, got {got}")
        own = not type(self).__module__.startswith("augment.")
        if own and made.device.type == "cpu" and made.isnan().any():
            raise AugmentError(f"`render` of {self.name} must return numbers, got NaN")
        return made

    def tensors(self, params: Mapping[str, Tensor], height: int, width: int) -> dict[str, Tensor]:
        """Return the coefficients as tensors in main memory, in the shapes that `render` needs."""
        return _as_tensors(self.coefficients(as_numbers(params), height, width))

    def checked(self, params: Mapping[str, Any], count: int, height: int, width: int) -> Params:
        """Return parameters as tensors (B,) in main memory.

        Raises:
            AugmentError: names, lengths or values that do not fit.
        """
        valid, low, high = self._bounds(height, width)
        for key in params:
            if key not in valid:
                raise AugmentError(f"{self.name} has no parameter {key!r}: {hint(key, valid)}")
        if lacking := [key for key in valid if key not in params]:
            raise AugmentError(f"the parameters of {self.name} lack {lacking[0]!r}: they need {', '.join(valid)}")
        values = {key: self._values(key, params[key], span, count) for key, span in valid.items()}
        if count and values:
            together = torch.cat(list(values.values())).view(len(values), count)
            fits = ((together >= low) & (together <= high)).all(1)  # NaN fits nowhere
            if not fits.all():
                key = list(values)[fits.tolist().index(False)]
                ends, got = "{:.7g}, {:.7g}".format(*valid[key].ends), values[key].tolist()
                raise AugmentError(f"parameter {key!r} of {self.name} must lie in [{ends}], got {got}")
        return values

    def limits(self, height: int, width: int) -> dict[str, Range]:
        """Return the parameters that `draw` returns, each with the minimum and maximum that `apply` accepts."""
        return self.spans(height, width)

    def _bounds(self, height: int, width: int) -> tuple[dict[str, Range], Tensor, Tensor]:
        """Return the parameters, and their smallest and largest values (P, 1) with what rounding may add."""
        if (height, width) not in self._limits:
            valid = self.limits(height, width)
            ends = torch.tensor([span.ends for span in valid.values()], dtype=torch.float32).view(-1, 2)
            self._limits[height, width] = (valid, *(ends + ends.abs() * _ROUNDING).split(1, dim=1))
        return self._limits[height, width]

    def _values(self, key: str, given: Any, span: Range, count: int) -> Tensor:
        """Return one parameter as a tensor (B,): int64 for whole numbers, else float32."""
        try:
            value = torch.as_tensor(given if isinstance(given, Tensor) else np.asarray(given), device="cpu")
        except (TypeError, ValueError, RuntimeError):
            value = torch.zeros(0, 0)
        broken = span.whole and value.is_floating_point() and not value.equal(value.floor())
        if value.shape != (count,) or value.is_complex() or broken:
            kind = "whole" if span.whole else "real"
            raise AugmentError(
                f"parameter {key!r} of {self.name} must be {kind} numbers ({count},), one for each frame of the batch, "
                f"got {shortened(repr(given))}"
            )
        return value.long() if span.whole else value.float()


def seeded(*words: int) -> torch.Generator:
    """Return a generator that depends only on some whole numbers, such as a seed and the number of a frame."""
    state = np.random.SeedSequence(words).generate_state(1, np.uint64)
    return torch.Generator("cpu").manual_seed(int(state[0] >> np.uint64(1)))


def check_shape(batch: Tensor) -> None:
    """Raise AugmentError if a batch is not a tensor (B, 3, H, W) of uint8 or float32."""
    fits = isinstance(batch, Tensor) and batch.ndim == 4 and batch.shape[1] == 3 and 0 not in batch.shape[2:]
    if not fits or batch.dtype not in (torch.uint8, torch.float32):
        got = f"{tuple(batch.shape)} {batch.dtype}" if isinstance(batch, Tensor) else type(batch).__name__
        raise AugmentError(f"a batch is a tensor (B, 3, H, W), uint8, or float32 in [0, 1], got {got}")


def check_batch(batch: Tensor) -> None:
    """Check a batch as `check_shape` does, and that the values of a float batch lie in [0, 1]."""
    check_shape(batch)
    if batch.dtype == torch.uint8 or batch.numel() == 0:
        return
    low, high = (float(value) for value in batch.detach().aminmax())
    if not 0 <= low <= high <= 1:  # NaN lies nowhere
        levels = high > (2 if low >= 0 else 20)  # a normalized image may reach 3
        remedy = "divide levels by 255" if levels else "clamp it, or normalize it later"
        remedy = remedy if math.isfinite(high - low) else "mend NaN and infinite values"
        raise AugmentError(f"a float batch lies in [0, 1], got values from {low:.9g} to {high:.9g}: {remedy}")


def beside(values: Tensor, batch: Tensor) -> Tensor:
    """Move a tensor from main memory to the device of a batch, without waiting for the transfer to a GPU."""
    if values.device == batch.device:
        return values
    return (values.pin_memory() if batch.is_cuda else values).to(batch.device, non_blocking=True)


@lru_cache(maxsize=8)
def places_in(height: int, width: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the row numbers (1, 1, H, 1) and column numbers (1, 1, 1, W) of an image, float32; cached."""
    rows, columns = (torch.arange(count, device=device, dtype=torch.float32) for count in (height, width))
    return rows.view(1, 1, -1, 1), columns.view(1, 1, 1, -1)


def by_frame(params: Mapping[str, Tensor]) -> list[dict[str, Any]]:
    """Return the parameters of each frame as plain numbers by name, one dictionary per frame."""
    columns = [value.tolist() for value in params.values()]
    return [dict(zip(params, each, strict=True)) for each in zip(*columns, strict=True)]


def as_numbers(params: Mapping[str, Tensor]) -> Numbers:
    """Return parameters as float64 arrays, by name."""
    return {key: value.numpy().astype(np.float64) for key, value in params.items()}


def _as_tensors(numbers: Numbers) -> dict[str, Tensor]:
    """Return numbers (B,) or (k, B) as tensors (B, 1, 1, 1) or (B, k, 1, 1), float32."""
    return {
        name: torch.from_numpy(np.atleast_2d(value).T.astype(np.float32))[..., None, None]
        for name, value in numbers.items()
    }
