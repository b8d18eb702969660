"""What several commands have to do: read the data, open the panoramas, describe frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from omegaconf import DictConfig, OmegaConf

from analytic import DESCRIPTORS, Description, Descriptor, Thumbnail, descriptor
from siamloc.cli.compose import config_folder, plain, sweep_suffix, task_overrides
from siamloc.data.decoding import Preprocessing
from siamloc.data.frames import FrameTable, concatenate, image_files
from siamloc.data.library import PanoramaLibrary
from siamloc.data.panorama import camera_from_config
from siamloc.data.roles import Protocol
from siamloc.errors import ConfigError, DataError, hint
from siamloc.files import read_json
from siamloc.maps import HeadingPart, VisualMap, WithHeading
from siamloc.progress import track
from siamloc.runs import Run

if TYPE_CHECKING:
    from siamloc.models import SiameseModule

_READER_KEYS = {"manifest": ("manifest",), "cold": ("root", "camera"), "folder": ("root",)}


def read_frames(config: DictConfig) -> FrameTable:
    """Return all frames of the configured data set."""
    from siamloc import data

    kind = config.data.kind
    if kind not in _READER_KEYS:
        raise ConfigError(f"unknown data.kind {kind!r}: {hint(kind, _READER_KEYS)}")
    where = {key: config.data[key] for key in _READER_KEYS[kind] if key in config.data}
    frames = data.read(kind, on_error=config.data.on_error, **where)
    if kind == "cold":
        _check_simulated(config, frames)
    return frames


def _check_simulated(config: DictConfig, frames: FrameTable) -> None:
    """Compare what simulated images are, as the note beside them says, with how they would be unwrapped."""
    for folder in sorted({Path(path).parents[1] for path in frames.path.tolist()}):
        if not (folder / "camera.json").is_file():
            continue
        images = read_json(folder / "camera.json").get("images")
        fitting = {"panorama": ("none",), "omnidirectional": ("polar", "hyperbolic")}.get(images)
        if fitting is not None and config.unwrap.kind not in fitting:
            raise ConfigError(
                f"{folder} holds simulated images of kind {images}, which unwrap={config.unwrap.kind} does not fit: "
                f"use unwrap={fitting[-1]}" + (", or simulate with camera=panorama" if images != "panorama" else "")
            )


def image_size(config: DictConfig) -> tuple[int, int]:
    """Return rows and columns of a panorama."""
    size = plain(config.data)["image_size"]
    if not (isinstance(size, list) and len(size) == 2 and all(isinstance(n, int) and n > 0 for n in size)):
        raise ConfigError(f"data.image_size must be [rows, columns] in pixels, got {size}")
    return size[0], size[1]


def preprocessing(config: DictConfig) -> Preprocessing:
    """Return how images become panoramas."""
    camera, view = camera_from_config(plain(config.unwrap), image_size(config))
    return Preprocessing.checked(image_size(config), camera, view if camera is not None else None)


def images_named(names: Any) -> list[Path]:
    """Return the image files that a key names: one file or folder, or a list of them.

    Raises:
        ConfigError: none named.
        DataError: a file that is not there, or a folder without images.
    """
    paths: list[Path] = []
    for name in [names] if isinstance(names, str) else list(names):
        path = Path(name)
        if path.is_dir():
            inside = image_files(path)
            if not inside:
                raise DataError(f"{path} holds no images")
            paths.extend(inside)
        elif path.is_file():
            paths.append(path)
        else:
            raise DataError(f"there is no image {path}")
    if not paths:
        raise ConfigError("no images given: name files or folders, images=[a.jpeg,folder]")
    return paths


def open_library(config: DictConfig, frames: FrameTable) -> PanoramaLibrary:
    """Decode the frames' images, or find them decoded."""
    camera, view = camera_from_config(plain(config.unwrap), image_size(config))
    return PanoramaLibrary(
        frames,
        config.data.cache,
        image_size=image_size(config),
        unwrap=camera,
        view=view if camera is not None else None,
        on_error=config.data.on_error,
    )


