"""`export`: write what the robot needs as a bundle, and compare it with the original."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from os.path import commonprefix
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from analytic import Descriptor, Fused
from foundation.calls import typed
from foundation.files import atomic_folder, file_hash, plain, read_json, write_json
from siamloc.data.decoding import Preprocessing
from siamloc.data.image_files import bits_of, size_of
from siamloc.data.reading import path_keys
from siamloc.errors import ConfigError, SiamlocError
from siamloc.maps import Built, CoarseLayer, LayerSearch, VisualMap, match
from siamloc.maps.comparing import comparison_of
from siamloc.maps.describing import descriptor_from
from siamloc.maps.heading import is_analytic, parts_of
from siamloc.maps.packing import PRECISIONS, Precision
from siamloc.runtime import bundle as files
from siamloc.runtime.bundle import Bundle
from siamloc.runtime.exportable import (
    check_counted,
    check_given,
    check_learned,
    check_replaceable,
    checked_layer,
    described_alike,
    network_in,
)
from siamloc.runtime.localizer import Localizer
from siamloc.runtime.own_camera import SampledCamera
from siamloc.runtime.precision import CALIBRATION, Measured, measured, smallest, spread
from siamloc.runtime.thumbnails import save_thumbnails

if TYPE_CHECKING:
    from torch import nn

    from siamloc.data.frames import FrameTable
    from siamloc.data.library import PanoramaLibrary
    from siamloc.maps import ErrorModel, Refinement

TOLERANCE = 1e-4
"""How far the robot's descriptor may be from the original, relative to its norm, or to 1 if the norm is smaller."""

_UNKNOWN = {"max_abs_difference": 0.0, "max_relative_difference": 0.0}
_PLACES = {"cache"}  # keys of data that name folders of this machine, besides those of its readers
_TRIED = 3  # number of panoramas that a bundle must describe as the original does


