"""Pretraining: a network learns from an endless supply of random buildings, before it sees any data set.

Importing this package loads no torch; each name is loaded on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy
from siamloc.pretraining.settings import RECIPE, ViewSettings

if TYPE_CHECKING:
    from siamloc.pretraining.learning import pretrain
    from siamloc.pretraining.view_batches import ViewDataModule

__all__ = ["RECIPE", "ViewDataModule", "ViewSettings", "pretrain"]

__getattr__, __dir__ = lazy(__name__, {"ViewDataModule": "view_batches", "pretrain": "learning"})
