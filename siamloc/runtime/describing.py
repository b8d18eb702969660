"""Describe images on the robot as the map's were described, with onnxruntime or with numpy and OpenCV."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic import AnalyticError, Description, Descriptor, Fused, ImageDescriptor
from siamloc.errors import ConfigError, FormatError, hint, logger
from siamloc.maps import VisualMap
from siamloc.maps.heading import descriptor_of
from siamloc.runtime.bundle import COARSE, MODEL, RELATIVE, Bundle

CPU = "CPUExecutionProvider"
PROVIDERS = ("CUDAExecutionProvider", "OpenVINOExecutionProvider", CPU)
"""Execution providers that are used without being asked for, in order of preference, where onnxruntime has them."""
# A network of one operation, y = max(x, 0): shows whether a provider works.
_SMALLEST = bytes.fromhex(
    "08083a330a0c0a0178120179220452656c751201675a0f0a0178120a0a08080112040a020802620f0a0179120a0a08080112040a02080242040a00"
    "1011"
)


def with_own_descriptor(
    bundle: Bundle, known: VisualMap, threads: int | None, providers: Sequence[str] | None
) -> tuple[VisualMap, _Network | None]:
    """Return the map of a bundle with the descriptor that made it, and the bundle's network, if it has one.

    Args:
        bundle: the bundle.
        known: the bundle's map.
        threads: number of onnxruntime threads; onnxruntime chooses if None.
        providers: onnxruntime's execution providers in order of preference; None as for `session_of`.

    Raises:
        ConfigError: a provider that this onnxruntime lacks.
        FormatError: a network that onnxruntime cannot run, or an analytic descriptor that did not make the map.
    """
    session, relative = (
        session_of(bundle.path / name, threads, providers) if name in bundle.files else None
        for name in (MODEL, RELATIVE)
    )
    own = known.orientation if known.heading is None else None  # else the parts are the heading's
    network = None if session is None else _Network(session, relative, known)
    by: Descriptor | None = network
    if by is None or known.identity.get("name") == Fused.name:
        by = analytic_descriptor(known.identity, bundle, known.width, own, network)
    if known.heading is not None and not known.heading_by_network:
        analytic_descriptor(known.heading, bundle, orientation=known.orientation)  # refuses another than the map's
    return replace(known, describes=by), network


class _Network(Descriptor):
    """The network of a bundle, which is its descriptor or a part of it; thread-safe."""

    name = "network"

    def __init__(self, session: Any, relative: Any, known: VisualMap) -> None:
        self.session, self._relative, self._known = session, relative, known

    @property
    def identity(self) -> dict[str, Any]:
        return self._known.identity

    @property
    def tells_heading(self) -> bool:
        return self._known.heading_by_network

    @property
    def compares(self) -> bool:
        """Whether it can estimate where one image was taken relative to another."""
        return self._relative is not None

    def describe(self, batch: Any) -> Description:
        position, *parts = self.session.run(None, {"panorama": batch})
        orientation = parts[0] if parts else None
        if orientation is not None and not np.isfinite(orientation).all():
            # onnxruntime sums in another order than torch and gets variances below 0 where there is no contrast.
            orientation = np.nan_to_num(orientation, nan=0.0, posinf=0.0, neginf=0.0)
        return Description(position, orientation)

    def compare(
        self, queries: NDArray[np.float32], known: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Estimate where n images were taken relative to n map frames, in the form that `Refinement` expects."""
        assert self._relative is not None
        pose, information, match = self._relative.run(None, {"query": queries, "known": known})
        return pose.astype(np.float64), information.astype(np.float64), match.astype(np.float64)


def working_providers() -> dict[str, bool]:
    """Try the execution providers of `PROVIDERS` that onnxruntime has, and return whether each one computes here.

    onnxruntime names all providers that it was built with, also those whose device or libraries are missing.

    Raises:
        ModuleNotFoundError: onnxruntime is not installed.

    Example:
        >>> working_providers()["CPUExecutionProvider"]
        True
    """
    import onnxruntime

    there = onnxruntime.get_available_providers()
    return {one: one in _session(_SMALLEST, None, (one,)).get_providers() for one in PROVIDERS if one in there}