@typed
def export(
    described_by: nn.Module | Descriptor | str | Sequence[str | Descriptor],
    known: VisualMap | None,
    folder: str | Path,
    *,
    errors: ErrorModel | None = None,
    refinement: Refinement | None = None,
    layer: CoarseLayer | Built | None = None,
    coarse_map: VisualMap | None = None,
    search: LayerSearch | None = None,
    preprocessing: Preprocessing | None = None,
    images: PanoramaLibrary | None = None,
    thumbnails: bool = False,
    precision: Precision | Literal["auto"] = "float32",
    validation: FrameTable | None = None,
    figures: Mapping[str, Any] | None = None,
    overwrite: bool = False,
) -> Bundle:
    """Write a network or analytic descriptor and its map as a bundle for the robot, whose `Localizer` needs no torch.

    An older bundle in the same folder is replaced only once the new one is complete. A bundle names no folder of the
    machine that wrote it: the paths of its map frames start at the folder that all of them share.

    Args:
        described_by: the network or descriptor: a module (B, 3, H, W) -> (B, D), `siamloc.models.as_descriptor` of one,
            or an analytic descriptor, which the robot computes with numpy and OpenCV, or a fused one with a network at
            most; for the descriptor of the map its name, or the list of its parts, is enough, as for
            `siamloc.maps.build`.
        known: the descriptor's map; None for a network alone, which only describes images. If the map has heading
            parts, the robot gets headings.
        folder: where to write the bundle.
        errors: the model of the expected error, learned on this map; None for none.
        refinement: how poses are made finer than the map, learned on this map, such as `Result.refinement`; None for
            the poses of the nearest map frames.
        layer: nodes over the map, from `siamloc.maps.group`, which the robot searches first; None for none.
        coarse_map: a map of the same frames by the analytic descriptor that ranks the nodes; the map itself if None.
        search: how the nodes are ranked and searched; the defaults of `LayerSearch` if None.
        preprocessing: how images become panoramas (`images.preprocessing`); the map's if None.
        images: panoramas of the frames of the map and of `validation`.
        thumbnails: whether to include thumbnails of the map frames, made from `images`.
        precision: "float16" stores the map in half precision; "int8" stores it in one byte per number, and its network
            computes with integers, whose ranges are taken from the map's `images`; "auto" takes the smallest bundle
            that loses at most 2 % of the localization error on `validation`, see `siamloc.runtime.precision`.
        validation: frames with positions, for "auto".
        figures: results of the evaluation, plain values that `Bundle.about` returns; for reference only.
        overwrite: replace an older bundle even if drives updated its map that `known` does not count.

    Returns:
        The opened bundle; its `parity` gives how far its network is from the original, before any loss of precision.

    Raises:
        ConfigError: the folder holds files other than a bundle's, or a bundle whose map further drives updated, the map
            was made by another descriptor, something was learned on or built over another map, poses are to be refined
            by a network that does not compare, the camera is of a class that is not imported, required images are not
            given, or the descriptor cannot be exported.
        DataError: validation frames for "auto" whose positions are in another unit than the map's.
        SiamlocError: the bundle differs from the original.
        StorageError: the disk is full or cannot be written to.
    """
    folder = Path(folder).absolute()
    check_replaceable(folder)
    if not overwrite:
        check_counted(folder, known)
    held = {} if known is None else known.identity
    alone = list(parts_of(held).values()) or [held]
    analytic = [one for one in alone if is_analytic(one)]  # networks may wrap around or not
    circular = all(one.get("circular", True) for one in analytic or alone)
    given = descriptor_from(described_by, circular=circular, device=None)
    if isinstance(given, Fused) and known is not None:
        given = known.with_descriptor(given).descriptor  # with the weights of the map
    identity, parameters = described_alike(given, known, preprocessing)
    check_learned(known, errors, refinement)
    searched = None
    if layer is not None:
        searched = search or LayerSearch()
        layer = checked_layer(known, layer, coarse_map, searched)
    check_given(given, known, images, thumbnails, precision, validation)
    heading = None
    if known is not None and known.orientation is not None and known.heading_by.tells_heading:
        heading = {"identity": known.identity if known.heading is None else known.heading}
    about = {
        "format": files.FORMAT,
        "version": files.VERSION,
        "preprocessing": parameters,
        "identity": identity,
        "unit": None if known is None else known.unit,
        "heading": heading,
        "search": None if searched is None else searched.plain(),
        "figures": None if figures is None else plain(dict(figures)),
        "pictures": _pictures(parameters, known, images),
    }
    if (network := network_in(given)) is not None:
        from siamloc.models import as_descriptor
        from siamloc.runtime.onnx_model import on_cpu

        here = as_descriptor(on_cpu(network.module), None)  # as the robot computes
        if isinstance(given, Fused):
            parts = {name: here if one is network else one for name, one in given.parts.items()}
            given = replace(given, parts=parts)
        else:
            given = here
    known = None if known is None else replace(known, describes=given)
    camera = _own_camera(parameters, preprocessing, known, images)
    pieces: dict[str, Any] = {files.MAP: known, files.ERRORS: errors, files.REFINEMENT: refinement}
    pieces |= {files.LAYER: layer, files.COARSE: coarse_map, files.CAMERA: camera}
    made = _Ingredients(about, given, pieces, images, thumbnails)
    with atomic_folder(folder) as fresh:
        if precision == "auto":
            made.write_smallest(fresh, validation)
        else:
            made.write(fresh, precision)
    return Bundle.open(folder)


