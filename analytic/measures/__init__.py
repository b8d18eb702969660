"""Measures of a clustering of frames: silhouettes, moments of inertia, purity by room, loop closures."""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
