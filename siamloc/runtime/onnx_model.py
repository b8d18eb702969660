"""Write networks as ONNX files, each compared with its network before it gets its final name."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from augment.base import on_host
from foundation.calls import typed
from foundation.files import atomic_path, file_hash
from siamloc.errors import ConfigError, SiamlocError
from siamloc.models.describing import evaluating, identity_of, network_of, orienting
from siamloc.runtime.onnx_file import OPSET, label, quiet, session_of, traced

FORMAT = "siamloc-network"
INPUT, OUTPUT, HEADING_OUTPUT = "panorama", "descriptor", "orientation"
TOLERANCE = 1e-4
MOST_BYTES = 2**31 - 2**24  # protobuf is limited to 2 GiB, and the graph needs a little of that
_WORDS = {OUTPUT: "descriptors", HEADING_OUTPUT: "orientation parts"}


@typed
@on_host()
def export_onnx(network: nn.Module, path: str | Path, image_size: Sequence[int]) -> dict[str, Any]:
    """Write a network as an ONNX file.

    The file takes `panorama` (B, 3, H, W) uint8 and gives `descriptor` (B, D), and `orientation` (B, K, F) if the
    network finds headings; B is free, and the division by 255 and any normalization of the network are included. Its
    metadata hold the format, its version, and the network's identity as JSON. The file gets its final name only after
    `parity` has passed, in evaluation mode; the network keeps its mode.

    Args:
        network: (B, 3, H, W) -> (B, D), such as one made by `siamloc.models.build`; its weights must be float32.
        path: of the file; its folder is created if needed.
        image_size: (H, W) in pixels.

    Returns:
        `path`, `bytes`, `sha256`, `opset`, `identity`, and `parity` (what `parity`
        returns).

    Raises:
        ConfigError: weights that are not float32 or take 2 GB or more, or an image size that does not suit the network.
        SiamlocError: the file's descriptors differ from the network's.
        StorageError: the disk is full or cannot be written to.
    """
    path = Path(path)
    network = on_cpu(network)
    identity = identity_of(network)
    rows, columns = int(image_size[0]), int(image_size[1])
    example = torch.zeros(2, 3, rows, columns, dtype=torch.uint8)  # an example of 1 would fix the batch to 1
    graph, outputs = _graph(network)
    with evaluating(graph):
        graph(example)  # a wrong size fails here, with the network's own message
    if sum(tensor.nbytes for tensor in network.state_dict().values()) >= MOST_BYTES:
        raise ConfigError("a network of 2 GB or more does not fit into an ONNX file: export a smaller one")
    program = traced(graph, (example,), [INPUT], outputs, free_batch=True)
    label(program, FORMAT, identity)
    with atomic_path(path) as temporary:
        with quiet():
            program.save(temporary, external_data=False)
        report = parity(network, temporary)
    return {
        "path": str(path),
        "bytes": path.stat().st_size,
        "sha256": file_hash(path),
        "opset": OPSET,
        "identity": identity,
        "parity": report,
    }


@typed
def parity(
    network: nn.Module,
    path: str | Path,
    *,
    batches: Sequence[int] = (1, 2, 7),
    seed: int = 0,
    tolerance: float = TOLERANCE,
) -> dict[str, Any]:
    """Compare an ONNX file, run by onnxruntime on the CPU, with its network on random images.

    Both compute in float32 but sum the same products in a different order, so they differ by rounding errors that grow
    with the values: the tolerance applies to the difference itself if the largest value is at most 1, and to the
    difference divided by the largest value if that is above 1. An absolute bound alone would reject correct files of
    networks with large values; a relative one alone would let a network near 0 pass with any direction.

    Args:
        network: in any mode; it is compared in evaluation mode and keeps its mode.
        path: of the ONNX file.
        batches: numbers of images to try.
        seed: of the random images.
        tolerance: largest difference allowed, relative to the largest value where that is above 1.

    Returns:
        `max_abs_difference`, `max_abs_value`, `max_relative_difference` (the first over the second, or the
        first itself if the network gives only zeros), `tolerance`, `batches`, `seed`, `onnxruntime` (its version); if
        the network finds headings, `orientation`: the first three for the orientation parts.

    Raises:
        FormatError: a file that onnxruntime cannot run.
        SiamlocError: a difference above the tolerance, or values that are not finite.
    """
    import onnxruntime

    network = on_cpu(network)
    session = session_of(path)
    graph, outputs = _graph(network)
    rows, columns = session.get_inputs()[0].shape[2:]
    generator = np.random.default_rng(seed)
    difference, value = np.zeros(len(outputs)), np.zeros(len(outputs))
    with evaluating(graph):
        for batch in batches:
            images = generator.integers(0, 256, (batch, 3, rows, columns), dtype=np.uint8)
            expected = [one.numpy() for one in graph(torch.from_numpy(images))]
            got = session.run(None, {INPUT: images})
            shapes = [[one.shape for one in given] for given in (got, expected)]
            if shapes[0] != shapes[1]:
                said = [" and ".join(map(str, given)) for given in shapes]
                raise SiamlocError(f"{path} gives descriptors of shape {said[0]} instead of {said[1]}: do not use it")
            # np.maximum propagates NaN, while the built-in max may drop it.
            apart = [np.abs(one - other).max() for one, other in zip(got, expected, strict=True)]
            difference = np.maximum(difference, apart)
            value = np.maximum(value, [np.abs(one).max() for one in expected])
    reports = []
    for name, most, largest in zip(outputs, difference.tolist(), value.tolist(), strict=True):
        relative = most / largest if largest > 0 else most
        if not most <= tolerance * max(1.0, largest):
            raise SiamlocError(
                f"the {_WORDS[name]} of {path} differ by {most:.3g} from the network's, {relative:.3g} of the largest "
                f"value {largest:.3g} (tolerance {tolerance:g}): do not use the file"
            )
        reports.append(
            {"max_abs_difference": most, "max_abs_value": largest, "max_relative_difference": relative},
        )
    return {
        **reports[0],
        "tolerance": tolerance,
        "batches": list(batches),
        "seed": seed,
        "onnxruntime": onnxruntime.__version__,
        **dict(zip(outputs[1:], reports[1:], strict=True)),
    }


class _FromPixels(nn.Module):
    """A network as the graph of its file: from pixels to the descriptor, and to the orientation part if it has one."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, panorama: torch.Tensor) -> tuple[torch.Tensor, ...]:
        images = panorama.to(torch.float32) / 255  # the input of networks everywhere
        oriented = orienting(self.network)
        return (self.network(images),) if oriented is None else oriented.with_orientation(images)


def _graph(network: nn.Module) -> tuple[nn.Module, tuple[str, ...]]:
    """Return the module to export for a network, and the names of its outputs."""
    return _FromPixels(network), (OUTPUT,) if orienting(network) is None else (OUTPUT, HEADING_OUTPUT)


def on_cpu(network: nn.Module) -> nn.Module:
    """Return a network on the CPU: itself, or a copy.

    Raises:
        ConfigError: weights that are not float32.
    """
    network = network_of(network)
    types = {tensor.dtype for tensor in network.parameters()}
    if not types <= {torch.float32}:
        found = ", ".join(sorted(str(kind) for kind in types))
        raise ConfigError(f"export needs float32 weights, got {found}: call .float() on the network first")
    if {tensor.device.type for tensor in network.parameters()} <= {"cpu"}:
        return network
    return copy.deepcopy(network).cpu()
