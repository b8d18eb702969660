"""Jobs: what a command does, as an object of checked settings with `run()`, the same from a notebook.

    >>> from siamloc.jobs import Report
    >>> job = Report.of({"run": "runs/robot", "out": "robot.html"})
    >>> page = job.run()  # doctest: +SKIP

Importing this package loads no job; each is loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc.jobs.augment import Expand, Preview
    from siamloc.jobs.evaluate import Evaluate
    from siamloc.jobs.export import Export
    from siamloc.jobs.job import Job
    from siamloc.jobs.map import MapFrames
    from siamloc.jobs.prepare import Prepare
    from siamloc.jobs.report import Compare, Report
    from siamloc.jobs.reproduce import Reproduce
    from siamloc.jobs.robot import Localize, Watch
    from siamloc.jobs.simulate import Simulate
    from siamloc.jobs.train import Pretrain, Train

__all__ = [
    "Compare",
    "Evaluate",
    "Expand",
    "Export",
    "Job",
    "Localize",
    "MapFrames",
    "Prepare",
    "Pretrain",
    "Preview",
    "Report",
    "Reproduce",
    "Simulate",
    "Train",
    "Watch",
]

_HOMES = {
    "Compare": "report",
    "Evaluate": "evaluate",
    "Expand": "augment",
    "Export": "export",
    "Job": "job",
    "Localize": "robot",
    "MapFrames": "map",
    "Prepare": "prepare",
    "Pretrain": "train",
    "Preview": "augment",
    "Report": "report",
    "Reproduce": "reproduce",
    "Simulate": "simulate",
    "Train": "train",
    "Watch": "robot",
}

__getattr__, __dir__ = lazy(__name__, _HOMES)
