"""From a trained network to the robot: `export` writes a bundle, `Localizer` locates images with it.

    siamloc.runtime.export(network, known, "runs/robot/bundle")
    siamloc.runtime.Localizer("runs/robot/bundle").locate("photo.jpeg")

Importing this package loads no torch, and the robot needs numpy, opencv and onnxruntime alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc.runtime.bundle import Bundle
    from siamloc.runtime.exporting import export
    from siamloc.runtime.localizer import Candidate, Localizer, Location
    from siamloc.runtime.onnx_model import export_heading, export_onnx, heading_parity, parity
    from siamloc.runtime.stream import Located, locate_all, written

__all__ = [
    "Bundle",
    "Candidate",
    "Localizer",
    "Located",
    "Location",
    "export",
    "export_heading",
    "export_onnx",
    "heading_parity",
    "locate_all",
    "parity",
    "written",
]

_HOMES = {
    "Bundle": "bundle",
    "export": "exporting",
    "Candidate": "localizer",
    "Localizer": "localizer",
    "Location": "localizer",
    "Located": "stream",
    "locate_all": "stream",
    "written": "stream",
    "export_heading": "onnx_model",
    "export_onnx": "onnx_model",
    "heading_parity": "onnx_model",
    "parity": "onnx_model",
}

__getattr__, __dir__ = lazy(__name__, _HOMES)
