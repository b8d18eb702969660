"""The effects by name. Knows where each one lives and loads it when it is asked for."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from augment.errors import AugmentError, nearest

if TYPE_CHECKING:
    from augment.base import Effect

_HOMES = {
    "bulb": "spots.Bulb",
    "square": "spots.Square",
    "trapezoid": "spots.Trapezoid",
    "brighten": "photometric.Brighten",
    "darken": "photometric.Darken",
    "sharpen": "sharpness.Sharpen",
    "blur": "sharpness.Blur",
    "contrast": "photometric.Contrast",
    "equalize": "colour.Equalize",
    "saturate": "colour.Saturate",
    "rotate": "rotation.Rotate",
    "noise": "sensor.Noise",
    "occlude": "occlusion.Occlude",
    "motion_blur": "sharpness.MotionBlur",
    "gamma": "photometric.Gamma",
    "white_balance": "photometric.WhiteBalance",
    "exposure": "photometric.Exposure",
    "vignette": "shading.Vignette",
    "shadow": "shading.Shadow",
    "sun_patch": "shading.SunPatch",
    "jpeg": "sensor.Jpeg",
}

EFFECTS = tuple(_HOMES)
POLICIES = ("none", "thesis", "lighting", "strong")


def effect(name: str, **params: Any) -> Effect:
    """Return an effect by its name.

    Args:
        name: one of `augment.EFFECTS`.
        **params: ranges and options of that effect; a range is one number or a pair (low, high).

    Raises:
        AugmentError: an unknown name or parameter (the valid ones are named), or a range that makes no sense.
    """
    if name not in EFFECTS:
        raise AugmentError(f"unknown effect {name!r}: {nearest(name, EFFECTS)}")
    module, _, cls = _HOMES[name].partition(".")
    built: Effect = getattr(import_module(f"augment.{module}"), cls)(**params)
    return built
