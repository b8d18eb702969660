"""siamloc: siamese place recognition and localization for robots with omnidirectional cameras.

    frames = siamloc.data.read("manifest", manifest="robot.csv")
    images = siamloc.data.PanoramaLibrary(frames)
    monday, tuesday = frames.select(sequence="monday"), frames.select(sequence="tuesday")
    network = siamloc.models.build("alexnet", "fc500_500_5")
    siamloc.training.fit(network, images, monday, run="runs/robot", epochs=10)
    known = siamloc.maps.build(network, images, monday)
    result = siamloc.evaluation.localization(known, images, tuesday)
    print(result.measures["error"], result.table())
    siamloc.runtime.export(network, known, "runs/robot/bundle")

Importing the package loads neither torch nor lightning; each subpackage loads what it needs on first use.
"""

from foundation.lazy import lazy

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
