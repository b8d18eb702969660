"""siamloc: siamese place recognition and localization for robots with omnidirectional cameras.

`README.md` and `docs/index.md` show the main job: read frames, train or take the shipped network, build a map, evaluate
it, and export it for the robot.

Importing the package loads neither torch nor lightning; each subpackage loads what it needs on first use.
"""

from foundation.lazy import lazy

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy(__name__, __file__)
