"""One small building, built once for all tests of the simulator."""

from __future__ import annotations

import pytest

from siamloc.simulate import Run, build_scene, load_building
from siamloc.simulate.layout import Building
from siamloc.simulate.scene import Scene


@pytest.fixture(scope="session")
def mini() -> Building:
    return load_building("mini", 0)


@pytest.fixture(scope="session")
def cloudy(mini: Building) -> Scene:
    return build_scene(mini, Run("cloudy", 1))


@pytest.fixture(scope="session")
def night(mini: Building) -> Scene:
    return build_scene(mini, Run("night", 1))


@pytest.fixture(scope="session")
def sunny(mini: Building) -> Scene:
    return build_scene(mini, Run("sunny", 3))