@dataclass(frozen=True)
class _Ingredients:
    """Everything a bundle is made from; `parts` are the objects that save themselves, by the names of their files."""

    about: dict[str, Any]
    given: Descriptor
    parts: dict[str, Any]
    images: Any
    thumbnails: bool

    def write(self, fresh: Path, precision: Precision) -> None:
        """Write the files of a bundle, and compare them with the original.

        Raises:
            SiamlocError: the bundle differs from the original.
        """
        module, known, finer = getattr(network_in(self.given), "module", None), self.parts[files.MAP], None
        if (refinement := self.parts[files.REFINEMENT]) is not None:
            finer = {"method": refinement.method, "neighbours": refinement.neighbours}
        moved = _portable(self.parts)
        errors = moved[files.ERRORS]
        about = {
            **self.about,
            "precision": precision,
            "refinement": finer,
            "errors": None if errors is None else errors.as_dict(),
        }
        if module is not None:
            about["parity"] = self._write_networks(module, fresh, precision, finer)
        for file, part in moved.items():
            if part is not None:
                part.save(fresh / file, *([precision] if isinstance(part, VisualMap) else []))
        if self.thumbnails and known is not None:
            save_thumbnails(fresh / files.THUMBNAILS, self.images, known.frames)
        about["sha256"] = {file: file_hash(fresh / file) for file in files.PARTS if (fresh / file).is_file()}
        write_json(fresh / files.DESCRIPTION, {"parity": _UNKNOWN, **about})  # to be opened, and compared
        if known is not None:
            apart = _check_alike(fresh, known, precision, self.images)
            if module is None or precision != "float32" or isinstance(self.given, Fused):
                write_json(fresh / files.DESCRIPTION, {**about, "parity": {**about.get("parity", {}), **apart}})

    def write_smallest(self, fresh: Path, frames: Any) -> None:
        """Write the smallest bundle whose localization error on frames grows by at most `LOSS`."""
        rows, (panoramas, asked) = list[Measured](), spread(self.images, frames.take(frames.has_position))
        for precision in PRECISIONS:
            (fresh / precision).mkdir()
            self.write(fresh / precision, precision)
            rows.append(measured(fresh / precision, self.given, panoramas, asked.xy))
        for file in (fresh / smallest(rows).precision).iterdir():
            file.replace(fresh / file.name)
        for precision in PRECISIONS:
            shutil.rmtree(fresh / precision)
        about = read_json(fresh / files.DESCRIPTION)
        write_json(fresh / files.DESCRIPTION, {**about, "precisions": [asdict(row) for row in rows]})

    def _write_networks(
        self, module: nn.Module, fresh: Path, precision: Precision, finer: dict[str, Any] | None
    ) -> dict[str, Any]:
        """Write the network, and its comparing part if the robot compares images by it; return the network's parity.

        Args:
            module: the network.
            fresh: the bundle's folder.
            precision: precision of the numbers.
            finer: the description of the refinement, to which the parity of the comparing part is added.
        """
        from siamloc.runtime.onnx_model import export_onnx, export_relative, quantize

        size = self.about["preprocessing"]["height"], self.about["preprocessing"]["width"]
        parity: dict[str, Any] = export_onnx(module, fresh / files.MODEL, size)
        known, refines = self.parts[files.MAP], finer is not None and finer["method"] == "relative"
        if refines or (known is not None and comparison_of(known) is not None):
            apart = export_relative(module, fresh / files.RELATIVE)
            if finer is not None and refines:
                finer["parity"] = apart
        if precision == "int8":
            quantize(fresh / files.MODEL, spread(self.images, self.parts[files.MAP].frames, CALIBRATION)[0])
        return parity


