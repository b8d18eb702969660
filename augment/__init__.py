"""Physically motivated augmentation of panoramas: light, optics and motion, batched and replayable.

    effect = augment.effect("bulb", tone="light")
    params = effect.draw(torch.Generator().manual_seed(0), batch)   # separate ones for every frame
    brighter = effect.apply(batch, params)                          # the same images each time

A batch has shape (B, 3, H, W), RGB, uint8 or float32 in [0, 1]; columns are azimuth and wrap around unless
`circular=False`. `augment.policy` combines effects at random; `augment.Augment` turns an effect or a policy into a
torch module and torchvision transform. `augment.expand` writes expanded data sets to disk. Importing the package does
not load torch.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from augment.errors import AugmentError
from augment.registry import EFFECTS, POLICIES

if TYPE_CHECKING:
    from augment.base import Effect
    from augment.combinations import variants
    from augment.compose import Policy
    from augment.contact_sheet import preview
    from augment.policies import policy, policy_from_config
    from augment.registry import effect
    from augment.transforms import Augment

__all__ = [
    "EFFECTS",
    "POLICIES",
    "Augment",
    "AugmentError",
    "Effect",
    "Policy",
    "effect",
    "policy",
    "policy_from_config",
    "preview",
    "variants",
]

_HOMES = {
    "Augment": "augment.transforms",
    "Effect": "augment.base",
    "Policy": "augment.compose",
    "effect": "augment.registry",
    "policy": "augment.policies",
    "policy_from_config": "augment.policies",
    "preview": "augment.contact_sheet",
    "variants": "augment.combinations",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'augment' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
