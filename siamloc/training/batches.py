"""Base of all training batches: their images, their augmentation, and the transfer to the device."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence, Sized
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, DistributedSampler

from augment.base import Effect, seeded
from foundation.settings import Settings
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.lightning import LightningDataModule

SHARE = 0.25
"""Share of a GPU's free memory that panoramas may take."""
_COPIED_AT_ONCE = 256
_DESCRIBED_AT_ONCE = 64
_PLACES = 0xA07  # separates the draws for batches of places from others


@dataclass(frozen=True)
class BatchAugmentation(Settings):
    """Augment training images as their batches are gathered.

    The augmentation of an image depends on the seed and its number among those that are drawn together, not on the
    workers that gather batches or the ranks that train together.

    Attributes:
        effect: an effect or a policy of `augment`.
        where: "cpu", where batches are gathered, or "gpu", after the batch was transferred to the device.
        seed: seed of the random parameters, a whole number that is not negative.

    Raises:
        ConfigError: a value of the wrong kind.
    """

    WHERE = "augment"

    effect: Effect
    where: Literal["cpu", "gpu"] = "cpu"
    seed: int = 0

    def draw(
        self, stream: Sequence[int], images: int, image_shape: tuple[int, ...], mine: slice = slice(None)
    ) -> dict[str, Tensor]:
        """Draw parameters for some of the images that are drawn together.

        Args:
            stream: whole numbers, such as epoch and batch, that make draws independent of each other.
            images: number of images that are drawn together, by all processes.
            image_shape: (3, H, W).
            mine: the images, among these, whose parameters are returned; all by default.
        """
        whole = torch.empty((images, *image_shape), dtype=torch.uint8, device="meta")  # for its shape only
        drawn = self.effect.draw(seeded(self.seed, *stream), whole)
        return {name: value[mine] for name, value in drawn.items()}

    def add(
        self, item: dict[str, Any], batch: tuple[int, int], image_shape: tuple[int, ...], rank: int, world_size: int
    ) -> None:
        """Augment the images of a batch of places, or add the parameters with which the device augments them.

        Args:
            item: the batch, where `frame` has an entry for each image.
            batch: number of the epoch, and number of the batch in the epoch, both from 0.
            image_shape: (3, H, W).
            rank: number of this process among those that draw a batch together.
            world_size: number of those processes.
        """
        count = len(item["frame"])
        mine = slice(rank * count, (rank + 1) * count)
        params = self.draw((*batch, _PLACES), count * world_size, image_shape, mine)
        if "theta" in item and "heading" in params:
            item["theta"] = item["theta"] + params["heading"].to(item["theta"].dtype)
        self.apply(item, params, image_shape)

    def apply(self, item: dict[str, Any], params: dict[str, Tensor], image_shape: tuple[int, ...]) -> None:
        """Augment a batch with drawn parameters, or add the parameters with which the device augments it.

        Args:
            item: the batch, whose `images` are replaced, or which gets the key `change` if `where` is "gpu".
            params: the parameters that `draw` returned for the images of the batch.
            image_shape: (3, H, W).
        """
        if self.where == "gpu":
            item["change"] = self.effect.program(params, *image_shape[1:])
        else:
            item["images"] = self.effect.apply(item["images"], params)


class Resident:
    """Keep some panoramas of a library in the memory of a device, as 8-bit numbers.

    Args:
        library: decoded panoramas.
        rows: the required rows of the library, in any order; repeats are allowed.
        device: device that holds the images; each process has its own copy.

    Attributes:
        images: (N, 3, H, W) uint8.
        numbers: index of each row of the library among `images`, (len(library),); -1 for rows that are not among them.

    Example:
        >>> import cv2, tempfile
        >>> from pathlib import Path
        >>> folder = Path(tempfile.mkdtemp())
        >>> paths = [folder / f"{number}.png" for number in range(4)]
        >>> for number, path in enumerate(paths):
        ...     _ = cv2.imwrite(str(path), np.full((8, 16, 3), number, np.uint8))
        >>> library = PanoramaLibrary(FrameTable(path=paths), folder / "cache", image_size=(8, 16))
        >>> resident = Resident(library, [3, 1], torch.device("cpu"))
        >>> resident.images[torch.from_numpy(resident.numbers[[1, 1, 3]]), 0, 0, 0]
        tensor([1, 1, 3], dtype=torch.uint8)
    """

    def __init__(self, library: PanoramaLibrary, rows: ArrayLike, device: torch.device) -> None:
        needed: NDArray[np.int64] = np.unique(np.asarray(rows, dtype=np.int64))
        self.numbers = np.full(len(library), -1, dtype=np.int64)
        self.numbers[needed] = np.arange(len(needed))
        self.images = torch.empty((len(needed), *library.image_shape), dtype=torch.uint8, device=device)
        for start in range(0, len(needed), _COPIED_AT_ONCE):
            part = torch.from_numpy(library.batch(needed[start : start + _COPIED_AT_ONCE]))
            self.images[start : start + len(part)].copy_(part)


