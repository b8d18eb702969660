"""From a trained network to the robot: `export` writes a bundle, `Localizer` locates images with it.

    siamloc.runtime.export(network, known, "runs/robot/bundle")
    siamloc.runtime.Localizer("runs/robot/bundle").locate("photo.jpeg")

Importing this package loads no torch, and the robot needs numpy, opencv and onnxruntime alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc.runtime.bundle import Bundle, export
    from siamloc.runtime.localizer import Candidate, Localizer, Location, write_locations
    from siamloc.runtime.onnx_model import export_heading, export_onnx, heading_parity, parity

__all__ = [
    "Bundle",
    "Candidate",
    "Localizer",
    "Location",
    "export",
    "export_heading",
    "export_onnx",
    "heading_parity",
    "parity",
    "write_locations",
]

_HOMES = {
    "Bundle": "bundle",
    "export": "bundle",
    "Candidate": "localizer",
    "Localizer": "localizer",
    "Location": "localizer",
    "write_locations": "localizer",
    "export_heading": "onnx_model",
    "export_onnx": "onnx_model",
    "heading_parity": "onnx_model",
    "parity": "onnx_model",
}

__getattr__, __dir__ = lazy(__name__, _HOMES)
