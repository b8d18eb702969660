"""Check what a bundle is to be made from, before anything is written."""

from __future__ import annotations

import os.path
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analytic import Descriptor, Fused
from foundation.files import older_folder, plain, real_path
from siamloc.data.decoding import Preprocessing
from siamloc.data.frames import FrameTable, check_units
from siamloc.errors import ConfigError, FormatError
from siamloc.maps import Built, CoarseLayer, HierarchicalSearch, LayerSearch, VisualMap
from siamloc.maps.heading import is_analytic
from siamloc.maps.history import UPKEEP
from siamloc.runtime import bundle as files
from siamloc.runtime.collecting import SINCE

if TYPE_CHECKING:
    from siamloc.data.library import PanoramaLibrary
    from siamloc.maps import ErrorModel, Refinement


def check_replaceable(path: Path) -> None:
    """Check that the path does not exist, or is an empty folder, or holds an older bundle and nothing else.

    A mount point cannot be replaced, even if it is empty.
    """
    if not path.exists():
        return
    if not path.is_dir():
        raise ConfigError(f"{path} is a file: name a folder for the bundle")
    if os.path.ismount(real_path(path)):
        raise ConfigError(f"{path} is a mount point, which a bundle cannot replace: mount the folder above it")
    names = {file.name for file in path.iterdir()}
    others = sorted(names - {files.DESCRIPTION, *files.PARTS})
    if others or (names and files.DESCRIPTION not in names):
        raise ConfigError(
            f"{path} holds other files, such as {(others or sorted(names))[0]}, and a bundle replaces all of it: "
            "move them elsewhere, or name another folder"
        )


def check_not_updated(path: Path) -> None:
    """Check that the saved map in this path, if any, was not updated; one of another version counts as not updated.

    Raises:
        ConfigError: what updates changed would be lost.
    """
    with suppress(FormatError):
        if path.is_file() and UPKEEP in VisualMap.load(path).made:
            raise ConfigError(
                f"{path} holds what updates added and counted, which a new map would lose: move the file away first"
            )


def check_counted(path: Path, known: VisualMap | None) -> None:
    """Check that a new map counts all drives by which robots updated the map of the bundle in this path, if any.

    A bundle that a killed update left beside this path counts as well.

    Raises:
        ConfigError: what these drives changed would be lost.
    """
    older = None if path.exists() else older_folder(path)
    try:
        held = VisualMap.load((older or path) / files.MAP)
    except FormatError:
        return
    drives, counted = (one.made.get(UPKEEP, {}).get("drives", []) if one is not None else [] for one in (held, known))
    # Drives of other updates are in the user's hands, who may make the map from them anew.
    if lost := [drive for drive in drives if SINCE in drive and drive not in counted]:
        back = "" if older is None else f"rename that folder to {path.name}, "
        raise ConfigError(
            f"robots updated the map in {older or path} by drives that the new one lacks, {len(lost)} of them, the "
            f"last is {lost[-1]}: {back}name another folder, or replace it with overwrite=true and update the new one "
            "by what robots collected"
        )


def described_alike(
    descriptor: Descriptor, known: VisualMap | None, preprocessing: Preprocessing | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the descriptor's identity and how panoramas are made.

    Raises:
        ConfigError: a robot cannot compute the descriptor, or the map's images were described or made otherwise.
    """
    network = network_in(descriptor)
    for one in descriptor.parts.values() if isinstance(descriptor, Fused) else [descriptor]:
        if one is not network and not is_analytic(one.identity):
            raise ConfigError(
                f"only networks and the descriptors in analytic.DESCRIPTORS can be exported, not {one.name}: write it "
                "as a torch.nn.Module (B, 3, H, W) -> (B, D), which is a network"
            )
    if (network is None or isinstance(descriptor, Fused)) and known is None:
        raise ConfigError(
            f"a bundle by {descriptor.name} needs a map: run `siamloc map descriptor={descriptor.name}` first"
        )
    identity = plain(descriptor.identity)
    held = None if known is None else known.identity.get("images")
    if preprocessing is None and held is None:
        raise ConfigError(
            "without a map that records how its panoramas are made, the bundle cannot know it: give "
            "preprocessing=images.preprocessing"
        )
    parameters = plain(held if preprocessing is None else preprocessing.parameters())
    if known is not None:
        known.check_descriptor({**identity, "images": parameters} if held is not None else identity)
    return identity, parameters


def network_in(descriptor: Descriptor) -> Any:
    """Return the descriptor itself if it is a network, or the part of a fused one that is; None if there is none.

    Raises:
        ConfigError: several parts are networks.
    """
    parts = descriptor.parts if isinstance(descriptor, Fused) else {descriptor.name: descriptor}
    networks = {name: one for name, one in parts.items() if getattr(one, "module", None) is not None}
    if len(networks) > 1:
        raise ConfigError(f"a bundle holds one network, and {' and '.join(networks)} are networks: fuse one of them")
    return next(iter(networks.values()), None)


def check_learned(known: VisualMap | None, errors: ErrorModel | None, refinement: Refinement | None) -> None:
    """Check that errors and refinement were learned on the map, and fit together."""
    from siamloc.maps.refinement import check_compares

    for part in (errors, refinement):
        if part is not None and (known is None or not part.learned_on(known)):
            raise ConfigError(f"the {part.NOUN} was learned on another map than the bundle's: learn it again")
    if known is not None and refinement is not None and refinement.method == "relative":
        check_compares(known)
    method = "none" if refinement is None else refinement.method
    if errors is not None and errors.refine != method:
        raise ConfigError(
            f"the error model is for poses with refine={errors.refine}, but the robot makes them with refine={method}: "
            "give errors and refinement of the same evaluation, of task.error_model=true and task.refine, repeated if "
            "it is older"
        )


def checked_layer(
    known: VisualMap | None, layer: CoarseLayer | Built, coarse: VisualMap | None, search: LayerSearch
) -> CoarseLayer:
    """Return the nodes, after checking that a robot can search them first."""
    if known is None:
        raise ConfigError("a coarse layer needs the map that it was built over: give the map")
    if coarse is not None and not is_analytic(coarse.identity):
        raise ConfigError("on the robot, nodes are ranked by the map itself or by an analytic descriptor")
    return HierarchicalSearch(known, layer, coarse=coarse, settings=search).layer


def check_given(
    given: Descriptor,
    known: VisualMap | None,
    images: PanoramaLibrary | None,
    thumbnails: bool,
    precision: str,
    validation: FrameTable | None,
) -> None:
    """Check that thumbnails and precision have the data they are made from."""
    if known is None:
        if thumbnails or precision != "float32":
            raise ConfigError(f"without a map there are neither pictures of it nor precision={precision}: give the map")
        return
    learns = precision == "auto" or (precision == "int8" and network_in(given) is not None)
    if images is None and (thumbnails or learns):
        what = "a bundle with pictures of the map" if thumbnails else f"precision={precision}"
        raise ConfigError(f"{what} needs the panoramas of the map's frames: give images=")
    if images is not None:
        known.check_images(images.preprocessing.parameters(), images.preprocessing.size)
    if precision != "auto":
        return
    if validation is None or not (validation.has_position.any() and known.frames.has_position.any()):
        raise ConfigError(
            "precision=auto compares localization errors: give frames with positions as validation=, and a map with "
            "positions"
        )
    check_units([known.frames, validation])
