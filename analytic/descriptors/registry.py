"""Descriptors by name."""

from __future__ import annotations

from importlib import import_module
from typing import Any, cast

from analytic.descriptors.base import ImageDescriptor
from analytic.errors import AnalyticError
from foundation.errors import known
from foundation.settings import defaults_of

DESCRIPTORS: dict[str, tuple[str, str]] = {
    "fs": ("fourier", "FourierSignature"),
    "hog": ("hog", "Hog"),
    "gist": ("gist", "Gist"),
    "wisurf": ("wisurf", "WiSurf"),
    "briefgist": ("briefgist", "BriefGist"),
    "radon_fourier": ("radon", "RadonFourier"),
    "radon_poc": ("radon", "RadonPoc"),
    "hsv": ("hsv", "Hsv"),
    "thumbnail": ("thumbnail", "Thumbnail"),
}


def descriptor(name: str, **params: Any) -> ImageDescriptor:
    """Make a descriptor by name.

    Args:
        name: one of DESCRIPTORS.
        params: parameters of its class; the defaults are those that [T] found best.

    Raises:
        AnalyticError: an unknown name or parameter, or a value that fits no image.

    Example:
        >>> import numpy as np
        >>> hog = descriptor("hog", rows=16, bins=16)
        >>> panoramas = np.random.default_rng(0).integers(0, 256, (4, 3, 128, 512), dtype=np.uint8)
        >>> known, turned = hog.describe(panoramas), hog.describe(np.roll(panoramas, 128, axis=3))
        >>> found = hog.localize(turned, known)
        >>> found.index, np.degrees(found.heading)
        (array([0, 1, 2, 3]), array([90., 90., 90., 90.]))
    """
    return _class(name).of(params)


def parameters(name: str) -> dict[str, Any]:
    """Return the parameters of a descriptor with their defaults.

    Raises:
        AnalyticError: an unknown name.

    Example:
        >>> parameters("briefgist")
        {'circular': True, 'homomorphic': False, 'rows': 64, 'columns': 16}
    """
    return defaults_of(_class(name))


def _class(name: str) -> type[ImageDescriptor]:
    module, kind = DESCRIPTORS[known(name, DESCRIPTORS, "descriptor", AnalyticError)]
    return cast(type[ImageDescriptor], getattr(import_module(f"analytic.descriptors.{module}"), kind))
