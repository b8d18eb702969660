"""The checks of `fit` before the first step, and the choices that follow from the frames."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from siamloc.data.checks import wrong_headings
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.places import PlaceSettings
from siamloc.errors import ConfigError, DataError, explained, leave_out
from siamloc.models.cross_entropy import CrossEntropyLoss
from siamloc.models.describing import NetworkDescriptor, comparing, learned
from siamloc.models.module import name_of
from siamloc.models.origins import Origins
from siamloc.models.places import BatchLoss
from siamloc.models.siamese import Loss
from siamloc.training.batches import EpochDataModule
from siamloc.training.place_batches import PlaceDataModule, origins_of, rooms_of
from siamloc.training.settings import Monitor, Training

_TRIED = 8  # batches to search for something to learn from
_UNIT_ROUNDING = 1e-2  # of the length of a descriptor in half precision


def usable(
    images: PanoramaLibrary, frames: FrameTable, validation: FrameTable | None, settings: Training
) -> tuple[FrameTable, FrameTable | None]:
    """Select the frames with a readable image and, for distance labels, a position.

    If pairs are labelled by rooms, frames without a room label are left out if others in their building have one, since
    their room is unknown.
    """
    pairs, strict = settings.pairs, str(images.settings()["on_error"])
    tables: dict[str, FrameTable] = {}
    for name, table in (("training", frames), ("validation", validation)):
        if table is None:
            continue
        tables[name] = images.readable(table)
        if not len(tables[name]):
            raise DataError(f"there are no {name} frames" if not len(table) else f"no {name} image can be read")

    def leave(which: Callable[[FrameTable], NDArray[np.bool_]], what: str) -> None:
        for name, table in tables.items():
            rows = which(table)
            leave_out(table.path[rows].tolist(), len(table), f"{name} frames have no {what}", strict)
            tables[name] = table.take(~rows)

    if isinstance(pairs, PlaceSettings):
        by_distance = pairs.by == "position"
    else:
        auto = pairs.label == "auto"
        if pairs.label == "room" or (auto and len(rooms_of(tables["training"])) >= 2):
            leave(
                lambda table: (table.room == "") & np.isin(table.building, table.building[table.room != ""]),
                "room label, which others have",
            )
        by_distance = pairs.label == "distance" or (auto and len(set(tables["training"].place.tolist())) == 1)
    if by_distance:
        leave(lambda table: ~table.has_position, f"position, which {pairs.needs_positions}")
    train, validated = tables["training"], tables.get("validation")
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
    """Check that a loss takes this number of arguments.

    Args:
        loss: the loss; None stands for the default loss, which fits.
        arguments: 3 for a loss of pairs, (d0, d1, y), and 2 for a loss of batches of places, (descriptors, origins).

    Raises:
        ConfigError: a class, a loss of torch, or a loss that takes other arguments.
    """
    if loss is None:
        return
    if isinstance(loss, type):
        raise ConfigError(f"the loss {name_of(loss)} is a class: make an object of it, {name_of(loss)}()")
    called = loss.forward if isinstance(loss, nn.Module) else loss
    of_torch = (nn.modules.loss.__name__, nn.functional.__name__)
    if getattr(getattr(called, "func", called), "__module__", None) in of_torch:  # also below functools.partial
        raise ConfigError(
            f"the loss {name_of(loss)} of torch takes other targets than the labels of pairs, 0 for alike to 1, or the "
            "origins of a batch: write a function that calls it"
        )
    try:
        inspect.signature(called).bind(*[None] * arguments)
    except TypeError as error:
        raise ConfigError(
            "a loss of batches of places takes (descriptors, origins), one of pairs takes (d0, d1, y): this one, "
            f"{name_of(loss)}, does not fit these pairs"
        ) from error
    except ValueError:  # functions without a signature
        return


def check_rooms(loss: Loss | BatchLoss | None, train: FrameTable, validated: FrameTable | None) -> None:
    """Check that the frames have the rooms that the loss needs, and that validation frames share rooms with them.

    Args:
        loss: the loss; only losses that use rooms need any.
        train: training frames.
        validated: validation frames, or None.

    Raises:
        DataError: too few rooms, or validation frames that are all in other rooms, for `CrossEntropyLoss`.
    """
    if getattr(loss, "room", 0) and len(rooms_of(train)) < 2:
        raise DataError(
            f"this loss learns from rooms, and the training frames have {len(rooms_of(train))}: give the labels of "
            "2 rooms or more, or choose another loss (or loss.room=0)"
        )
    if isinstance(loss, CrossEntropyLoss) and validated is not None:
        known, asked = rooms_of(train), rooms_of(validated)
        if asked and not set(asked) & set(known):
            raise DataError(
                f"the validation frames are in other rooms ({', '.join(asked)}) than the training frames "
                f"({', '.join(known)}), which loss=cross_entropy never names: validate in the same rooms, or leave the "
                "validation out"
            )


def check_batches(data: EpochDataModule, loss: object, processes: int = 1) -> None:
    """Check that there is enough data for the processes, and that batches of places suit the loss.

    Some batches are drawn and given to the loss's method `lacks`, if it has one.

    Raises:
        ConfigError: too little data, or a loss that learns nothing from any of these batches.
    """
    data.check_processes(processes)
    lacks = getattr(loss, "lacks", None)
    if not isinstance(data, PlaceDataModule) or lacks is None:
        return
    sampler = data.sampler
    found = origins_of(sampler.frames, by=sampler.settings.by)
    for number in range(_TRIED):
        rows = torch.from_numpy(sampler.whole_batch(*divmod(number, len(sampler)), processes))
        origins = Origins(**{name: value[rows] for name, value in found.items()})
        if data.augmentation is not None or sampler.settings.radius == 0:  # views of one image differ
            origins = replace(origins, frame=torch.arange(len(rows)))
        if (missing := lacks(origins)) is None:
            return
    raise ConfigError(
        f"the loss learns nothing from these batches, {_TRIED} of {_TRIED} drawn have no {missing}; the nearest are "
        f"{float(origins.apart().min()):.3g} apart: set that key otherwise, draw other frames together (pairs.images, "
        "pairs.radius, pairs.near), or let an augmentation make views of one image"
    )


def check_headings(network: nn.Module, train: FrameTable, settings: Training) -> None:
    """Check that a network that compares images can learn to do so from the frames.

    Raises:
        ConfigError: pairs, or places by their order, which are not suitable.
        DataError: headings that are missing, or that look like degrees, or positions that are not in metres.
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
    if train.unit != "m":
        raise DataError(
            "model.relative=true (from Python relative=True) is learned from positions in metres, and those of the "
            f"training frames are in {train.unit!r}: give x and y in metres, or set model.relative to false"
        )


