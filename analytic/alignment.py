"""Align two descriptions: find the relative heading, and the distance at that turn.

A robot that turns left by s steps sees its surroundings s steps further right: Q[k] = R[k - s], so the circular
correlation c[s] = sum_k Q[k] R[k - s] has its peak there. By the correlation theorem c is the inverse transform of
Q conj(R), which costs one small product per frequency instead of one comparison per turn.

Turning changes neither lengths nor means. The turn with the largest correlation is therefore the one with the
smallest Euclidean distance, and the Euclidean, cosine and Pearson distances need nothing more than the peak: no vector
has to be turned. Each of these distances is a difference of two numbers that nearly agree for similar vectors, and the
peak is rounded to float32. Pairs for which that would lose precision are compared value by value.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache, partial
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from analytic.arrays import Floats, Integers
from analytic.description import Description, fft
from analytic.distances import distance as distance_named
from foundation.threads import each

Spectra = NDArray[np.complex64]  # (frequencies, B, F)
Turned = Callable[[int], NDArray[Any]]  # returns a query turned back by a number of steps
Measure = Callable[[NDArray[Any], NDArray[Any]], float]  # the distance of two arrays of the same shape
_CLOSE = 2e-2  # a squared distance below this share of the squared lengths is not computed from a float32 peak
_FAINT = 1e-5
_VALUES = 1 << 23  # of correlations in memory at once: 32 MiB


class Turns(NamedTuple):
    """The best turn of each query against each reference.

    Attributes:
        step: (n, m) steps that the robot of the query has turned left, in [0, steps).
        peak: (n, m) scalar product of query and reference at that turn.
    """

    step: Integers
    peak: Floats


def heading(step: NDArray[Any], steps: int) -> Floats:
    """Convert a number of steps to the left into an angle, rad in (-pi, pi].

    Example:
        >>> np.degrees(heading(np.array([0, 1, 2, 3]), 4))
        array([  0.,  90., 180., -90.])
    """
    turned = np.asarray(step) % steps
    return np.where(2 * turned > steps, turned - steps, turned) * (2 * np.pi / steps)


def best_turns(
    queries: Spectra,
    references: Spectra,
    steps: int,
    *,
    product: tuple[Spectra, Spectra] | None = None,
    whole: bool = False,
) -> Turns:
    """Return the turn with the largest correlation of each pair; ties go to the smallest step.

    Only a bounded part of the correlations is in memory at once.

    Args:
        queries: spectra (U, n, F) of real values at `steps` steps; U may leave out the highest frequencies.
        references: spectra (U, m, F).
        steps: K, steps of a full turn.
        product: the spectra whose scalar product at that turn is the peak; the correlated spectra if None.
        whole: whether correlations are whole numbers; they are then rounded, so that ties are exact.

    Example:
        >>> from analytic.description import spectrum
        >>> seen = np.random.default_rng(0).random((1, 12, 5))
        >>> turned = np.roll(seen, 3, axis=1)
        >>> best_turns(spectrum(turned), spectrum(seen), 12).step
        array([[3]])
    """
    shape = (queries.shape[1], references.shape[1])
    found = Turns(np.zeros(shape, dtype=np.int64), np.zeros(shape))
    for rows, columns in _blocks(*shape, steps):
        crossed = _crossed(queries[:, rows], references[:, columns])
        correlation = fft().irfft(crossed, n=steps, axis=2)
        if whole:
            np.rint(correlation, out=correlation)
        best = found.step[rows, columns] = correlation.argmax(axis=2)
        if product is None:
            found.peak[rows, columns] = np.take_along_axis(correlation, best[..., None], axis=2)[..., 0]
        else:
            crossed = _crossed(product[0][:, rows], product[1][:, columns])
            found.peak[rows, columns] = np.einsum("nmu,nmu->nm", crossed, _waves(len(product[0]), steps)[best]).real
    return found


def whitened_turns(queries: Description, references: Description, steps: int) -> Turns:
    """Return the turn with the largest correlation of phases of each pair, and the plain scalar product at that turn.

    Magnitudes below 1e-5 of a description's largest count as zero.
    """
    phases = [made.kept("phases", lambda one: whitened(one.spectrum, _FAINT)) for made in (queries, references)]
    return best_turns(phases[0], phases[1], steps, product=(queries.spectrum, references.spectrum))


def aligned_distances(name: str, queries: Description, references: Description, turns: Turns) -> Floats:
    """Return the named distance (n, m) between orientation parts of each pair at its turn.

    Args:
        name: a name in `analytic.DISTANCES`.
        queries: n descriptions.
        references: m descriptions.
        turns: the best turn of each pair, from `best_turns`.

    Example:
        >>> import analytic
        >>> hog = analytic.descriptor("hog")
        >>> seen = hog.describe(np.random.default_rng(0).random((2, 128, 512)))
        >>> turns = best_turns(seen.spectrum, seen.spectrum, seen.orientation.shape[1])
        >>> np.diag(aligned_distances("euclidean", seen, seen, turns))
        array([0., 0.])
    """
    measure: Measure = norm
    if name in ("euclidean", "minkowski"):
        apart, close = euclidean(turns.peak, queries.squares[:, None] + references.squares)
    elif name == "manhattan":
        apart, close = np.zeros(turns.step.shape), np.ones(turns.step.shape, dtype=bool)
        measure = partial(norm, kind=cv2.NORM_L1)
    else:
        apart, close = _from_similarity(name, queries, references, turns.peak)
        measure = partial(_named, distance_named(name))
    values = queries.turnable
    return directly(apart, close, turns.step, lambda row: rolled(values[row]), references.turnable, measure)


def euclidean(product: Floats, lengths: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return Euclidean distances (n, m), and which pairs are too close for these to be precise.

    Args:
        product: (n, m) scalar product of each pair.
        lengths: (n, m) sum of both squared lengths.
    """
    squared = lengths - 2 * product
    return np.sqrt(np.maximum(squared, 0)), squared < _CLOSE * lengths


