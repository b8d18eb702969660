from . import metrics as metrics
from .building_choice import buildings as buildings, by_building as by_building
from .compact_maps import compact as compact
from .comparison import Comparison as Comparison, compare as compare
from .disturbed import robustness as robustness
from .hierarchy import hierarchical as hierarchical
from .layers import mapping as mapping
from .localize import error_model as error_model, localization as localization, rooms as rooms
from .result import Measures as Measures, Result as Result
from .session import Session as Session
