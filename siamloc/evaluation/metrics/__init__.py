"""Measures of place recognition and localization: pure functions on arrays.

Positions are in the unit of the data set (metres by default), angles in radians.
"""

from siamloc.evaluation.metrics.errors import error_floor, heading_error, localization_error, summarize
from siamloc.evaluation.metrics.recall import (
    Recall,
    first_rank_within,
    one_percent,
    recall_at_k,
    recall_at_one_percent,
    recall_from_ranks,
)
from siamloc.evaluation.metrics.rooms import (
    PairAccuracy,
    PairCurve,
    confusion_matrix,
    fitted_margin,
    pair_accuracy,
    pair_dissimilarity,
    pair_threshold_curve,
)

__all__ = [
    "PairAccuracy",
    "PairCurve",
    "Recall",
    "confusion_matrix",
    "error_floor",
    "first_rank_within",
    "fitted_margin",
    "heading_error",
    "localization_error",
    "one_percent",
    "pair_accuracy",
    "pair_dissimilarity",
    "pair_threshold_curve",
    "recall_at_k",
    "recall_at_one_percent",
    "recall_from_ranks",
    "summarize",
]
