"""Plots and report pages made from results. Matplotlib is loaded only when something is drawn."""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
