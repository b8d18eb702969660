"""Evaluation: pure measures, the tasks that use them, and the files that hold the results. Does not load torch."""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["absolute", "metrics", "results", "room_retrieval"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        return importlib.import_module(f"siamloc.tasks.{name}")
    raise AttributeError(f"module 'siamloc.tasks' has no attribute {name!r}")
