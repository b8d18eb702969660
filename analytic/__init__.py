"""Global-appearance descriptors of panoramas, distances, clustering and the incremental mapper.

Inputs and outputs are NumPy arrays. Importing the package does not load torch.
"""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
