"""Reproduce published tables and figures, each with one call or one command.

result = siamloc.reproduce.reproduce("figure_3_11", data="freiburg_sim", scale="short")
print(result.table())
result.save("reproduced")
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc.reproduce.claims import holds
    from siamloc.reproduce.page import write_report
    from siamloc.reproduce.reproduction import Reproduction
    from siamloc.reproduce.running import reproduce
    from siamloc.reproduce.study_book import Study, listing, studies, study

_HOMES = {
    "Study": "study_book",
    "Reproduction": "reproduction",
    "holds": "claims",
    "listing": "study_book",
    "study": "study_book",
    "studies": "study_book",
    "reproduce": "running",
    "write_report": "page",
}

__all__ = ["Reproduction", "Study", "holds", "listing", "reproduce", "studies", "study", "write_report"]

__getattr__, __dir__ = lazy(__name__, _HOMES)
