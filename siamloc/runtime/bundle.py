"""The bundle: one folder with everything a robot needs, and its description in `bundle.json`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from siamloc.data.decoding import Preprocessing
from siamloc.errors import ConfigError, FormatError
from siamloc.files import atomic_folder, file_hash, plain, read_json, write_json

if TYPE_CHECKING:
    from torch import nn

    from analytic import Descriptor
    from siamloc.maps import ErrorModel, Refinement, VisualMap

FORMAT = "siamloc-bundle"
VERSION = 3
_DESCRIPTION = "bundle.json"
_MODEL = "model.onnx"
_MAP = "map.npz"
_HEADING = "heading.onnx"
_ERRORS = "error_model.json"
_REFINEMENT = "refinement.json"
_RELATIVE = "relative.onnx"
_FINER = {"interpolate": "between", "relative": "by comparison with"}
_KEYS = {"sha256": dict, "preprocessing": dict, "identity": dict, "parity": dict}


@dataclass(frozen=True, repr=False)
class Bundle:
    """An opened bundle; `siamloc.runtime.export` writes one.

    Attributes:
        folder: where it lies.
        about: what `bundle.json` holds: `preprocessing`, `identity` of the network, `parity` (how far the exported
            network is from the original), `heading` and `errors` (what gives them, None without), `refinement` (how
            poses are made finer than the map, None if they are not), `sha256` by file.
        preprocessing: how an image becomes a panorama.
    """

    folder: Path
    about: dict[str, Any]
    preprocessing: Preprocessing

    def __repr__(self) -> str:
        return f"Bundle({str(self.folder)!r}: {', '.join(self.about['sha256'])})"

    @property
    def image_size(self) -> tuple[int, int]:
        """Rows and columns of a panorama."""
        return self.preprocessing.view.height, self.preprocessing.view.width

    @property
    def identity(self) -> dict[str, Any]:
        """What decides a descriptor, network and preprocessing; the map carries the same."""
        return {**self.about["identity"], "images": self.about["preprocessing"]}

    @property
    def parity(self) -> dict[str, Any]:
        """How far the exported network is from the original; see `siamloc.runtime.parity`."""
        return dict(self.about["parity"])

    @property
    def model(self) -> Path:
        """The network, as ONNX."""
        return self.folder / _MODEL

    @property
    def map(self) -> Path | None:
        """The visual map; None for a bundle that only describes images."""
        return self._file(_MAP)

    @property
    def heading(self) -> Path | None:
        """What finds headings beside the network, as ONNX; None if there is none, or the network finds them."""
        return self._file(_HEADING)

    @property
    def errors(self) -> Path | None:
        """The model of the expected error; None if there is none."""
        return self._file(_ERRORS)

    @property
    def refinement(self) -> Path | None:
        """How poses are made finer than the map; None if they are not."""
        return self._file(_REFINEMENT)

    @property
    def relative(self) -> Path | None:
        """What compares a query with map frames, as ONNX; None if nothing does."""
        return self._file(_RELATIVE)

    def summary(self) -> str:
        """Say in two lines how exact the exported network is, and what the robot gets."""
        first = (
            f"bundle: {self.folder}; largest difference from the network {self.parity['max_abs_difference']:.1e}, "
            f"{self.parity['max_relative_difference']:.1e} of the largest value"
        )
        if self.map is None:
            return f"{first}\nthe robot gets descriptors alone: there is no map to locate images in"
        finer = self.about.get("refinement")
        how = "" if finer is None else f" ({_FINER[finer['method']]} {finer['neighbours']} map frames)"
        gets = [f"position{how}"]
        if self.about.get("heading") is not None:
            gets.append(f"heading (by {self.about['heading']['identity']['name']})")
        if self.errors is not None:
            lost = self.about["errors"].get("lost_above")
            gets.append("expected error" if lost is None else f"expected error (lost above {lost:g} {self._unit})")
        return f"{first}\nthe robot gets: {', '.join(gets)}"

    @classmethod
    def open(cls, folder: str | Path) -> Bundle:
        """Open a bundle and check that its files are the ones it was written with.

        Raises:
            FormatError: no bundle, of another version, or with files that are missing or altered.
        """
        folder = Path(folder)
        path = folder / _DESCRIPTION
        if not path.is_file():
            raise FormatError(f"{folder} is not a bundle, it holds no {_DESCRIPTION}: write one with `siamloc export`")
        about = read_json(path)
        if not isinstance(about, dict) or about.get("format") != FORMAT or not isinstance(about.get("version"), int):
            raise FormatError(f"{path} was not written by `siamloc export`: export again")
        if about["version"] > VERSION:
            raise FormatError(
                f"{folder} has bundle version {about['version']}, this siamloc reads version {VERSION}: update siamloc"
            )
        if about["version"] < VERSION:
            raise FormatError(
                f"{folder} has bundle version {about['version']}, this siamloc reads version {VERSION}: export again"
            )
        for key, kind in _KEYS.items():
            if not isinstance(about.get(key), kind):
                found = "lacks" if key not in about else "is altered in"
                raise FormatError(f"{path} {found} {key}: export again")
        if _MODEL not in about["sha256"]:
            raise FormatError(f"{path} lists no {_MODEL}: export again")
        for name, digest in about["sha256"].items():
            if not (folder / name).is_file() or file_hash(folder / name) != digest:
                raise FormatError(
                    f"{folder / name} is missing or not the file the bundle was written with: export again"
                )
        try:
            preprocessing = Preprocessing.of(about["preprocessing"])
        except (ConfigError, TypeError) as error:
            raise FormatError(f"{path} is altered in preprocessing ({error}): export again") from error
        return cls(folder, about, preprocessing)

    @property
    def _unit(self) -> str:
        return str(self.about.get("unit", "m"))

    def _file(self, name: str) -> Path | None:
        return self.folder / name if name in self.about["sha256"] else None


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
        folder: where to.
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
    with atomic_folder(folder) as fresh:
        exported = export_onnx(module, fresh / _MODEL, image_size)
        files, heading = list(exported["files"]), None
        if known is not None:
            known.save(fresh / _MAP)
            files.append(_MAP)
        if known is not None and known.heading is not None and known.heading.own:
            heading = {"identity": known.heading.identity, "parity": exported["parity"]["orientation"]}
        elif known is not None and known.heading is not None:
            parity = export_heading(known.heading.descriptor, fresh / _HEADING, image_size)
            heading = {"identity": known.heading.identity, "parity": parity}
            files.append(_HEADING)
        if errors is not None:
            errors.save(fresh / _ERRORS)
            files.append(_ERRORS)
        finer: dict[str, Any] | None = None
        if refinement is not None:
            refinement.save(fresh / _REFINEMENT)
            files.append(_REFINEMENT)
            finer = {"method": refinement.method, "neighbours": refinement.neighbours}
        if finer is not None and finer["method"] == "relative":
            finer["parity"] = export_relative(module, fresh / _RELATIVE)
            files.append(_RELATIVE)
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
        write_json(fresh / _DESCRIPTION, about)
    return Bundle.open(folder)


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


def _check_replaceable(folder: Path) -> None:
    """Make sure that the folder is not there yet, or empty, or an older bundle and nothing else."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise ConfigError(f"{folder} is a file: name another folder for the bundle")
    names = {path.name for path in folder.iterdir()}
    others = sorted(names - {_DESCRIPTION, _MODEL, f"{_MODEL}.data", _MAP, _HEADING, _ERRORS, _REFINEMENT, _RELATIVE})
    if others or (names and _DESCRIPTION not in names):
        raise ConfigError(
            f"{folder} holds other files, such as {(others or sorted(names))[0]}: name a folder of its own"
        )
