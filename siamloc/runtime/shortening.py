"""ONNX files of lower precision: weights in half precision, and layers that compute with integers."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from siamloc.errors import ConfigError
from siamloc.files import atomic_path

if TYPE_CHECKING:
    from onnx import GraphProto, NodeProto, TensorProto

_LAYERS = ["Conv", "Gemm"]
_WORTH = 4096  # smallest array worth shortening, in numbers
_PIECE = 1 << 19  # weights of a fully connected layer that are made float32 at once
_ROWS = 16  # a multiple of what a kernel computes at once, so that no piece leaves it half empty


def halve(path: Path) -> None:
    """Store the weights of an ONNX file in half precision, in place; it still computes in float32.

    Each layer's weights become float32 when the layer is reached, again for every image, so that a robot never holds
    all of them in float32. For that they are listed as optional inputs: onnxruntime would convert constants at startup
    and keep them. A large fully connected layer is split into several, each with some of the outputs, since in float32
    it alone could take more memory than all weights in half precision.

    Raises:
        ConfigError: a file of 2 GB or more, whose weights are in a separate file.
    """
    import onnx

    _check_one_file(path)
    model = onnx.load(path)
    _divide_layers(model.graph)
    _halve_weights(model.graph)
    with atomic_path(path) as temporary:
        onnx.save(model, temporary)


def quantize(path: Path, panoramas: NDArray[np.uint8]) -> None:
    """Make an ONNX file compute with 8-bit integers, in place; other large weights become half precision.

    Args:
        path: of the file.
        panoramas: (n, 3, H, W) from which the value ranges are taken.

    Raises:
        ConfigError: a file of 2 GB or more, whose weights are in a separate file.
    """
    from onnxruntime.quantization import QuantFormat, QuantType, quantize_static

    _check_one_file(path)
    with atomic_path(path) as temporary, _quiet():
        quantize_static(
            str(path),
            str(temporary),
            _Panoramas(panoramas),
            quant_format=QuantFormat.QDQ,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            op_types_to_quantize=_LAYERS,
            per_channel=True,
            reduce_range=True,
        )
    halve(path)


def _halve_weights(graph: GraphProto) -> None:
    """Replace large float32 weights with ones in half precision, cast to float32 where they are first used."""
    from onnx import helper, numpy_helper

    casts: dict[str, NodeProto] = {}
    kept, given = [], {one.name for one in graph.output}
    for tensor in graph.initializer:
        values = numpy_helper.to_array(tensor)
        # Vectors are biases, and scales of quantized values, which half precision would spoil.
        short = values.dtype != np.float32 or values.ndim < 2 or values.size < _WORTH or tensor.name in given
        if short or np.abs(values).max() >= np.finfo(np.float16).max:
            kept.append(tensor)
            continue
        name = f"{tensor.name} in half precision"  # no exporter gives a name with spaces
        kept.append(numpy_helper.from_array(values.astype(np.float16), name))
        graph.input.append(helper.make_tensor_value_info(name, kept[-1].data_type, values.shape))
        casts[tensor.name] = helper.make_node("Cast", [name], [tensor.name], to=tensor.data_type)
    nodes = []
    for node in graph.node:
        nodes += [casts.pop(name) for name in _names(node) if name in casts]
        nodes.append(node)
    _replace(graph, nodes, kept)


def _divide_layers(graph: GraphProto) -> None:
    """Split fully connected layers of more than `_PIECE` weights into ones with some of the outputs each."""
    from onnx import helper, numpy_helper

    weights = {tensor.name: tensor for tensor in graph.initializer}
    uses = Counter([*(name for node in graph.node for name in _names(node)), *(one.name for one in graph.output)])
    nodes = []
    for node in graph.node:
        # The weights (outputs, inputs) and the bias (outputs,), if any.
        names = [name for name in node.input[1:] if name]
        attributes = {one.name: helper.get_attribute_value(one) for one in node.attribute}
        own = all(name in weights and uses[name] == 1 for name in names)
        if node.op_type != "Gemm" or not attributes.get("transB") or not own:
            nodes.append(node)
            continue
        arrays = [numpy_helper.to_array(weights[name]) for name in names]
        outputs, inputs = arrays[0].shape
        step = max(_PIECE // inputs // _ROWS, 1) * _ROWS
        if outputs <= step or any(array.shape != (outputs,) for array in arrays[1:]):
            nodes.append(node)
            continue
        pieces = []
        for start in range(0, outputs, step):
            held = [f"{name} from {start}" for name in names]
            pieces.append(f"{node.output[0]} from {start}")
            nodes.append(helper.make_node("Gemm", [node.input[0], *held], pieces[-1:], **attributes))
            for name, array in zip(held, arrays, strict=True):
                weights[name] = numpy_helper.from_array(np.ascontiguousarray(array[start : start + step]), name)
        nodes.append(helper.make_node("Concat", pieces, [node.output[0]], axis=1))
        for name in names:
            del weights[name]
    _replace(graph, nodes, weights.values())


def _names(node: NodeProto) -> Iterator[str]:
    """Yield the names that a node uses, including those in its branches and loops."""
    yield from node.input
    for attribute in node.attribute:
        for graph in [attribute.g, *attribute.graphs]:
            for inner in graph.node:
                yield from _names(inner)


def _replace(graph: GraphProto, nodes: Iterable[NodeProto], weights: Iterable[TensorProto]) -> None:
    """Replace the nodes and weights of a graph."""
    nodes, weights = list(nodes), list(weights)
    del graph.node[:], graph.initializer[:]
    graph.node.extend(nodes)
    graph.initializer.extend(weights)


class _Panoramas:
    """Feeds a quantizer one panorama after the other."""

    def __init__(self, panoramas: NDArray[np.uint8]) -> None:
        self._left = iter(panoramas)

    def __iter__(self) -> _Panoramas:
        return self

    def __next__(self) -> dict[str, NDArray[np.uint8]]:
        return {"panorama": next(self._left)[None]}

    def get_next(self) -> dict[str, NDArray[np.uint8]] | None:
        return next(self, None)


def _check_one_file(path: Path) -> None:
    if path.with_name(f"{path.name}.data").exists():
        raise ConfigError(
            "a network of 2 GB or more cannot be stored in lower precision: export it with precision=float32"
        )


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the quantizer's advice, which goes to the root logger."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)
    try:
        yield
    finally:
        logging.disable(before)
