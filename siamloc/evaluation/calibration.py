"""Quality of predicted errors: the calibration curve, and precision and recall of the verdict "lost"."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.evaluation.metrics.arrays import column_of
from siamloc.results import by_label


def calibration_curve(predicted: ArrayLike, error: ArrayLike, bins: int = 10) -> list[dict[str, Any]]:
    """Return mean predicted and observed errors in bins with about equal numbers of queries.

    Args:
        predicted: expected errors (n,).
        error: observed errors (n,).
        bins: largest number of bins; equal predictions stay in the same bin.

    Returns:
        For each bin, in order of the prediction: `count`, and the means `predicted` and `observed`.

    Raises:
        DataError: another shape, or values that are not finite.
    """
    expected, observed = column_of(predicted, "predicted errors"), column_of(error, "observed errors")
    if not len(expected):
        return []
    edges = np.unique(np.quantile(expected, np.arange(1, int(bins)) / bins, method="lower"))
    number = np.searchsorted(edges, expected)
    return [
        {"count": len(rows), "predicted": float(expected[rows].mean()), "observed": float(observed[rows].mean())}
        for rows in (np.flatnonzero(number == i) for i in range(len(edges) + 1))
        if len(rows)
    ]


def lost_measures(called: ArrayLike, error: ArrayLike, lost_above: float) -> dict[str, Any]:
    """Return how well the verdict "lost" agrees with true errors above a threshold.

    Args:
        called: which queries were called lost (n,).
        error: true errors (n,).
        lost_above: error above which a query is truly lost, in the unit of the errors.

    Returns:
        lost_above; the numbers of queries `called` lost, truly `lost` and `both`; `precision`, both / called; `recall`,
        both / lost;
        NaN if the denominator is zero.
    """
    verdict, lost = np.asarray(called, dtype=bool), np.asarray(error) > lost_above
    both, n_called, n_lost = (int(part.sum()) for part in (verdict & lost, verdict, lost))
    return {
        "lost_above": float(lost_above),
        "called": n_called,
        "lost": n_lost,
        "both": both,
        "precision": both / n_called if n_called else math.nan,
        "recall": both / n_lost if n_lost else math.nan,
    }


def calibration_measures(columns: Mapping[str, NDArray], lost_above: float) -> dict[str, Any]:
    """Return how well column `error_m` of `queries.csv` predicts column `error`: overall, by lighting and by room.

    Args:
        columns: columns of `queries.csv`; `lost` holds which queries were called lost.
        lost_above: error above which a query is truly lost, in the unit of the positions.

    Returns:
        The groups "overall", "lighting" (by label) and "room" (by label). A group holds `queries`; `predicted` and
        `observed`, the means; `gap`, the difference between predicted and observed error in a query's bin of the
        calibration curve, averaged over queries; `curve`, as from `calibration_curve`; and `lost`, from
        `lost_measures`.
    """

    def group(rows: NDArray[np.int64]) -> dict[str, Any]:
        predicted, error = columns["error_m"][rows], columns["error"][rows]
        curve = calibration_curve(predicted, error)
        gaps = math.fsum(part["count"] * abs(part["predicted"] - part["observed"]) for part in curve)
        return {
            "queries": len(rows),
            "predicted": float(predicted.mean()),
            "observed": float(error.mean()),
            "gap": gaps / len(rows),
            "curve": curve,
            "lost": lost_measures(columns["lost"][rows], error, lost_above),
        }

    return by_label(columns, group, "lighting", "room")
