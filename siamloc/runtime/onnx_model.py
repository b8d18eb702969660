"""Networks and heading descriptors as ONNX files, each compared with what it was made of before it gets its name."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from analytic import Description, Descriptor, ImageDescriptor
from siamloc.errors import ConfigError, SiamlocError
from siamloc.files import atomic_path, file_hash, scratch_folder
from siamloc.models.describing import evaluating, identity_of, network_of, orienting
from siamloc.models.network import Network
from siamloc.runtime.onnx_file import OPSET, label, quiet, session_of, traced

FORMAT, HEADING_FORMAT = "siamloc-network", "siamloc-heading"
INPUT, OUTPUT, HEADING_OUTPUT = "panorama", "descriptor", "orientation"
TOLERANCE, HEADING_TOLERANCE = 1e-4, 1e-3
ONE_FILE_BYTES = 2**31 - 2**24  # protobuf ends at 2 GiB; the graph next to the weights takes a little
_WORDS = {OUTPUT: "descriptors", HEADING_OUTPUT: "orientation parts"}
_HEADING_IMAGES = 4
_LUMA = (0.299, 0.587, 0.114)


def export_onnx(network: nn.Module, path: str | Path, image_size: Sequence[int]) -> dict[str, Any]:
    """Write a network as an ONNX file.

    The file takes `panorama` (B, 3, H, W) float32 in [0, 1] and gives `descriptor` (B, D), and `orientation` (B, K, F)
    where the network finds headings; B is free, and whatever normalization the network has is inside. Its metadata hold
    the format, its version, and the network's identity as JSON. All is in one file, except that weights of 2 GB and
    more, which ONNX cannot hold, lie next to it in `<name>.data`. The file gets its name only after `parity` has
    passed, in evaluation mode; the network keeps its mode.

    Args:
        network: (B, 3, H, W) -> (B, D), such as `siamloc.models.build` makes; its weights must be float32.
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
    network = on_cpu(network)
    identity = identity_of(network)
    rows, columns = int(image_size[0]), int(image_size[1])
    example = torch.zeros(2, 3, rows, columns)  # an example of 1 would fix the batch to 1
    with evaluating(network):
        network(example)  # a wrong size fails here, in the network's own words
    graph, outputs = _graph(network)
    program = traced(graph, (example,), [INPUT], outputs, free_batch=True)
    label(program, FORMAT, identity)
    size = sum(tensor.nbytes for tensor in network.state_dict().values())
    if size < ONE_FILE_BYTES:
        files = [path.name]
        with atomic_path(path) as temporary:
            with quiet():
                program.save(temporary, external_data=False)
            report = parity(network, temporary)
    else:
        files = [path.name, f"{path.name}.data"]
        # The graph names the weights' file, so both are written under their own names elsewhere.
        with scratch_folder(path) as folder:
            with quiet():
                program.save(folder / path.name, external_data=True)
            report = parity(network, folder / path.name)
            for name in reversed(files):
                (folder / name).replace(path.with_name(name))
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
        first itself where the network gives zeros only), `tolerance`, `batches`, `seed`, `onnxruntime` (its version);
        `orientation`, the first three of the orientation parts, where the network finds headings.

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
    with evaluating(network):
        for batch in batches:
            images = generator.random((batch, 3, rows, columns), dtype=np.float32)
            found = graph(torch.from_numpy(images))
            expected = [one.numpy() for one in (found if isinstance(found, tuple) else (found,))]
            got = session.run(None, {INPUT: images})
            shapes = [[one.shape for one in given] for given in (got, expected)]
            if shapes[0] != shapes[1]:
                said = [" and ".join(map(str, given)) for given in shapes]
                raise SiamlocError(f"{path} gives descriptors of shape {said[0]} for {said[1]}: do not use it")
            # np.maximum carries a NaN on, where the built-in max may drop it.
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


class _Both(nn.Module):
    """Descriptor and orientation part of a network that finds headings, as the graph of an ONNX file."""

    def __init__(self, network: Network) -> None:
        super().__init__()
        self.network = network

    def forward(self, panorama: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.network.with_orientation(panorama)


def _graph(network: nn.Module) -> tuple[nn.Module, tuple[str, ...]]:
    """Return what goes into the file of a network, and the names of what it gives."""
    if (oriented := orienting(network)) is not None:
        return _Both(oriented), (OUTPUT, HEADING_OUTPUT)
    return network, (OUTPUT,)


class _Orientation(nn.Module):
    """The orientation part of one panorama, as the graph of an ONNX file."""

    def __init__(self, descriptor: ImageDescriptor) -> None:
        super().__init__()
        self.descriptor = descriptor

    def forward(self, panorama: torch.Tensor) -> torch.Tensor:
        red, green, blue = panorama.unbind(1)
        grey = red * _LUMA[0] + green * _LUMA[1] + blue * _LUMA[2]
        return self.descriptor._describe(grey)[1]


def export_heading(descriptor: Descriptor, path: str | Path, image_size: Sequence[int]) -> dict[str, Any]:
    """Write the orientation part of an analytic descriptor as an ONNX file.

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
        SiamlocError: the file gives other headings.
        StorageError: the disk refuses.
    """
    rows, columns = int(image_size[0]), int(image_size[1])
    descriptor.describe(np.zeros((1, 3, rows, columns), dtype=np.uint8))  # a wrong size fails here
    refused = ConfigError(
        f"heading={descriptor.name} with these parameters cannot be exported for the robot: make the map again with "
        "`siamloc map heading=hog`"
    )
    if not isinstance(descriptor, ImageDescriptor) or descriptor.homomorphic:
        raise refused
    example, module = torch.zeros(1, 3, rows, columns), _Orientation(descriptor)
    with evaluating(module):
        found = module(example)  # fills the descriptor's caches with tensors that do not belong to the export
    if found.is_complex():
        raise refused
    try:
        program = traced(module, (example,), [INPUT], [HEADING_OUTPUT], free_batch=False)
    except Exception as error:  # the exporter's errors have no common base
        raise refused from error
    label(program, HEADING_FORMAT, descriptor.identity)
    with atomic_path(path) as temporary:
        with quiet():
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

    session = session_of(path)
    rows, columns = session.get_inputs()[0].shape[2:]
    generator = np.random.default_rng(seed)
    images = generator.integers(0, 256, (_HEADING_IMAGES, 3, rows, columns), dtype=np.uint8)
    turned = np.stack(
        [
            np.roll(image, turn, 2)
            for image, turn in zip(images, generator.integers(columns, size=_HEADING_IMAGES), strict=True)
        ]
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
    headings = descriptor.relative_heading(Description(expected.position, got), known)
    wrong = int((headings != descriptor.relative_heading(expected, known)).sum())
    if not mean <= HEADING_TOLERANCE or wrong:
        raise SiamlocError(
            f"the orientation parts of {path} differ from {descriptor.name}'s by {mean:.3g} of their mean (tolerance "
            f"{HEADING_TOLERANCE:g}), and {wrong} of {_HEADING_IMAGES} headings do: do not use the file"
        )
    return {
        "mean_relative_difference": mean,
        "max_abs_difference": float(apart.max()),
        "tolerance": HEADING_TOLERANCE,
        "headings": _HEADING_IMAGES,
        "seed": seed,
        "onnxruntime": onnxruntime.__version__,
    }


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
