"""Evaluation: pure measures, the tasks that use them, and the files that hold the results. Does not load torch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc.evaluation import absolute, metrics, results, room_retrieval

__all__ = ["absolute", "metrics", "results", "room_retrieval"]

__getattr__, __dir__ = lazy(__name__, dict.fromkeys(__all__, ""))
