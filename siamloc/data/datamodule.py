"""`PairDataModule`: batches of pairs for training and validation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from augment import Policy
from augment.torchvision_compat import ensure_torchvision
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.pairs import Pairs, PairSampler
from siamloc.errors import ConfigError

ensure_torchvision()
from lightning.pytorch import LightningDataModule  # noqa: E402


@dataclass(frozen=True)
class PairChange:
    """What happens to the images of some pairs: the parameters of an epoch's augmentation.

    Attributes:
        policy: what is applied.
        first: parameters of the first images, a row per pair.
        second: parameters of the second images.
        on_device: applied after the batch has come to the device, instead of where it is gathered.
    """

    policy: Policy
    first: dict[str, Tensor]
    second: dict[str, Tensor]
    on_device: bool

    def of(self, rows: slice) -> dict[str, Tensor]:
        """Return the parameters of these pairs' images, the first ones before the second ones."""
        return {name: torch.cat([self.first[name][rows], self.second[name][rows]]) for name in self.first}


@dataclass(frozen=True)
class PairAugmentation:
    """Augmentation of training pairs on the fly.

    What happens to an image follows from the seed, the epoch and the number of its pair alone: not from the batch it
    is in, nor from workers or ranks.

    Attributes:
        policy: of `augment`.
        where: "cpu", where batches are gathered, or "gpu", after the batch has come to the device.
        seed: any whole number, not negative.

    Raises:
        ConfigError: another place.
    """

    policy: Policy
    where: str = "cpu"
    seed: int = 0

    def __post_init__(self) -> None:
        if self.where not in ("cpu", "gpu"):
            raise ConfigError(f"augment.where must be cpu or gpu, got {self.where!r}")

    def draw(self, epoch: int, pairs: int, image_shape: tuple[int, ...], mine: slice) -> PairChange:
        """Return the parameters of some of an epoch's pairs."""
        whole = torch.empty((pairs, *image_shape), dtype=torch.uint8, device="meta")  # for its shape only
        sides: list[dict[str, Tensor]] = []
        for side in (0, 1):
            # The last word sets the stream apart from the one that draws the pairs.
            words = np.random.SeedSequence([self.seed, epoch, side, 0xA06]).generate_state(1, np.uint64)
            generator = torch.Generator().manual_seed(int(words[0] >> np.uint64(1)))
            drawn = self.policy.draw(generator, whole)
            sides.append({name: value[mine] for name, value in drawn.items()})
        return PairChange(self.policy, sides[0], sides[1], on_device=self.where == "gpu")


