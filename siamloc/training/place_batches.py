"""`PlaceDataModule`: batches of places for training, and map frames and queries of a validation drive."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from foundation.calls import typed
from siamloc.data.frames import FrameTable, concatenate
from siamloc.data.library import PanoramaLibrary
from siamloc.data.places import PlaceSampler, PlaceSettings, places_of
from siamloc.training.batches import BatchAugmentation, EpochDataModule

_DESCRIBED_AT_ONCE = 64
_VALIDATED_WITH = 500  # map frames, and queries, at most


class PlaceBatches(Dataset[dict[str, Any]]):
    """The batches of every epoch: item (epoch, i) is a whole batch, gathered at once from the library.

    Each item is a dictionary: `images` (N, 3, H, W) uint8, `xy` (N, 2) float32, `building`, `room` and `frame` (N,).
    If the panoramas are on the device, the images are replaced by their numbers there, `rows` (N,).

    Args:
        library: decoded panoramas.
        sampler: draws the frames.
        augmentation: of the images, if any.
        rank: number of this process among those that train together.
        world_size: number of those processes.
        numbers: of the library's rows on the device, `Resident.numbers`; None if images are gathered here.

    Raises:
        ConfigError: more places than frames.
    """

    def __init__(
        self,
        library: PanoramaLibrary,
        sampler: PlaceSampler,
        augmentation: BatchAugmentation | None = None,
        rank: int = 0,
        world_size: int = 1,
        numbers: NDArray[np.int64] | None = None,
    ) -> None:
        sampler.check_processes(world_size)
        self._library = library
        self._sampler = sampler
        self._rows = library.rows(sampler.frames)
        self._origins = origins_of(sampler.frames, by=sampler.settings.by)
        self._augmentation = augmentation
        self._rank, self._world_size = rank, world_size
        self._numbers = numbers

    def __len__(self) -> int:
        return len(self._sampler)

    def __getitem__(self, number: tuple[int, int]) -> dict[str, Any]:
        epoch, batch = number
        if not 0 <= batch < len(self):
            raise IndexError(f"batch {batch} of {len(self)}")
        rows = self._sampler.batch(epoch, batch, self._rank, self._world_size)
        item: dict[str, Any] = dict(_images(self._library, self._rows[rows], self._numbers))
        item |= {name: value[rows] for name, value in self._origins.items()}
        if self._augmentation is not None:
            self._augmentation.add(item, number, self._library.image_shape, self._rank, self._world_size)
        return item


class ValidationDrive(Dataset[dict[str, Any]]):
    """Map frames, then queries, in batches; every process has all of them.

    Args:
        library: decoded panoramas of all frames.
        known: map frames.
        queries: frames to search in the map. At most 500 of both are used, evenly spaced.
        numbers: of the library's rows on the device, as for `PlaceBatches`.
    """

    def __init__(
        self,
        library: PanoramaLibrary,
        known: FrameTable,
        queries: FrameTable,
        numbers: NDArray[np.int64] | None = None,
    ) -> None:
        rooms = rooms_of(known)
        known, queries = _evenly(known), _evenly(queries)
        self._library, self._numbers = library, numbers
        self._rows = np.concatenate([library.rows(known), library.rows(queries)])
        parts = origins_of(known, queries, rooms=rooms)
        self._columns = {**parts, "known": torch.arange(len(self._rows)) < len(known)}

    def __len__(self) -> int:
        return -(-len(self._rows) // _DESCRIBED_AT_ONCE)

    def __getitem__(self, number: tuple[int, int]) -> dict[str, Any]:
        rows = slice(number[1] * _DESCRIBED_AT_ONCE, (number[1] + 1) * _DESCRIBED_AT_ONCE)
        images = _images(self._library, self._rows[rows], self._numbers)
        return {**images, **{name: value[rows] for name, value in self._columns.items()}}


def _images(library: PanoramaLibrary, rows: NDArray[np.int64], numbers: NDArray[np.int64] | None) -> dict[str, Tensor]:
    """Return the images, or their numbers if they are on the device."""
    if numbers is not None:
        return {"rows": torch.from_numpy(numbers[rows])}
    return {"images": torch.from_numpy(library.batch(rows))}


class PlaceDataModule(EpochDataModule):
    """Serve batches of places to a `PlaceModule`.

    The batches of an epoch follow from the seed and the number of the epoch, so that a resumed run sees the same ones
    as an uninterrupted run. Works with any `Trainer`.

    Args:
        library: decoded panoramas of all frames.
        train: training frames, among those of the library.
        validation: frames that are searched among the training frames after every epoch, or None. At most 500 of both
            are used, evenly spaced.
        places: how batches are drawn; the defaults of `PlaceSettings` if None.
        workers: processes that gather batches; 0 gathers in the training process, which is fastest on a CPU.
        augmentation: of the training images; none if None.
        seed: of the batches.
    """

    library: PanoramaLibrary

    @typed
    def __init__(
        self,
        library: PanoramaLibrary,
        train: FrameTable,
        validation: FrameTable | None = None,
        *,
        places: PlaceSettings | None = None,
        workers: int = 0,
        augmentation: BatchAugmentation | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(library, workers, augmentation)
        self.sampler = PlaceSampler(train, places, seed=seed)
        self._validation = validation

    def check_processes(self, processes: int) -> None:
        """Raise ConfigError unless there are as many places as these processes draw together."""
        self.sampler.check_processes(processes)

    def notes(self) -> list[str]:
        """Return notes on frames from which batches cannot be drawn as requested."""
        return self.sampler.notes()

    def train_dataloader(self) -> DataLoader[Any]:
        """Make the loader of the training batches."""
        numbers = self.numbers(self.augmentation)
        batches = PlaceBatches(self.library, self.sampler, self.augmentation, *self.share(), numbers)
        return self.loader(batches, self.next_epoch())

    def val_dataloader(self) -> DataLoader[Any] | list[Any]:
        """Make the loader of the validation; an empty list if there are no validation frames."""
        if self._validation is None:
            return []
        numbers = self.numbers(None)
        return self.loader(ValidationDrive(self.library, self.sampler.frames, self._validation, numbers), None)

    def paths(self, epoch: int, batch: int) -> dict[str, NDArray[np.str_]]:
        """Return the files of the images of a training batch."""
        rows = self.sampler.batch(epoch, batch, *self.share())
        return {"images": self.sampler.frames.path[rows]}

    def needed(self) -> list[FrameTable]:
        """Return the training and the validation frames."""
        return [self.sampler.frames, *([] if self._validation is None else [self._validation])]


def rooms_of(frames: FrameTable) -> list[str]:
    """Return the sorted names of the known rooms of frames, which differ between buildings."""
    return sorted(set(frames.place[frames.room != ""].tolist()))


def origins_of(*tables: FrameTable, by: str = "position", rooms: Sequence[str] = ()) -> dict[str, Tensor]:
    """Return the fields of `siamloc.models.Origins` for the frames of tables, one table after the other.

    If places are drawn by sequence, positions and buildings are those of `siamloc.data.places.places_of`. Rooms are
    numbered in the order given, and then by name.
    """
    frames = concatenate(tables)
    number = {name: row for row, name in enumerate(dict.fromkeys([*rooms, *rooms_of(frames)]))}
    places = np.where(frames.room == "", "", frames.place).tolist()
    room = np.array([number.get(place, -1) for place in places], dtype=np.int64)
    xy, building = places_of(frames, by)
    known = np.isfinite(xy).all(axis=1)
    for one in range(building.max() + 1):  # single precision resolves decimetres only near the origin
        if (known & (building == one)).any():
            xy[building == one] -= xy[known & (building == one)].mean(axis=0)
    return {
        "xy": torch.from_numpy(xy).float(),
        "building": torch.from_numpy(building),
        "room": torch.from_numpy(room),
        "frame": torch.arange(len(room)),
        "theta": torch.from_numpy(frames.theta.astype(np.float32)),
    }


def _evenly(frames: FrameTable) -> FrameTable:
    count = min(len(frames), _VALIDATED_WITH)
    return frames.take(np.linspace(0, len(frames) - 1, count).round().astype(np.int64))
