"""A node of the map ([I] 4.1): its frames, their mean and covariance, and how far its own frames usually are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic.arrays import Floats, Integers
from analytic.descriptors.base import Description
from analytic.errors import AnalyticError
from analytic.mapper.parameters import CLOSE, Parameters

_LEAST_SHRINKAGE = 1e-6  # two frames, or frames on one line, have intensity 0 and a covariance without inverse
_LEAST_VARIANCE = 1e-12  # of equal frames, relative to their mean square
_NO_VARIANCE = 1e-30  # of frames that are all zero
_FEW = 24  # values of a descriptor in the lower bound of a distance


@dataclass(frozen=True)
class Mahalanobis:
    """Squared Mahalanobis distances to the mean of a mode (eq. 3), prepared in one matrix.

    A node has few frames for the numbers of its descriptor, so its covariance S is shrunk towards a multiple of the
    identity: C = (1 - a) S + c I, where c is the intensity a times the mean variance, and a is that of Ledoit and Wolf
    (2004) by default. With Y (n, D), the frames about their mean, and s = (1 - a) / n, that is C = s Y^T Y + c I. With
    L the Cholesky factor of C, the distance of z = d - mean is z^T C^-1 z = |L^-1 z|^2.

    While n is at most D / 2, a smaller matrix (n, n) does, by Woodbury's identity: with L the Cholesky factor of
    s Y Y^T + c I, the distance is (|z|^2 - |L^-1 sqrt(s) Y z|^2) / c.

    Attributes:
        mean: (D,).
        factor: L (D, D) or (n, n).
        rows: sqrt(s) Y (n, D) for the smaller matrix, else None.
        least: c, the least variance of any direction.
        bound: (k, k + 1) inverse Cholesky factor of the covariance of every few numbers of the descriptor, and minus
            its product with their mean: |bound (d, 1)|^2 is their distance, which is at most that of all numbers.
    """

    mean: Floats
    factor: Floats
    rows: Floats | None
    least: float
    bound: Floats

    @staticmethod
    def of(mean: Floats, points: Floats, scatter: Floats | None, shrinkage: str | float) -> Mahalanobis:
        """Prepare the distances to n frames.

        Args:
            mean: (D,) mean of the frames.
            points: (n, D) the frames.
            scatter: Y^T Y (D, D); None for few frames.
            shrinkage: "ledoit_wolf" or a fixed intensity.

        Raises:
            AnalyticError: the covariance has no inverse.
        """
        from scipy.linalg import lapack
        from scipy.spatial.distance import cdist

        count, size = points.shape
        away = points - mean if scatter is None else points[:0]
        product = away @ away.T if scatter is None else scatter
        squares = cdist(points, mean[None], "sqeuclidean")[:, 0]
        intensity = ledoit_wolf(product, squares, size) if isinstance(shrinkage, str) else float(shrinkage)
        least = intensity * max(
            float(np.trace(product)) / (count * size), _LEAST_VARIANCE * float(np.mean(mean**2)), _NO_VARIANCE
        )
        weight, few = (1 - intensity) / count, every_few(size)
        part = away[:, few].T @ away[:, few] if scatter is None else scatter[few, few]
        inverse = lapack.dtrtri(_cholesky(weight * part, least), lower=1)[0]
        bound = np.column_stack([inverse, -inverse @ mean[few]])
        rows = np.sqrt(weight) * away if scatter is None else None
        return Mahalanobis(mean, _cholesky(weight * product, least), rows, least, bound)

    def distances(self, points: Floats) -> Floats:
        """Return the squared distances (n,) of points (n, D)."""
        from scipy.linalg import lapack

        away = (points - self.mean).T
        inside = lapack.dtrtrs(self.factor, away if self.rows is None else self.rows @ away, lower=1)[0]
        squares = np.einsum("dn,dn->n", inside, inside)
        if self.rows is None:
            return squares
        return np.maximum(np.einsum("dn,dn->n", away, away) - squares, 0.0) / self.least


def every_few(size: int) -> slice:
    """Return the indices of every few of `size` numbers of a descriptor, for the lower bound of a distance."""
    return slice(None, None, -(-size // _FEW))


def ledoit_wolf(product: Floats, squares: Floats, size: int) -> float:
    """Compute the shrinkage intensity of Ledoit and Wolf (2004), in [1e-6, 1].

    With S = Y^T Y / n and p = D: b2 = (sum |y|^4 / n - |S|^2) / n against d2 = |S|^2 - trace(S)^2 / p, and
    min(b2, d2) / d2.

    Args:
        product: Y^T Y (D, D) or Y Y^T (n, n), which have the same trace and the same norm.
        squares: (n,) the |y|^2.
        size: D, the number of values of a position descriptor.
    """
    count = len(squares)
    spread = float(np.einsum("ij,ij->", product, product)) / count**2
    excess = spread - (float(np.trace(product)) / count) ** 2 / size
    error = min((float(squares @ squares) / count - spread) / count, excess)
    return max(error / excess, _LEAST_SHRINKAGE) if error > 0 and excess > 0 else _LEAST_SHRINKAGE


def _cholesky(covariance: Floats, least: float) -> Floats:
    """Return the lower Cholesky factor of a covariance plus `least` times the identity."""
    from scipy.linalg import lapack

    covariance[np.diag_indices(len(covariance))] += least
    factor, failed = lapack.dpotrf(covariance.T, lower=1, overwrite_a=1)
    if failed:
        raise AnalyticError("the covariance of a node cannot be inverted: its frames are too alike; raise shrinkage")
    return factor


@dataclass(frozen=True)
class Gallery:
    """The frames of a mode that images are compared with. Immutable: methods return another gallery.

    The spectrum of each frame is computed once, on its own, so that its values depend on no other frame.

    Attributes:
        frames: (n,) numbers of the frames, in the order in which they joined.
        shown: descriptions of the frames, in the same order.
    """

    frames: Integers
    shown: Description

    @staticmethod
    def of(frames: Sequence[int] | Integers, descriptions: Sequence[Description]) -> Gallery:
        """Return the gallery of frames with these numbers and descriptions."""
        shown = Description.concatenate(descriptions)
        if shown.orientation is not None:
            shown.kept("spectrum", lambda _: np.concatenate([part.spectrum for part in descriptions], axis=1))
        return Gallery(np.array(frames, dtype=np.int64), shown)

    def __len__(self) -> int:
        return len(self.frames)

    def keep(self, rows: Any) -> Gallery:
        """Return the gallery of some rows, given as an index array or a mask."""
        shown = self.shown.take(rows)
        if shown.orientation is not None:
            shown.kept("spectrum", lambda _: self.shown.spectrum[:, rows])
        return Gallery(self.frames[rows], shown)

    def join(self, other: Gallery) -> Gallery:
        """Return the gallery of the frames of two galleries."""
        return Gallery.of(np.append(self.frames, other.frames), [self.shown, other.shown])

    def spread(self, other: Gallery, limit: int | None) -> Gallery:
        """Add the single frame of another gallery to a gallery of at most `limit` frames.

        A full gallery takes the frame only if it is further from all others than the closest two are from each other;
        the later of those two then goes. The frames that stay cover the node as evenly as a single pass over the frames
        allows.
        """
        if limit is None or len(self) < limit:
            return self.join(other)
        least, later = self.closest
        apart = self.shown.position.astype(np.float64) - other.shown.position
        if np.sqrt(np.square(apart).sum(axis=1).min()) <= least:
            return self
        return self.keep(np.arange(len(self)) != later).join(other)

    def thin(self, limit: int | None) -> Gallery:
        """Remove the later frame of the closest pair until at most `limit` frames are left."""
        gallery = self
        while limit is not None and len(gallery) > limit:
            gallery = gallery.keep(np.arange(len(gallery)) != gallery.closest[1])
        return gallery

    @cached_property
    def closest(self) -> tuple[float, int]:
        """The smallest distance between position parts of two frames, and the row of the later of the two frames."""
        from scipy.spatial.distance import cdist

        points = self.shown.position.astype(np.float64)
        apart = cdist(points, points)
        apart[np.tril_indices(len(self))] = np.inf
        first, second = np.unravel_index(np.argmin(apart), apart.shape)
        return float(apart[first, second]), int(second)


@dataclass(frozen=True)
class Mode:
    """One appearance of a node's place, such as under one light. Immutable: methods that change it return another mode.

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
    frames: Integers
    held: NDArray[np.bool_]
    points: Floats
    centre: Floats
    mean: Floats
    scatter: Floats | None
    gallery: Gallery

    @staticmethod
    def of(rules: Parameters, frames: Sequence[int], descriptions: Sequence[Description]) -> Mode:
        """Return the mode of frames with these numbers and descriptions, which join in that order."""
        gallery = Gallery.of(frames[:1], descriptions[:1])
        for frame, description in zip(frames[1:], descriptions[1:], strict=True):
            gallery = gallery.spread(Gallery.of([frame], [description]), rules.exemplars)
        points = np.concatenate([description.position for description in descriptions]).astype(np.float64)
        return Mode.from_points(rules, np.array(frames), _split(rules, len(points)), points, gallery)

    @staticmethod
    def from_points(
        rules: Parameters, frames: Integers, held: NDArray[np.bool_], points: Floats, gallery: Gallery
    ) -> Mode:
        """Return the mode of frames, with statistics computed from their position descriptors; see `Mode`."""
        model = points[~held]
        mean = model.mean(axis=0)
        return Mode(rules, frames, held, points, points.mean(axis=0), mean, _scatter(model, mean), gallery)

    def __len__(self) -> int:
        return len(self.frames)

    def add(self, frame: int, description: Description) -> Mode:
        """Return the mode with one more frame."""
        x = description.position[0].astype(np.float64)
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
        centre = self.centre + (x - self.centre) / (len(self) + 1)
        gallery = self.gallery.spread(Gallery.of([frame], [description]), self.rules.exemplars)
        return Mode(self.rules, np.append(self.frames, frame), flags, points, centre, mean, scatter, gallery)

    def remove(self, frames: Sequence[int]) -> Mode:
        """Return the mode without some of its frames; at least one frame must stay."""
        left = ~np.isin(self.frames, frames)
        if left.all():
            return self
        held = self.held[left]
        if min(held.sum(), (~held).sum()) < 2:
            held = _split(self.rules, len(held))
        gallery = self.gallery.keep(~np.isin(self.gallery.frames, frames))
        return Mode.from_points(self.rules, self.frames[left], held, self.points[left], gallery)

    def merge(self, other: Mode) -> Mode:
        """Return the mode of the frames of two modes."""
        frames, held = np.append(self.frames, other.frames), np.append(self.held, other.held)
        gallery = self.gallery.join(other.gallery).thin(self.rules.exemplars)
        return Mode.from_points(self.rules, frames, held, np.concatenate([self.points, other.points]), gallery)

    @cached_property
    def metric(self) -> Mahalanobis:
        """The squared Mahalanobis distances of eq. 3, prepared for the mode."""
        return Mahalanobis.of(self.mean, self.points[~self.held], self.scatter, self.rules.shrinkage)

    @cached_property
    def usual(self) -> tuple[float, float]:
        """Mean and standard deviation of the distances of the held-out frames, the Gaussian of eq. 4.

        The deviation is that of a sample (n - 1), and 0 for fewer than two frames, so that nothing closes. Where
        `exemplars` are bounded, every second, fourth, ... of the held-out frames is used.
        """
        rows = np.flatnonzero(self.held)
        while self.rules.exemplars is not None and len(rows) > self.rules.exemplars:
            rows = rows[::2]
        distances = self.metric.distances(self.points[rows])
        return float(distances.sum() / max(len(rows), 1)), float(distances.std(ddof=1)) if len(rows) > 1 else 0.0

    def shift(self, x: Floats) -> float:
        """Return the left side of eq. 9 (D,): how far the representative would move with another frame."""
        return float(np.linalg.norm(x - self.centre)) / (len(self) + 1)

    @cached_property
    def reach(self) -> float:
        """The right side of eq. 9: how far the representative would move without its most distant frame."""
        from scipy.spatial.distance import cdist

        return float(cdist(self.points, self.centre[None]).max()) / max(len(self) - 1, 1)


