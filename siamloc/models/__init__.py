"""Siamese networks: branches and heads, losses, Lightning modules, trained weights ([T] 5.2-5.3).

Importing this package loads no torch; each name is loaded on first use.
"""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
