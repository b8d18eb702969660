"""Data sets: readers, unwrapping, decoded panoramas, the protocol (which frames do what), and data checks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.data.checks import check, room_sizes, summary
from siamloc.data.decoding import Preprocessing
from siamloc.data.examples import example
from siamloc.data.frames import FrameTable, concatenate
from siamloc.data.library import PanoramaLibrary
from siamloc.data.panorama import (
    HyperbolicMirror,
    OmnidirectionalCamera,
    PanoramaView,
    PolarRing,
    azimuth_column,
    column_azimuth,
    unwrap,
)
from siamloc.data.protocol import Protocol, Role
from siamloc.data.reading import READERS, DataSettings, read
from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc.data.expansion import Expanded, expand

__all__ = [
    "READERS",
    "DataSettings",
    "Expanded",
    "FrameTable",
    "HyperbolicMirror",
    "OmnidirectionalCamera",
    "PanoramaLibrary",
    "PanoramaView",
    "PolarRing",
    "Preprocessing",
    "Protocol",
    "Role",
    "azimuth_column",
    "check",
    "column_azimuth",
    "concatenate",
    "example",
    "expand",
    "read",
    "room_sizes",
    "summary",
    "unwrap",
]

# These need torch, which nothing else here loads.
_HOMES = {"Expanded": "expansion", "expand": "expansion"}

__getattr__, __dir__ = lazy(__name__, _HOMES)
