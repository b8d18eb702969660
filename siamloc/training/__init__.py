"""Training: `fit` draws pairs of frames, trains a network on them and keeps checkpoints and curves in a run.

Importing this package loads no torch; each name is loaded when it is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.data.pairs import PairSampler, PairSettings
from siamloc.data.places import PlaceSampler, PlaceSettings
from siamloc.lazy import lazy
from siamloc.models.registry import Optimizer
from siamloc.runs import Run
from siamloc.training.comparison import Comparison, compare
from siamloc.training.recipes import RECIPES, Recipe, recipe
from siamloc.training.settings import Training, ViewSettings

if TYPE_CHECKING:
    from siamloc.training.batches import BatchAugmentation
    from siamloc.training.fitting import fit
    from siamloc.training.pair_batches import PairDataModule
    from siamloc.training.place_batches import PlaceDataModule
    from siamloc.training.pretraining import pretrain
    from siamloc.training.view_batches import ViewDataModule

__all__ = [
    "RECIPES",
    "BatchAugmentation",
    "Comparison",
    "Optimizer",
    "PairDataModule",
    "PairSampler",
    "PairSettings",
    "PlaceDataModule",
    "PlaceSampler",
    "PlaceSettings",
    "Recipe",
    "Run",
    "Training",
    "ViewDataModule",
    "ViewSettings",
    "compare",
    "fit",
    "pretrain",
    "recipe",
]

_HOMES = {
    "BatchAugmentation": "batches",
    "PairDataModule": "pair_batches",
    "PlaceDataModule": "place_batches",
    "ViewDataModule": "view_batches",
    "fit": "fitting",
    "pretrain": "pretraining",
}

__getattr__, __dir__ = lazy(__name__, _HOMES)
