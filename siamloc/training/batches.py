"""`PairDataModule`: batches of pairs for training and validation, new ones in every epoch."""

from __future__ import annotations

from collections.abc import Iterator, Sized
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, DistributedSampler

from augment.base import Effect
from augment.torchvision_compat import ensure_torchvision
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.pairs import Pairs, PairSampler, PairSettings
from siamloc.errors import ConfigError

ensure_torchvision()
from lightning.pytorch import LightningDataModule  # noqa: E402


@dataclass(frozen=True)
class PairAugmentation:
    """Augment the training pairs as they are gathered.

    What happens to an image follows from the seed, the epoch and the number of its pair alone: not from the batch it
    is in, nor from workers or ranks.

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

    def draw(self, epoch: int, pairs: int, image_shape: tuple[int, ...], mine: slice) -> list[dict[str, Tensor]]:
        """Draw the parameters of some of an epoch's pairs: those of the first images, and those of the second."""
        whole = torch.empty((pairs, *image_shape), dtype=torch.uint8, device="meta")  # for its shape only
        sides: list[dict[str, Tensor]] = []
        for side in (0, 1):
            # The last word sets the stream apart from the one that draws the pairs.
            words = np.random.SeedSequence([self.seed, epoch, side, 0xA06]).generate_state(1, np.uint64)
            generator = torch.Generator().manual_seed(int(words[0] >> np.uint64(1)))
            drawn = self.effect.draw(generator, whole)
            sides.append({name: value[mine] for name, value in drawn.items()})
        return sides

    def draw_batch(
        self, epoch: int, batch: int, images: int, image_shape: tuple[int, ...], mine: slice
    ) -> dict[str, Tensor]:
        """Draw the parameters of some of the images of one batch, whose number decides them together with the epoch."""
        whole = torch.empty((images, *image_shape), dtype=torch.uint8, device="meta")  # for its shape only
        words = np.random.SeedSequence([self.seed, epoch, batch, 0xA07]).generate_state(1, np.uint64)
        drawn = self.effect.draw(torch.Generator().manual_seed(int(words[0] >> np.uint64(1))), whole)
        return {name: value[mine] for name, value in drawn.items()}


class PairBatches(Dataset[dict[str, Any]]):
    """The batches of every epoch: item (epoch, i) is a whole batch, gathered at once from the library.

    Each item is a dictionary: `first` and `second` (B, 3, H, W) uint8, `label` (B,) float32, `same` (B,) bool.

    Args:
        library: decoded panoramas.
        sampler: draws the pairs.
        batch_size: pairs in a batch; the last batch may be smaller.
        augmentation: what happens to the images, if anything.
        rank: number of this process among those that train together.
        world_size: how many those are. All get the same number of pairs, and no two the same pair.

    Raises:
        ConfigError: fewer pairs than processes.
    """

    def __init__(
        self,
        library: PanoramaLibrary,
        sampler: PairSampler,
        batch_size: int,
        augmentation: PairAugmentation | None = None,
        rank: int = 0,
        world_size: int = 1,
    ) -> None:
        self._pairs_of_each = len(sampler) // world_size
        if self._pairs_of_each == 0:
            raise ConfigError(f"{len(sampler)} pairs are fewer than the {world_size} processes that train together")
        self._library = library
        self._sampler = sampler
        self._rows = library.rows(sampler.frames)
        self._batch_size = batch_size
        self._augmentation = augmentation
        self._rank, self._world_size = rank, world_size
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
        images = torch.from_numpy(self._library.batch(self._rows[np.concatenate([pairs.first, pairs.second])]))
        later = {}
        if self._augmentation is not None:
            params = {name: torch.cat([side[name][rows] for side in self._drawn]) for name in self._drawn[0]}
            if self._augmentation.where == "gpu":
                later = {"change": params}
            else:
                images = self._augmentation.effect.apply(images, params)
        first, second = images.chunk(2)
        label, same = torch.from_numpy(pairs.label), torch.from_numpy(pairs.same)
        return {**later, "first": first, "second": second, "label": label, "same": same}

    def _draw(self, epoch: int) -> None:
        self._pairs: Pairs = self._sampler.epoch(epoch, self._rank, self._world_size).take(slice(self._pairs_of_each))
        if self._augmentation is not None:
            mine = slice(self._rank, self._pairs_of_each * self._world_size, self._world_size)
            self._drawn = self._augmentation.draw(epoch, len(self._sampler), self._library.image_shape, mine)
        self._epoch = epoch


