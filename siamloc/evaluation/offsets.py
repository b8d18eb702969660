"""Positions without a common origin: of buildings that overlap, of drives beside what they look like, or that drift."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from siamloc.data.frames import FrameTable

_WINDOW = 15  # successive queries whose offsets are compared
_CLEAR = 3.0  # times the spacing of the map, and times the scatter of the offsets


def implausible_offsets(known: FrameTable, queries: FrameTable, matches: NDArray[np.int64]) -> Iterator[str]:
    """Find drives whose queries match map frames at some distance, successive queries in the same direction.

    Such a drive has positions with another origin than the map's, or odometry that drifts. Wrong matches look
    different: each lies in another direction from its query.

    Args:
        known: the map's frames (m), all with positions.
        queries: frames (n), all with positions.
        matches: the map frame that looks most like each query (n,).

    Yields:
        A sentence for each drive of which most queries are displaced.
    """
    from scipy.spatial import cKDTree

    distinct = np.unique(known.xy, axis=0)
    if len(distinct) < 2:
        return
    spacing = float(np.median(cKDTree(distinct).query(distinct, k=2)[0][:, 1]))
    for name, rows in queries.rows_by("sequence").items():
        if len(rows) < 2 * _WINDOW:
            continue
        offsets = known.xy[matches[rows]] - queries.xy[rows]
        middle, scatter = _windows(offsets)
        length, driven = np.linalg.norm(middle, axis=1), _windows(queries.xy[rows])[1]
        # Where a whole corridor looks like one map frame, offsets scatter as widely as the positions.
        clear = (length > _CLEAR * np.maximum(scatter, spacing)) & (scatter < driven / 2)
        if clear.mean() > 0.5:
            least, most = length[clear].min(), length[clear].max()
            yield (
                f"{clear.mean():.0%} of the queries of {name or 'the drive'} look like map frames {least:.2g} to "
                f"{most:.2g} {queries.unit} aside, successive ones in the same direction: their positions seem to have "
                "another origin than the map's, or to drift. The errors include this."
            )


def overlapping_buildings(*tables: FrameTable) -> str:
    """Return a sentence about two buildings of a map, and its queries, that overlap; an empty text if none do."""
    xy, building = (np.concatenate([getattr(one, key) for one in tables]) for key in ("xy", "building"))
    placed = np.isfinite(xy).all(axis=1) & (building != "")
    named = {name: xy[placed & (building == name)] for name in np.unique(building[placed]).tolist()}
    spans = {name: (own.min(axis=0), own.max(axis=0)) for name, own in named.items()}
    for (one, (low, high)), (other, (least, most)) in combinations(spans.items(), 2):
        if (low <= most).all() and (least <= high).all():
            return (
                f"the positions of the buildings {one} and {other} overlap: unless they have a common origin, "
                "distances between the two mean nothing, and floors, hits, true nodes and closures count them. Measure "
                "each by itself (docs/guide/evaluation.md says how), or move one of them aside."
            )
    return ""


def _windows(vectors: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the median of the vectors (n, 2) in each window (k, 2), and the median distance from it (k,)."""
    windows = sliding_window_view(vectors, _WINDOW, axis=0)
    middle = np.median(windows, axis=2)
    return middle, np.median(np.linalg.norm(windows - middle[:, :, None], axis=1), axis=1)
