"""Compare the identities of what described a map and what described its queries."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from foundation.settings import leaves
from siamloc.data.panorama import PolarRing
from siamloc.data.presets import AutoRing, ColdRing
from siamloc.maps.heading import parts_of

_RINGS = {kind.__name__ for kind in (PolarRing, AutoRing, ColdRing)}  # whose rows have no known elevations
BY_DRIVE = AutoRing.__name__, ColdRing.__name__
"""Cameras whose values are found in the pictures of each drive."""
_FOUND = {"centre", "inner", "outer"}  # values of an `AutoRing` that may differ from drive to drive


def differences(ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> str:
    """Return a text with the keys in which two identities differ, and their values; empty if there are none."""
    orders = [list(parts_of(one)) for one in (ours, theirs)]
    if orders[0] != orders[1] and set(orders[0]) == set(orders[1]):
        return f"the parts are {', '.join(orders[0])} in the map, {', '.join(orders[1])} here"
    ours, theirs = ({key: repr(item) for key, item in leaves(one) if item != {}} for one in (ours, theirs))
    keys = [key for key in {**ours, **theirs} if ours.get(key) != theirs.get(key)]
    keys = ["name"] if "name" in keys else keys  # the parameters of different descriptors are unrelated
    return "; ".join(f"{key} is {ours.get(key, 'absent')} in the map, {theirs.get(key, 'absent')} here" for key in keys)


def exchangeable(camera: Mapping[str, Any] | None, other: Mapping[str, Any] | None) -> bool:
    """Whether two cameras, by their parameters, give the same panoramas although they may differ.

    Their models know the elevation of each pixel, or they are rings that are found in the pictures of each drive and
    have the same direction.
    """
    if camera is None or other is None:
        return False
    if camera.get("kind") not in _RINGS and other.get("kind") not in _RINGS:
        return True
    return camera.get("kind") in BY_DRIVE and all(
        camera.get(key) == other.get(key) for key in {*camera, *other} - _FOUND
    )
