"""`PlaceDataModule`: batches of places for training, and map frames and queries of a validation drive."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from foundation.calls import typed
from foundation.columns import spread_rows
from siamloc.data.frames import DEVIATIONS, FrameTable, concatenate
from siamloc.data.library import PanoramaLibrary
from siamloc.data.places import PlaceSampler, PlaceSettings, places_of
from siamloc.training.batches import BatchAugmentation, DriveBatches, EpochDataModule, Panoramas

_VALIDATED_WITH = 500  # map frames, and queries, at most


@dataclass(eq=False)
class PlaceBatches(Dataset[dict[str, Any]]):
    """The batches of places of every epoch: item (epoch, i) is a whole batch.

    Each item is a dictionary: `images` (N, 3, H, W) uint8, or `rows` (N,) as in `Panoramas.of`; `xy` (N, 2) float32;
    `building`, `room` and `frame` (N,), whole numbers; `theta` (N,) float32, in rad; and `deviation` (N, 2) float32 if
    any frame has one.

    Attributes:
        panoramas: gives the images of the sampler's frames, or their numbers on the device.
        sampler: draws the places of each batch, and the frames of each place.
        augmentation: changes the training images, such as their contrast; None leaves them as they are.
        rank: number of this process among those that train together.
        world_size: number of those processes.
    """

    panoramas: Panoramas
    sampler: PlaceSampler
    augmentation: BatchAugmentation | None = None
    rank: int = 0
    world_size: int = 1

    def __post_init__(self) -> None:
        self._origins = origins_of(self.sampler.frames, by=self.sampler.settings.by)

    def __len__(self) -> int:
        return len(self.sampler)

    def __getitem__(self, number: tuple[int, int]) -> dict[str, Any]:
        rows = self.sampler.batch(*number, self.rank, self.world_size)
        item: dict[str, Any] = dict(self.panoramas.of(rows))
        item |= {name: value[rows] for name, value in self._origins.items()}
        if self.augmentation is not None:
            self.augmentation.add(item, number, self.panoramas.shape, self.rank, self.world_size)
        return item


def validation_drive(
    library: PanoramaLibrary, known: FrameTable, queries: FrameTable, numbers: NDArray[np.int64] | None = None
) -> DriveBatches:
    """Make the batches of a validation drive: at most 500 map frames, then at most 500 queries, evenly spaced.

    Args:
        library: decoded panoramas of all frames.
        known: the map frames, among those of the library.
        queries: frames, among those of the library, that are searched among the map frames.
        numbers: index on the device of each row of the library, as for `Panoramas`.
    """
    drive = [evenly(known), evenly(queries)]
    columns = origins_of(*drive, rooms=rooms_of(known))
    columns["known"] = torch.arange(sum(map(len, drive))) < len(drive[0])
    return DriveBatches(columns, Panoramas(library, concatenate(drive), numbers))


class PlaceDataModule(EpochDataModule):
    """Serve batches of places to a `PlaceModule`.

    The batches of an epoch follow from the seed and the number of the epoch, so that a resumed run sees the same
    batches as an uninterrupted run. Works with any `Trainer`; in a training loop without one,
    `on_after_batch_transfer(batch, 0)` augments the batches of an augmentation with where="gpu".

    Args:
        library: decoded panoramas of all frames.
        train: training frames, among those of the library.
        validation: frames that are searched among the training frames after every epoch, or None. At most 500 of both
            are used, evenly spaced.
        places: how many places and images a batch has, and how places are drawn; the defaults of `PlaceSettings` if
            None.
        workers: processes that gather batches; 0 gathers in the training process, which is fastest on a CPU.
        augmentation: changes the training images, such as their contrast; None leaves them as they are.
        seed: seed from which the batches of all epochs follow.
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
        """Raise ConfigError unless the frames have as many places as these processes draw together."""
        self.sampler.check_processes(processes)

    def notes(self) -> list[str]:
        """Return notes on frames from which batches cannot be drawn as requested."""
        return self.sampler.notes()

    def train_dataloader(self) -> DataLoader[Any]:
        """Make the loader of the training batches."""
        panoramas = Panoramas(self.library, self.sampler.frames, self.numbers(self.augmentation))
        return self.loader(PlaceBatches(panoramas, self.sampler, self.augmentation, *self.share()), self.next_epoch())

    def val_dataloader(self) -> DataLoader[Any] | list[Any]:
        """Make the loader of the validation; an empty list if there are no validation frames."""
        if self._validation is None:
            return []
        frames, numbers = self.sampler.frames, self.numbers(None)
        return self.loader(validation_drive(self.library, frames, self._validation, numbers), None)

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
    deviation = np.nan_to_num(np.column_stack([getattr(frames, name) for name in DEVIATIONS]))
    return {
        "xy": torch.from_numpy(xy).float(),
        "building": torch.from_numpy(building),
        "room": torch.from_numpy(room),
        "frame": torch.arange(len(room)),
        "theta": torch.from_numpy(frames.theta.astype(np.float32)),
        **({"deviation": torch.from_numpy(deviation).float()} if by == "position" and deviation.any() else {}),
    }


def evenly(frames: FrameTable) -> FrameTable:
    """Return at most 500 frames of a table, evenly spaced."""
    return frames.take(spread_rows(len(frames), _VALIDATED_WITH))