class Roles:
    """The frames of the roles of a protocol, with their panoramas.

    Only the sequences that the roles need are decoded.

    Args:
        config: the configuration.
        names: roles to fill.
        known: frames of a map that was made before; they are given the role "known".
    """

    def __init__(self, config: DictConfig, names: tuple[str, ...], known: FrameTable | None = None) -> None:
        self.protocol = Protocol.from_config(plain(config.protocol))
        table = read_frames(config)
        wanted = {name: self.protocol.frames(name, table) for name in names}
        for name, frames in wanted.items():
            if not len(frames):
                raise ConfigError(
                    f"protocol.{name} selects none of the {len(table)} frames; the data holds {table.describe()}: "
                    f"choose others with protocol.{name}.sequences, lightings or rooms"
                )
        if known is not None:
            wanted["known"] = _found_again(known, table)
        sequences = list(concatenate(list(wanted.values())).rows_by("sequence"))
        self.library = open_library(config, table.take(np.isin(table.sequence, sequences)))
        self._frames = {name: self.library.select(frames) for name, frames in wanted.items()}

    def __contains__(self, name: str) -> bool:
        return name in self._frames

    def __getitem__(self, name: str) -> FrameTable:
        frames = self._frames[name]
        if not len(frames):
            raise DataError(f"none of the images of the {name} frames could be read")
        return frames


def _found_again(known: FrameTable, table: FrameTable) -> FrameTable:
    """Return the rows of a table that show the frames of a map, in the map's order.

    Raises:
        ConfigError: a frame is not there any more, or has another position or room than in the map.
    """
    row = {path: number for number, path in enumerate(table.path.tolist())}
    missing = [path for path in known.path.tolist() if path not in row]
    if missing:
        raise ConfigError(
            f"{len(missing)} of the map's {len(known)} frames are not in the data, the first is {missing[0]}: "
            "evaluate with the data that the map was made of, or make the map anew"
        )
    found = table.take([row[path] for path in known.path.tolist()])
    moved = ~np.isclose(found.xy, known.xy, rtol=0, atol=1e-9, equal_nan=True).all(axis=1)
    changed = moved | (found.room != known.room)
    if changed.any():
        first = known.path[np.flatnonzero(changed)[0]]
        raise ConfigError(
            f"{int(changed.sum())} of the map's {len(known)} frames have another position or room in the data now, the "
            f"first is {first}: make the map anew with `siamloc map`"
        )
    return found


def usable(config: DictConfig, frames: FrameTable, known: np.ndarray, lack: str) -> FrameTable:
    """Return the frames for which `known` holds; say how many lack something, or stop there if so configured.

    Raises:
        DataError: none is left, or one lacks something and data.on_error is "raise".
    """
    if known.all():
        return frames
    missing = int((~known).sum())
    first = frames.path[np.flatnonzero(~known)[0]]
    text = f"{missing} of {len(frames)} frames {lack}, the first is {first}"
    if config.data.on_error == "raise":
        raise DataError(f"{text}: data.on_error=skip leaves them out")
    if missing == len(frames):
        raise DataError(f"all {len(frames)} frames {lack}")
    print(f"{text}: left out")
    return frames.take(known)


def train_run(config: DictConfig) -> Run:
    """Return the folder that a training writes into."""
    if config.run is not None:
        folder = Path(config.run)
    else:
        folder = Path("runs") / "-".join(
            [config.data.name, config.model.branch.name, config.model.head.name, f"seed{config.seed}"]
        )
    suffix = sweep_suffix()
    return Run(folder / suffix if suffix else folder)


def descriptor_options(name: str) -> dict[str, Any]:
    """Return the options of a descriptor by the name of its configuration file; what it leaves out has its default.

    Raises:
        ConfigError: an unknown name.
    """
    folder = config_folder() / "descriptor"
    path = folder / f"{name}.yaml"
    if not path.is_file():
        raise ConfigError(f"unknown descriptor {name!r}: {hint(name, [p.stem for p in folder.glob('*.yaml')])}")
    return {str(key): value for key, value in OmegaConf.load(path).items() if key != "defaults"}


def label_of(options: Mapping[str, Any]) -> str:
    """Return what the folders and table rows of a descriptor or a build are called: its label, else its name."""
    return str(options.get("label") or options["name"])


def map_file(run: Run, name: str) -> Path:
    """Return where the map of a descriptor lies in a run."""
    return run.map if name == "network" else run.evaluation(name) / "map.npz"


