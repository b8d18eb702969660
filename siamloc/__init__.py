"""siamloc: siamese place recognition and localization for robots with omnidirectional cameras.

Importing the package loads neither torch nor lightning; each subpackage loads what it needs when it is used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.errors import SiamlocError
from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc import data, evaluation, maps, models, report, runtime, simulate, training

__version__ = "0.1.0"

__all__ = [
    "SiamlocError",
    "__version__",
    "data",
    "evaluation",
    "maps",
    "models",
    "report",
    "runtime",
    "simulate",
    "training",
]

__getattr__, __dir__ = lazy(__name__, {name: "" for name in __all__ if name.islower() and "_" not in name})
