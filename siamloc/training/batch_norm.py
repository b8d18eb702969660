"""Batch normalization across GPUs: each normalizes with the statistics of the images of all processes."""

from __future__ import annotations

from torch import distributed, nn

from augment.torchvision_compat import ensure_torchvision

ensure_torchvision()
from lightning.pytorch.plugins import LayerSync  # noqa: E402


class OneBatch(LayerSync):
    """Let processes that train together on GPUs normalize as one process with the whole batch would.

    Layers become torch's synchronized ones during training, and keep their place, their weights and all references to
    them.
    """

    def __init__(self) -> None:
        self._were: dict[nn.Module, type[nn.Module]] = {}

    def apply(self, model: nn.Module) -> nn.Module:
        """Make the layers of a model normalize across all processes, if there are several."""
        if not distributed.is_initialized() or distributed.get_world_size() == 1:
            return model
        for layer in model.modules():
            if type(layer) in (nn.BatchNorm1d, nn.BatchNorm2d):
                self._were[layer] = type(layer)
                layer.__class__ = nn.SyncBatchNorm
                layer.process_group = None  # type: ignore[assignment]  # all processes
        return model

    def revert(self, model: nn.Module) -> nn.Module:
        """Restore the original layers."""
        for layer, kind in self._were.items():
            layer.__class__ = kind
            del layer.process_group
        self._were.clear()
        return model
