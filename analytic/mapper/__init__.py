"""The incremental topological mapper: nodes, loop closures and a reason for every decision."""

from __future__ import annotations

from analytic.mapper.decision import Change, Decision, Location, Reason, replay
from analytic.mapper.graph import NodeGraph
from analytic.mapper.mapper import IncrementalMapper
from analytic.mapper.parameters import Parameters

__all__ = [
    "Change",
    "Decision",
    "IncrementalMapper",
    "Location",
    "NodeGraph",
    "Parameters",
    "Reason",
    "replay",
]
