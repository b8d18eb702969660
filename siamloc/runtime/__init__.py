"""From a trained network to the robot: `export` writes a bundle, `Localizer` locates images with it.

    siamloc.runtime.export(network, known, "runs/robot/bundle")
    siamloc.runtime.Localizer("runs/robot/bundle").locate("photo.jpeg")

Importing this package does not load torch; the robot needs only numpy, opencv and, for networks, onnxruntime.
"""

from foundation.lazy import lazy

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