def check_network(network: nn.Module, image: NDArray[np.uint8], circular: bool, *, unit: bool) -> int:
    """Describe one image (1, 3, H, W), to find out whether the network fits before anything is written.

    Returns:
        The number of learned values in a descriptor.

    Raises:
        ConfigError: a circular network for images that do not wrap around, descriptors that are not of unit length, or
            inference mode, now or when the network was made.
        DataError: a network that does not take the images, or gives one image different descriptors.
    """
    held = (*network.parameters(), *network.buffers())
    if torch.is_inference_mode_enabled() or any(map(torch.is_inference, held)):
        raise ConfigError("no network learns under torch.inference_mode(): make it and train it outside of that mode")
    if getattr(network, "settings", {}).get("circular") and not circular:
        raise ConfigError(
            "the network wraps around the azimuth (model.circular=true, from Python build(circular=True)), and the "
            "columns of these images do not (data.circular=false): set model.circular=false (and model.canonical=false "
            "where it is true), use the recipe photographs or rooms for images of an ordinary camera, or set "
            "data.circular=true for panoramas"
        )
    with explained(f"the network cannot take panoramas of {' x '.join(map(str, image.shape[1:]))}", DataError):
        descriptor = NetworkDescriptor(network).describe(image).position
    descriptor = learned(network, descriptor)
    length = float((descriptor.astype("float64") ** 2).sum() ** 0.5)
    if unit and abs(length - 1) > _UNIT_ROUNDING:
        raise ConfigError(
            f"this loss needs descriptors of length 1, this network's have {length:.3g}: choose the "
            "head flat, gem, bands, fourier or magnitudes, or end your own network with torch.nn.functional.normalize"
        )
    return descriptor.shape[1]


def check_weights(module: nn.Module) -> None:
    """Check that a network and its loss have weights to train.

    Args:
        module: the module that holds both.

    Raises:
        ConfigError: no weights, or only frozen ones.
    """
    learns = [weight.requires_grad for weight in module.parameters()]
    if not any(learns):
        found = "have no weights" if not learns else f"have only frozen ones, {len(learns)} with requires_grad=False"
        raise ConfigError(
            f"training needs weights to change, and the network and its loss {found}: train a network with layers that "
            "learn, or thaw some by layer.requires_grad_()"
        )


def monitored(
    settings: Training, train: FrameTable, validated: FrameTable | None, network: nn.Module, loss: object = None
) -> Monitor | None:
    """Return the validation figure that chooses the checkpoint, see `Training.monitor`; None without validation.

    Raises:
        DataError: frames without the positions or rooms needed for any validation.
        ConfigError: a figure that the frames, the network or the loss do not give, or `patience` although nothing is
            validated.
    """
    if validated is None:
        if settings.patience is not None:
            raise ConfigError(
                f"patience={settings.patience} counts epochs without a better validation, and nothing is validated: "
                "give validation frames, or leave patience out"
            )
        return None
    placed = bool(_buildings(train) & _buildings(validated))
    roomed = len(rooms_of(train)) >= 2 and bool(rooms_of(validated))
    turned = _buildings(train.take(np.isfinite(train.theta))) & _buildings(validated)
    compares = comparing(network) is not None and bool(turned)
    names = isinstance(loss, CrossEntropyLoss) and roomed
    positions = "training and validation frames with positions in one building"
    needs = {
        "error": (placed, positions),
        "recall": (placed, positions),
        "room": (roomed, "validation frames with rooms, and 2 rooms or more in training"),
        "accuracy": (names, "loss=cross_entropy, and training and validation frames with rooms"),
        "refined": (
            compares,
            "model.relative=true (from Python relative=True), training frames with positions and headings, and "
            "validation frames with positions in one of their buildings",
        ),
    }
    monitor = settings.monitor
    known, what = needs.get(monitor, (True, ""))
    if not known:
        raise ConfigError(f"monitor={monitor} needs {what}: give them, or choose monitor=auto")
    if monitor != "auto":
        return monitor
    if names:
        return "accuracy"
    if compares:
        return "refined"
    if not isinstance(settings.pairs, PlaceSettings):
        # Frames of the drive that is trained on are next to those of the training.
        drives = [set(frames.sequence[frames.has_position].tolist()) for frames in (train, validated)]
        return "error" if placed and not set.intersection(*drives) else "loss"
    if placed or roomed:
        return "error" if placed else "room"
    raise DataError(
        "the checkpoint is chosen by the error of localization or by the rooms found, but training and validation "
        "frames do not both have positions in one building, or both rooms (2 or more in training): give "
        "either, or leave the validation out"
    )


def _buildings(frames: FrameTable) -> set[str]:
    """Return the buildings of the frames that have a position."""
    return set(frames.building[frames.has_position].tolist())
