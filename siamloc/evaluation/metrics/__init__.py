"""Measures of place recognition and localization: pure functions on arrays.

Positions are in the unit of the data set (metres by default), angles in radians.
"""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
