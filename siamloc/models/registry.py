"""What a network can be made of and trained with, by name ([T] tables 5.1 and 5.2). Loads no torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from siamloc.errors import ConfigError, hint
from siamloc.settings import NotNegative, Positive, Rule, Settings


@dataclass(frozen=True)
class BranchSpec:
    """How a branch is made.

    Attributes:
        name: what configurations call it; for a torchvision network its name there.
        widths: outputs of the three convolutions of a simple branch; None for a torchvision network.
    """

    name: str
    widths: tuple[int, int, int] | None = None


BRANCHES: dict[str, BranchSpec] = {
    spec.name: spec
    for spec in (
        BranchSpec("simple1", widths=(3, 8, 16)),
        BranchSpec("simple2", widths=(3, 16, 32)),
        BranchSpec("alexnet"),
        BranchSpec("densenet121"),
        *(BranchSpec(f"vgg{depth}{suffix}") for suffix in ("", "_bn") for depth in (11, 13, 16, 19)),
    )
}
"""The feature extractors of [T] table 5.1; `*_bn` has a batch normalization after each convolution."""

HEADS: dict[str, tuple[int, int, int]] = {
    "fc500_500_5": (500, 500, 5),
    "fc500_100_10": (500, 100, 10),
    "fc1000_1000_10": (1000, 1000, 10),
    "fc4096_4096_1000": (4096, 4096, 1000),
}
"""Neurons of the three fully connected layers, versions 1 to 4 of [T] table 5.2."""


Momentum = Annotated[float, Rule("a number from 0 to below 1", lambda value: 0 <= value < 1)]


@dataclass(frozen=True)
class Optimizer(Settings):
    """How the weights are updated; the defaults are those of [T] 5.3.

    Attributes:
        name: "sgd", "adam" or "adamw".
        learning_rate: step size.
        momentum: of "sgd"; for the other two the decay of the first moment (beta 1).
        weight_decay: share of a weight that each step takes away, times the learning rate.
    """

    WHERE = "optimizer"

    name: Literal["sgd", "adam", "adamw"] = "sgd"
    learning_rate: Positive = 0.001
    momentum: Momentum = 0.9
    weight_decay: NotNegative = 0.0


def branch_spec(name: str) -> BranchSpec:
    """Look up a branch by its name.

    Raises:
        ConfigError: an unknown name.
    """
    if name not in BRANCHES:
        raise ConfigError(f"unknown branch {name!r}: {hint(name, BRANCHES)}")
    return BRANCHES[name]


def head_widths(name: str) -> tuple[int, int, int]:
    """Look up the neurons of a head's three layers by its name.

    Raises:
        ConfigError: an unknown name.
    """
    if name not in HEADS:
        raise ConfigError(f"unknown head {name!r}: {hint(name, HEADS)}")
    return HEADS[name]
