"""The stages of a network from the image to the descriptor: the weights of each, and freezing the first stages."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from itertools import chain
from typing import Any

from torch import nn

from siamloc.errors import ConfigError


def stages(network: nn.Module) -> list[list[str]]:
    """List the names of a network's weights by stage, from the image to the descriptor.

    A network of `siamloc.models.build` has a stage for each resolution of its branch: a stage starts with a layer that
    reduces rows and columns, or after a pool that reduces them; the last stage is the head. A custom module gives its
    stages in a property `stages`, a list with a module or a list of modules for each.

    Raises:
        ConfigError: a module without stages, or whose stages do not hold every weight once.

    Example:
        >>> from siamloc.models import build
        >>> for names in stages(build("simple1", "flat", (32, 64))):
        ...     print(names[0], "...", len(names))
        branch.features.0.weight ... 6
        head.layer.weight ... 2
    """
    names = {weight: name for name, weight in network.named_parameters()}
    found = [[names.get(weight, "") for weight in nn.ModuleList(parts).parameters()] for parts in _parts(network)]
    if Counter(chain(*found)) != Counter(names.values()):
        raise ConfigError(
            f"the stages of {type(network).__name__} must hold each of its weights once, and no others: let its "
            "property `stages` list all parts from the image to the descriptor"
        )
    return found


def comparing_weights(network: nn.Module) -> list[nn.Parameter]:
    """Return the weights that learn to estimate displacements; none for a network that does not compare images."""
    if not isinstance(getattr(network, "relative", None), nn.Module):
        return []
    return [weight for part in ("orientation", "relative") for weight in network.get_submodule(part).parameters()]


class FrozenStages:
    """Freeze the first stages of a network: they get no gradient until they are thawed.

    Raises:
        ConfigError: as `stages`.
    """

    def __init__(self, network: nn.Module, count: int) -> None:
        self._parts = nn.ModuleList([nn.ModuleList(parts) for parts in _parts(network)[:count]])
        self._weights = [(weight, weight.requires_grad) for weight in self._parts.parameters()]
        self._modes = [(part, part.training) for part in self._parts.modules()]
        self._parts.requires_grad_(False)

    def rest(self) -> None:
        """Switch the frozen stages to evaluation mode: no updates of batch normalization, no dropout."""
        self._parts.eval()

    def thaw(self) -> None:
        """Restore gradients and modes of the frozen stages."""
        for weight, trained in self._weights:
            weight.requires_grad_(trained)
        for part, training in self._modes:
            part.training = training


def _parts(network: nn.Module) -> list[list[nn.Module]]:
    """Return the modules of each stage."""
    given: Any = getattr(network, "stages", None)
    stages = given if isinstance(given, Iterable) else [[]]
    listed = [[*stage] if isinstance(stage, list | tuple) else [stage] for stage in stages]
    if not all(isinstance(part, nn.Module) for parts in listed for part in parts) or not all(listed):
        raise ConfigError(
            f"{type(network).__name__} does not say its stages: give it a property `stages`, a list of its parts from "
            "the image to the descriptor, or leave out optimizer.frozen_stages"
        )
    return listed
