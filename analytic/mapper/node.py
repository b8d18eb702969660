"""A node of the map, and its modes: the appearances under which its place is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Description
from analytic.mapper.frames import Gallery, Rim, Rows, spread, thin
from analytic.mapper.parameters import Parameters
from analytic.mapper.statistics import Metric, Model, Moments

_LEAST_LEFT = 1e-2  # of the spread; below it, removing frames leaves too little precision in the sums over the others


@dataclass(frozen=True)
class Gaussian:
    """Mean and spread of the distances of a mode's held-out frames to its model ([I] 4.1).

    Attributes:
        mean: mean of the squared Mahalanobis distances.
        std: standard deviation of the distances, with n - 1; 0 for fewer than two, so that nothing closes.
    """

    mean: float
    std: float


@dataclass(frozen=True)
class Mode:
    """One appearance of a node. Immutable: methods that change it return another mode.

    Attributes:
        rules: the parameters of the map.
        frames: (n,) numbers of its frames, in the order in which they joined.
        held: (n,) whether a frame is held out for the Gaussian; the others model the mode.
        rows: (n, D) position descriptors of its frames.
        squares: (n,) their squared lengths.
        centre: (D,) mean of all its frames, the representative.
        model: mean and covariance of the frames that model it.
        gallery: the frames that images are compared with.
        rim: the frames that may be the furthest from the centre, if determined before.
    """

    rules: Parameters
    frames: NDArray[np.int64]
    held: NDArray[np.bool_]
    rows: Rows
    squares: NDArray[np.float64]
    centre: NDArray[np.float64]
    model: Model
    gallery: Gallery
    rim: Rim | None = None

    @staticmethod
    def of(rules: Parameters, frames: Sequence[int], descriptions: Sequence[Description]) -> Mode:
        """Return the mode of frames and their descriptions, one frame each, added in that order."""
        size = descriptions[0].position.shape[1]
        mode = Mode(
            rules,
            np.empty(0, dtype=np.int64),
            np.empty(0, dtype=bool),
            Rows.of(np.empty((0, size))),
            np.empty(0),
            np.zeros(size),
            Model(Moments.none(size), rules.shrinkage),
            Gallery.of([], [], rules.exemplars),
        )
        for frame, description in zip(frames, descriptions, strict=True):
            mode = mode.add(frame, description)
        return mode

    def __len__(self) -> int:
        return len(self.frames)

    def add(self, frame: int, description: Description) -> Mode:
        """Return the mode with one more frame."""
        x = description.position[0].astype(np.float64)
        held = self.rules.holds_out(int(self.held.sum()), len(self))
        limit = self.rules.exemplars
        rim = self._furthest[0] if "_furthest" in self.__dict__ else self.rim
        return replace(
            self,
            frames=np.append(self.frames, frame),
            held=np.append(self.held, held),
            rows=self.rows.add(x),
            squares=np.append(self.squares, x @ x),
            centre=self.centre + (x - self.centre) / (len(self) + 1),
            model=self.model if held else self.model.add(x),
            gallery=self.gallery.add(frame, description)
            if limit is None
            else spread(self.gallery, frame, description, limit),
            rim=None if rim is None else rim.add(len(self)),
        )

    def remove(self, frames: Sequence[int]) -> Mode:
        """Return the mode without some of its frames."""
        gone = np.isin(self.frames, frames)
        left = ~gone
        rows, held, model = self.rows.array[left], self.held[left], self.model
        for x in self.rows.array[gone & ~self.held]:
            model = model.remove(x)
        if min(held.sum(), (~held).sum()) < 2:
            held, model = self._split(rows)
        elif model.moments.trace < _LEAST_LEFT * self.model.moments.trace:
            model = self._modelled(rows[~held])
        count, centre = len(self), self.centre
        for x in self.rows.array[gone]:
            count -= 1
            centre = centre + (centre - x) / max(count, 1)
        return replace(
            self,
            frames=self.frames[left],
            held=held,
            rows=Rows.of(rows),
            squares=self.squares[left],
            centre=centre,
            model=model,
            gallery=self.gallery.without(frames),
            rim=None,
        )

    def merge(self, other: Mode) -> Mode:
        """Return the mode of the frames of both."""
        count = len(self) + len(other)
        gallery = self.gallery
        for frame, description in zip(other.gallery.frames.tolist(), other.gallery.descriptions(), strict=True):
            gallery = gallery.add(frame, description)
        return replace(
            self,
            frames=np.concatenate([self.frames, other.frames]),
            held=np.concatenate([self.held, other.held]),
            rows=Rows.of(np.concatenate([self.rows.array, other.rows.array])),
            squares=np.concatenate([self.squares, other.squares]),
            centre=self.centre + (other.centre - self.centre) * (len(other) / count),
            model=self.model.merge(other.model),
            gallery=thin(gallery, self.rules.exemplars),
            rim=None,
        )

    @property
    def sample(self) -> NDArray[np.int64]:
        """The rows of the held-out frames in use: all, or every second, fourth, ... to respect `exemplars`."""
        rows = np.flatnonzero(self.held)
        step = 1
        while self.rules.exemplars is not None and -(-len(rows) // step) > self.rules.exemplars:
            step *= 2
        return rows[::step]

    @cached_property
    def metric(self) -> Metric:
        """The squared Mahalanobis distances to the mean of the frames that model the mode."""
        return self.model.metric(self.rows.array[~self.held] if self.model.few else None)

    @cached_property
    def gaussian(self) -> Gaussian:
        """The mean and standard deviation of the distances of the held-out frames."""
        distances = self.metric.distances(self.rows.array[self.sample])
        if len(distances) < 2:
            return Gaussian(float(distances.sum()), 0.0)
        return Gaussian(float(distances.mean()), float(distances.std(ddof=1)))

    @property
    def reach(self) -> float:
        """The right side of eq. 9: how far the representative would move without its most distant frame."""
        if len(self) < 2:
            return 0.0
        return self._furthest[1] / (len(self) - 1)

    @cached_property
    def _furthest(self) -> tuple[Rim, float]:
        """The rim, and the largest distance of a frame to the centre."""
        rows = self.rows.array
        if self.rim is not None:
            known = self.rim.furthest(rows, self.centre)
            if self.rim.holds(known, self.centre):
                return self.rim, known
        rim = Rim.of(rows, self.squares, self.centre)
        return rim, rim.furthest(rows, self.centre)

    def shift(self, x: NDArray[np.float64]) -> float:
        """Return the left side of eq. 9: how far the representative would move with one more frame (D,)."""
        return float(np.linalg.norm(x - self.centre)) / (len(self) + 1)

    def _split(self, rows: NDArray[np.float64]) -> tuple[NDArray[np.bool_], Model]:
        """Choose which frames (n, D) to hold out; return the flags and the model of the others."""
        flags: list[bool] = []
        for _ in rows:
            flags.append(self.rules.holds_out(sum(flags), len(flags)))
        held = np.array(flags, dtype=bool)
        return held, self._modelled(rows[~held])

    def _modelled(self, rows: NDArray[np.float64]) -> Model:
        """Return the model of frames (n, D)."""
        model = Model(Moments.none(rows.shape[1]), self.rules.shrinkage)
        for x in rows:
            model = model.add(x)
        return model


@dataclass(frozen=True)
class Node:
    """A place in the map.

    Attributes:
        id: number that is never used twice.
        modes: at least one.
    """

    id: int
    modes: tuple[Mode, ...]

    def __len__(self) -> int:
        return sum(len(mode) for mode in self.modes)

    @property
    def frames(self) -> list[int]:
        """The numbers of its frames, in capture order."""
        return sorted(np.concatenate([mode.frames for mode in self.modes]).tolist())

    def with_mode(self, index: int, mode: Mode) -> Node:
        """Return the node with one mode replaced."""
        return replace(self, modes=(*self.modes[:index], mode, *self.modes[index + 1 :]))

    def remove(self, frames: Sequence[int]) -> Node:
        """Return the node without some of its frames; a mode that loses all its frames is removed."""
        modes = [mode.remove(frames) if np.isin(mode.frames, frames).any() else mode for mode in self.modes]
        return replace(self, modes=tuple(mode for mode in modes if len(mode)))
