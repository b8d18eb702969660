"""Plots of results, drawn by matplotlib without a display; matplotlib is loaded when something is drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc.report.draw.suitable import pictures, save_all

__all__ = ["pictures", "save_all"]

__getattr__, __dir__ = lazy(__name__, dict.fromkeys(__all__, "suitable"))
