"""From a trained network to the robot. Importing this package loads no torch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc.runtime.bundle import Bundle, write_bundle
    from siamloc.runtime.export import export_onnx, parity
    from siamloc.runtime.heading_export import export_heading, heading_parity
    from siamloc.runtime.localizer import Localizer, Location

__all__ = [
    "Bundle",
    "Localizer",
    "Location",
    "export_heading",
    "export_onnx",
    "heading_parity",
    "parity",
    "write_bundle",
]

_HOMES = {
    "Bundle": "bundle",
    "Localizer": "localizer",
    "Location": "localizer",
    "export_heading": "heading_export",
    "export_onnx": "export",
    "heading_parity": "heading_export",
    "parity": "export",
    "write_bundle": "bundle",
}

__getattr__, __dir__ = lazy(__name__, _HOMES)
