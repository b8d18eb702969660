"""The simulated building: an office drawn, lit and photographed by ray casting, written in COLD's own layout.

from siamloc.simulate import simulate
simulate({"out": "data", "building": "mini", "runs": ["cloudy1", "night1"], "camera": "panorama"})
"""

from siamloc.simulate.buildings import building_names, load_building
from siamloc.simulate.config import STANDARD_RUNS, SimulateConfig
from siamloc.simulate.produce import Summary, simulate
from siamloc.simulate.render import render
from siamloc.simulate.run import Run
from siamloc.simulate.scene import Scene, build_scene

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