class EpochSampler(DistributedSampler):  # type: ignore[type-arg]
    """Number the batches of the current epoch as (epoch, batch).

    The trainer calls `set_epoch` before each epoch. The epoch travels with the number of the batch, so that workers
    which live through several epochs draw for the right one. Since the batches are those of this process already, it
    is a `DistributedSampler`: the trainer puts no other one in its place.

    Args:
        batches: in an epoch.
        epoch: to begin with; None for validation, which has the pairs of epoch 0 in every epoch.
    """

    def __init__(self, batches: Sized, epoch: int | None = 0) -> None:
        super().__init__(batches, num_replicas=1, rank=0, shuffle=False)  # type: ignore[arg-type]
        self._moving = epoch is not None
        self.set_epoch(epoch or 0)

    def __iter__(self) -> Iterator[tuple[int, int]]:  # type: ignore[override]
        epoch = self.epoch if self._moving else 0
        return ((epoch, number) for number in range(len(self)))


class EpochDataModule(LightningDataModule):
    """Base of data modules whose batches follow from the number of the epoch; the number travels in the checkpoint.

    A trainer that resumes may ask for the first batches long before it knows which epoch it is in, and keeps them.
    """

    _first_epoch = 0

    def next_epoch(self) -> int:
        """Return the epoch whose batches are asked for."""
        if self.trainer is None:
            return 0
        return max(self._first_epoch, self.trainer.fit_loop.epoch_progress.current.processed)  # type: ignore[attr-defined]

    def state_dict(self) -> dict[str, Any]:
        """Give the checkpoint the epoch that comes next."""
        return {"epoch": self.next_epoch()}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take over the epoch of a checkpoint."""
        self._first_epoch = int(state_dict["epoch"])


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
        validation_pairs: int | None = None,
        workers: int = 0,
        augmentation: PairAugmentation | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__()
        if int(batch_size) < 1:
            raise ConfigError(f"batch_size must be a whole number from 1, got {batch_size}")
        self._library = library
        self._batch_size = int(batch_size)
        self._workers = int(workers)
        self._augmentation = augmentation
        self.sampler = PairSampler(train, pairs, seed=seed)
        self.validation_sampler: PairSampler | None = None
        if validation is not None:
            # Labels mean the same in both: distances are divided by one scale.
            scale = self.sampler.scale if self.sampler.label == "distance" else None
            settings = replace(
                self.sampler.settings, label=self.sampler.label, epoch_pairs=validation_pairs, scale=scale
            )
            self.validation_sampler = PairSampler(validation, settings, seed=seed)

    def train_dataloader(self) -> DataLoader[Any]:
        """Make the loader of the training batches."""
        return self._loader(self.sampler, self._augmentation, self.next_epoch())

    def val_dataloader(self) -> DataLoader[Any] | list[Any]:
        """Make the loader of the validation batches; an empty list where there are no validation frames."""
        return [] if self.validation_sampler is None else self._loader(self.validation_sampler, None, None)

    def on_after_batch_transfer(self, batch: dict[str, Any], dataloader_idx: int) -> dict[str, Any]:
        """Apply the augmentation that was put off until the batch is on the device."""
        params = batch.pop("change", None)
        if params is not None and self._augmentation is not None:
            images = torch.cat([batch["first"], batch["second"]])
            batch["first"], batch["second"] = self._augmentation.effect.apply(images, params).chunk(2)
        return batch

    def _loader(
        self, sampler: PairSampler, augmentation: PairAugmentation | None, epoch: int | None
    ) -> DataLoader[Any]:
        rank, world_size = (0, 1) if self.trainer is None else (self.trainer.global_rank, self.trainer.world_size)
        batches = PairBatches(self._library, sampler, self._batch_size, augmentation, rank, world_size)
        return DataLoader(
            batches,
            batch_size=None,
            sampler=EpochSampler(batches, epoch),
            num_workers=self._workers,
            persistent_workers=self._workers > 0,
            generator=torch.Generator().manual_seed(0),  # keeps the loader from drawing on the global generator
        )
