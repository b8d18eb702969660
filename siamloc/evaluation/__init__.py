"""Evaluation: a function for each task, a common type of result, and the measures as pure functions.

A task takes a map, panoramas and the frames to locate, and returns a `Result`:

    result = siamloc.evaluation.localization(known, images, tuesday, baselines=["hog"])
    print(result.measures["error"], result.table())
"""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
