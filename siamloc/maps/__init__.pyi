from .coarse import CoarseLayer as CoarseLayer, UNASSIGNED as UNASSIGNED
from .describing import build as build, describe as describe
from .error_model import ErrorModel as ErrorModel
from .grouping import Built as Built, WAYS as WAYS, group as group
from .hierarchy import (
    HierarchicalRetrieval as HierarchicalRetrieval,
    HierarchicalSearch as HierarchicalSearch,
    LayerSearch as LayerSearch,
)
from .history import History as History, Reason as Reason
from .joining import RefinedPoses as RefinedPoses
from .selecting import key_frames as key_frames
from .live_survey import LiveSurvey as LiveSurvey
from .locating import locate as locate
from .maintenance import Maintenance as Maintenance, Update as Update, update as update
from .matching import frame_distances as frame_distances, headings as headings, match as match
from .motion import motions as motions
from .pose_filter import PoseFilter as PoseFilter
from .ranking import NodeRanking as NodeRanking
from .refinement import Refinement as Refinement, interpolate_poses as interpolate_poses, refine as refine
from .search import Retrieval as Retrieval, VectorIndex as VectorIndex
from .sequence_filter import (
    MotionModel as MotionModel,
    SequenceFilter as SequenceFilter,
    temperature_of_map as temperature_of_map,
    tune_filter as tune_filter,
)
from .surveying import Survey as Survey, SurveySettings as SurveySettings, survey as survey
from .thinning import Thinned as Thinned, thin as thin
from .visual_map import VisualMap as VisualMap
