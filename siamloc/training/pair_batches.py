"""`PairDataModule`: batches of pairs for training and validation, new ones in every epoch."""

from __future__ import annotations

from collections.abc import Sized
from dataclasses import replace
from typing import Any, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from augment.torchvision_compat import ensure_torchvision
from foundation.calls import typed
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.pairs import Pairs, PairSampler, PairSettings
from siamloc.errors import ConfigError, SiamlocError
from siamloc.training.batches import BatchAugmentation, EpochDataModule

ensure_torchvision()

_STREAM = 0xA06  # separates the draws of the augmentation from those of the pairs
_DRAWN_AT_ONCE = 1024  # pairs, whatever the size of a batch and the number of processes


class PairBatches(Dataset[dict[str, Any]]):
    """The batches of every epoch: item (epoch, i) is a whole batch, gathered at once from the library.

    Each item is a dictionary: `first` and `second` (B, 3, H, W) uint8, `label` (B,) float32, `same` (B,) bool. If the
    panoramas are on the device, the images are replaced by their numbers there, those of both: `rows` (2 B,).

    Args:
        library: decoded panoramas.
        sampler: draws the pairs.
        batch_size: pairs in a batch; the last batch may be smaller.
        augmentation: of the images, if any.
        rank: number of this process among those that train together.
        world_size: number of those processes. All get the same number of pairs, and no two the same pair.
        numbers: of the library's rows on the device, `Resident.numbers`; None if images are gathered here.

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
        self._blocks: dict[tuple[int, int, int], dict[str, Tensor]] = {}  # parameters for blocks of pairs

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
            params = self._drawn(epoch, rows)
            if self._augmentation.where == "gpu":
                item["change"] = self._augmentation.effect.program(params, *self._library.image_shape[1:])
        if self._numbers is not None:
            return {**item, "rows": torch.from_numpy(self._numbers[wanted])}
        images = torch.from_numpy(self._library.batch(wanted))
        if self._augmentation is not None and self._augmentation.where == "cpu":
            images = self._augmentation.effect.apply(images, params)
        first, second = images.chunk(2)
        return {**item, "first": first, "second": second}

    def _draw(self, epoch: int) -> None:
        self._pairs: Pairs = self._sampler.epoch(epoch, self._rank, self._world_size).take(slice(self._pairs_of_each))
        self._epoch = epoch

    def _drawn(self, epoch: int, rows: slice) -> dict[str, Tensor]:
        """Return the augmentation parameters for the first images of some pairs, and then for their second images."""
        assert self._augmentation is not None
        draw, shape = self._augmentation.draw, self._library.image_shape
        blocks, numbers = np.divmod(
            np.arange(*rows.indices(self._pairs_of_each)) * self._world_size + self._rank, _DRAWN_AT_ONCE
        )
        keys = [(epoch, side, block) for side in (0, 1) for block in np.unique(blocks).tolist()]
        self._blocks = {key: self._blocks.get(key) or draw((*key, _STREAM), _DRAWN_AT_ONCE, shape) for key in keys}
        parts = [(params, torch.from_numpy(numbers[blocks == key[2]])) for key, params in self._blocks.items()]
        return {name: torch.cat([params[name][some] for params, some in parts]) for name in parts[0][0]}


def check_pairs_of_each(
    pairs: int, processes: int, what: str = "pairs", more: str = "request more with pairs.epoch_pairs"
) -> None:
    """Raise ConfigError if there are fewer pairs than processes."""
    if pairs < processes:
        raise ConfigError(
            f"{pairs} {what} are fewer than the {processes} processes that train together: {more}, or train with fewer "
            "processes (trainer.devices, trainer.num_nodes)"
        )


class PairDataModule(EpochDataModule):
    """Serve pairs of panoramas to a `SiameseModule`.

    The training pairs of an epoch follow from the seed and the number of the epoch, so that a resumed run sees the same
    pairs as an uninterrupted one. With several processes each gets its own share, all of the same length. Works with
    any `Trainer`.

    Args:
        library: decoded panoramas of all frames.
        train: training frames, among those of the library.
        validation: validation frames, or None.
        pairs: which pairs to draw, for both; the defaults of `PairSettings` if None.
        batch_size: pairs in a batch.
        drive: map frames and queries that are described after the validation pairs, such as a `ValidationDrive`.
        validation_pairs: number of validation pairs, which are the same in every epoch; as many as there are
            validation frames if None.
        workers: processes that gather batches; 0 gathers in the training process, which is fastest on a CPU.
        augmentation: of the training images; none if None.
        seed: of the pairs.

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
            # Labels mean the same in both: distances are divided by the same scale.
            scale = self.sampler.scale if self.sampler.label == "distance" else None
            settings = replace(
                self.sampler.settings, label=self.sampler.label, epoch_pairs=validation_pairs, scale=scale
            )
            if settings.same_room_share is None and len(set(validation.place.tolist())) == 1:
                settings = replace(settings, same_room_share=1.0)  # it has no others
            try:
                self.validation_sampler = PairSampler(validation, settings, seed=seed)
            except SiamlocError as error:
                raise type(error)(f"of the validation: {error}") from error

    def check_processes(self, processes: int) -> None:
        """Raise ConfigError if there are fewer pairs than processes."""
        check_pairs_of_each(len(self.sampler), processes)
        if self.validation_sampler is not None:
            check_pairs_of_each(len(self.validation_sampler), processes, "validation pairs", "give more frames")

    def train_dataloader(self) -> DataLoader[Any]:
        """Make the loader of the training batches."""
        return self.loader(self._pair_batches(self.sampler, self.augmentation), self.next_epoch())

    def val_dataloader(self) -> DataLoader[Any] | list[Any]:
        """Make the loader of the validation batches; an empty list if there are no validation frames."""
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
        """Return the training and the validation frames."""
        samplers = (self.sampler, self.validation_sampler)
        return [sampler.frames for sampler in samplers if sampler is not None]

    def parts(self, images: Tensor) -> dict[str, Tensor]:
        """Return the first and the second images."""
        first, second = images.chunk(2)
        return {"first": first, "second": second}

    def whole(self, batch: dict[str, Any]) -> Tensor:
        """Return the first images, followed by the second ones."""
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
