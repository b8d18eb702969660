"""Plots and report pages made from results. Matplotlib is loaded only when something is drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc.report import draw, page
    from siamloc.report.page.write import write_report

__all__ = ["draw", "page", "write_report"]

__getattr__, __dir__ = lazy(__name__, {"draw": "", "page": "", "write_report": "page.write"})
