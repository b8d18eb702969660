from .buildings import building_names as building_names, load_building as load_building
from .preview import panoramas as panoramas
from .produce import (
    STANDARD_RUNS as STANDARD_RUNS,
    SimulateConfig as SimulateConfig,
    Summary as Summary,
    simulate as simulate,
)
from .rendering import render as render
from .run import Run as Run
from .scene import Scene as Scene, build_scene as build_scene, relit as relit
from .views import Views as Views, draw_views as draw_views
