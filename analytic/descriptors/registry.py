"""Descriptors by name."""

from __future__ import annotations

from dataclasses import fields
from importlib import import_module
from typing import Any, cast

from analytic.descriptors.base import ImageDescriptor
from analytic.errors import AnalyticError, hint

DESCRIPTORS: dict[str, tuple[str, str]] = {
    "fs": ("fourier", "FourierSignature"),
    "hog": ("hog", "Hog"),
    "gist": ("gist", "Gist"),
    "wisurf": ("wisurf", "WiSurf"),
    "briefgist": ("briefgist", "BriefGist"),
    "radon_fourier": ("radon", "RadonFourier"),
    "radon_poc": ("radon", "RadonPoc"),
    "hsv": ("hsv", "Hsv"),
}


def descriptor(name: str, **params: Any) -> ImageDescriptor:
    """Return the descriptor of that name.

    Args:
        name: one of DESCRIPTORS.
        params: see the class; what is left out has the configuration that [T] found best.

    Raises:
        AnalyticError: an unknown name or parameter, or a value that fits no image.
    """
    made = _class(name)
    valid = [field.name for field in fields(made)]
    for key in params:
        if key not in valid:
            raise AnalyticError(f"descriptor {name!r} has no parameter {key!r}: {hint(key, valid)}")
    return made(**params)


def parameters(name: str) -> dict[str, Any]:
    """Return the parameters of a descriptor with their defaults.

    Raises:
        AnalyticError: an unknown name.
    """
    return {field.name: field.default for field in fields(_class(name))}


def _class(name: str) -> type[ImageDescriptor]:
    if name not in DESCRIPTORS:
        raise AnalyticError(f"unknown descriptor {name!r}: {hint(name, DESCRIPTORS)}")
    module, kind = DESCRIPTORS[name]
    return cast(type[ImageDescriptor], getattr(import_module(f"analytic.descriptors.{module}"), kind))
