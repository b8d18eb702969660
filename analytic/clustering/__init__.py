"""Compact maps: frames clustered by their descriptors, with one representative per cluster ([C] 3).

Every method numbers its clusters from 0 to k-1 in the order in which they first appear among the frames.
"""

from __future__ import annotations

from analytic.clustering.compact import positions, representatives, sample, sample_rows
from analytic.clustering.self_organizing import som
from analytic.clustering.spectral_clustering import affinity, spectral

__all__ = [
    "affinity",
    "positions",
    "representatives",
    "sample",
    "sample_rows",
    "som",
    "spectral",
]