def _split(rules: Parameters, count: int) -> NDArray[np.bool_]:
    """Return which of `count` frames are held out (count,), as if they joined one by one."""
    return np.diff(np.floor(rules.held_out * np.arange(count + 1) + CLOSE)) > 0


def _scatter(frames: Floats, mean: Floats) -> Floats | None:
    """Return the scatter (D, D) of frames (n, D) about their mean; None for few of them."""
    if 2 * len(frames) <= len(mean):
        return None
    away = frames - mean
    return away.T @ away


@dataclass(frozen=True)
class Node:
    """A place in the map, with one mode for each of its appearances.

    Attributes:
        id: number that is never used twice.
        modes: the node's modes, at least one.
    """

    id: int
    modes: tuple[Mode, ...]

    def __len__(self) -> int:
        return sum(len(mode) for mode in self.modes)

    @property
    def frames(self) -> list[int]:
        """The numbers of the node's frames, in capture order."""
        return sorted(np.concatenate([mode.frames for mode in self.modes]).tolist())

    def with_mode(self, index: int, mode: Mode) -> Node:
        """Return the node with one mode replaced."""
        return replace(self, modes=(*self.modes[:index], mode, *self.modes[index + 1 :]))

    def remove(self, frames: Sequence[int]) -> Node:
        """Return the node without some of its frames; a mode that loses all its frames is removed."""
        kept = [mode for mode in self.modes if not np.isin(mode.frames, frames).all()]
        return replace(self, modes=tuple(mode.remove(frames) for mode in kept))
