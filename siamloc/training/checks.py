"""The checks of `fit` before the first step, and the choices that follow from the frames."""

from __future__ import annotations

import inspect
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from siamloc.data.checks import wrong_headings
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.pairs import PairSettings
from siamloc.data.places import PlaceSettings
from siamloc.errors import ConfigError, DataError, SiamlocError, leave_out
from siamloc.models.batch_losses import SoftContrastiveLoss
from siamloc.models.cross_entropy import CrossEntropyLoss
from siamloc.models.describing import comparing, describe
from siamloc.models.origins import Origins
from siamloc.models.outputs import name_of
from siamloc.models.places import BatchLoss
from siamloc.models.siamese import Loss
from siamloc.training.batches import EpochDataModule
from siamloc.training.lacking import what_is_lacking
from siamloc.training.place_batches import PlaceDataModule, origins_of, rooms_of
from siamloc.training.settings import Monitor, Training

_ROOMS = 2  # minimum number to distinguish
_TRIED = 8  # batches to search for something to learn from
_UNIT_ROUNDING = 1e-2  # of the length of a descriptor in half precision


def usable(
    images: PanoramaLibrary, frames: FrameTable, validation: FrameTable | None, settings: Training
) -> tuple[FrameTable, FrameTable | None]:
    """Select the frames with a readable image and, for distance labels, a position.

    If pairs are labelled by rooms, frames without a room label are left out if others in their building have one, since
    their room is unknown.
    """
    found: list[FrameTable | None] = []
    pairs = settings.pairs
    distance = pairs.by == "position" if isinstance(pairs, PlaceSettings) else pairs.label == "distance"
    by_rooms = False
    for name, table in (("training", frames), ("validation", validation)):
        if table is None:
            found.append(None)
            continue
        readable = images.readable(table)
        if not len(readable):
            raise DataError(f"there are no {name} frames" if not len(table) else f"no {name} image can be read")
        strict = str(images.settings()["on_error"])
        if name == "training" and isinstance(pairs, PairSettings):
            by_rooms = pairs.label == "room" or (pairs.label == "auto" and _rooms(readable) >= _ROOMS)
        if by_rooms:
            labelled = readable.room != ""
            unknown = ~labelled & np.isin(readable.building, readable.building[labelled])
            missing = readable.path[unknown].tolist()
            leave_out(missing, len(readable), f"{name} frames have no room label, which others have", strict)
            readable = readable.take(~unknown)
        if name == "training" and isinstance(pairs, PairSettings) and pairs.label == "auto":
            distance = len(set(readable.place.tolist())) == 1
        if distance:
            missing = readable.path[~readable.has_position].tolist()
            what = f"{name} frames have no position, which {pairs.needs_positions}"
            leave_out(missing, len(readable), what, strict)
            readable = readable.take(readable.has_position)
        found.append(readable)
    train, validated = found
    assert train is not None
    if validated is not None:
        known = set(train.identities())
        both = [key for key in validated.identities() if key in known]
        if both:
            raise ConfigError(
                f"{len(both)} validation frames are training frames too, the first is {both[0][1]}, so that the result "
                "would not be honest: validate with other frames"
            )
    return train, validated


def check_loss(loss: Loss | BatchLoss | None, arguments: int) -> None:
    """Make sure that a loss takes this number of arguments."""
    if loss is None or not callable(loss):
        return
    try:
        called = loss.forward if isinstance(loss, nn.Module) else loss
        inspect.signature(called).bind(*[None] * arguments)
    except TypeError as error:
        raise ConfigError(
            "a loss of batches of places takes (descriptors, origins), one of pairs takes (d0, d1, y): this one, "
            f"{name_of(loss)}, does not fit these pairs"
        ) from error
    except ValueError:  # functions without a signature
        return


