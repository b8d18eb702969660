from . import (
    data as data,
    evaluation as evaluation,
    maps as maps,
    models as models,
    pretraining as pretraining,
    progress as progress,
    report as report,
    runtime as runtime,
    simulate as simulate,
    training as training,
)
from .checkup import Checkup as Checkup, doctor as doctor
from .errors import SiamlocError as SiamlocError
from .walking import Walked as Walked, WalkSettings as WalkSettings, walk as walk

__version__: str
