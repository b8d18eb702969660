"""The branches and heads by name ([T] tables 5.1 and 5.2). Loads no torch, so that lists of names are free."""

from __future__ import annotations

from dataclasses import dataclass

from siamloc.errors import ConfigError, hint


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


def branch_spec(name: str) -> BranchSpec:
    """Return the branch of that name.

    Raises:
        ConfigError: an unknown name.
    """
    if name not in BRANCHES:
        raise ConfigError(f"unknown branch {name!r}: {hint(name, BRANCHES)}")
    return BRANCHES[name]


def head_widths(name: str) -> tuple[int, int, int]:
    """Return the neurons of the three layers of the head of that name.

    Raises:
        ConfigError: an unknown name.
    """
    if name not in HEADS:
        raise ConfigError(f"unknown head {name!r}: {hint(name, HEADS)}")
    return HEADS[name]
