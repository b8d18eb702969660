"""Write the part of a network that compares a query with map frames as an ONNX file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from augment.base import on_host
from foundation.files import atomic_path
from siamloc.errors import SiamlocError
from siamloc.maps.refinement import OUTPUTS
from siamloc.models.describing import evaluating, identity_of, required_comparing
from siamloc.models.orientation import VALUES
from siamloc.models.relative import RelativePose
from siamloc.runtime.onnx_file import label, quiet, session_of, traced
from siamloc.runtime.onnx_model import on_cpu

FORMAT = "siamloc-relative"
INPUTS = ("query", "known")
TOLERANCE = 1e-3


@on_host()
def export_relative(network: nn.Module, path: str | Path) -> dict[str, Any]:
    """Write a network's comparing part, see `siamloc.models.relative.RelativePose`, as an ONNX file.

    The file takes orientation parts `query` and `known` (B, K, F), where B is free, and gives `pose` (B, 3),
    `information` (B, 3, 3) and `match` (B,). It gets its final name only after `relative_parity` has passed.

    Args:
        network: built with relative=True; its weights must be float32.
        path: of the file; its folder is created if needed.

    Returns:
        What `relative_parity` returns.

    Raises:
        ConfigError: a network that does not compare, or weights that are not float32.
        SiamlocError: the file gives different poses.
        StorageError: the disk is full or cannot be written to.
    """
    network = on_cpu(network)
    relative = required_comparing(network)
    example = tuple(torch.zeros(2, relative.columns, VALUES) for _ in INPUTS)
    program = traced(_Compared(relative), example, INPUTS, OUTPUTS, free_batch=True)
    label(program, FORMAT, identity_of(network))
    with atomic_path(path) as temporary:
        with quiet():
            program.save(temporary, external_data=False)
        return relative_parity(network, temporary)


def relative_parity(
    network: nn.Module, path: str | Path, batches: tuple[int, ...] = (1, 2, 7), seed: int = 0
) -> dict[str, Any]:
    """Compare an ONNX file, run by onnxruntime on the CPU, with its network, on random parts, rotated and disturbed.

    Args:
        network: the network that was exported.
        path: of the ONNX file.
        batches: numbers of pairs to try.
        seed: of the random parts.

    Returns:
        `max_relative_difference` (each output's relative to its largest value), `tolerance`, `batches`, `seed`,
        `onnxruntime` (its version).

    Raises:
        ConfigError: a network that does not compare.
        FormatError: a file that onnxruntime cannot run.
        SiamlocError: a difference above the tolerance, or values that are not finite.
    """
    import onnxruntime

    relative, session = required_comparing(on_cpu(network)), session_of(path)
    generator, largest = np.random.default_rng(seed), 0.0
    for batch in batches:
        known = generator.standard_normal((batch, relative.columns, VALUES), dtype=np.float32)
        noise = generator.standard_normal(known.shape, dtype=np.float32)
        query = np.roll(known, int(generator.integers(relative.columns)), axis=1) + noise / 2
        with evaluating(relative):
            found = relative(torch.from_numpy(query), torch.from_numpy(known))
        got = session.run(None, dict(zip(INPUTS, (query, known), strict=True)))
        apart = [_apart(one, other.numpy()) for one, other in zip(got, found, strict=True)]
        largest = float(np.max([largest, *apart]))  # propagates NaN
    if not largest <= TOLERANCE:
        raise SiamlocError(
            f"the poses that {path} gives differ by {largest:.3g} of the largest value from those that the network "
            f"gives (tolerance {TOLERANCE:g}): do not use the file"
        )
    return {
        "max_relative_difference": largest,
        "tolerance": TOLERANCE,
        "batches": list(batches),
        "seed": seed,
        "onnxruntime": onnxruntime.__version__,
    }


class _Compared(nn.Module):
    """`RelativePose` with plain outputs."""

    def __init__(self, relative: RelativePose) -> None:
        super().__init__()
        self.relative = relative

    def forward(self, query: torch.Tensor, known: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return tuple(self.relative(query, known))


def _apart(found: NDArray[np.float32], expected: NDArray[np.float32]) -> float:
    """Return the largest difference over the largest value; NaN for other shapes."""
    if found.shape != expected.shape:
        return float("nan")
    return float(np.abs(found - expected).max() / np.abs(expected).max())
