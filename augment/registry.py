"""Effects by name: where each one is defined; it is loaded when requested."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from augment.errors import AugmentError
from foundation.errors import known

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
    "equalize": "photometric.Equalize",
    "saturate": "photometric.Saturate",
    "rotate": "columns.Rotate",
    "noise": "sensor.Noise",
    "occlude": "columns.Occlude",
    "motion_blur": "sharpness.MotionBlur",
    "gamma": "photometric.Gamma",
    "white_balance": "photometric.WhiteBalance",
    "exposure": "photometric.Exposure",
    "vignette": "layers.Vignette",
    "shadow": "layers.Shadow",
    "sun_patch": "layers.SunPatch",
    "jpeg": "sensor.Jpeg",
    "relight": "relight.Relight",
    "doorway": "relight.Doorway",
    "windows": "relight.Windows",
    "view": "view.View",
}

EFFECTS = tuple(_HOMES)
POLICIES = ("none", "thesis", "lighting", "strong", "any_light")


def effect(name: str, **params: Any) -> Effect:
    """Make an effect by its name.

    Args:
        name: one of `augment.EFFECTS`.
        **params: ranges and options of that effect; a range is one number or a pair (low, high).

    Raises:
        AugmentError: an unknown name or parameter (the message lists the valid ones), or an invalid range.

    Example:
        >>> import augment
        >>> augment.effect("gamma", gamma=(0.8, 1.25))
        gamma(gamma=(0.8, 1.25), circular=True)
    """
    module, _, cls = _HOMES[known(name, EFFECTS, "effect", AugmentError)].partition(".")
    built: Effect = getattr(import_module(f"augment.{module}"), cls)(**params)
    return built
