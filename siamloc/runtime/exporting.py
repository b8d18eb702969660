"""`export`: what the robot needs, written as a bundle and compared with what it was made of."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from siamloc.data.decoding import Preprocessing
from siamloc.errors import ConfigError, FormatError, SiamlocError
from siamloc.files import atomic_folder, atomic_path, file_hash, plain, scratch_folder, write_json
from siamloc.runtime.bundle import (
    DESCRIPTION,
    ERRORS,
    FORMAT,
    HEADING,
    MAP,
    MODEL,
    PARTS,
    REFINEMENT,
    RELATIVE,
    VERSION,
    Bundle,
)
from siamloc.runtime.localizer import Localizer
from siamloc.runtime.parts import Archive

if TYPE_CHECKING:
    from torch import nn

    from analytic import Descriptor
    from siamloc.maps import ErrorModel, Refinement, VisualMap

_TRIED = 3  # panoramas that a bundle has to describe as the network does


def export(
    network: nn.Module | Descriptor,
    known: VisualMap | None,
    folder: str | Path,
    *,
    errors: ErrorModel | None = None,
    refinement: Refinement | None = None,
    preprocessing: Preprocessing | None = None,
) -> Bundle:
    """Write network and map as a bundle for the robot, whose `Localizer` needs no torch.

    An older bundle in the same folder is replaced only when the new one is whole.

    Args:
        network: what describes images: a module (B, 3, H, W) -> (B, D), or `siamloc.models.as_descriptor` of one.
        known: its map; None for a bundle that only describes images. If the map has a heading part, the robot gets
            headings.
        folder: where to; a name that ends in .zip becomes one archive.
        errors: the model of the expected error, learned on this map; None if there is none.
        refinement: how poses are made finer than the map, learned on this map, such as `Result.refinement`; None for
            the poses of the nearest map frames.
        preprocessing: how images become panoramas (`images.preprocessing`); the map's if None.

    Returns:
        The opened bundle; `parity` says how far the exported network is from the original.

    Raises:
        ConfigError: the folder holds other files than a bundle's, the map is another network's, the error model or the
            refinement was learned on another map, a network that does not compare is to refine, panoramas that cannot
            be made from plain values, or what cannot be exported.
        SiamlocError: the exported network differs from the original.
        StorageError: the disk is full or refuses.
    """
    from siamloc.maps.refinement import check_compares
    from siamloc.models import as_descriptor
    from siamloc.runtime.onnx_model import export_heading, export_onnx
    from siamloc.runtime.onnx_relative import export_relative

    folder, descriptor = Path(folder).absolute(), as_descriptor(network)
    _check_replaceable(folder)
    module = getattr(descriptor, "module", None)
    if module is None:
        raise ConfigError(f"only a network can be exported, not {descriptor.name}")
    identity, parameters = _described_alike(descriptor, known, preprocessing)
    if errors is not None and (known is None or not errors.learned_on(known)):
        raise ConfigError("the error model was learned on another map than the bundle's: learn it again")
    if refinement is not None and (known is None or not refinement.learned_on(known)):
        raise ConfigError("how poses are refined was learned on another map than the bundle's: evaluate again")
    compares = refinement is not None and refinement.method == "relative"
    if known is not None and compares:
        check_compares(known)
    method = "none" if refinement is None else refinement.method
    if errors is not None and errors.refine != method:
        raise ConfigError(
            f"the error model expects errors of poses with refine={errors.refine}, and the robot makes them with "
            f"refine={method}: give errors and refinement of one evaluation, made anew where it is older"
        )
    image_size = (parameters["height"], parameters["width"])
    with _written(folder) as fresh:
        exported = export_onnx(module, fresh / MODEL, image_size)
        files, heading = list(exported["files"]), None
        if known is not None:
            known.save(fresh / MAP)
            files.append(MAP)
        if known is not None and known.heading is not None and known.heading.own:
            heading = {"identity": known.heading.identity, "parity": exported["parity"]["orientation"]}
        elif known is not None and known.heading is not None:
            parity = export_heading(known.heading.descriptor, fresh / HEADING, image_size)
            heading = {"identity": known.heading.identity, "parity": parity}
            files.append(HEADING)
        if errors is not None:
            errors.save(fresh / ERRORS)
            files.append(ERRORS)
        finer: dict[str, Any] | None = None
        if refinement is not None:
            refinement.save(fresh / REFINEMENT)
            files.append(REFINEMENT)
            finer = {"method": refinement.method, "neighbours": refinement.neighbours}
        if finer is not None and finer["method"] == "relative":
            finer["parity"] = export_relative(module, fresh / RELATIVE)
            files.append(RELATIVE)
        about = {
            "format": FORMAT,
            "version": VERSION,
            "preprocessing": parameters,
            "identity": identity,
            "unit": None if known is None else known.unit,
            "parity": exported["parity"],
            "heading": heading,
            "errors": None if errors is None else errors.as_dict(),
            "refinement": finer,
            "sha256": {file: file_hash(fresh / file) for file in files},
        }
        write_json(fresh / DESCRIPTION, about)
        if known is not None:
            _check_alike(fresh, descriptor, known)
    return Bundle.open(folder)


@contextmanager
def _written(path: Path) -> Iterator[Path]:
    """Yield a folder to fill, which becomes the bundle: a folder or an archive."""
    if path.suffix != ".zip":
        with atomic_folder(path) as fresh:
            yield fresh
        return
    with scratch_folder(path) as fresh:
        yield fresh
        with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
            for file in sorted(fresh.iterdir()):
                # A fixed date keeps the archive a function of what it holds; weights and descriptors do not shrink.
                entry = zipfile.ZipInfo(file.name, date_time=(1980, 1, 1, 0, 0, 0))
                with archive.open(entry, "w", force_zip64=True) as member, file.open("rb") as held:
                    shutil.copyfileobj(held, member, 1 << 20)


def _check_alike(folder: Path, descriptor: Descriptor, known: VisualMap) -> None:
    """Open what was written as the robot does, and compare it with the network and its map.

    Raises:
        SiamlocError: it describes a panorama in another way, or finds another map frame.
    """
    from siamloc.runtime.onnx_model import TOLERANCE

    localizer = Localizer(folder)
    rows, columns = localizer.bundle.image_size
    panoramas = np.random.default_rng(0).integers(0, 256, (_TRIED, 3, rows, columns), dtype=np.uint8)
    expected = descriptor.describe(panoramas).position
    got = np.concatenate([localizer.describe_panorama(one).position for one in panoramas])
    apart, norm = np.linalg.norm(got - expected, axis=1), np.linalg.norm(expected, axis=1)
    if not (apart <= TOLERANCE * np.maximum(norm, 1.0)).all():
        raise SiamlocError(
            f"the bundle describes panoramas {apart.max():.3g} away from the network, whose descriptors have length "
            f"{norm.max():.3g}: do not use it"
        )
    wanted, found = known.search(expected), localizer.map.search(expected)
    if not np.array_equal(wanted.indices, found.indices):
        raise SiamlocError("the bundle's map gives other frames than the map it was made of: do not use it")


def _described_alike(
    descriptor: Descriptor, known: VisualMap | None, preprocessing: Preprocessing | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the network's identity and how panoramas are made, after making sure that the map's are the same."""
    identity = plain(descriptor.identity)
    held = None if known is None else known.identity.get("images")
    if preprocessing is None and held is None:
        raise ConfigError(
            "without a map that says how its panoramas are made, a bundle needs to be told: give "
            "preprocessing=images.preprocessing"
        )
    parameters = plain(held if preprocessing is None else preprocessing.parameters())
    if known is not None:
        known.check_describer({**identity, "images": parameters} if held is not None else identity)
    Preprocessing.of(parameters)  # a camera of one's own cannot be made from plain values, and is an error here
    return identity, parameters


def _check_replaceable(path: Path) -> None:
    """Make sure that the path is not there yet, or an empty folder, or an older bundle and nothing else."""
    if not path.exists():
        return
    if path.is_file() and path.suffix == ".zip":
        try:
            Archive(path, {DESCRIPTION, *PARTS}, DESCRIPTION)
        except FormatError as error:
            raise ConfigError(f"{path} is something else than a bundle: name another file") from error
        return
    if not path.is_dir() or path.suffix == ".zip":
        what = "a folder" if path.is_dir() else "a file"
        raise ConfigError(f"{path} is {what}: name another folder, or an archive .zip, for the bundle")
    names = {file.name for file in path.iterdir()}
    others = sorted(names - {DESCRIPTION, *PARTS})
    if others or (names and DESCRIPTION not in names):
        raise ConfigError(f"{path} holds other files, such as {(others or sorted(names))[0]}: name a folder of its own")
