"""Jobs: what a command does, as an object of checked settings with `run()`, the same from a notebook.

    >>> from siamloc.jobs import Report
    >>> job = Report.of({"run": "runs/robot", "out": "robot.html"})
    >>> page = job.run()  # doctest: +SKIP

Importing this package loads no job; each is loaded on first use.
"""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
