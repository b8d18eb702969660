"""The combinations of effects that the thesis trains on ([T] 5.3.2), one by one and as a policy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any

from augment.compose import Policy
from augment.errors import AugmentError

Tree = dict[str, Any]

_SHAPES = ("bulb", "square", "trapezoid")
_ROTATE: Tree = {"effect": "rotate"}
_LOCALS: tuple[tuple[str, Tree], ...] = tuple(
    (f"{shape} {tone}", {"effect": shape, "tone": tone}) for shape in _SHAPES for tone in ("light", "dark")
)
_GLOBALS: tuple[tuple[str, Tree], ...] = tuple((name, {"effect": name}) for name in ("brighten", "darken"))
_WHOLE: tuple[tuple[str, Tree], ...] = (
    ("sharpen", {"effect": "sharpen"}),
    ("blur", {"effect": "blur"}),
    ("contrast up", {"effect": "contrast", "factor": [1.2, 1.8]}),
    ("contrast down", {"effect": "contrast", "factor": [0.5, 0.8]}),
    ("equalize", {"effect": "equalize"}),
    ("saturate", {"effect": "saturate"}),
)
_BULBS = ("light", "light", "light"), ("dark", "dark", "dark"), ("light", "light", "dark"), ("light", "dark", "dark")


@dataclass(frozen=True)
class Variant:
    """One picture to be made of every frame.

    Attributes:
        number: from 0.
        label: the effects in words, such as "darken + bulb light + rotate".
        policy: draws their parameters; nothing in it is left to chance but these.
    """

    number: int
    label: str
    policy: Policy


def variants(depth: int, circular: bool = True) -> list[Variant]:
    """Return the variants that a data set is expanded by, `depth` for each frame.

    They come in a fixed order, so that a greater depth holds the smaller ones ([T] table 5.18 has 16, 44, 128, 129
    and 246 a frame and does not list them):

    - 1-16: the original, each single effect (six spots, brighten, darken, sharpen, blur, contrast raised and
      lowered, equalize, saturate), and a rotation;
    - 17-44: the 14 single effects with a rotation, brighten and darken with each of the six spots, three bulbs of
      light and three of darkness;
    - 45-104: three bulbs of both tones, every pair of spots, and a rotation with each of the combinations of
      effects that has not had one. So depth 104 holds every combination once;
    - from 105: the same list again without the original, with fresh parameters: depth 128 goes on to the 24th of
      it, 129 to the 25th, 246 through all of it and on to the 39th of a third round.

    Args:
        depth: how many, at least 1.
        circular: False for cameras whose columns do not wrap around; combinations with a rotation then turn by 0.

    Raises:
        AugmentError: a depth below 1.
    """
    if isinstance(depth, bool) or not isinstance(depth, int) or depth < 1:
        raise AugmentError(f"depth must be a whole number of variants per frame, at least 1, got {depth!r}")
    listed = combinations()
    policies = {label: Policy({"all_of": steps}, name=label, circular=circular) for label, steps in listed.items()}
    labels = list(listed)
    order = labels + labels[1:] * (depth // len(labels) + 1)
    return [Variant(number, label, policies[label]) for number, label in enumerate(order[:depth])]


def combinations() -> dict[str, list[Tree]]:
    """Return the 104 combinations in the order of `variants`: the steps of each by its label."""
    singles = [*_LOCALS, *_GLOBALS, *_WHOLE]
    bulbs = [tuple((f"bulb {tone}", {"effect": "bulb", "tone": tone}) for tone in tones) for tones in _BULBS]
    lit = [(change, spot) for change in _GLOBALS for spot in _LOCALS]
    pairs = list(combinations_with_replacement(_LOCALS, 2))
    turn = ("rotate", _ROTATE)
    ordered: list[tuple[tuple[str, Tree], ...]] = [(), *((one,) for one in singles), (turn,)]
    ordered += [(one, turn) for one in singles]
    ordered += [*lit, *bulbs[:2], *bulbs[2:], *pairs]
    ordered += [(*some, turn) for some in [*lit, *bulbs, *pairs]]
    return {" + ".join(word for word, _ in some) or "original": [step for _, step in some] for some in ordered}


def tree(rotate: float) -> Mapping[str, Any]:
    """Return the combinations of `variants` as one tree, weighted by how many there are of each kind.

    Args:
        rotate: probability of the rotation, which goes with every combination.
    """
    spot = {"one_of": [{"effect": shape} for shape in _SHAPES]}
    change = {"one_of": [{"effect": name} for name in ("brighten", "darken")]}
    bulb = {"effect": "bulb"}
    one_of = [
        {"all_of": [], "weight": 1},
        {**spot, "weight": 6},
        {**change, "weight": 2},
        {"effect": "sharpen"},
        {"effect": "blur"},
        {"effect": "contrast", "weight": 2},
        {"effect": "equalize"},
        {"effect": "saturate"},
        {"all_of": [change, spot], "weight": 12},
        {"all_of": [spot, spot], "weight": 21},
        {"all_of": [bulb, bulb, bulb], "weight": 4},
    ]
    return {"all_of": [{"one_of": one_of}, {**_ROTATE, "probability": rotate}]}
