"""Maps: descriptors stored with poses and rooms, exact search, coarse layers and the sequence filter.

    known = siamloc.maps.build("hog", images, monday)
    found = known.search(vectors, k=5)

Importing this package loads neither torch nor scipy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc.maps.coarse import UNASSIGNED, CoarseLayer
    from siamloc.maps.describing import build, describe
    from siamloc.maps.error_model import ErrorModel
    from siamloc.maps.grouping import WAYS, Built, group
    from siamloc.maps.heading import HeadingPart
    from siamloc.maps.hierarchy import HierarchicalRetrieval, HierarchicalSearch, LayerSearch
    from siamloc.maps.interpolation import interpolate_poses
    from siamloc.maps.matching import frame_distances, headings, match
    from siamloc.maps.pose_filter import PoseFilter
    from siamloc.maps.projector import write_projector
    from siamloc.maps.ranking import NodeRanking
    from siamloc.maps.refinement import RefinedPoses, Refinement, refine
    from siamloc.maps.search import Retrieval, VectorIndex
    from siamloc.maps.sequence_filter import MotionModel, SequenceFilter, temperature_of_map, tune_filter
    from siamloc.maps.visual_map import VisualMap

_HOMES = {
    "UNASSIGNED": "coarse",
    "CoarseLayer": "coarse",
    "build": "describing",
    "describe": "describing",
    "ErrorModel": "error_model",
    "WAYS": "grouping",
    "Built": "grouping",
    "group": "grouping",
    "HeadingPart": "heading",
    "HierarchicalRetrieval": "hierarchy",
    "HierarchicalSearch": "hierarchy",
    "LayerSearch": "hierarchy",
    "NodeRanking": "ranking",
    "interpolate_poses": "interpolation",
    "frame_distances": "matching",
    "headings": "matching",
    "match": "matching",
    "PoseFilter": "pose_filter",
    "write_projector": "projector",
    "RefinedPoses": "refinement",
    "Refinement": "refinement",
    "refine": "refinement",
    "Retrieval": "search",
    "VectorIndex": "search",
    "MotionModel": "sequence_filter",
    "SequenceFilter": "sequence_filter",
    "temperature_of_map": "sequence_filter",
    "tune_filter": "sequence_filter",
    "VisualMap": "visual_map",
}

__all__ = [
    "UNASSIGNED",
    "WAYS",
    "Built",
    "CoarseLayer",
    "ErrorModel",
    "HeadingPart",
    "HierarchicalRetrieval",
    "HierarchicalSearch",
    "LayerSearch",
    "MotionModel",
    "NodeRanking",
    "PoseFilter",
    "RefinedPoses",
    "Refinement",
    "Retrieval",
    "SequenceFilter",
    "VectorIndex",
    "VisualMap",
    "build",
    "describe",
    "frame_distances",
    "group",
    "headings",
    "interpolate_poses",
    "match",
    "refine",
    "temperature_of_map",
    "tune_filter",
    "write_projector",
]

__getattr__, __dir__ = lazy(__name__, _HOMES)
