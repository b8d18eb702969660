"""A node of the map ([I] 4.1): its frames, their mean and covariance, and how far its own frames usually are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Description
from analytic.errors import AnalyticError
from analytic.mapper.gallery import Gallery
from analytic.mapper.parameters import Parameters

Array = NDArray[np.float64]

_LEAST_SHRINKAGE = 1e-6  # two frames, or frames on one line, have intensity 0 and a covariance without inverse
_LEAST_VARIANCE = 1e-12  # of equal frames, relative to their mean square
_NO_VARIANCE = 1e-30  # of frames that are all zero


@dataclass(frozen=True)
class Mahalanobis:
    """Squared Mahalanobis distances to the mean of a mode (eq. 3), prepared in one matrix.

    A node has few frames for the numbers of its descriptor, so its covariance S is shrunk towards a multiple of the
    identity: C = (1 - a) S + c I, where c is the intensity a times the mean variance, and a is that of Ledoit and Wolf
    (2004) by default. With Y (n, D), the frames about their mean, and s = (1 - a) / n, that is C = s Y^T Y + c I. The
    matrix M is the inverse Cholesky factor of C, and the distance of z = d - mean is z^T C^-1 z = |M z|^2.

    While n is at most D / 2, a smaller matrix (n, D) does, by Woodbury's identity: with L the Cholesky factor of
    s Y Y^T + c I and M = L^-1 sqrt(s) Y, the distance is (|z|^2 - |M z|^2) / c.

    Attributes:
        mean: (D,).
        matrix: M (D, D) or (n, D).
        least: c, the least variance of any direction.
    """

    mean: Array
    matrix: Array
    least: float

    @staticmethod
    def of(mean: Array, product: Array, squares: Array, away: Array | None, shrinkage: str | float) -> Mahalanobis:
        """Prepare the distances to n frames.

        Args:
            mean: (D,) mean of the frames.
            product: Y^T Y (D, D), or Y Y^T (n, n) for few frames.
            squares: (n,) the |y|^2 of the frames.
            away: Y (n, D) for few frames, else None.
            shrinkage: "ledoit_wolf" or a fixed intensity.

        Raises:
            AnalyticError: the covariance has no inverse.
        """
        from scipy.linalg import lapack

        count, size = len(squares), len(mean)
        intensity = ledoit_wolf(product, squares, size) if isinstance(shrinkage, str) else float(shrinkage)
        least = intensity * max(
            float(np.trace(product)) / (count * size), _LEAST_VARIANCE * float(np.mean(mean**2)), _NO_VARIANCE
        )
        weight = (1 - intensity) / count
        shrunk = weight * product
        shrunk[np.diag_indices(len(shrunk))] += least
        factor, failed = lapack.dpotrf(shrunk.T, lower=1, overwrite_a=1)
        if failed:
            raise AnalyticError(
                "the covariance of a node cannot be inverted: its descriptors differ too little for their size; choose "
                "a larger fixed shrinkage"
            )
        inverse = lapack.dtrtri(factor, lower=1, overwrite_c=1)[0]
        return Mahalanobis(mean, inverse if away is None else inverse @ (np.sqrt(weight) * away), least)

    def distance(self, point: Array) -> float:
        """Return the squared distance of a point (D,)."""
        away = point - self.mean
        inside = self.matrix.dot(away)
        if len(self.matrix) == len(self.mean):
            return float(inside.dot(inside))
        return max(float(away.dot(away) - inside.dot(inside)), 0.0) / self.least

    def distances(self, points: Array) -> Array:
        """Return the squared distances (n,) of points (n, D)."""
        away = points - self.mean
        inside = away @ self.matrix.T
        squares = np.einsum("nd,nd->n", inside, inside)
        if len(self.matrix) == len(self.mean):
            return squares
        return np.maximum(np.einsum("nd,nd->n", away, away) - squares, 0.0) / self.least


def ledoit_wolf(product: Array, squares: Array, size: int) -> float:
    """Compute the shrinkage intensity of Ledoit and Wolf (2004), in [1e-6, 1].

    With S = Y^T Y / n and p = D: b2 = (sum |y|^4 / n - |S|^2) / n against d2 = |S|^2 - trace(S)^2 / p, and
    min(b2, d2) / d2.

    Args:
        product: Y^T Y (D, D) or Y Y^T (n, n), which have the same trace and the same norm.
        squares: (n,) the |y|^2.
        size: D.
    """
    count = len(squares)
    spread = float(np.einsum("ij,ij->", product, product)) / count**2
    excess = spread - (float(np.trace(product)) / count) ** 2 / size
    error = min((float(squares @ squares) / count - spread) / count, excess)
    return max(error / excess, _LEAST_SHRINKAGE) if error > 0 and excess > 0 else _LEAST_SHRINKAGE


def squared_distances(points: Array, centre: Array) -> Array:
    """Return the squared Euclidean distances (n,) of points (n, D) to a centre (D,), in one pass over the points."""
    return np.maximum(np.einsum("nd,nd->n", points, points) - 2 * (points @ centre) + centre @ centre, 0.0)


@dataclass(frozen=True)
class Mode:
    """One appearance of a node. Immutable: methods that change it return another mode.

    Attributes:
        rules: the parameters of the map.
        frames: (n,) numbers of its frames, in the order in which they joined.
        held: (n,) whether a frame is held out for the Gaussian of eq. 4; the others model the mode.
        points: (n, D) position descriptors of its frames.
        centre: (D,) mean of all its frames, the representative.
        mean: (D,) mean of the frames that model it.
        scatter: (D, D) sum of y y^T over the frames that model it, y being a frame less their mean; None while they
            are at most D / 2.
        gallery: the frames that images are compared with.
    """

    rules: Parameters
    frames: NDArray[np.int64]
    held: NDArray[np.bool_]
    points: Array
    centre: Array
    mean: Array
    scatter: Array | None
    gallery: Gallery

    @staticmethod
    def of(rules: Parameters, frames: Sequence[int], descriptions: Sequence[Description]) -> Mode:
        """Return the mode of frames and their descriptions, one frame each, that join in that order."""
        gallery = Gallery.of(frames[:1], descriptions[:1])
        for frame, description in zip(frames[1:], descriptions[1:], strict=True):
            gallery = gallery.spread(Gallery.of([frame], [description]), rules.exemplars)
        points = np.concatenate([description.position for description in descriptions]).astype(np.float64)
        return Mode.from_points(rules, np.array(frames), _split(rules, len(points)), points, gallery)

    @staticmethod
    def from_points(
        rules: Parameters, frames: NDArray[np.int64], held: NDArray[np.bool_], points: Array, gallery: Gallery
    ) -> Mode:
        """Return the mode of frames whose statistics are computed from their position descriptors; see `Mode`."""
        model = points[~held]
        mean = model.mean(axis=0)
        return Mode(rules, frames, held, points, points.mean(axis=0), mean, _scatter(model, mean), gallery)

    def __len__(self) -> int:
        return len(self.frames)

    def add(self, frame: int, description: Description) -> Mode:
        """Return the mode with one more frame."""
        x = description.position[0].astype(np.float64)
        count = len(self) + 1
        held = self.rules.holds_out(int(self.held.sum()), len(self))
        points, flags = np.vstack([self.points, x]), np.append(self.held, held)
        mean, scatter = self.mean, self.scatter
        if not held:
            modelled = int((~flags).sum())
            away = x - mean
            mean = mean + away / modelled
            if scatter is None:
                scatter = _scatter(points[~flags], mean)
            else:
                scatter = scatter + np.outer(away, away * ((modelled - 1) / modelled))
        return replace(
            self,
            frames=np.append(self.frames, frame),
            held=flags,
            points=points,
            centre=self.centre + (x - self.centre) / count,
            mean=mean,
            scatter=scatter,
            gallery=self.gallery.spread(Gallery.of([frame], [description]), self.rules.exemplars),
        )

    def remove(self, frames: Sequence[int]) -> Mode:
        """Return the mode without some of its frames; some must be left."""
        left = ~np.isin(self.frames, frames)
        if left.all():
            return self
        held = self.held[left]
        if min(held.sum(), (~held).sum()) < 2:
            held = _split(self.rules, len(held))
        gallery = self.gallery.keep(~np.isin(self.gallery.frames, frames))
        return Mode.from_points(self.rules, self.frames[left], held, self.points[left], gallery)

    def merge(self, other: Mode) -> Mode:
        """Return the mode of the frames of both."""
        return Mode.from_points(
            self.rules,
            np.append(self.frames, other.frames),
            np.append(self.held, other.held),
            np.concatenate([self.points, other.points]),
            self.gallery.join(other.gallery).thin(self.rules.exemplars),
        )

    @cached_property
    def metric(self) -> Mahalanobis:
        """The distances of eq. 3."""
        if self.scatter is not None:
            squares = squared_distances(self.points, self.mean)[~self.held]
            return Mahalanobis.of(self.mean, self.scatter, squares, None, self.rules.shrinkage)
        away = self.points[~self.held] - self.mean
        product = away @ away.T
        return Mahalanobis.of(self.mean, product, np.diagonal(product), away, self.rules.shrinkage)

    @cached_property
    def usual(self) -> tuple[float, float]:
        """Mean and standard deviation of the distances of the held-out frames, the Gaussian of eq. 4.

        The deviation is that of a sample (n - 1), and 0 for fewer than two frames, so that nothing closes. Where
        `exemplars` are bounded, every second, fourth, ... of the held-out frames is used.
        """
        rows = np.flatnonzero(self.held)
        step = 1
        while self.rules.exemplars is not None and -(-len(rows) // step) > self.rules.exemplars:
            step *= 2
        distances = self.metric.distances(self.points[rows[::step]])
        if len(distances) < 2:
            return float(distances.sum()), 0.0
        return float(distances.mean()), float(distances.std(ddof=1))

    def shift(self, x: Array) -> float:
        """Return the left side of eq. 9: how far the representative would move with one more frame (D,)."""
        return float(np.linalg.norm(x - self.centre)) / (len(self) + 1)

    @cached_property
    def reach(self) -> float:
        """The right side of eq. 9: how far the representative would move without its most distant frame."""
        if len(self) < 2:
            return 0.0
        furthest = self.points[np.argmax(squared_distances(self.points, self.centre))]
        return float(np.linalg.norm(furthest - self.centre)) / (len(self) - 1)


def _split(rules: Parameters, count: int) -> NDArray[np.bool_]:
    """Choose which of `count` frames are held out."""
    flags: list[bool] = []
    for _ in range(count):
        flags.append(rules.holds_out(sum(flags), len(flags)))
    return np.array(flags, dtype=bool)


def _scatter(frames: Array, mean: Array) -> Array | None:
    """Return the scatter (D, D) of frames (n, D) about their mean; None for few of them."""
    if 2 * len(frames) <= len(mean):
        return None
    away = frames - mean
    return away.T @ away


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
        kept = [mode for mode in self.modes if not np.isin(mode.frames, frames).all()]
        return replace(self, modes=tuple(mode.remove(frames) for mode in kept))
