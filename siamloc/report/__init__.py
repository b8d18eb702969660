"""Plots and pages made from result files. Loads matplotlib only when something is drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc.report import plots

__all__ = ["plots"]

__getattr__, __dir__ = lazy(__name__, dict.fromkeys(__all__, ""))
