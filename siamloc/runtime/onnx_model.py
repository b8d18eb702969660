"""Write networks as ONNX files, each compared with its network before it gets its final name."""

from __future__ import annotations

import copy
import json
import logging
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from augment.base import on_host
from foundation.calls import typed
from foundation.files import atomic_path
from siamloc.errors import ConfigError, SiamlocError
from siamloc.maps.refinement import OUTPUTS
from siamloc.models.describing import (
    NetworkDescriptor,
    describing,
    evaluating,
    identity_of,
    network_of,
    orienting,
    required_comparing,
)
from siamloc.models.orientation import VALUES
from siamloc.models.relative import RelativePose
from siamloc.runtime.describing import session_of

FORMAT, FORMAT_OF_RELATIVE, FORMAT_VERSION = "siamloc-network", "siamloc-relative", 2
OPSET = 20
INPUT, OUTPUT, HEADING_OUTPUT = "panorama", "descriptor", "orientation"
RELATIVE_INPUTS = ("query", "known")
TOLERANCE, RELATIVE_TOLERANCE, ORIENTATION_TOLERANCE = 1e-4, 1e-3, 1e-2
MOST_BYTES = 2**31 - 2**24  # protobuf is limited to 2 GiB, and the graph needs a little of that
_BATCHES, _SEED = (1, 2, 7), 0  # numbers of random images, or pairs of parts, that a comparison tries
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
        path: path of the file; its folder is created if needed.
        image_size: (H, W) in pixels.

    Returns:
        What `parity` returns.

    Raises:
        ConfigError: weights that are not float32 or take 2 GB or more.
        DataError: an image size that does not suit the network, or descriptors that depend on more than their image.
        SiamlocError: the file's descriptors differ from the network's.
        StorageError: the disk is full or cannot be written to.
    """
    network = on_cpu(network)
    graph = _FromPixels(network)
    example = torch.zeros(2, 3, int(image_size[0]), int(image_size[1]), dtype=torch.uint8)
    NetworkDescriptor(network).describe(example)  # a wrong size fails here, with the network's own message
    if sum(tensor.nbytes for tensor in network.state_dict().values()) >= MOST_BYTES:
        raise ConfigError("a network of 2 GB or more does not fit into an ONNX file: export a smaller one")
    with _written(path, graph, {INPUT: example}, graph.outputs, FORMAT, identity_of(network)) as temporary:
        return parity(network, temporary)


@typed
def parity(network: nn.Module, path: str | Path) -> dict[str, Any]:
    """Compare an ONNX file, run by onnxruntime on the CPU, with its network on random images.

    Both compute in float32 but sum the same products in a different order, so they differ by rounding errors that grow
    with the values: the tolerance applies to the difference itself if the largest value is at most 1, and to the
    difference divided by the largest value if that is above 1. An absolute bound alone would reject correct files of
    networks with large values; a relative one alone would let a network near 0 pass with any direction.

    Orientation parts are what varies over the columns, scaled to a mean square of 1: where features vary little, the
    scale makes their rounding errors large as well. Their tolerance is wider, and absolute: a correlation between parts
    changes by no more than the values do, so that headings stay the same.

    Args:
        network: in any mode; it is compared in evaluation mode and keeps its mode.
        path: path of the ONNX file.

    Returns:
        `max_abs_difference`, `max_abs_value`, `max_relative_difference` (the first over the second, or the
        first itself if the network gives only zeros), `tolerance`, `batches`, `seed`, `onnxruntime` (its version); if
        the network finds headings, `orientation`: the first three for the orientation parts.

    Raises:
        FormatError: a file that onnxruntime cannot run.
        SiamlocError: a difference above the tolerance, or values that are not finite.
    """
    graph, session, generator = _FromPixels(on_cpu(network)), session_of(path), np.random.default_rng(_SEED)
    size = session.get_inputs()[0].shape[2:]
    drawn = ({INPUT: generator.integers(0, 256, (batch, 3, *size), dtype=np.uint8)} for batch in _BATCHES)
    apart, values = (found.max(axis=0).tolist() for found in _differences(graph, session, path, drawn))
    reports = {}
    for name, most, largest in zip(graph.outputs, apart, values, strict=True):
        relative = most / largest if largest > 0 else most
        tolerance = TOLERANCE if name == OUTPUT else ORIENTATION_TOLERANCE
        if not most <= tolerance * (max(1.0, largest) if name == OUTPUT else 1.0):
            raise SiamlocError(
                f"the {_WORDS[name]} of {path} differ by {most:.3g} from the network's, {relative:.3g} of the largest "
                f"value {largest:.3g} (tolerance {tolerance:g}): do not use the file"
            )
        reports[name] = {"max_abs_difference": most, "max_abs_value": largest, "max_relative_difference": relative}
    return {**reports.pop(OUTPUT), **_conditions(TOLERANCE), **reports}


@on_host()
def export_relative(network: nn.Module, path: str | Path) -> dict[str, Any]:
    """Write a network's comparing part, see `siamloc.models.relative.RelativePose`, as an ONNX file.

    The file takes orientation parts `query` and `known` (B, K, F), where B is free, and gives `pose` (B, 3),
    `information` (B, 3, 3) and `match` (B,). It gets its final name only after `relative_parity` has passed.

    Args:
        network: built with relative=True; its weights must be float32.
        path: path of the file; its folder is created if needed.

    Returns:
        What `relative_parity` returns.

    Raises:
        ConfigError: a network that does not compare, or weights that are not float32.
        SiamlocError: the file gives different poses.
        StorageError: the disk is full or cannot be written to.
    """
    network = on_cpu(network)
    relative = required_comparing(network)
    example = {name: torch.zeros(2, relative.columns, VALUES) for name in RELATIVE_INPUTS}
    identity = identity_of(network)
    with _written(path, _Compared(relative), example, OUTPUTS, FORMAT_OF_RELATIVE, identity) as temporary:
        return relative_parity(network, temporary)


def relative_parity(network: nn.Module, path: str | Path) -> dict[str, Any]:
    """Compare an ONNX file, run by onnxruntime on the CPU, with its network, on random parts, rotated and disturbed.

    Args:
        network: the network that was exported.
        path: path of the ONNX file.

    Returns:
        `max_relative_difference` (each output's relative to its largest value), `tolerance`, `batches`, `seed`,
        `onnxruntime` (its version).

    Raises:
        ConfigError: a network that does not compare.
        FormatError: a file that onnxruntime cannot run.
        SiamlocError: a difference above the tolerance, or values that are not finite.
    """
    relative, session = required_comparing(on_cpu(network)), session_of(path)
    generator = np.random.default_rng(_SEED)

    def drawn() -> Iterator[dict[str, NDArray[Any]]]:
        for batch in _BATCHES:
            known = generator.standard_normal((batch, relative.columns, VALUES), dtype=np.float32)
            noise = generator.standard_normal(known.shape, dtype=np.float32)
            query = np.roll(known, int(generator.integers(relative.columns)), axis=1) + noise / 2
            yield dict(zip(RELATIVE_INPUTS, (query, known), strict=True))

    apart, values = _differences(_Compared(relative), session, path, drawn())
    largest = float((apart / values).max())
    if not largest <= RELATIVE_TOLERANCE:
        raise SiamlocError(
            f"the poses that {path} gives differ by {largest:.3g} of the largest value from those that the network "
            f"gives (tolerance {RELATIVE_TOLERANCE:g}): do not use the file"
        )
    return {"max_relative_difference": largest, **_conditions(RELATIVE_TOLERANCE)}


def quantize(path: Path, panoramas: NDArray[np.uint8]) -> None:
    """Make the convolutions and fully connected layers of an ONNX file compute with 8-bit integers, in place.

    Args:
        path: path of the file.
        panoramas: (n, 3, H, W) from which the value ranges are taken.
    """
    from onnxruntime.quantization import CalibrationDataReader, QuantFormat, QuantType, quantize_static

    feeds = ({INPUT: panorama[None]} for panorama in panoramas)

    class Panoramas(CalibrationDataReader):  # type: ignore[misc]
        def get_next(self) -> dict[str, NDArray[np.uint8]] | None:
            return next(feeds, None)

    with atomic_path(path) as temporary, _quiet():
        quantize_static(
            str(path),
            str(temporary),
            Panoramas(),
            quant_format=QuantFormat.QDQ,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            op_types_to_quantize=["Conv", "Gemm"],
            per_channel=True,
            reduce_range=True,
        )


class _FromPixels(nn.Module):
    """A network as the graph of its file: from pixels to the descriptor, and to the orientation part if it has one."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network
        self.outputs = (OUTPUT,) if orienting(network) is None else (OUTPUT, HEADING_OUTPUT)

    def forward(self, panorama: torch.Tensor) -> tuple[torch.Tensor, ...]:
        images = panorama.to(torch.float32) / 255  # the input of networks everywhere
        return describing(self.network)(images)


class _Compared(nn.Module):
    """`RelativePose` with plain outputs."""

    def __init__(self, relative: RelativePose) -> None:
        super().__init__()
        self.relative = relative

    def forward(self, query: torch.Tensor, known: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return tuple(self.relative(query, known))[: len(OUTPUTS)]


@contextmanager
def _written(
    path: str | Path,
    graph: nn.Module,
    example: Mapping[str, torch.Tensor],
    outputs: Sequence[str],
    kind: str,
    identity: Mapping[str, Any],
) -> Iterator[Path]:
    """Write a module as an ONNX file, and yield a temporary path, which becomes `path` if the block has no error.

    Args:
        path: of the file.
        graph: the module, traced in evaluation mode; afterwards the mode of every part is restored.
        example: its arguments by name, in batches of two: a batch of one would be taken as constant.
        outputs: names of its outputs.
        kind: format of the file, for its metadata.
        identity: of the network, for the metadata.
    """
    batch = {0: torch.export.Dim("batch")}
    with evaluating(graph), torch.inference_mode(mode=False), torch.no_grad(), _quiet():
        program: Any = torch.onnx.export(
            graph,
            tuple(example.values()),
            dynamo=True,
            input_names=list(example),
            output_names=list(outputs),
            opset_version=OPSET,
            verbose=False,
            dynamic_shapes=tuple(batch for _ in example),
        )
    about = {"format": kind, "format_version": str(FORMAT_VERSION), "identity": json.dumps(identity, sort_keys=True)}
    program.model.metadata_props.update(about)
    for node in program.model.graph.all_nodes():
        node.metadata_props.clear()  # each would name lines of the source by their paths on this machine
    with atomic_path(path) as temporary:
        with _quiet():
            program.save(temporary, external_data=False)
        yield temporary


def _differences(
    graph: nn.Module, session: Any, path: str | Path, batches: Iterable[dict[str, NDArray[Any]]]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the largest difference between file and network, and the largest value, for each batch and output.

    Raises:
        SiamlocError: outputs of another shape.
    """
    apart, values = [], []
    with evaluating(graph):
        for given in batches:
            expected = [one.numpy() for one in graph(*map(torch.from_numpy, given.values()))]
            got = session.run(None, given)
            shapes = [" and ".join(str(one.shape) for one in several) for several in (got, expected)]
            if shapes[0] != shapes[1]:
                raise SiamlocError(f"{path} gives outputs of shape {shapes[0]} instead of {shapes[1]}: do not use it")
            apart.append([np.abs(one - other).max() for one, other in zip(got, expected, strict=True)])
            values.append([np.abs(one).max() for one in expected])
    return np.array(apart), np.array(values)


def _conditions(tolerance: float) -> dict[str, Any]:
    """Return the tolerance, the random images and the version of onnxruntime that a comparison used."""
    import onnxruntime

    return {"tolerance": tolerance, "batches": list(_BATCHES), "seed": _SEED, "onnxruntime": onnxruntime.__version__}


def on_cpu(network: nn.Module) -> nn.Module:
    """Return a network on the CPU: the network itself, or a copy if it is elsewhere.

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


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the exporter's deprecation warnings and progress lines, and the quantizer's advice, but not errors."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(before)
