"""`PairDataModule`: batches of pairs for training and validation, new ones in every epoch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from foundation.calls import typed
from foundation.settings import Count
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.pairs import PairSampler, PairSettings
from siamloc.errors import ConfigError, SiamlocError
from siamloc.training.batches import BatchAugmentation, EpochDataModule, Panoramas

_STREAM = 0xA06  # separates the draws of the augmentation from those of the pairs
_DRAWN_AT_ONCE = 1024  # pairs, whatever the size of a batch and the number of processes


@dataclass(eq=False)
class PairBatches(Dataset[dict[str, Any]]):
    """The batches of pairs of every epoch: item (epoch, i) is a whole batch.

    Each item is a dictionary: `images` (2 B, 3, H, W) uint8, the first images of the pairs and then the second ones,
    or `rows` (2 B,) as in `Panoramas.of`; `label` (B,) float32 and `same` (B,) bool.

    Attributes:
        panoramas: gives the images of the sampler's frames, or their numbers on the device.
        sampler: draws the pairs of frames of each epoch, with their labels.
        batch_size: pairs in a batch; the last batch may be smaller.
        augmentation: changes the training images, such as their contrast; None leaves them as they are.
        rank: number of this process among those that train together.
        world_size: number of those processes. All get the same number of pairs, and no two the same pair.
    """

    panoramas: Panoramas
    sampler: PairSampler
    batch_size: int
    augmentation: BatchAugmentation | None = None
    rank: int = 0
    world_size: int = 1

    def __post_init__(self) -> None:
        self._pairs_of_each = len(self.sampler) // self.world_size
        self._epoch = -1
        self._blocks: dict[tuple[int, int, int], dict[str, Tensor]] = {}  # parameters for blocks of pairs

    def __len__(self) -> int:
        return -(-self._pairs_of_each // self.batch_size)

    def __getitem__(self, number: tuple[int, int]) -> dict[str, Any]:
        epoch, batch = number
        if epoch != self._epoch:
            drawn = self.sampler.epoch(epoch, self.rank, self.world_size)
            self._pairs, self._epoch = drawn.take(slice(self._pairs_of_each)), epoch
        rows = slice(batch * self.batch_size, (batch + 1) * self.batch_size)
        pairs = self._pairs.take(rows)
        item: dict[str, Any] = {"label": torch.from_numpy(pairs.label), "same": torch.from_numpy(pairs.same)}
        item |= self.panoramas.of(np.concatenate([pairs.first, pairs.second]))
        if self.augmentation is not None:
            self.augmentation.apply(item, self._drawn(epoch, rows), self.panoramas.shape)
        return item

    def _drawn(self, epoch: int, rows: slice) -> dict[str, Tensor]:
        """Return the augmentation parameters for the first images of some pairs, and then for their second images."""
        assert self.augmentation is not None
        draw, shape = self.augmentation.draw, self.panoramas.shape
        mine = np.arange(*rows.indices(self._pairs_of_each)) * self.world_size + self.rank
        blocks, numbers = np.divmod(mine, _DRAWN_AT_ONCE)
        keys = [(epoch, side, block) for side in (0, 1) for block in np.unique(blocks).tolist()]
        self._blocks = {key: self._blocks.get(key) or draw((*key, _STREAM), _DRAWN_AT_ONCE, shape) for key in keys}
        parts = [(params, torch.from_numpy(numbers[blocks == key[2]])) for key, params in self._blocks.items()]
        return {name: torch.cat([params[name][some] for params, some in parts]) for name in parts[0][0]}


class PairDataModule(EpochDataModule):
    """Serve pairs of panoramas to a `SiameseModule`.

    The training pairs of an epoch follow from the seed and the number of the epoch, so that a resumed run sees the same
    pairs as an uninterrupted one. With several processes each gets its own share, all of the same length. Works with
    any `Trainer`; in a training loop without one, `on_after_batch_transfer(batch, 0)` makes what a `SiameseModule`
    takes of each batch of the loaders.

    Args:
        library: decoded panoramas of all frames.
        train: training frames, among those of the library.
        validation: validation frames, or None; pairs of them are drawn by the same settings, once for all epochs.
        pairs: which pairs to draw, for both; the defaults of `PairSettings` if None.
        batch_size: pairs in a batch.
        drive: map frames and queries that are described after the validation pairs, such as `validation_drive` makes.
        workers: processes that gather batches; 0 gathers in the training process, which is fastest on a CPU.
        augmentation: changes the training images, such as their contrast; None leaves them as they are.
        seed: seed of the draws of pairs, in training and validation.

    Raises:
        ConfigError: a batch size below 1.
    """

    library: PanoramaLibrary

    @typed
    def __init__(
        self,
        library: PanoramaLibrary,
        train: FrameTable,
        validation: FrameTable | None = None,
        *,
        pairs: PairSettings | None = None,
        batch_size: Count = 16,
        drive: Dataset[Any] | None = None,
        workers: int = 0,
        augmentation: BatchAugmentation | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(library, workers, augmentation)
        self._batch_size, self._drive = batch_size, drive
        self.sampler = PairSampler(train, pairs, seed=seed)
        self.validation_sampler: PairSampler | None = None
        if validation is not None:
            # Labels mean the same in both: distances are divided by the same scale.
            label = self.sampler.label
            scale = self.sampler.scale if label == "distance" else None
            settings = replace(self.sampler.settings, label=label, epoch_pairs=None, scale=scale)
            if settings.same_room_share is None and len(set(validation.place.tolist())) == 1:
                settings = replace(settings, same_room_share=1.0)  # it has no others
            try:
                self.validation_sampler = PairSampler(validation, settings, seed=seed)
            except SiamlocError as error:
                raise type(error)(f"of the validation: {error}") from error

    def check_processes(self, processes: int) -> None:
        """Raise ConfigError if there are fewer pairs than processes."""
        for sampler, what, more in (
            (self.sampler, "pairs", "request more with pairs.epoch_pairs"),
            (self.validation_sampler, "validation pairs", "give more frames"),
        ):
            if sampler is not None and len(sampler) < processes:
                raise ConfigError(
                    f"{len(sampler)} {what} are fewer than the {processes} processes that train together: {more}, or "
                    "train with fewer processes (trainer.devices, trainer.num_nodes)"
                )

    def train_dataloader(self) -> DataLoader[Any]:
        """Make the loader of the training batches."""
        return self.loader(self._batches(self.sampler, self.augmentation), self.next_epoch())

    def val_dataloader(self) -> list[DataLoader[Any]]:
        """Make the loaders of the validation pairs and of the drive; an empty list without validation frames."""
        if self.validation_sampler is None:
            return []
        parts = [self._batches(self.validation_sampler, None), *([] if self._drive is None else [self._drive])]
        return [self.loader(part, None) for part in parts]

    def on_after_batch_transfer(self, batch: dict[str, Any], dataloader_idx: int) -> dict[str, Any]:
        """Gather and augment the images if that is done on the device, and part them into `first` and `second`."""
        batch = super().on_after_batch_transfer(batch, dataloader_idx)
        if "known" in batch:  # of a drive
            return batch
        first, second = batch.pop("images").chunk(2)
        return {**batch, "first": first, "second": second}

    def needed(self) -> list[FrameTable]:
        """Return the training and the validation frames."""
        samplers = (self.sampler, self.validation_sampler)
        return [sampler.frames for sampler in samplers if sampler is not None]

    def _batches(self, sampler: PairSampler, augmentation: BatchAugmentation | None) -> PairBatches:
        panoramas = Panoramas(self.library, sampler.frames, self.numbers(augmentation))
        return PairBatches(panoramas, sampler, self._batch_size, augmentation, *self.share())
