"""Plots and pages made from result files. Loads matplotlib only when something is drawn."""

from __future__ import annotations

import importlib
from typing import Any

__all__ = ["plots"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        return importlib.import_module(f"siamloc.report.{name}")
    raise AttributeError(f"module 'siamloc.report' has no attribute {name!r}")