def finished_run(config: DictConfig) -> Run:
    """Return the run that a command works on; for analytic descriptors any folder will do."""
    return Run(Path(config.run) if config.run is not None else Path("runs") / label_of(plain(config.descriptor)))


def make_descriptor(config: DictConfig, run: Run, options: dict[str, Any]) -> Descriptor:
    """Return a descriptor by its options (`descriptor` of the configuration), on the configured device."""
    options = dict(options)
    name = options.pop("name")
    options.pop("label", None)
    if name == "thumbnail":
        return Thumbnail(**options)
    if name in DESCRIPTORS:
        return descriptor(name, **options, circular=config.data.circular, device=device(config))
    if name in ("network", "untrained"):
        from siamloc.models import SiameseModule, read_hyperparameters

        trained = Run(Path(options["run"])) if options.get("run") else run
        checkpoint = trained.checkpoint(config.checkpoint)
        if name == "untrained":
            network = SiameseModule(**read_hyperparameters(checkpoint))
        else:
            network = SiameseModule.load(checkpoint)
        _check_architecture(config, network, trained)
        return network.to(device(config))
    raise ConfigError(f"unknown descriptor {name!r}: {hint(name, ('network', 'untrained', 'thumbnail', *DESCRIPTORS))}")


def device(config: DictConfig) -> str:
    """Return the device that descriptors are computed on."""
    import torch

    if config.device == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    kind, _, number = str(config.device).partition(":")
    if kind not in ("cpu", "cuda") or not (number == "" or number.isdigit()):
        raise ConfigError(f"device must be auto, cpu or cuda, got {config.device!r}")
    if kind == "cuda" and not torch.cuda.is_available():
        raise ConfigError("device=cuda, but torch finds no GPU here: use device=cpu or auto")
    return str(config.device)


def describe_frames(descriptor: Descriptor, library: PanoramaLibrary, frames: FrameTable, what: str) -> Description:
    """Return the description of frames, showing progress."""
    return Description.concatenate(list(described(descriptor, library, frames, what)))


def described(descriptor: Descriptor, library: PanoramaLibrary, frames: FrameTable, what: str) -> Iterator[Description]:
    """Yield the descriptions of frames, batch by batch, showing progress."""
    parts = (descriptor.describe(batch) for batch in library.batches(frames))
    return track(parts, len(frames), what, size=len)


def build_map(
    config: DictConfig,
    descriptor: Descriptor,
    library: PanoramaLibrary,
    frames: FrameTable,
    what: str,
    heading: Descriptor | None = None,
) -> VisualMap:
    """Describe map frames and return their map, with what another descriptor tells headings by if one is given."""
    both = descriptor if heading is None else WithHeading(descriptor, heading)
    description = describe_frames(both, library, frames, what)
    part = None
    if heading is not None and description.orientation is not None:
        part = HeadingPart.of(heading, description.orientation)
    return VisualMap(
        description.position,
        frames,
        identity_of(config, descriptor),
        descriptor.default_distance,
        unit=config.data.unit,
        made={"role": plain(config.protocol.map), "overrides": _map_overrides()},
        orientation=description.orientation if heading is None else None,
        heading=part,
    )


def identity_of(config: DictConfig, descriptor: Descriptor) -> dict[str, Any]:
    """Return what decides a frame's descriptor: the descriptor's identity, and how images become panoramas."""
    return {**descriptor.identity, "images": preprocessing(config).parameters()}


def _map_overrides() -> list[str]:
    """Return the overrides that chose the map's frames and its headings, for the commands that use the map later."""
    return [word for word in task_overrides() if word.startswith(("protocol", "heading"))]


def _check_architecture(config: DictConfig, network: SiameseModule, run: Run) -> None:
    expected = {"branch": config.model.branch.name, "head": config.model.head.name, "image_size": image_size(config)}
    for key, wanted in expected.items():
        found = network.hparams[key]
        found = tuple(found) if key == "image_size" else found
        if found != wanted:
            raise ConfigError(
                f"the checkpoint of {run.folder} is of another architecture: it has {key} {found}, the configuration "
                f"says {wanted}; leave {key} out to use the run's own, or train anew"
            )
