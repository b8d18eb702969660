"""The incremental topological mapper: nodes, loop closures and a reason for every decision."""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
