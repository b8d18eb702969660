"""Maps: descriptors stored with poses and rooms, exact search, coarse layers and the sequence filter.

    known = siamloc.maps.build("hog", images, monday)
    found = known.search(vectors, k=5)

Importing this package loads neither torch nor scipy.
"""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
