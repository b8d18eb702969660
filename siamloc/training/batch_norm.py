"""Batch normalization across processes: each normalizes with the statistics of the images of all processes."""

from __future__ import annotations

from typing import Any, cast

import torch
from torch import Tensor, distributed, nn
from torch.nn.modules.batchnorm import _BatchNorm

from siamloc.lightning import LayerSync


class OneBatch(LayerSync):
    """Let processes that train together normalize as one process with the whole batch would.

    Layers change their class during training, and keep their place, their weights and all references to them.

    Args:
        gpu: whether to use torch's own layer, which is fast and only supports GPUs.
    """

    def __init__(self, gpu: bool) -> None:
        self._kinds = {kind: nn.SyncBatchNorm if gpu else own for kind, own in _AMONG_PROCESSES.items()}
        self._were: dict[nn.Module, type[nn.Module]] = {}

    def apply(self, model: nn.Module) -> nn.Module:
        """Make the layers of a model normalize across all processes, if there are several."""
        if not distributed.is_initialized() or distributed.get_world_size() == 1:
            return model
        for layer in model.modules():
            if type(layer) in self._kinds:
                self._were[layer] = type(layer)
                layer.__class__ = self._kinds[type(layer)]
                layer.process_group = None  # type: ignore[assignment]  # all processes, for the torch layer
        return model

    def revert(self, model: nn.Module) -> nn.Module:
        """Restore the original layers."""
        for layer, kind in self._were.items():
            layer.__class__ = kind
            del layer.process_group
        self._were.clear()
        return model


class _AmongProcesses(_BatchNorm):
    """Normalize (B, C, ...) by means and variances over all processes; gradients flow back to all of them."""

    def forward(self, input: Tensor) -> Tensor:
        """Normalize a batch; in evaluation mode as usual."""
        if not self.training:
            return super().forward(input)
        self._check_input_dim(input)
        wide = input.float()
        others = [axis for axis in range(input.ndim) if axis != 1]
        shape = [-1 if axis == 1 else 1 for axis in range(input.ndim)]
        count = torch.full((1,), wide.numel() / wide.shape[1], device=wide.device)
        sums = _of_all(torch.cat([wide.sum(others), count]))
        total = sums[-1].detach()
        mean = sums[:-1] / total
        apart = wide - mean.view(shape)
        variance = _of_all(apart.square().sum(others)) / total
        if self.track_running_stats and self.running_mean is not None and self.running_var is not None:
            counted = cast(Tensor, self.num_batches_tracked).add_(1)
            share = 1 / float(counted) if self.momentum is None else self.momentum
            with torch.no_grad():
                self.running_mean.lerp_(mean.detach(), share)
                self.running_var.lerp_(variance.detach() * total / (total - 1).clamp(min=1), share)
        found = apart * (variance + self.eps).rsqrt().view(shape)
        if self.affine:
            found = found * self.weight.view(shape) + self.bias.view(shape)
        return found.to(input.dtype)


class _AmongProcesses1d(_AmongProcesses, nn.BatchNorm1d):
    pass


class _AmongProcesses2d(_AmongProcesses, nn.BatchNorm2d):
    pass


_AMONG_PROCESSES: dict[type[nn.Module], type[nn.Module]] = {
    nn.BatchNorm1d: _AmongProcesses1d,
    nn.BatchNorm2d: _AmongProcesses2d,
}


class _Sum(torch.autograd.Function):
    """Sum over all processes. Every process uses the sum, so the gradients are summed, too."""

    @staticmethod
    def forward(ctx: Any, value: Tensor) -> Tensor:
        total = value.clone()
        distributed.all_reduce(total)
        return total

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> Tensor:  # type: ignore[override]
        return cast(Tensor, _Sum.apply(gradients[0]))


def _of_all(value: Tensor) -> Tensor:
    return cast(Tensor, _Sum.apply(value))