def check_rooms(loss: Loss | BatchLoss | None, train: FrameTable, validated: FrameTable | None) -> None:
    """Make sure that the frames have the rooms that the loss needs, and that the validation uses those."""
    if isinstance(loss, CrossEntropyLoss):
        _check_classes(rooms_of(train), None if validated is None else rooms_of(validated))
    if isinstance(loss, SoftContrastiveLoss) and loss.room > 0 and _rooms(train) < _ROOMS:
        raise DataError(
            f"the loss learns from rooms, loss.room={loss.room:g}, but the training frames have {_rooms(train)}: give "
            "their room labels, or set loss.room to 0"
        )


def _check_classes(rooms: list[str], asked: list[str] | None) -> None:
    """Make sure that there are rooms to name, and that the validation has some of them."""
    if len(rooms) < _ROOMS:
        what = f"are all in one room, {rooms[0]}" if rooms else "have no room labels"
        raise DataError(
            f"loss=cross_entropy learns to name rooms, and the training frames {what}: give the labels of {_ROOMS} "
            "rooms or more, or choose another loss"
        )
    if asked and not set(asked) & set(rooms):
        raise DataError(
            f"the validation frames are in rooms that the training frames lack ({_some(asked)}, and not "
            f"{_some(rooms)}), which loss=cross_entropy never names: validate in the same rooms, or leave the "
            "validation out"
        )


def _some(names: list[str], most: int = 5) -> str:
    return ", ".join([*names[:most], *(["..."] if len(names) > most else [])])


def check_batches(data: EpochDataModule, loss: object, processes: int = 1) -> None:
    """Make sure that there is enough data for the processes, and that batches of places suit the loss.

    Some batches are drawn and checked for what a loss of siamloc needs.

    Raises:
        ConfigError: too little data, or a loss that learns nothing from any of these batches.
    """
    data.check_processes(processes)
    if not isinstance(data, PlaceDataModule):
        return
    sampler = data.sampler
    found = origins_of(sampler.frames, by=sampler.settings.by)
    lacking: str | None = None
    for number in range(_TRIED):
        rows = torch.from_numpy(sampler.whole_batch(*divmod(number, len(sampler)), processes))
        origins = Origins(**{name: value[rows] for name, value in found.items()})
        if data.augmentation is not None or sampler.settings.radius == 0:  # views of one image differ
            origins = replace(origins, frame=torch.arange(len(rows)))
        lacking = what_is_lacking(loss, origins)
        if lacking is None:
            return
    raise ConfigError(f"the loss learns nothing from these batches, {_TRIED} of {_TRIED} drawn have no {lacking}")


def check_headings(network: nn.Module, train: FrameTable, settings: Training) -> None:
    """Make sure that a network that compares images can learn to do so from the frames.

    Raises:
        ConfigError: pairs, or places by their order, which are not suitable.
        DataError: headings that are missing, or that look like degrees.
    """
    if comparing(network) is None:
        return
    pairs = settings.pairs
    if not isinstance(pairs, PlaceSettings) or pairs.by != "position":
        raise ConfigError(
            "model.relative=true (from Python relative=True) is learned from batches of places by their positions: "
            "take the recipe modern or fine_tuning, or set model.relative to false"
        )
    if np.isfinite(train.theta).sum() < 2:
        raise DataError(
            "model.relative=true (from Python relative=True) is learned from headings, and the training frames have "
            "none: give the column theta, in rad, or set model.relative to false (from Python take "
            "siamloc.models.pretrained(relative=False), or build without relative)"
        )
    for finding in wrong_headings(train):
        raise DataError(f"model.relative=true (from Python relative=True) is learned from headings: {finding}")


