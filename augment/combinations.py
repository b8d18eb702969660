"""The variants of each frame in an expanded data set: the combinations of effects of the thesis ([T] 5.3.2)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations_with_replacement, product
from typing import Any

import torch

from augment.base import Params, seeded
from augment.compose import Policy
from augment.errors import AugmentError
from foundation.settings import Count, checked

Tree = dict[str, Any]

_SHAPES = ("bulb", "square", "trapezoid")
_SPOTS = {f"{shape} {tone}": {"effect": shape, "tone": tone} for shape in _SHAPES for tone in ("light", "dark")}
_GLOBALS = ("brighten", "darken")
_SINGLES: dict[str, Tree] = {
    **_SPOTS,
    **{name: {"effect": name} for name in (*_GLOBALS, "sharpen", "blur")},
    "contrast up": {"effect": "contrast", "factor": [1.2, 1.8]},
    "contrast down": {"effect": "contrast", "factor": [0.5, 0.8]},
    **{name: {"effect": name} for name in ("equalize", "saturate", "rotate")},
}
_BULBS = ("light", "light", "light"), ("dark", "dark", "dark"), ("light", "light", "dark"), ("light", "dark", "dark")


@dataclass(frozen=True)
class Variant:
    """One image to be made from every frame.

    Attributes:
        number: from 0.
        label: the effects in words, such as "darken + bulb light + rotate".
        policy: draws the parameters of these effects; nothing else in it is random.
    """

    number: int
    label: str
    policy: Policy

    def parameters(self, seed: int, frames: Iterable[int], size: tuple[int, int]) -> Params:
        """Return the parameters of this variant for the given frames, each of shape (number of frames,).

        The parameters of a frame depend only on the seed, the variant and the frame's number.

        Args:
            seed: seed of the expansion, a whole number, 0 or more.
            frames: numbers of the frames in the expanded data set, from 0.
            size: rows and columns of the images.
        """
        count = len(self.policy.spans(*size))
        generators = [seeded(seed, frame, self.number) for frame in frames]
        rows = [torch.rand(count, generator=one, device="cpu", dtype=torch.float32) for one in generators]
        return self.policy.values(torch.stack(rows), *size)


def variants(depth: int, circular: bool = True) -> list[Variant]:
    """Return the variants for expanding a data set, `depth` for each frame.

    They come in a fixed order, so that a greater depth contains the smaller ones ([T] table 5.18 has 16, 44, 128, 129
    and 246 per frame without listing them):

    - 1-16: the original, each single effect (six spots, brighten, darken, sharpen, blur, contrast raised and
      lowered, equalize, saturate), and a rotation;
    - 17-44: the 14 single effects with a rotation, brighten and darken with each of the six spots, three light
      bulbs and three dark ones;
    - 45-104: three bulbs of mixed tones, every pair of spots, and a rotation with each combination that
      lacks one above. Depth 104 therefore has every combination once;
    - from 105: the same list again without the original, with other parameters: depth 128 reaches its 24th entry,
      129 its 25th, and 246 the 39th entry of the third round.

    Args:
        depth: number of variants, at least 1.
        circular: False for cameras whose columns do not wrap around; combinations with a rotation then turn by 0.

    Raises:
        AugmentError: a depth below 1.

    Example:
        >>> [variant.label for variant in variants(18)[15:]]
        ['rotate', 'bulb light + rotate', 'bulb dark + rotate']
    """
    checked(depth, Count, "depth", AugmentError)
    listed = combinations()
    policies = {label: Policy({"all_of": steps}, name=label, circular=circular) for label, steps in listed.items()}
    labels = list(listed)
    order = labels + labels[1:] * (depth // len(labels) + 1)
    return [Variant(number, label, policies[label]) for number, label in enumerate(order[:depth])]


def combinations() -> dict[str, list[Tree]]:
    """Return the effects of the 104 combinations by label, in the order of `variants`."""
    singles = [(label,) for label in _SINGLES]  # the rotation last
    bulbs = [tuple(f"bulb {tone}" for tone in tones) for tones in _BULBS]
    several = [*product(_GLOBALS, _SPOTS), *bulbs, *combinations_with_replacement(_SPOTS, 2)]
    ordered: list[tuple[str, ...]] = [(), *singles, *((*one, "rotate") for one in singles[:-1])]
    ordered += [*several, *((*some, "rotate") for some in several)]
    return {" + ".join(labels) or "original": [_SINGLES[label] for label in labels] for labels in ordered}
