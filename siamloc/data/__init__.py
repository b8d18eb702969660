"""Data sets: readers, unwrapping, decoded panoramas, the protocol (which frames do what), and data checks."""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
