"""From a trained network to the robot: `export` writes a bundle, `Localizer` locates images with it.

    siamloc.runtime.export(network, known, "runs/robot/bundle")
    siamloc.runtime.Localizer("runs/robot/bundle").locate("photo.jpeg")

Importing this package does not load torch; the robot needs only numpy, opencv and onnxruntime.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from siamloc.lazy import lazy

if TYPE_CHECKING:
    from siamloc.runtime.bundle import Bundle
    from siamloc.runtime.exporting import export
    from siamloc.runtime.live import Live
    from siamloc.runtime.localizer import Candidate, Localizer, Location
    from siamloc.runtime.onnx_model import export_onnx, parity
    from siamloc.runtime.precision import precision_table
    from siamloc.runtime.stream import Located, locate_all, written

__all__ = [
    "Bundle",
    "Candidate",
    "Live",
    "Localizer",
    "Located",
    "Location",
    "export",
    "export_onnx",
    "locate_all",
    "parity",
    "precision_table",
    "written",
]

_HOMES = {
    "Bundle": "bundle",
    "export": "exporting",
    "Candidate": "localizer",
    "Live": "live",
    "Localizer": "localizer",
    "Location": "localizer",
    "Located": "stream",
    "locate_all": "stream",
    "written": "stream",
    "export_onnx": "onnx_model",
    "parity": "onnx_model",
    "precision_table": "precision",
}

__getattr__, __dir__ = lazy(__name__, _HOMES)
