"""Policies by name, and a policy of one's own from plain values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from augment.compose import Policy
from augment.errors import AugmentError, nearest
from augment.registry import POLICIES
from augment.thesis import tree as thesis_tree

Tree = dict[str, Any]

_SPOTS: list[Tree] = [{"effect": "bulb"}, {"effect": "square"}, {"effect": "trapezoid"}]


def policy(name: str, *, circular: bool = True, rotate: float | None = None) -> Policy:
    """Return a policy by its name.

    Args:
        name: "none" (every picture stays), "thesis" (the combinations of [T] 5.3.2), "lighting" (all that light and
            exposure do indoors, geometry untouched) or "strong" (lighting, optics, motion, noise and occlusion
            together).
        circular: False for cameras whose columns do not wrap around; nothing is rotated then.
        rotate: probability of a rotation; one half in "thesis", 0 in "lighting", 1 in "strong" if not given.

    Raises:
        AugmentError: an unknown name, or a probability outside [0, 1].
    """
    defaults = {"none": 0.0, "thesis": 0.5, "lighting": 0.0, "strong": 1.0}
    if name not in POLICIES:
        raise AugmentError(f"unknown policy {name!r}: {nearest(name, POLICIES)}")
    probability = defaults[name] if rotate is None else rotate
    turn: Tree = {"effect": "rotate", "probability": probability}
    trees: dict[str, Any] = {
        "none": {"all_of": [turn] if probability else []},
        "thesis": thesis_tree(probability),
        "lighting": {"all_of": [*_lighting(), *([turn] if probability else [])]},
        "strong": {"all_of": [*_lighting(), *_camera(), turn]},
    }
    return Policy(trees[name], name=name, circular=circular)


def policy_from_config(config: Mapping[str, Any]) -> Policy:
    """Return the policy that plain values describe, as they stand in a configuration file.

    Args:
        config: `name` and the parameters of `policy`; or a tree (`all_of`, `one_of` or `effect`, see `Policy`) with
            an optional `name` and `circular`.

    Raises:
        AugmentError: an unknown key, name or parameter, or a value that makes no sense.
    """
    if not isinstance(config, Mapping):
        raise AugmentError(f"a policy is a mapping with a name, all_of, one_of or effect, got {config!r}")
    options = dict(config)
    circular = options.pop("circular", True)
    if not isinstance(circular, bool):
        raise AugmentError(f"circular of a policy must be true or false, got {circular!r}")
    if {"effect", "all_of", "one_of"} & set(options):
        return Policy(options, name=str(options.pop("name", "own")), circular=circular)
    if "name" not in options:
        raise AugmentError("a policy needs a name, or its own tree under all_of, one_of or effect")
    name = str(options.pop("name"))
    for key in options:
        if key != "rotate":
            raise AugmentError(
                f"policy {name} has no parameter {key!r}: {nearest(key, ('name', 'rotate', 'circular'))}"
            )
    return policy(name, circular=circular, rotate=options.get("rotate"))


def _lighting() -> list[Tree]:
    """The chain of light: what falls into the room, where it falls, and what the camera makes of it."""
    return [
        {
            "one_of": [
                {"one_of": _SPOTS},
                {"all_of": [{"one_of": _SPOTS}, {"one_of": _SPOTS}]},
                {"effect": "shadow"},
                {"effect": "sun_patch"},
                {"all_of": [{"effect": "shadow"}, {"effect": "sun_patch"}]},
            ],
            "probability": 0.7,
        },
        {"effect": "exposure", "probability": 0.6},
        {"effect": "white_balance", "probability": 0.5},
        {
            "one_of": [{"effect": "gamma"}, {"effect": "contrast"}, {"effect": "equalize"}],
            "probability": 0.3,
        },
        {"effect": "saturate", "probability": 0.2},
    ]


def _camera() -> list[Tree]:
    """Optics, motion and the sensor, and what may stand in the way."""
    return [
        {"effect": "occlude", "share": [0.05, 0.2], "level": [0, 90], "probability": 0.25},
        {"effect": "vignette", "probability": 0.2},
        {"one_of": [{"effect": "blur"}, {"effect": "motion_blur"}, {"effect": "sharpen"}], "probability": 0.3},
        {"effect": "noise", "variance": [0.0005, 0.005], "probability": 0.3},
        {"effect": "jpeg", "quality": [20, 70], "probability": 0.2},
    ]
