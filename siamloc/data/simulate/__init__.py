"""The simulated building: an office drawn, lit and photographed by ray casting, written in COLD's own layout.

from siamloc.data.simulate import simulate
simulate({"out": "data", "building": "mini", "runs": ["cloudy1", "night1"], "camera": "panorama"})
"""

from siamloc.data.simulate.buildings import building_names, load_building
from siamloc.data.simulate.config import STANDARD_RUNS, SimulateConfig
from siamloc.data.simulate.produce import Summary, simulate
from siamloc.data.simulate.render import render
from siamloc.data.simulate.run import Run
from siamloc.data.simulate.scene import Scene, build_scene

__all__ = [
    "STANDARD_RUNS",
    "Run",
    "Scene",
    "SimulateConfig",
    "Summary",
    "build_scene",
    "building_names",
    "load_building",
    "render",
    "simulate",
]
