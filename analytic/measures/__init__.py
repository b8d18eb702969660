"""Measures of a clustering of frames: silhouettes, moments of inertia, purity by room, loop closures."""

from __future__ import annotations

from analytic.measures.closures import ClosureScores, closure_scores
from analytic.measures.compactness import (
    Silhouettes,
    moment_of_inertia,
    moments_of_inertia,
    silhouette,
    silhouettes,
)
from analytic.measures.rooms import Purity, purity

__all__ = [
    "ClosureScores",
    "Purity",
    "Silhouettes",
    "closure_scores",
    "moment_of_inertia",
    "moments_of_inertia",
    "purity",
    "silhouette",
    "silhouettes",
]