def directly(
    apart: Floats,
    close: NDArray[np.bool_],
    step: Integers,
    turned: Callable[[int], Turned],
    references: NDArray[Any],
    measure: Measure,
) -> Floats:
    """Return distances (n, m) after comparing close pairs value by value.

    Args:
        apart: (n, m) the distances of all other pairs.
        close: (n, m) True for pairs whose entry in `apart` is too imprecise.
        step: (n, m) turn of each pair, in steps.
        turned: returns, for the index of a query, the function that turns it back by a number of steps.
        references: (m, ...) values to compare with.
        measure: distance of a turned query and a reference.
    """

    def compare(query: Turned, row: int, columns: Integers) -> list[float]:
        return [measure(query(int(step[row, column])), references[column]) for column in columns]

    for row in np.flatnonzero(close.any(axis=1)).tolist():
        columns = np.flatnonzero(close[row])
        parts = np.array_split(columns, max(1, columns.size * references[0].size >> 24))
        apart[row, columns] = np.concatenate(each(partial(compare, turned(row), row), parts, cv2.getNumThreads()))
    return apart


def norm(one: NDArray[Any], other: NDArray[Any], kind: int = cv2.NORM_L2) -> float:
    """Return the distance of two arrays of the same shape, summed in double precision in a single pass.

    Args:
        one: float32.
        other: values of the same shape.
        kind: which distance, as a constant of OpenCV.
    """
    return float(cv2.norm(one, other.astype(one.dtype, copy=False), kind))


def whitened(spectra: Spectra, least: float) -> Spectra:
    """Return spectra with magnitude 1, or 0 where the magnitude is below a share of the description's largest.

    Correlating phases alone keeps one part of the image from outweighing the others.

    Example:
        >>> whitened(np.array([[[3j]], [[1e-9]]]), 1e-5).ravel()
        array([0.+1.j, 0.+0.j])
    """
    magnitude = np.abs(spectra)
    floor = least * magnitude.max(axis=(0, 2), keepdims=True)
    return np.divide(spectra, magnitude, out=np.zeros_like(spectra), where=magnitude > floor)


def moments(description: Description) -> tuple[Floats, Floats]:
    """Return the means of orientation parts, and their lengths after subtracting the means, (B,) each."""
    flat = description.turnable.reshape(len(description), -1)
    mean = flat.mean(axis=1, dtype=np.float64)
    squares = [np.square(row - middle).sum() for row, middle in zip(flat, mean, strict=True)]
    return mean, np.sqrt(np.array(squares, dtype=np.float64))


def rolled(query: NDArray[Any]) -> Turned:
    """Return a function that takes a number of steps s, and returns an orientation part turned back by s, as a view.

    Args:
        query: the orientation part (K, F): K steps of a full turn with F numbers each.
    """
    twice = np.concatenate([query, query])  # each turn of the query is a stretch of it: Q[k + s] against R[k]
    return lambda step: twice[step : step + len(query)]


def _blocks(n: int, m: int, steps: int) -> Iterator[tuple[slice, slice]]:
    """Yield the blocks of a table of pairs (n, m) whose correlations at every turn fit in bounded memory."""
    most = max(1, _VALUES // steps)
    width = max(1, min(m, most))
    height = max(1, most // width)
    for top in range(0, n, height):
        for left in range(0, m, width):
            yield slice(top, top + height), slice(left, left + width)


def _crossed(queries: Spectra, references: Spectra) -> Spectra:
    """Return the sum over the features of Q conj(R), (n, m, U)."""
    # Computed as conj(R conj(Q)), which needs no conjugate copy of a whole map.
    return (queries.conj() @ references.transpose(0, 2, 1)).conj().transpose(1, 2, 0)


@lru_cache(maxsize=8)
def _waves(frequencies: int, steps: int) -> NDArray[np.complex64]:
    """Return the matrix (steps, frequencies) that maps a spectrum to its inverse transform at every step."""
    frequency = np.arange(frequencies)
    weight = np.where((frequency == 0) | (2 * frequency == steps), 1, 2) / steps
    waves: NDArray[np.complex128] = weight * np.exp(2j * np.pi * frequency * np.arange(steps)[:, None] / steps)
    return waves.astype(np.complex64)


def _from_similarity(
    name: str, queries: Description, references: Description, peak: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return cosine or Pearson distances (n, m), and which pairs are too close for these to be precise."""
    lengths = np.sqrt(np.outer(queries.squares, references.squares))
    scale, product = lengths, peak
    if name == "correlation":
        (mean, spread), (known_mean, known_spread) = (d.kept("moments", moments) for d in (queries, references))
        scale = np.outer(spread, known_spread)
        product = peak - queries.turnable[0].size * np.outer(mean, known_mean) if peak.size else peak
    similarity = np.divide(product, scale, out=np.zeros_like(peak), where=scale > 0)
    return np.clip(1 - similarity, 0, 2), scale - product < _CLOSE / 2 * lengths


def _named(measure: Callable[..., Floats], one: NDArray[Any], other: NDArray[Any]) -> float:
    return float(measure(one.reshape(1, -1), other.reshape(1, -1))[0, 0])
