"""Global-appearance descriptors of panoramas, distances, clustering and the incremental mapper.

Inputs and outputs are NumPy arrays. Importing the package does not load torch.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
