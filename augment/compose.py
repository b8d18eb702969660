"""`Policy`: effects combined at random: all of a list, or one of a list, each with a probability."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import SequenceMatcher
from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from augment.base import Effect, Params
from augment.columns import wrapped
from augment.errors import AugmentError, hint
from augment.ranges import Range
from augment.registry import effect
from foundation.settings import NotNegative, Share, checked

_KINDS = ("effect", "all_of", "one_of")
_UNIT = Range(0, 1)
_TAKEN = Range(0, 1, minimum=0, maximum=1, whole=True)


@dataclass(frozen=True)
class Step:
    """A node of a policy's tree.

    Attributes:
        kind: "effect", "all_of" (its steps one after the other) or "one_of" (one of its steps).
        steps: the children; an effect has none.
        effect: what an effect node does.
        slot: number of an effect node among all effects of the policy, in the order of application; -1 for others.
        probability: probability that a frame that reaches this node takes it.
        weight: relative to its siblings in "one_of".
        name: prefix of the parameters of an effect node, such as "3.bulb".
    """

    kind: str
    steps: tuple[Step, ...] = ()
    effect: Effect | None = None
    slot: int = -1
    probability: float = 1.0
    weight: float = 1.0
    name: str = ""


class Policy(Effect):
    """Effects combined at random, with the interface of a single effect.

    Every frame draws its own path through the tree and its own parameters. If slot 3 is a bulb, its parameters are
    `3.bulb.on` (whether this frame got it), `3.bulb.radius` and so on; `heading` is what all rotations together
    add to the robot's heading, rad in (-pi, pi]. Nothing in a policy moves the robot or changes its room.

    Args:
        tree: nested plain values. {"effect": name, **its parameters}, {"all_of": [...]} or {"one_of": [...]}, each
            with an optional `probability` (default 1) and, inside one_of, `weight` (default 1).
        name: name of the policy.
        circular: False turns wrap-around off in all effects that do not set it themselves.

    Attributes:
        config: the policy in plain values; `policy_from_config` makes the same policy from them.

    Raises:
        AugmentError: an unknown effect, parameter or key, or a probability outside [0, 1].

    Example:
        >>> import torch, augment
        >>> night = {"effect": "exposure", "stops": [-2.5, -0.5]}
        >>> lamp = {"effect": "bulb", "tone": "light", "probability": 0.5}
        >>> policy = augment.Policy({"all_of": [night, lamp]}, name="night")
        >>> params = policy.draw(torch.Generator().manual_seed(0), torch.zeros(3, 3, 128, 512))
        >>> params["1.bulb.on"]
        tensor([ True, False,  True])
    """

    name = "policy"

    def __init__(self, tree: Mapping[str, Any], name: str = "policy", circular: bool = True) -> None:
        super().__init__(circular=circular)
        self.name = name  # type: ignore[misc]
        self.tree = _step(tree, circular, itertools.count(), name)
        self.config: dict[str, Any] = {"name": name, "circular": circular, **tree}
        steps = list(_walk(self.tree))
        self.slots: tuple[Step, ...] = tuple(step for step in steps if step.effect is not None)
        self._gates = [f"gate{number}" for number in range(sum(step.probability < 1 for step in steps))]
        self._choices = [f"choice{number}" for number in range(sum(step.kind == "one_of" for step in steps))]
        self._prefixed = {step.name: step.effect for step in self.slots if step.effect is not None}
        self.effects = tuple(self._prefixed.values())
        renderers = [inner.renderer for inner in self.effects]
        self.stages = _stages(self.tree, [(type(one), repr(one.options)) for one in renderers])

    def __repr__(self) -> str:
        return f"Policy({self.name!r}, {len(self.slots)} slots)"

    def places(self, height: int, width: int) -> dict[str, Range]:
        """Return the ranges of the parameters of all effects, and of one random number for each decision."""
        spans = dict.fromkeys([*self._gates, *self._choices], _UNIT)
        for prefix, inner in self._prefixed.items():
            spans.update({f"{prefix}.{key}": span for key, span in inner.spans(height, width).items()})
        return spans

    def limits(self, height: int, width: int) -> dict[str, Range]:
        """Return the limits of all parameters that `draw` returns, including whether each effect is on."""
        spans = {}
        for prefix, inner in self._prefixed.items():
            spans[f"{prefix}.on"] = _TAKEN
            spans.update({f"{prefix}.{key}": span for key, span in inner.limits(height, width).items()})
        return {**spans, "heading": Range(0, 0)}

    def complete(self, params: Params, count: int, height: int, width: int) -> Params:
        """Decide which effects each frame gets, and add up the headings of their rotations, in rad in (-pi, pi]."""
        taken = self._decide(params, count)
        done: Params = {}
        heading = torch.zeros(count, dtype=torch.float32)
        for slot, (prefix, inner) in enumerate(self._prefixed.items()):
            own = {key: params[f"{prefix}.{key}"] for key in inner.spans(height, width)}
            own = inner.complete(own, count, height, width)
            done[f"{prefix}.on"] = taken[slot]
            done.update({f"{prefix}.{key}": value for key, value in own.items()})
            if "heading" in own:
                heading = heading + own["heading"] * taken[slot]
        return {**done, "heading": wrapped(heading)}

    def parts(self, params: Mapping[str, Tensor]) -> list[tuple[Effect, Params, NDArray[np.bool_]]]:
        """Return the effect, the parameters and the altered frames of each slot. See `Effect.parts`."""
        owns: dict[str, Params] = {prefix: {} for prefix in self._prefixed}
        for key, value in params.items():
            prefix, _, name = key.rpartition(".")
            if prefix:
                owns[prefix][name] = value
        parts = []
        for own, inner in zip(owns.values(), self.effects, strict=True):
            on = own.pop("on").numpy().astype(bool)
            parts.append((inner, own, on & inner.active(own) if on.any() else on))
        return parts

    def render(self, batch: Tensor, values: Mapping[str, Tensor]) -> Tensor:
        """Not called: the steps of a policy are its effects."""
        raise NotImplementedError

    def _decide(self, params: Params, count: int) -> list[Tensor]:
        """Return for each slot which frames got it (B,)."""
        gates = iter([params[name] for name in self._gates])
        choices = iter([params[name].contiguous() for name in self._choices])
        taken: list[Tensor] = []

        def visit(step: Step, here: Tensor) -> None:  # in the order of `_walk`
            if step.probability < 1:
                here = here & (next(gates) < step.probability)
            if step.effect is not None:
                taken.append(here)
            elif step.kind == "all_of":
                for child in step.steps:
                    visit(child, here)
            else:
                chosen = torch.bucketize(next(choices), _bounds(tuple(child.weight for child in step.steps)))
                for number, child in enumerate(step.steps):
                    visit(child, here & (chosen == number))

        visit(self.tree, torch.ones(count, dtype=torch.bool))
        return taken


def _stages(step: Step, kinds: Sequence[Any]) -> list[list[int]]:
    """Group slots into stages that are rendered together, so that every alternative keeps the order of its effects.

    Args:
        step: the root of the tree, or a step below it.
        kinds: the kind of each slot; slots of one kind in different alternatives are rendered together.
    """
    if step.effect is not None:
        return [[step.slot]]
    parts = [_stages(child, kinds) for child in step.steps]
    if step.kind == "all_of":
        return [stage for part in parts for stage in part]
    merged: list[list[int]] = []
    for part in sorted(parts, key=len, reverse=True):
        before, merged = merged, []
        here, there = ([kinds[stage[0]] for stage in side] for side in (before, part))
        for tag, i, j, k, m in SequenceMatcher(None, here, there, autojunk=False).get_opcodes():
            if tag == "equal":
                merged += [[*one, *other] for one, other in zip(before[i:j], part[k:m], strict=True)]
            else:
                merged += [*before[i:j], *part[k:m]]
    return merged


@lru_cache(maxsize=256)
def _bounds(weights: tuple[float, ...]) -> Tensor:
    """Divide [0, 1) into intervals proportional to weights; return their inner boundaries."""
    share = torch.tensor(weights, dtype=torch.float64)
    return (share.cumsum(0) / share.sum())[:-1].float()


def _walk(step: Step) -> Iterator[Step]:
    yield step
    for child in step.steps:
        yield from _walk(child)


def _step(tree: Any, circular: bool, slots: Iterator[int], where: str) -> Step:
    rest = dict(tree) if isinstance(tree, Mapping) else {}
    kinds = [kind for kind in _KINDS if kind in rest]
    if len(kinds) != 1:
        raise AugmentError(f"a step of policy {where} has exactly one of {', '.join(_KINDS)}, got {tree!r}")
    kind = kinds[0]
    content = rest.pop(kind)
    probability = checked(rest.pop("probability", 1.0), Share, f"a probability of policy {where}", AugmentError)
    weight = checked(rest.pop("weight", 1.0), NotNegative, f"a weight of policy {where}", AugmentError)
    if kind == "effect":
        slot = next(slots)
        built = effect(content, **{"circular": circular, **{str(key): value for key, value in rest.items()}})
        return Step(kind, (), built, slot, probability, weight, f"{slot}.{content}")
    if rest:
        key = next(iter(rest))
        raise AugmentError(f"{kind} in policy {where} has no key {key!r}: {hint(key, (kind, 'probability', 'weight'))}")
    if not isinstance(content, Sequence) or isinstance(content, str):
        raise AugmentError(f"{kind} in policy {where} must be a list of steps, got {content!r}")
    steps = tuple(_step(child, circular, slots, where) for child in content)
    if kind == "one_of" and not sum(step.weight for step in steps) > 0:
        raise AugmentError(f"one_of in policy {where} needs at least one step with a weight above 0")
    return Step(kind, steps, None, -1, probability, weight)