def room_for(device: torch.device) -> int:
    """Return how many bytes panoramas may take on a device: a quarter of a GPU's free memory, 0 elsewhere."""
    if device.type != "cuda":
        return 0  # the library is in the same memory
    return int(SHARE * torch.cuda.mem_get_info(device)[0])


class Panoramas:
    """The panoramas of a table of frames, as a part of a batch.

    Args:
        library: decoded panoramas.
        frames: some of the library's frames.
        numbers: index on the device of each row of the library, `Resident.numbers`; None to gather images from the
            library.
    """

    def __init__(self, library: PanoramaLibrary, frames: FrameTable, numbers: NDArray[np.int64] | None = None) -> None:
        self.shape = library.image_shape
        self._library, self._rows, self._numbers = library, library.rows(frames), numbers

    def of(self, frames: Any) -> dict[str, Tensor]:
        """Return the `images` (B, 3, H, W) of some frames, or their numbers on the device as `rows` (B,)."""
        rows = self._rows[frames]
        if self._numbers is not None:
            return {"rows": torch.from_numpy(self._numbers[rows])}
        return {"images": torch.from_numpy(self._library.batch(rows))}


class DriveBatches(Dataset[dict[str, Any]]):
    """Batches of the map frames, then the queries, of a validation drive; every process has all of them.

    Args:
        columns: columns of the frames, by their names in a batch: `known` (n,), True for map frames, `xy` (n, 2) and
            the other fields of `siamloc.models.Origins`.
        panoramas: the images of the frames; None if they are among the columns.
    """

    def __init__(self, columns: dict[str, Tensor], panoramas: Panoramas | None = None) -> None:
        self._columns, self._panoramas = columns, panoramas

    def __len__(self) -> int:
        return -(-len(self._columns["known"]) // _DESCRIBED_AT_ONCE)

    def __getitem__(self, number: tuple[int, int]) -> dict[str, Any]:
        rows = slice(number[1] * _DESCRIBED_AT_ONCE, (number[1] + 1) * _DESCRIBED_AT_ONCE)
        images = {} if self._panoramas is None else self._panoramas.of(rows)
        return {**images, **{name: value[rows] for name, value in self._columns.items()}}


class EpochSampler(DistributedSampler):  # type: ignore[type-arg]
    """Number the batches of the current epoch as (epoch, batch).

    The trainer calls `set_epoch` before each epoch. The epoch is passed along with the number of the batch, so that
    workers that live for several epochs draw for the right one. This class is a `DistributedSampler`, so that the
    trainer does not replace it: the batches are already those of this process.

    Args:
        batches: number of batches in an epoch.
        epoch: the first epoch; None for validation, which has the pairs of epoch 0 in every epoch.
        start: an epoch and its first batch; all other epochs start with batch 0.
    """

    def __init__(self, batches: Sized, epoch: int | None = 0, start: tuple[int, int] = (0, 0)) -> None:
        super().__init__(batches, num_replicas=1, rank=0, shuffle=False)  # type: ignore[arg-type]
        self._moving = epoch is not None
        self._start = start
        self.set_epoch(epoch or 0)

    def __iter__(self) -> Iterator[tuple[int, int]]:  # type: ignore[override]
        epoch = self.epoch if self._moving else 0
        first = self._start[1] if self._moving and epoch == self._start[0] else 0
        return ((epoch, number) for number in range(first, len(self)))


class EpochDataModule(LightningDataModule):
    """Base of data modules whose batches depend on the number of the epoch, which is stored in the checkpoint.

    A checkpoint within an epoch also stores the number of the next batch.

    A trainer that resumes may request the first batches long before it knows which epoch it is in, and keeps them.

    A GPU with enough memory keeps all panoramas, and a batch transfers only their numbers, unless its images are
    augmented on the CPU; otherwise batches are transferred from pinned memory.

    Args:
        library: decoded panoramas of all frames; None if images come from elsewhere.
        workers: processes that gather batches; 0 gathers in the training process, which is fastest on a CPU.
        augmentation: changes the training images, such as their contrast; None leaves them as they are.
    """

    _first_epoch = 0
    _first_batch = 0

    def __init__(self, library: PanoramaLibrary | None, workers: int, augmentation: BatchAugmentation | None) -> None:
        super().__init__()
        self.library = library
        self.workers = int(workers)
        self.augmentation = augmentation
        self._resident: Resident | None = None

    def next_epoch(self) -> int:
        """Return the number of the epoch whose batches come next."""
        if self.trainer is None:
            return 0
        return max(self._first_epoch, self.trainer.fit_loop.epoch_progress.current.processed)  # type: ignore[attr-defined]

    def state_dict(self) -> dict[str, Any]:
        """Return the epoch and the batch that come next, for the checkpoint."""
        batch = 0
        if self.trainer is not None:
            done = self.trainer.fit_loop.epoch_loop.batch_progress.current.processed  # type: ignore[attr-defined]
            batch = done if done < self.trainer.num_training_batches else 0
        return {"epoch": self.next_epoch(), "batch": batch}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the epoch and the batch from a checkpoint."""
        self._first_epoch, self._first_batch = int(state_dict["epoch"]), int(state_dict.get("batch", 0))

    def share(self) -> tuple[int, int]:
        """Return the rank of this process among those that train together, and their number."""
        return (0, 1) if self.trainer is None else (self.trainer.global_rank, self.trainer.world_size)

    def check_processes(self, processes: int) -> None:
        """Raise ConfigError unless there are enough pairs or places for this number of processes."""

    def notes(self) -> list[str]:
        """Return a sentence about each property that the frames lack for the requested batches."""
        return []

    def needed(self) -> list[FrameTable]:
        """Return the tables of the library's frames that occur in the batches."""
        return []

    def numbers(self, augmentation: BatchAugmentation | None) -> NDArray[np.int64] | None:
        """Return the index on the trainer's device of each row of the library; None if images stay in the library.

        The first call transfers the images.
        """
        changed_here = augmentation is not None and augmentation.where == "cpu"
        if self.trainer is None or self.library is None or changed_here:
            return None
        device = self.trainer.strategy.root_device
        if self._resident is None or self._resident.images.device != device:
            rows = np.unique(np.concatenate([self.library.rows(frames) for frames in self.needed()]))
            if len(rows) * math.prod(self.library.image_shape) > room_for(device):
                return None
            self._resident = Resident(self.library, rows, device)
        return self._resident.numbers

    def teardown(self, stage: str) -> None:
        """Free the memory of the device."""
        self._resident = None

    def transfer_batch_to_device(
        self, batch: dict[str, Any], device: torch.device, dataloader_idx: int
    ) -> dict[str, Any]:
        """Transfer a batch to the device, except its augmentation, which transfers itself."""
        rest = {name: value for name, value in batch.items() if name != "change"}
        rest = super().transfer_batch_to_device(rest, device, dataloader_idx)
        return {**rest, "change": batch["change"]} if "change" in batch else rest

    def on_after_batch_transfer(self, batch: dict[str, Any], dataloader_idx: int) -> dict[str, Any]:
        """Gather and augment the images of a batch on the device, if that is where they are."""
        if "rows" in batch:
            assert self._resident is not None
            batch["images"] = self._resident.images.index_select(0, batch.pop("rows"))
        if "change" in batch:
            assert self.augmentation is not None
            batch["images"] = self.augmentation.effect.play(batch["images"], batch.pop("change"))
        return batch

    def loader(self, batches: Dataset[Any], epoch: int | None) -> DataLoader[Any]:
        """Make the loader of whole batches, where item (epoch, i) is one batch; see `EpochSampler`."""
        return DataLoader(
            batches,
            batch_size=None,
            sampler=EpochSampler(batches, epoch, (self._first_epoch, self._first_batch)),  # type: ignore[arg-type]
            num_workers=self.workers,
            persistent_workers=self.workers > 0,
            pin_memory=self.trainer is not None and self.trainer.strategy.root_device.type == "cuda",
            generator=torch.Generator().manual_seed(0),  # keeps the loader from using the global generator
        )
