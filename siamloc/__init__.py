"""siamloc: siamese place recognition and localization for robots with omnidirectional cameras.

Importing the package loads neither torch nor lightning; each subpackage loads what it needs when it is used.
"""

from __future__ import annotations

import importlib
from typing import Any

from siamloc.errors import SiamlocError

__version__ = "0.1.0"
__all__ = ["SiamlocError", "__version__", "data", "maps", "models", "report", "runtime", "tasks"]

_SUBPACKAGES = frozenset({"data", "maps", "models", "report", "runtime", "tasks"})


def __getattr__(name: str) -> Any:
    if name in _SUBPACKAGES:
        return importlib.import_module(f"siamloc.{name}")
    raise AttributeError(f"module 'siamloc' has no attribute {name!r}")