def check_network(network: nn.Module, image: NDArray[np.uint8], circular: bool, *, unit: bool) -> int:
    """Describe one image (1, 3, H, W), to detect a network of another size before anything is written.

    Returns:
        The length of a descriptor.

    Raises:
        ConfigError: a circular network for images that do not wrap around, or descriptors that are not of unit length.
        DataError: a network that does not take the images.
    """
    if getattr(network, "settings", {}).get("circular") and not circular:
        raise ConfigError(
            "the network wraps around the azimuth (model.circular=true, from Python build(circular=True)), and the "
            "columns of these images do not (data.circular=false): set model.circular=false (and model.canonical=false "
            "where it is true), use the recipe photographs or rooms for images of an ordinary camera, or set "
            "data.circular=true for panoramas"
        )
    try:
        descriptor = describe(network, image)
    except SiamlocError:
        raise
    except Exception as error:  # a custom module may raise anything
        shape = " x ".join(map(str, image.shape[1:]))
        first_line = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise DataError(f"the network cannot take panoramas of {shape}: {first_line}") from error
    length = float((descriptor.astype("float64") ** 2).sum() ** 0.5)
    if unit and abs(length - 1) > _UNIT_ROUNDING:
        raise ConfigError(
            f"this loss needs descriptors of length 1, this network's have {length:.3g}: choose the "
            "head flat, gem, bands, fourier or magnitudes, or end your own network with torch.nn.functional.normalize"
        )
    return descriptor.shape[1]


def monitored(
    settings: Training, train: FrameTable, validated: FrameTable | None, network: nn.Module, loss: object = None
) -> Monitor | None:
    """Return the figure that chooses the checkpoint, as in `Training.monitor`; None if nothing is validated.

    Raises:
        DataError: frames without the positions or rooms needed for the validation.
        ConfigError: `patience` although nothing is validated.
    """
    if validated is None:
        if settings.patience is not None:
            raise ConfigError(
                f"patience={settings.patience} counts epochs without a better validation, and nothing is validated: "
                "give validation frames, or leave patience out"
            )
        return None
    placed = bool(_buildings(train) & _buildings(validated))
    roomed = _rooms(train) >= _ROOMS and _rooms(validated) > 0
    monitor = settings.monitor
    if monitor in ("error", "recall") and not placed:
        raise DataError(
            f"monitor={monitor} needs positions, and training and validation frames do not both have them in one "
            "building: give them, or choose monitor=auto"
        )
    if monitor == "room" and not roomed:
        raise DataError(
            f"monitor=room needs rooms, {_ROOMS} or more in training, and training and validation frames do not both "
            "have them: give them, or choose monitor=auto"
        )
    turned = _buildings(train.take(np.isfinite(train.theta))) & _buildings(validated)
    compares = comparing(network) is not None and bool(turned)
    if monitor == "refined" and not compares:
        raise ConfigError(
            "monitor=refined is the error of poses by comparison: it needs model.relative=true (from Python "
            "relative=True), training frames with positions and headings, and validation frames with positions in one "
            "of their buildings; or choose monitor=auto"
        )
    names = isinstance(loss, CrossEntropyLoss)
    if monitor == "accuracy" and not (names and roomed):
        raise ConfigError(
            "monitor=accuracy is the share of frames whose room is named: it needs loss=cross_entropy and validation "
            "frames with rooms; or choose monitor=auto"
        )
    if monitor != "auto":
        return monitor
    if names and roomed:
        return "accuracy"
    if compares:
        return "refined"
    if not isinstance(settings.pairs, PlaceSettings):
        return "error" if placed and _another_drive(train, validated) else "loss"
    if placed:
        return "error"
    if roomed:
        return "room"
    raise DataError(
        "the checkpoint is chosen by the error of localization or by the rooms found, but training and validation "
        f"frames do not both have positions in one building, or both rooms ({_ROOMS} or more in training): give "
        "either, or leave the validation out"
    )


def _another_drive(train: FrameTable, validated: FrameTable) -> bool:
    """Whether the validation is a separate drive through a building of the training, so that it can be located.

    Frames of the same drive are next to those used for training.
    """
    known, asked = train.take(train.has_position), validated.take(validated.has_position)
    same_drives = set(known.sequence.tolist()) & set(asked.sequence.tolist())
    return not same_drives and bool(_buildings(train) & _buildings(validated))


def _buildings(frames: FrameTable) -> set[str]:
    """Return the buildings of the frames that have a position."""
    return set(frames.building[frames.has_position].tolist())


def _rooms(frames: FrameTable) -> int:
    """Count the rooms of frames that have one."""
    return len(set(frames.place[frames.room != ""].tolist()))
