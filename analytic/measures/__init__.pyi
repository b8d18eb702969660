from .closures import ClosureScores as ClosureScores, closure_scores as closure_scores
from .compactness import (
    Silhouettes as Silhouettes,
    moment_of_inertia as moment_of_inertia,
    moments_of_inertia as moments_of_inertia,
    silhouette as silhouette,
    silhouettes as silhouettes,
)
from .rooms import Purity as Purity, purity as purity
