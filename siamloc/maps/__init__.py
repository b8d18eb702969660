"""Maps: descriptors with poses and rooms on disk, and exact search in them. Loads neither torch nor scipy at import."""

from __future__ import annotations

import importlib
from typing import Any

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

_HOME = {
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


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f"siamloc.maps.{_HOME[name]}"), name)
    raise AttributeError(f"module 'siamloc.maps' has no attribute {name!r}")
