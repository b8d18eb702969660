"""Plots of results, drawn by matplotlib without a display; matplotlib is loaded when something is drawn."""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