class PairBatches(Dataset[dict[str, Any]]):
    """The batches of an epoch: item i is a whole batch, gathered at once from the store.

    Each item is a dictionary: `first` and `second` (B, 3, H, W) uint8, `label` (B,) float32, `same` (B,) bool.

    Args:
        library: decoded panoramas.
        frames: frames that the pairs count in.
        pairs: pairs of an epoch.
        batch_size: pairs in a batch; the last batch may be smaller.
        change: what happens to the images of these pairs, if anything; see `PairAugmentation`.
    """

    def __init__(
        self,
        library: PanoramaLibrary,
        frames: FrameTable,
        pairs: Pairs,
        batch_size: int,
        change: PairChange | None = None,
    ) -> None:
        self._change = change
        self._library = library
        rows = library.rows(frames)
        self._first = rows[pairs.first]
        self._second = rows[pairs.second]
        self._pairs = pairs
        self._batch_size = batch_size

    def __len__(self) -> int:
        return -(-len(self._pairs) // self._batch_size)

    def __getitem__(self, number: int) -> dict[str, Any]:
        if not 0 <= number < len(self):
            raise IndexError(f"batch {number} of {len(self)}")
        rows = slice(number * self._batch_size, (number + 1) * self._batch_size)
        images = torch.from_numpy(self._library.batch(np.concatenate([self._first[rows], self._second[rows]])))
        later = {}
        if self._change is not None:
            params = self._change.of(rows)
            if self._change.on_device:
                later = {"change": params}
            else:
                images = self._change.policy.apply(images, params)
        first, second = images.chunk(2)
        return {
            **later,
            "first": first,
            "second": second,
            "label": torch.from_numpy(self._pairs.label[rows]),
            "same": torch.from_numpy(self._pairs.same[rows]),
        }


class PairDataModule(LightningDataModule):
    """Pairs of panoramas for `SiameseModule`.

    The training pairs of an epoch follow from the seed and the number of the epoch, so that a resumed run sees the
    pairs it would have seen. Under several processes each gets its own share, all of them of one length. The
    trainer has to be told `reload_dataloaders_every_n_epochs=1` and `use_distributed_sampler=False`.

    Args:
        library: decoded panoramas of all frames.
        train: training frames, a selection of `library.frames`.
        validation: validation frames, or None.
        pairs: parameters of `PairSampler` for both.
        batch_size: pairs in a batch.
        validation_pairs: how many validation pairs; they are the same in every epoch. As many as there are
            validation frames if None.
        workers: processes that gather batches; 0 gathers in the training process, which is fastest on a CPU.
        augmentation: what happens to training images; nothing if None.

    Raises:
        ConfigError: a batch size below 1, or an epoch with fewer pairs than processes.
    """

    def __init__(
        self,
        library: PanoramaLibrary,
        train: FrameTable,
        validation: FrameTable | None,
        pairs: Mapping[str, Any],
        batch_size: int,
        validation_pairs: int | None = None,
        workers: int = 0,
        augmentation: PairAugmentation | None = None,
    ) -> None:
        super().__init__()
        self._augmentation = augmentation
        if int(batch_size) < 1:
            raise ConfigError(f"batch_size must be at least 1, got {batch_size}")
        self._library = library
        self._train = train
        self._validation = validation
        self._batch_size = int(batch_size)
        self._workers = int(workers)
        self.sampler = PairSampler(train, **pairs)
        self._validation_sampler: PairSampler | None = None
        if validation is not None:
            options = {**pairs, "label": self.sampler.label, "epoch_pairs": validation_pairs}
            if self.sampler.label == "distance":
                options["scale"] = self.sampler.scale
            self._validation_sampler = PairSampler(validation, **options)

    def train_dataloader(self) -> DataLoader[Any]:
        """Return the batches of the trainer's current epoch."""
        epoch, rank, world_size = 0, 0, 1
        if self.trainer is not None:
            epoch, rank, world_size = self.trainer.current_epoch, self.trainer.global_rank, self.trainer.world_size
        mine = self.sampler.epoch(epoch, rank, world_size)
        even = self.sampler.epoch_pairs // world_size
        if even == 0:
            raise ConfigError(f"epoch_pairs={self.sampler.epoch_pairs} is fewer than the {world_size} processes")
        change = None
        if self._augmentation is not None:
            taken = slice(rank, even * world_size, world_size)
            shape = self._library.image_shape
            change = self._augmentation.draw(epoch, self.sampler.epoch_pairs, shape, taken)
        return self._loader(self._train, mine.take(slice(even)), change)

    def val_dataloader(self) -> DataLoader[Any] | list[Any]:
        """Return the validation batches; an empty list where there are no validation frames."""
        if self._validation_sampler is None or self._validation is None:
            return []
        rank, world_size = (self.trainer.global_rank, self.trainer.world_size) if self.trainer is not None else (0, 1)
        return self._loader(self._validation, self._validation_sampler.epoch(0, rank, world_size))

    def on_after_batch_transfer(self, batch: dict[str, Any], dataloader_idx: int) -> dict[str, Any]:
        """Apply the augmentation that was put off until the batch is on the device."""
        params = batch.pop("change", None)
        if params is not None and self._augmentation is not None:
            images = torch.cat([batch["first"], batch["second"]])
            batch["first"], batch["second"] = self._augmentation.policy.apply(images, params).chunk(2)
        return batch

    def _loader(self, frames: FrameTable, pairs: Pairs, change: PairChange | None = None) -> DataLoader[Any]:
        batches = PairBatches(self._library, frames, pairs, self._batch_size, change)
        own = torch.Generator().manual_seed(0)  # keeps the loader from drawing on the global generator
        return DataLoader(batches, batch_size=None, shuffle=False, num_workers=self._workers, generator=own)
