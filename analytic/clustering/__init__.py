"""Compact maps: frames grouped by their descriptors, and one representative for each group ([C] 3).

Every method numbers its clusters 0 to k-1 in the order in which they first appear among the frames.
"""

from __future__ import annotations

from analytic.clustering.compact import positions, representatives, sample, sample_rows
from analytic.clustering.normalized import partition, spectral
from analytic.clustering.self_organizing import som
from analytic.clustering.similarity import affinity

__all__ = [
    "affinity",
    "partition",
    "positions",
    "representatives",
    "sample",
    "sample_rows",
    "som",
    "spectral",
]
