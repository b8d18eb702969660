"""`PairDataModule`: batches of pairs for training and validation, new ones in every epoch; and what it is built on."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence, Sized
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, DistributedSampler

from augment.base import Effect
from augment.torchvision_compat import ensure_torchvision
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.pairs import Pairs, PairSampler, PairSettings
from siamloc.errors import ConfigError, SiamlocError
from siamloc.training.resident import Resident, room_for

ensure_torchvision()
from lightning.pytorch import LightningDataModule  # noqa: E402

_STREAM = 0xA06  # sets the draws of the augmentation apart from those of the pairs


@dataclass(frozen=True)
class BatchAugmentation:
    """Augment training images as their batches are gathered.

    What happens to an image follows from the seed and its number among those that are drawn together: not from the
    workers that gather, nor from the ranks that train together.

    Attributes:
        effect: an effect or a policy of `augment`.
        where: "cpu", where batches are gathered, or "gpu", after the batch has come to the device.
        seed: any whole number, not negative.

    Raises:
        ConfigError: another place.
    """

    effect: Effect
    where: str = "cpu"
    seed: int = 0

    def __post_init__(self) -> None:
        if self.where not in ("cpu", "gpu"):
            raise ConfigError(f"augment.where must be cpu or gpu, got {self.where!r}")

    def draw(self, stream: Sequence[int], images: int, image_shape: tuple[int, ...], mine: slice) -> dict[str, Tensor]:
        """Draw the parameters of some of the images that are drawn together; the stream sets them apart from others."""
        whole = torch.empty((images, *image_shape), dtype=torch.uint8, device="meta")  # for its shape only
        words = np.random.SeedSequence([self.seed, *stream]).generate_state(1, np.uint64)
        drawn = self.effect.draw(torch.Generator().manual_seed(int(words[0] >> np.uint64(1))), whole)
        return {name: value[mine] for name, value in drawn.items()}


class PairBatches(Dataset[dict[str, Any]]):
    """The batches of every epoch: item (epoch, i) is a whole batch, gathered at once from the library.

    Each item is a dictionary: `first` and `second` (B, 3, H, W) uint8, `label` (B,) float32, `same` (B,) bool. Where
    the panoramas lie on the device, it has in place of the images their numbers there, those of both: `rows` (2 B,).

    Args:
        library: decoded panoramas.
        sampler: draws the pairs.
        batch_size: pairs in a batch; the last batch may be smaller.
        augmentation: what happens to the images, if anything.
        rank: number of this process among those that train together.
        world_size: how many those are. All get the same number of pairs, and no two the same pair.
        numbers: those of the library's rows on the device, `Resident.numbers`; None where images are gathered here.

    Raises:
        ConfigError: fewer pairs than processes.
    """

    def __init__(
        self,
        library: PanoramaLibrary,
        sampler: PairSampler,
        batch_size: int,
        augmentation: BatchAugmentation | None = None,
        rank: int = 0,
        world_size: int = 1,
        numbers: NDArray[np.int64] | None = None,
    ) -> None:
        check_pairs_of_each(len(sampler), world_size)
        self._pairs_of_each = len(sampler) // world_size
        self._library = library
        self._sampler = sampler
        self._rows = library.rows(sampler.frames)
        self._batch_size = batch_size
        self._augmentation = augmentation
        self._rank, self._world_size = rank, world_size
        self._numbers = numbers
        self._epoch = -1

    def __len__(self) -> int:
        return -(-self._pairs_of_each // self._batch_size)

    def __getitem__(self, number: tuple[int, int]) -> dict[str, Any]:
        epoch, batch = number
        if not 0 <= batch < len(self):
            raise IndexError(f"batch {batch} of {len(self)}")
        if epoch != self._epoch:
            self._draw(epoch)
        rows = slice(batch * self._batch_size, (batch + 1) * self._batch_size)
        pairs = self._pairs.take(rows)
        wanted = self._rows[np.concatenate([pairs.first, pairs.second])]
        item: dict[str, Any] = {"label": torch.from_numpy(pairs.label), "same": torch.from_numpy(pairs.same)}
        params: dict[str, Tensor] = {}
        if self._augmentation is not None:
            params = {name: torch.cat([side[name][rows] for side in self._drawn]) for name in self._drawn[0]}
            if self._augmentation.where == "gpu":
                item["change"] = params
        if self._numbers is not None:
            return {**item, "rows": torch.from_numpy(self._numbers[wanted])}
        images = torch.from_numpy(self._library.batch(wanted))
        if self._augmentation is not None and self._augmentation.where == "cpu":
            images = self._augmentation.effect.apply(images, params)
        first, second = images.chunk(2)
        return {**item, "first": first, "second": second}

    def _draw(self, epoch: int) -> None:
        self._pairs: Pairs = self._sampler.epoch(epoch, self._rank, self._world_size).take(slice(self._pairs_of_each))
        if self._augmentation is not None:
            mine = slice(self._rank, self._pairs_of_each * self._world_size, self._world_size)
            pairs, shape = len(self._sampler), self._library.image_shape
            self._drawn = [self._augmentation.draw((epoch, side, _STREAM), pairs, shape, mine) for side in (0, 1)]
        self._epoch = epoch


def check_pairs_of_each(
    pairs: int, processes: int, what: str = "pairs", more: str = "ask for more by pairs.epoch_pairs"
) -> None:
    """Raise ConfigError where there are fewer pairs than processes."""
    if pairs < processes:
        raise ConfigError(
            f"{pairs} {what} are fewer than the {processes} processes that train together: {more}, or train with fewer "
            "processes (trainer.devices, trainer.num_nodes)"
        )


class EpochSampler(DistributedSampler):  # type: ignore[type-arg]
    """Number the batches of the current epoch as (epoch, batch).

    The trainer calls `set_epoch` before each epoch. The epoch travels with the number of the batch, so that workers
    which live through several epochs draw for the right one. Since the batches are those of this process already, it
    is a `DistributedSampler`: the trainer puts no other one in its place.

    Args:
        batches: in an epoch.
        epoch: to begin with; None for validation, which has the pairs of epoch 0 in every epoch.
        start: an epoch and the batch that it begins with; all others begin with batch 0.
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
    """Base of data modules whose batches follow from the number of the epoch; the number travels in the checkpoint.

    In a checkpoint within an epoch the number of the next batch travels too.

    A trainer that resumes may ask for the first batches long before it knows which epoch it is in, and keeps them.

    On a GPU with room enough all panoramas lie there, and a batch brings their numbers only, unless its images are
    changed before; otherwise batches travel there from pinned memory.

    Args:
        library: decoded panoramas of all frames.
        workers: processes that gather batches; 0 gathers in the training process, which is fastest on a CPU.
        augmentation: what happens to training images; nothing if None.
    """

    _first_epoch = 0
    _first_batch = 0

    def __init__(self, library: PanoramaLibrary, workers: int, augmentation: BatchAugmentation | None) -> None:
        super().__init__()
        self.library = library
        self.workers = int(workers)
        self.augmentation = augmentation
        self._resident: Resident | None = None

    def next_epoch(self) -> int:
        """Return the epoch whose batches are asked for."""
        if self.trainer is None:
            return 0
        return max(self._first_epoch, self.trainer.fit_loop.epoch_progress.current.processed)  # type: ignore[attr-defined]

    def state_dict(self) -> dict[str, Any]:
        """Give the checkpoint the epoch and the batch that come next."""
        batch = 0
        if self.trainer is not None:
            done = self.trainer.fit_loop.epoch_loop.batch_progress.current.processed  # type: ignore[attr-defined]
            batch = done if done < self.trainer.num_training_batches else 0
        return {"epoch": self.next_epoch(), "batch": batch}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take over the epoch and the batch of a checkpoint."""
        self._first_epoch, self._first_batch = int(state_dict["epoch"]), int(state_dict.get("batch", 0))

    def share(self) -> tuple[int, int]:
        """Return the number of this process among those that train together, and how many those are."""
        return (0, 1) if self.trainer is None else (self.trainer.global_rank, self.trainer.world_size)

    def check_processes(self, processes: int) -> None:
        """Raise ConfigError unless there is something to learn from for each of so many processes."""
        raise NotImplementedError

    def notes(self) -> list[str]:
        """Say what the frames lack of what was asked for, a sentence each."""
        return []

    def paths(self, epoch: int, batch: int) -> dict[str, NDArray[np.str_]]:
        """Return the files of a training batch of this process, by the name that its images have in the batch."""
        raise NotImplementedError

    def needed(self) -> list[FrameTable]:
        """Return the frames of all batches."""
        raise NotImplementedError

    def numbers(self, augmentation: BatchAugmentation | None) -> NDArray[np.int64] | None:
        """Return where the library's rows lie on the device of the trainer; None where images are gathered here.

        The first call brings them there.
        """
        changed_here = augmentation is not None and augmentation.where == "cpu"
        if self.trainer is None or changed_here:
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
        """Bring a batch to the device, but for the parameters of its augmentation, which are read in main memory."""
        rest = {name: value for name, value in batch.items() if name != "change"}
        rest = super().transfer_batch_to_device(rest, device, dataloader_idx)
        return {**rest, "change": batch["change"]} if "change" in batch else rest

    def on_after_batch_transfer(self, batch: dict[str, Any], dataloader_idx: int) -> dict[str, Any]:
        """Gather the images, and change them, where both were put off until the batch is on the device."""
        if "rows" in batch:
            assert self._resident is not None
            batch = {**self.parts(self._resident.batch(batch.pop("rows"))), **batch}
        if "change" in batch:
            assert self.augmentation is not None
            images = self.augmentation.effect.apply(self.whole(batch), batch.pop("change"))
            batch |= self.parts(images)
        return batch

    def parts(self, images: Tensor) -> dict[str, Tensor]:
        """Return the images of a batch by their names in it."""
        return {"images": images}

    def whole(self, batch: dict[str, Any]) -> Tensor:
        """Return all images of a batch."""
        images: Tensor = batch["images"]
        return images

    def loader(self, batches: Dataset[Any], epoch: int | None) -> DataLoader[Any]:
        """Make the loader of whole batches, of which item (epoch, i) is one; see `EpochSampler`."""
        return DataLoader(
            batches,
            batch_size=None,
            sampler=EpochSampler(batches, epoch, (self._first_epoch, self._first_batch)),  # type: ignore[arg-type]
            num_workers=self.workers,
            persistent_workers=self.workers > 0,
            pin_memory=self.trainer is not None and self.trainer.strategy.root_device.type == "cuda",
            generator=torch.Generator().manual_seed(0),  # keeps the loader from drawing on the global generator
        )


class PairDataModule(EpochDataModule):
    """Serve pairs of panoramas to a `SiameseModule`.

    The training pairs of an epoch follow from the seed and the number of the epoch, so that a resumed run sees the
    pairs it would have seen. Under several processes each gets its own share, all of them of one length. It works
    with any `Trainer` as it is.

    Args:
        library: decoded panoramas of all frames.
        train: training frames, among those of the library.
        validation: validation frames, or None.
        pairs: which pairs, for both; the defaults of `PairSettings` if None.
        batch_size: pairs in a batch.
        drive: map frames and queries that are described after the validation pairs, such as a `ValidationDrive`.
        validation_pairs: how many validation pairs; they are the same in every epoch. As many as there are
            validation frames if None.
        workers: processes that gather batches; 0 gathers in the training process, which is fastest on a CPU.
        augmentation: what happens to training images; nothing if None.
        seed: of the pairs.

    Raises:
        ConfigError: a batch size below 1.
    """

    def __init__(
        self,
        library: PanoramaLibrary,
        train: FrameTable,
        validation: FrameTable | None = None,
        *,
        pairs: PairSettings | None = None,
        batch_size: int = 16,
        drive: Dataset[Any] | None = None,
        validation_pairs: int | None = None,
        workers: int = 0,
        augmentation: BatchAugmentation | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(library, workers, augmentation)
        if int(batch_size) < 1:
            raise ConfigError(f"batch_size must be a whole number from 1, got {batch_size}")
        self._batch_size = int(batch_size)
        self._drive = drive
        self.sampler = PairSampler(train, pairs, seed=seed)
        self.validation_sampler: PairSampler | None = None
        if validation is not None:
            # Labels mean the same in both: distances are divided by one scale.
            scale = self.sampler.scale if self.sampler.label == "distance" else None
            settings = replace(
                self.sampler.settings, label=self.sampler.label, epoch_pairs=validation_pairs, scale=scale
            )
            try:
                self.validation_sampler = PairSampler(validation, settings, seed=seed)
            except SiamlocError as error:
                raise type(error)(f"of the validation: {error}") from error

    def check_processes(self, processes: int) -> None:
        """Raise ConfigError where there are fewer pairs than processes."""
        check_pairs_of_each(len(self.sampler), processes)
        if self.validation_sampler is not None:
            check_pairs_of_each(len(self.validation_sampler), processes, "validation pairs", "give more frames")

    def train_dataloader(self) -> DataLoader[Any]:
        """Make the loader of the training batches."""
        return self.loader(self._pair_batches(self.sampler, self.augmentation), self.next_epoch())

    def val_dataloader(self) -> DataLoader[Any] | list[Any]:
        """Make the loader of the validation batches; an empty list where there are no validation frames."""
        if self.validation_sampler is None:
            return []
        pairs = self._pair_batches(self.validation_sampler, None)
        return self.loader(pairs if self._drive is None else _InTurn(pairs, self._drive), None)

    def paths(self, epoch: int, batch: int) -> dict[str, NDArray[np.str_]]:
        """Return the files of the first and the second images of a training batch."""
        rank, world_size = self.share()
        mine = len(self.sampler) // world_size
        rows = slice(batch * self._batch_size, min((batch + 1) * self._batch_size, mine))
        pairs = self.sampler.epoch(epoch, rank, world_size).take(rows)
        files = self.sampler.frames.path
        return {"first": files[pairs.first], "second": files[pairs.second]}

    def needed(self) -> list[FrameTable]:
        """Return the training frames and those of the validation."""
        samplers = (self.sampler, self.validation_sampler)
        return [sampler.frames for sampler in samplers if sampler is not None]

    def parts(self, images: Tensor) -> dict[str, Tensor]:
        """Return the first and the second images."""
        first, second = images.chunk(2)
        return {"first": first, "second": second}

    def whole(self, batch: dict[str, Any]) -> Tensor:
        """Return the first images and the second ones after them."""
        return torch.cat([batch["first"], batch["second"]])

    def _pair_batches(self, sampler: PairSampler, augmentation: BatchAugmentation | None) -> PairBatches:
        numbers = self.numbers(augmentation)
        return PairBatches(self.library, sampler, self._batch_size, augmentation, *self.share(), numbers)


class _InTurn(Dataset[dict[str, Any]]):
    """All batches of one data set, then those of another."""

    def __init__(self, first: PairBatches, second: Dataset[Any]) -> None:
        self._first, self._second = first, second

    def __len__(self) -> int:
        return len(self._first) + len(cast(Sized, self._second))

    def __getitem__(self, number: tuple[int, int]) -> dict[str, Any]:
        epoch, batch = number
        before = len(self._first)
        return self._first[number] if batch < before else self._second[epoch, batch - before]