def _portable(parts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parts without the places of files on this machine.

    The paths of map frames start at the folder that all of them share.
    """
    moved = dict(parts)
    for file in (files.MAP, files.COARSE):
        if (known := parts[file]) is not None:
            paths = [Path(path).absolute().parts for path in known.frames.path.tolist()]
            shared = len(commonprefix([path[:-1] for path in paths]))  # noqa: RUF071 (of parts, not of letters)
            frames = known.frames.with_columns(path=["/".join(path[shared:]) for path in paths])
            data = {key: value for key, value in known.made.get("data", {}).items() if key not in _PLACES | path_keys()}
            made = {**known.made, **({"data": data} if "data" in known.made else {})}
            moved[file] = replace(known, frames=frames, made=made)
    for file in (files.ERRORS, files.REFINEMENT):
        if (learned := parts[file]) is not None:
            moved[file] = replace(learned, map_digest=moved[files.MAP].placed().digest)
    return moved


def _check_alike(
    folder: Path, known: VisualMap, precision: Precision, images: PanoramaLibrary | None
) -> dict[str, Any]:
    """Open the written bundle as the robot does, and compare it with the original.

    Lower precision changes the descriptors: then only the size of the change is reported, and the bundle has to work.
    In lower precision, panoramas of the map are compared if images are given, since value ranges are chosen for them;
    otherwise noise is.

    Returns:
        How far its descriptors are from the original's, in the form of `siamloc.runtime.parity`.

    Raises:
        SiamlocError: it describes a panorama differently, or finds another map frame.
    """
    localizer = Localizer(folder)
    rows, columns = localizer.bundle.image_size
    panoramas = np.random.default_rng(0).integers(0, 256, (_TRIED, 3, rows, columns), dtype=np.uint8)
    if precision != "float32" and images is not None:
        panoramas = spread(images, known.frames, _TRIED)[0]
    asked, answered = known.describe(panoramas), localizer.describe(panoramas)
    expected, got = asked.position, answered.position
    apart, norm = np.linalg.norm(got - expected, axis=1), np.linalg.norm(expected, axis=1)
    if not np.isfinite(got).all():
        raise SiamlocError(f"the bundle in {precision} gives descriptors that are not finite: use another precision")
    if precision == "float32":
        if not (apart <= TOLERANCE * np.maximum(norm, 1.0)).all():
            raise SiamlocError(
                f"the bundle describes panoramas {apart.max():.3g} away from the original, whose descriptors have "
                f"length {norm.max():.3g}: do not use it"
            )
        if not np.array_equal(match(known, asked, 1).indices, match(localizer.map, answered, 1).indices):
            raise SiamlocError("the bundle's map finds other frames than the map it was made from: do not use it")
    largest, most = float(np.abs(expected).max()), float(np.abs(got - expected).max())
    return {
        "max_abs_difference": most,
        "max_abs_value": largest,
        "max_relative_difference": most / largest if largest else most,
        "tolerance": TOLERANCE,
    }


def _own_camera(
    parameters: Mapping[str, Any], given: Preprocessing | None, known: VisualMap | None, images: PanoramaLibrary | None
) -> SampledCamera | None:
    """Return where the panorama's pixels lie in the pictures of a camera of the user's own; None for a built-in camera.

    Raises:
        ConfigError: the camera's class is not imported, or the size of its pictures is unknown.
    """
    given = images.preprocessing if given is None and images is not None else given
    made = Preprocessing.of(parameters) if given is None else given
    if made.camera is None or ":" not in parameters["camera"]["kind"]:
        return None
    if made.level:
        raise ConfigError(
            "unwrap.level=true needs a camera model that siamloc knows: the bundle holds only where the pixels of "
            "level panoramas lie in the pictures of a camera of your own"
        )
    tables = [one.frames for one in (images, known) if one is not None]
    size = next((size for frames in tables for path in frames.path[:1] if (size := size_of(path)) is not None), None)
    if size is None:
        raise ConfigError(
            "the bundle holds a camera of your own for pictures of one size, and no frame's picture can be read to "
            "know it from: give images="
        )
    return SampledCamera.of(made.camera, made.view, size)


def _pictures(parameters: Mapping[str, Any], known: VisualMap | None, images: PanoramaLibrary | None) -> dict[str, Any]:
    """Return what the robot's pictures must have in common with the map's, as far as map or files say it."""
    tables = [one.frames for one in (known, images) if one is not None]
    path = next((path for frames in tables for path in frames.path[:1].tolist() if Path(path).is_file()), None)
    size = None if known is None else known.made.get("size")
    if path is not None and size is None and ":" not in (parameters["camera"] or {}).get("kind", ""):
        size = Preprocessing.of(parameters).sized_by([path]).size
    return {"size": size, "bits": None if path is None else bits_of(path)}
