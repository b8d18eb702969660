"""Training: `fit` draws pairs of frames, trains a network on them and keeps checkpoints and curves in a run.

Importing this package loads no torch; each name is loaded on first use.
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
from siamloc.training.settings import Training

if TYPE_CHECKING:
    from siamloc.training.batches import BatchAugmentation
    from siamloc.training.fitting import fit
    from siamloc.training.pair_batches import PairDataModule
    from siamloc.training.place_batches import PlaceDataModule

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
    "compare",
    "fit",
    "recipe",
]

_HOMES = {
    "BatchAugmentation": "batches",
    "PairDataModule": "pair_batches",
    "PlaceDataModule": "place_batches",
    "fit": "fitting",
}

__getattr__, __dir__ = lazy(__name__, _HOMES)
