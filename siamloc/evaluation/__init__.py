"""Evaluation: a function for each task, a common type of result, and the measures as pure functions.

A task takes a map, panoramas and the frames to locate, and returns a `Result`:

    result = siamloc.evaluation.localization(known, images, tuesday, baselines=["hog"])
    print(result.measures["error"], result.table())
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc.comparison import Comparison
    from siamloc.evaluation import metrics
    from siamloc.evaluation.building_choice import buildings, by_building
    from siamloc.evaluation.compact_maps import compact
    from siamloc.evaluation.comparison import compare
    from siamloc.evaluation.disturbed import robustness
    from siamloc.evaluation.hierarchy import hierarchical
    from siamloc.evaluation.layers import mapping
    from siamloc.evaluation.localize import error_model, localization, rooms
    from siamloc.evaluation.result import Result
    from siamloc.evaluation.session import Session

__all__ = [
    "Comparison",
    "Result",
    "Session",
    "buildings",
    "by_building",
    "compact",
    "compare",
    "error_model",
    "hierarchical",
    "localization",
    "mapping",
    "metrics",
    "robustness",
    "rooms",
]

_HOMES = {
    "Comparison": "comparison",
    "Result": "result",
    "Session": "session",
    "buildings": "building_choice",
    "by_building": "building_choice",
    "compact": "compact_maps",
    "compare": "comparison",
    "error_model": "localize",
    "hierarchical": "hierarchy",
    "localization": "localize",
    "mapping": "layers",
    "metrics": "",
    "robustness": "disturbed",
    "rooms": "localize",
}

__getattr__, __dir__ = lazy(__name__, _HOMES)