def session_of(path: str | Path, threads: int | None = None, providers: Sequence[str] | None = (CPU,)) -> Any:
    """Open an ONNX file with onnxruntime, and warn if a provider does not work here.

    Args:
        path: path of the file.
        threads: number of threads; onnxruntime's own choice if None.
        providers: execution providers in order of preference; if None, those of `PROVIDERS` that onnxruntime has.

    Raises:
        ConfigError: a provider that this onnxruntime lacks, or a path that the locale of this process cannot show.
        FormatError: a file that onnxruntime cannot run.
    """
    import onnxruntime

    there = onnxruntime.get_available_providers()
    wanted = [one for one in PROVIDERS if one in there] if providers is None else list(providers)
    for provider in wanted:
        if provider not in there:
            raise ConfigError(f"this onnxruntime has no provider {provider!r}: {hint(provider, there)}")
    try:
        str(path).encode()  # as onnxruntime does
        session = _session(str(path), threads, wanted)
    except UnicodeEncodeError as error:
        raise ConfigError(f"the locale of this process lacks letters of {path}: set PYTHONUTF8=1") from error
    except Exception as error:  # onnxruntime's exceptions have no common base
        raise FormatError(
            f"{path} is not an ONNX file that onnxruntime can run ({type(error).__name__}): export again"
        ) from error
    used = session.get_providers()
    if lost := [one for one in wanted if one not in used]:
        logger.warning(
            "%s does not work here, and %s computes instead: `siamloc doctor` shows what works; providers=[%s] is "
            "without this warning", " and ".join(lost), " and ".join(used), ",".join(used)
        )  # fmt: skip
    return session


def _session(network: str | bytes, threads: int | None, providers: Sequence[str]) -> Any:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    options.enable_mem_pattern = False  # a block for all steps of an image costs memory and saves no time
    options.intra_op_num_threads = threads or 0
    return onnxruntime.InferenceSession(network, options, providers=list(providers))


def coarse_map(bundle: Bundle) -> VisualMap | None:
    """Load the map by which a bundle ranks its nodes, with its descriptor; None if the map of the robot ranks them.

    Raises:
        FormatError: as `analytic_descriptor`.
    """
    coarse: VisualMap | None = bundle.load(COARSE)
    if coarse is None:
        return None
    orientation = coarse.description.orientation
    return coarse.with_descriptor(analytic_descriptor(coarse.identity, bundle, coarse.width, orientation))


def analytic_descriptor(
    identity: Mapping[str, Any],
    bundle: Bundle,
    width: int | None = None,
    orientation: NDArray[Any] | None = None,
    network: Descriptor | None = None,
) -> Descriptor:
    """Return an analytic or fused descriptor, after checking that it made the map.

    Args:
        identity: name and parameters of the descriptor.
        bundle: the bundle whose panoramas it describes.
        width: length of the map's descriptors; not checked if None.
        orientation: (n, K, F, ...) the map's orientation parts; not checked if None.
        network: the network among the parts of a fused descriptor, if there is one.

    Raises:
        FormatError: an unknown descriptor, or one whose sizes differ from the map's: then it did not make the map, and
            could take any amount of memory.
    """
    try:
        made = descriptor_of(identity, network)
        parts, widths = (made.parts, made.widths) if isinstance(made, Fused) else ({"": made}, None)
        sizes = {name: one.sizes(*bundle.image_size) for name, one in parts.items() if isinstance(one, ImageDescriptor)}
    except (AnalyticError, TypeError) as error:
        raise FormatError(
            f"{bundle.path} describes images in a way unknown to this version of siamloc: {error}"
        ) from error
    # Tables hold some sizes in reverse order, so only their product is compared.
    lengths = {name: math.prod(given) for name, (given, _) in sizes.items()}
    lengths = {**(widths or {}), **lengths}  # the length of a network's part is known only from the map
    held = None if orientation is None else math.prod(orientation.shape[1:3])
    by = getattr(made, "oriented_by", made)  # a network has no sizes to compare
    turning = next((sizes[name][1] for name, one in parts.items() if one is by and name in sizes), ())
    fits = widths is None or lengths == dict(widths)
    if not fits or (width is not None and sum(lengths.values()) != width) or held not in (None, math.prod(turning)):
        raise FormatError(f"{bundle.path} holds a map whose sizes differ from those of its {made.name}: export again")
    return made
