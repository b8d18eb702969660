"""Maps: descriptors with poses and rooms on disk, and exact search in them. Loads neither torch nor scipy at import."""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc.maps.coarse import CoarseLayer
    from siamloc.maps.heading import HeadingPart, WithHeading
    from siamloc.maps.layers import build_layer
    from siamloc.maps.matching import estimated_headings, match
    from siamloc.maps.search import Retrieval, nearest
    from siamloc.maps.visual_map import VisualMap

__all__ = [
    "CoarseLayer",
    "HeadingPart",
    "Retrieval",
    "VisualMap",
    "WithHeading",
    "build_layer",
    "estimated_headings",
    "match",
    "nearest",
]

_HOMES = {
    "CoarseLayer": "coarse",
    "HeadingPart": "heading",
    "WithHeading": "heading",
    "build_layer": "layers",
    "Retrieval": "search",
    "nearest": "search",
    "VisualMap": "visual_map",
    "match": "matching",
    "estimated_headings": "matching",
}

__getattr__, __dir__ = lazy(__name__, _HOMES)
