"""Exporting what an analytic descriptor tells headings by, and showing that the file tells the same headings."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from analytic import Description, Descriptor
from analytic.descriptors.base import ImageDescriptor
from siamloc.errors import ConfigError, SiamlocError
from siamloc.files import atomic_path
from siamloc.models.describing import evaluating
from siamloc.runtime.export import INPUT, OPSET, _quiet, _session

FORMAT = "siamloc-heading"
FORMAT_VERSION = 1
OUTPUT = "orientation"
TOLERANCE = 1e-3
_IMAGES = 4


class _Orientation(nn.Module):
    """The orientation part of one panorama, as the graph of an ONNX file."""

    def __init__(self, descriptor: ImageDescriptor) -> None:
        super().__init__()
        self.descriptor = descriptor

    def forward(self, panorama: torch.Tensor) -> torch.Tensor:
        return self.descriptor._describe(self.descriptor._seen(panorama))[1]


def export_heading(descriptor: Descriptor, path: str | Path, image_size: Sequence[int]) -> dict[str, Any]:
    """Write the orientation part of an analytic descriptor as an ONNX file and compare the file with the descriptor.

    The file takes `panorama` (1, 3, H, W) float32 in [0, 1] and gives `orientation` (1, K, F). It gets its name only
    after `heading_parity` has passed.

    Args:
        descriptor: such as `analytic.descriptor("hog")`.
        path: of the file; its folder is made.
        image_size: (H, W) in pixels.

    Returns:
        What `heading_parity` returns.

    Raises:
        ConfigError: a descriptor whose operations ONNX does not have.
        AnalyticError: a size that the descriptor's parameters do not fit.
        SiamlocError: the file tells other headings.
        StorageError: the disk refuses.
    """
    rows, columns = int(image_size[0]), int(image_size[1])
    descriptor.describe(np.zeros((1, 3, rows, columns), dtype=np.uint8))  # a wrong size fails here
    if not isinstance(descriptor, ImageDescriptor) or descriptor.homomorphic:
        raise _not_exportable(descriptor)
    example, module = torch.zeros(1, 3, rows, columns), _Orientation(descriptor)
    with evaluating(module):
        found = module(example)  # fills the descriptor's caches with tensors that do not belong to the export
    if found.is_complex():
        raise _not_exportable(descriptor)
    try:
        with _quiet(), torch.no_grad():
            program: Any = torch.onnx.export(
                module,
                (example,),
                dynamo=True,
                input_names=[INPUT],
                output_names=[OUTPUT],
                opset_version=OPSET,
                verbose=False,
            )
    except Exception as error:  # the exporter's errors have no common base
        raise _not_exportable(descriptor) from error
    program.model.metadata_props.update(
        {
            "format": FORMAT,
            "format_version": str(FORMAT_VERSION),
            "identity": json.dumps(descriptor.identity, sort_keys=True),
        }
    )
    with atomic_path(path) as temporary:
        with _quiet():
            program.save(temporary, external_data=False)
        return heading_parity(descriptor, temporary)


def heading_parity(descriptor: Descriptor, path: str | Path, seed: int = 0) -> dict[str, Any]:
    """Compare an ONNX file, run by onnxruntime on the CPU, with its descriptor, on random images and after turns.

    Values are compared by their mean: where a gradient lies on the border of two bins, rounding decides about one
    pixel, which is much for a single value and nothing for a heading.

    Args:
        descriptor: what the file was made of.
        path: of the ONNX file.
        seed: of the random images and turns.

    Returns:
        `mean_relative_difference` (mean difference over mean magnitude), `max_abs_difference`, `tolerance` of the
        first, `headings` compared, `seed`, `onnxruntime` (its version).

    Raises:
        FormatError: a file that onnxruntime cannot run.
        SiamlocError: a mean difference above the tolerance, or another heading.
    """
    import onnxruntime

    session = _session(path)
    rows, columns = session.get_inputs()[0].shape[2:]
    generator = np.random.default_rng(seed)
    images = generator.integers(0, 256, (_IMAGES, 3, rows, columns), dtype=np.uint8)
    turned = np.stack(
        [np.roll(image, turn, 2) for image, turn in zip(images, generator.integers(columns, size=_IMAGES), strict=True)]
    )
    known, expected = descriptor.describe(images), descriptor.describe(turned)
    got = np.concatenate(
        [session.run(None, {INPUT: image[None].astype(np.float32) / np.float32(255)})[0] for image in turned]
    )
    assert expected.orientation is not None
    if got.shape != expected.orientation.shape:
        raise SiamlocError(
            f"{path} gives orientation parts of shape {got.shape} for {expected.orientation.shape}: do not use it"
        )
    apart = np.abs(got - expected.orientation)
    mean = float(apart.mean() / np.abs(expected.orientation).mean())
    told = descriptor.relative_heading(Description(expected.position, got), known)
    wrong = int((told != descriptor.relative_heading(expected, known)).sum())
    if not mean <= TOLERANCE or wrong:
        raise SiamlocError(
            f"the orientation parts of {path} differ from {descriptor.name}'s by {mean:.3g} of their mean (tolerance "
            f"{TOLERANCE:g}), and {wrong} of {_IMAGES} headings do: do not use the file"
        )
    return {
        "mean_relative_difference": mean,
        "max_abs_difference": float(apart.max()),
        "tolerance": TOLERANCE,
        "headings": _IMAGES,
        "seed": seed,
        "onnxruntime": onnxruntime.__version__,
    }


def _not_exportable(descriptor: Descriptor) -> ConfigError:
    return ConfigError(
        f"heading={descriptor.name} with these parameters cannot be exported for the robot: make the map anew with "
        "`siamloc map heading=hog`"
    )
