"""Global-appearance descriptors of panoramas, distances, clustering and the incremental mapper.

Inputs and outputs are NumPy arrays. Importing the package does not load torch.
"""

from __future__ import annotations

from analytic import clustering, measures
from analytic.description import Alignment, Description, Match
from analytic.descriptors.base import Descriptor, ImageDescriptor
from analytic.descriptors.registry import DESCRIPTORS, descriptor
from analytic.distances import DISTANCES, distance
from analytic.errors import AnalyticError
from analytic.mapper import Decision, IncrementalMapper, Reason

__all__ = [
    "DESCRIPTORS",
    "DISTANCES",
    "Alignment",
    "AnalyticError",
    "Decision",
    "Description",
    "Descriptor",
    "ImageDescriptor",
    "IncrementalMapper",
    "Match",
    "Reason",
    "clustering",
    "descriptor",
    "distance",
    "measures",
]
