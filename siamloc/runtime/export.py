"""Exporting a network to ONNX, and showing that the exported file computes the same."""

from __future__ import annotations

import copy
import json
import logging
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from siamloc.errors import ConfigError, FormatError, SiamlocError
from siamloc.files import atomic_path, file_hash, storage_errors
from siamloc.models.describing import evaluating

FORMAT = "siamloc-network"
FORMAT_VERSION = 1
INPUT, OUTPUT = "panorama", "descriptor"
TOLERANCE = 1e-4
OPSET = 20
ONE_FILE_BYTES = 2**31 - 2**24  # protobuf ends at 2 GiB; the graph beside the weights takes a little


def export_onnx(network: nn.Module, path: str | Path, image_size: Sequence[int]) -> dict[str, Any]:
    """Write a network as an ONNX file and compare the file with the network.

    The file takes `panorama` (B, 3, H, W) float32 in [0, 1] and gives `descriptor` (B, D); B is free, and the
    normalization is inside. Its metadata hold the format, its version, and the network's identity as JSON. All is in
    one file, except that weights of 2 GB and more, which ONNX cannot hold, stand beside it in `<name>.data`. The
    file gets its name only after `parity` has passed, in evaluation mode; the network keeps its mode.

    Args:
        network: what `siamloc.models.build` makes, or a `SiameseModule`; its weights must be float32.
        path: of the file; its folder is made.
        image_size: (H, W) in pixels.

    Returns:
        `path`, `bytes`, `sha256`, `files` (names in the folder), `opset`, `identity`, and `parity` as `parity`
        returns it.

    Raises:
        ConfigError: weights that are not float32, or another image size than the network's.
        SiamlocError: the file's descriptors differ from the network's.
        StorageError: the disk refuses.
    """
    path = Path(path)
    network = _on_cpu(network)
    identity = getattr(network, "identity", None) or {"name": type(network).__name__}
    rows, columns = int(image_size[0]), int(image_size[1])
    program = _program(network, rows, columns)
    program.model.metadata_props.update(
        {"format": FORMAT, "format_version": str(FORMAT_VERSION), "identity": json.dumps(identity, sort_keys=True)}
    )
    size = sum(tensor.nbytes for tensor in network.state_dict().values())
    if size < ONE_FILE_BYTES:
        files = [path.name]
        with atomic_path(path) as temporary:
            with _quiet():
                program.save(temporary, external_data=False)
            report = parity(network, temporary)
    else:
        files = [path.name, f"{path.name}.data"]
        with storage_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            # The name of the weights' file stands in the graph, so both are written under their own names elsewhere.
            with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
                with _quiet():
                    program.save(Path(folder) / path.name, external_data=True)
                report = parity(network, Path(folder) / path.name)
                for name in reversed(files):
                    (Path(folder) / name).replace(path.with_name(name))
    return {
        "path": str(path),
        "bytes": sum(path.with_name(name).stat().st_size for name in files),
        "sha256": file_hash(path),
        "files": files,
        "opset": OPSET,
        "identity": identity,
        "parity": report,
    }


def parity(
    network: nn.Module,
    path: str | Path,
    *,
    batches: Sequence[int] = (1, 2, 7),
    seed: int = 0,
    tolerance: float = TOLERANCE,
) -> dict[str, Any]:
    """Compare an ONNX file, run by onnxruntime on the CPU, with its network on random images.

    Both compute in float32 and add up the same products in another order, so they differ by roundings that grow with
    the values: the tolerance holds for the difference itself where the largest value is at most 1, and for the
    difference over the largest value where that is above 1. An absolute bound alone would refuse right files of
    networks with large values, a relative one alone would let a network near 0 pass with any direction.

    Args:
        network: in any mode; it is compared in evaluation mode and keeps its own.
        path: of the ONNX file.
        batches: numbers of images to try.
        seed: of the random images.
        tolerance: largest difference allowed, relative to the largest value where that is above 1.

    Returns:
        `max_abs_difference`, `max_abs_value`, `max_relative_difference` (the first over the second, or the
        first itself where the network gives zeros only), `tolerance`, `batches`, `seed`, `onnxruntime` (its version).

    Raises:
        FormatError: a file that onnxruntime cannot run.
        SiamlocError: a difference above the tolerance, or values that are not finite.
    """
    import onnxruntime

    network = _on_cpu(network)
    session = _session(path)
    rows, columns = session.get_inputs()[0].shape[2:]
    generator = np.random.default_rng(seed)
    difference = value = 0.0
    with evaluating(network):
        for batch in batches:
            images = generator.random((batch, 3, rows, columns), dtype=np.float32)
            expected = network(torch.from_numpy(images)).numpy()
            got = session.run([OUTPUT], {INPUT: images})[0]
            if got.shape != expected.shape:
                raise SiamlocError(f"{path} gives descriptors of shape {got.shape} for {expected.shape}: do not use it")
            # np.maximum carries a NaN on, where the built-in max may drop it.
            difference = float(np.maximum(difference, np.abs(got - expected).max()))
            value = float(np.maximum(value, np.abs(expected).max()))
    relative = difference / value if value > 0 else difference
    if not difference <= tolerance * max(1.0, value):
        raise SiamlocError(
            f"the descriptors of {path} differ by {difference:.3g} from the network's, {relative:.3g} of the largest "
            f"value {value:.3g} (tolerance {tolerance:g}): do not use the file"
        )
    return {
        "max_abs_difference": difference,
        "max_abs_value": value,
        "max_relative_difference": relative,
        "tolerance": tolerance,
        "batches": list(batches),
        "seed": seed,
        "onnxruntime": onnxruntime.__version__,
    }


def _program(network: nn.Module, rows: int, columns: int) -> Any:
    example = torch.zeros(2, 3, rows, columns)  # an example of 1 would fix the batch to 1
    with evaluating(network):
        network(example)  # a wrong size fails here, in the network's own words
    training = [(part, part.training) for part in network.modules()]
    network.eval()
    try:
        with _quiet(), torch.no_grad():
            return torch.onnx.export(
                network,
                (example,),
                dynamo=True,
                input_names=[INPUT],
                output_names=[OUTPUT],
                dynamic_shapes=({0: torch.export.Dim("batch")},),
                opset_version=OPSET,
                verbose=False,
            )
    finally:
        for part, mode in training:
            part.training = mode


def _on_cpu(network: nn.Module) -> nn.Module:
    network = getattr(network, "network", network)  # of a SiameseModule
    types = {tensor.dtype for tensor in network.parameters()}
    if types != {torch.float32}:
        found = ", ".join(sorted(str(kind) for kind in types))
        raise ConfigError(f"export needs float32 weights, got {found}: call .float() on the network first")
    if {tensor.device.type for tensor in network.parameters()} == {"cpu"}:
        return network
    return copy.deepcopy(network).cpu()


def _session(path: str | Path) -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    try:
        return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's exceptions have no common base
        raise FormatError(f"{path} is no ONNX file that onnxruntime can run ({type(error).__name__})") from error


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the exporter's deprecation warnings and progress lines; its errors pass."""
    loggers = [logging.getLogger(name) for name in ("torch.onnx", "onnxscript", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
