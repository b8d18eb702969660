"""Late fusion: how far apart images typically are by each part of a fused descriptor, and how much each part counts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from analytic import Fused
from analytic.distances import DISTANCES
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError
from siamloc.maps.search import slices

Blocks = Mapping[str, NDArray[np.float32]]
"""The position parts (n, D_i) of n frames by each part of a fused descriptor."""

_SAMPLE = 512  # frames of a map
_MOST = 300  # combinations of weights that are tried
_TENTHS = 10  # steps from a weight of 0 to a weight of 1, for few parts
_PAIRS_AT_ONCE = 1 << 22


def check_apart(frames: FrameTable, validation: FrameTable | None) -> None:
    """Refuse validation frames from a drive of the map; without names of drives, frames of the map.

    Raises:
        ConfigError: a drive, or a frame without a drive, is in both.
    """
    if validation is None:
        return
    drives = ({name or path for name, path in table.identities()} for table in (frames, validation))
    if both := set.intersection(*drives):
        raise ConfigError(
            f"weights are learned on other drives than the map's, and {min(both)!r} is in the map and in the "
            "validation: validate on another sequence (on the command line protocol.validation.sequences)"
        )


def weighted(
    by: Fused,
    known: NDArray[np.float32],
    frames: FrameTable,
    asked: NDArray[np.float32] | None = None,
    validation: FrameTable | None = None,
) -> tuple[Fused, str]:
    """Return a fused descriptor with typical distances and weights, and a sentence about the weights.

    The typical distance of a part is the median distance of two of at most 512 map frames, evenly spaced. The weights,
    if the descriptor has none, are those of a grid on which the nearest map frames of the validation frames are nearest
    to them on average; if there are no positions, those with which fewest are in another room. The grid has steps of
    0.1 for up to four parts and larger ones for more, about 300 combinations at most; of equally good combinations, the
    most even one is taken. Without validation frames, the weights are equal.

    Args:
        by: the descriptor, with `widths`; it may have weights.
        known: (n, D) position parts of the map frames by it, not scaled yet.
        frames: the n map frames.
        asked: (m, D) those of the validation frames.
        validation: the m validation frames.
    """
    blocks, few = by.split(known), slice(None, None, -(-len(frames) // _SAMPLE))
    typical = {name: _median_distance(block[few]) for name, block in blocks.items()}
    weights, how = by.weights, "as given"
    if weights is None:
        weights, how = dict.fromkeys(blocks, 1.0), "equal, since there are no validation frames to learn them from"
        if asked is not None and validation is not None:
            how = "equal, since map and validation frames have neither positions nor rooms to learn them from"
            if found := _learned(blocks, frames, by.split(asked), validation, typical):
                weights, how = found
    made = replace(by, weights=weights, typical=typical)
    shares = ", ".join(f"{name} {weight:.2g}" for name, weight in (made.weights or {}).items())
    return made, f"{shares} ({how})"


def _learned(
    known: Blocks, frames: FrameTable, asked: Blocks, validation: FrameTable, typical: Mapping[str, float]
) -> tuple[dict[str, float], str] | None:
    """Return the best weights on the validation frames, and how good they are; None if nothing can be compared."""
    by_place = frames.has_position.any() and validation.has_position.any()
    inside, rows = (
        np.flatnonzero(table.has_position if by_place else table.room != "") for table in (frames, validation)
    )
    if not len(inside) or not len(rows):
        return None
    grid = _grid(len(known))
    off = np.zeros(len(grid))
    for part in slices(len(rows), _PAIRS_AT_ONCE // len(inside)):
        some = rows[part]
        apart = [_squares(asked[name][some], block[inside]) / typical[name] ** 2 for name, block in known.items()]
        if by_place:
            missed = DISTANCES["euclidean"](validation.xy[some], frames.xy[inside])
        else:
            missed = (validation.room[some, None] != frames.room[inside]).astype(float)
        for row, weights in enumerate(grid):
            nearest = sum(weight * one for weight, one in zip(weights, apart, strict=True)).argmin(axis=1)
            off[row] += missed[np.arange(len(some)), nearest].sum()
    off /= len(rows)
    order = np.square(grid - 1 / len(known)).sum(axis=1).argsort(kind="stable")
    best = order[off[order].argmin()]
    unit = frames.unit
    scores = [f"{value:.2f} {unit}" if by_place else f"{value:.1%}" for value in (off[best], off[order[0]])]
    what = "mean error" if by_place else "share of wrong rooms"
    how = f"learned on {len(rows)} validation frames: {what} {scores[0]}, with equal weights {scores[1]}"
    return dict(zip(known, grid[best].tolist(), strict=True)), how


def _grid(parts: int) -> NDArray[np.float64]:
    """Return combinations of weights (g, parts) with the sum 1: the finest even grid with few enough of them."""
    steps = max([n for n in range(1, _TENTHS + 1) if comb(n + parts - 1, parts - 1) <= _MOST], default=1)
    bars = np.array(list(combinations(range(steps + parts - 1), parts - 1)))
    ends = np.concatenate([np.full((len(bars), 1), -1), bars, np.full((len(bars), 1), steps + parts - 1)], axis=1)
    return (np.diff(ends, axis=1) - 1) / steps


def _median_distance(block: NDArray[np.float32]) -> float:
    """Return the median distance of two frames (n, D); 1 if all are the same."""
    apart = DISTANCES["euclidean"](block, block)[np.triu_indices(len(block), 1)]
    return float(np.median(apart[apart > 0])) if (apart > 0).any() else 1.0


def _squares(some: NDArray[np.float32], others: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return squared distances (n, m), which may be below 0 by rounding."""
    left, right = (np.einsum("ij,ij->i", one, one) for one in (some, others))
    return left[:, None] + right - 2 * some @ others.T
