"""Compact maps: frames clustered by their descriptors, with one representative per cluster ([C] 3).

Every method numbers its clusters from 0 to k-1 in the order in which they first appear among the frames.
"""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
