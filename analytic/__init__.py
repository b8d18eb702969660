"""Global-appearance descriptors of panoramas, distances, clustering and the incremental mapper.

Arrays of numpy go in and come out. Importing the package does not load torch.
"""

from __future__ import annotations

from analytic.descriptors.base import Description, Descriptor
from analytic.descriptors.thumbnail import Thumbnail
from analytic.distances import DISTANCES, distance
from analytic.errors import AnalyticError

__all__ = ["DISTANCES", "AnalyticError", "Description", "Descriptor", "Thumbnail", "distance"]
