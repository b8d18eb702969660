"""Training: `fit` draws pairs of frames, trains a network on them and keeps checkpoints and curves in a run.

Importing this package loads no torch; each name is loaded on first use.
"""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
