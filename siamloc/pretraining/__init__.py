"""Pretraining: a network learns from an endless supply of random buildings, before it sees any data set.

Importing this package loads no torch; each name is loaded on first use.
"""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
