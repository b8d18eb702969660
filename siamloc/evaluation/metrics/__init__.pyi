from .errors import (
    error_floor as error_floor,
    heading_error as heading_error,
    localization_error as localization_error,
    summarize as summarize,
)
from .recall import (
    Recall as Recall,
    first_rank_within as first_rank_within,
    one_percent as one_percent,
    recall_at_k as recall_at_k,
    recall_at_one_percent as recall_at_one_percent,
    recall_from_ranks as recall_from_ranks,
)
from .rooms import (
    PairAccuracy as PairAccuracy,
    PairCurve as PairCurve,
    confusion_matrix as confusion_matrix,
    fitted_margin as fitted_margin,
    pair_accuracy as pair_accuracy,
    pair_dissimilarity as pair_dissimilarity,
    pair_threshold_curve as pair_threshold_curve,
)
from .trajectory import (
    absolute_trajectory_error as absolute_trajectory_error,
    aligned_trajectory as aligned_trajectory,
    relative_trajectory_error as relative_trajectory_error,
)
