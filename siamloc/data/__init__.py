"""Data sets: readers, unwrapping, decoded panoramas, who does what (protocol), and what is wrong with the data."""

from __future__ import annotations

from siamloc.data.checks import check
from siamloc.data.decoding import Preprocessing
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

__all__ = [
    "READERS",
    "DataSettings",
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
    "read",
    "unwrap",
]
