from .batches import BatchAugmentation as BatchAugmentation
from .comparison import Comparison as Comparison, Run as Run, compare as compare
from .fitting import fit as fit
from .pair_batches import PairDataModule as PairDataModule, PairSampler as PairSampler
from .place_batches import PlaceDataModule as PlaceDataModule, PlaceSampler as PlaceSampler
from .recipes import RECIPES as RECIPES, Recipe as Recipe, recipe as recipe
from .settings import (
    Optimizer as Optimizer,
    PairSettings as PairSettings,
    PlaceSettings as PlaceSettings,
    Training as Training,
)
