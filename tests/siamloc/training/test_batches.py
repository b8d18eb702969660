from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from siamloc.data.datamodule import PairAugmentation, PairBatches, PairDataModule

import augment
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.pairs import PairSampler
from siamloc.errors import ConfigError


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """Images whose grey level tells which one they are; one of them is not readable."""
    folder = tmp_path_factory.mktemp("images")
    rows = []
    for number in range(12):
        path = folder / f"{number}.png"
        cv2.imwrite(str(path), np.full((4, 8, 3), 10 * number, np.uint8))
        rows.append(
            {"path": str(path), "x": number, "y": 0.0, "room": "AB"[number % 2], "sequence": ["p", "q"][number // 6]}
        )
    (folder / "3.png").write_bytes(b"")
    return FrameTable.from_rows(rows)


@pytest.fixture(scope="module")
def library(frames, tmp_path_factory):
    return PanoramaLibrary(frames, tmp_path_factory.mktemp("cache"), image_size=(4, 8))


def grey(images):
    return (np.asarray(images)[:, 0, 0, 0] // 10).tolist()


def test_batches_hold_the_pairs_of_the_epoch(library):
    frames = library.frames
    pairs = PairSampler(frames, "room", epoch_pairs=7).epoch(0)
    batches = PairBatches(library, frames, pairs, batch_size=3)
    assert len(batches) == 3
    joined = [batches[number] for number in range(3)]
    assert [len(batch["label"]) for batch in joined] == [3, 3, 1]
    assert grey(torch.cat([batch["first"] for batch in joined])) == frames.x[pairs.first].tolist()
    assert grey(torch.cat([batch["second"] for batch in joined])) == frames.x[pairs.second].tolist()
    assert torch.cat([batch["label"] for batch in joined]).tolist() == pairs.label.tolist()
    assert torch.cat([batch["same"] for batch in joined]).tolist() == pairs.same.tolist()
    with pytest.raises(IndexError):
        batches[3]


@pytest.mark.parametrize("workers", [0, 2])
def test_workers_do_not_change_the_draw(library, workers):
    data = PairDataModule(library, library.frames, None, {"label": "room", "seed": 0}, batch_size=4, workers=workers)
    seen = [grey(batch["first"]) for batch in data.train_dataloader()]
    expected = library.frames.x[PairSampler(library.frames, "room", seed=0).epoch(0).first].tolist()
    assert sum(seen, []) == expected  # noqa: RUF017


def test_validation_pairs_share_label_and_scale(library):
    train, validation = library.frames.take(slice(0, 6)), library.frames.take(slice(6, None))
    data = PairDataModule(library, train, validation, {"label": "distance", "seed": 0}, batch_size=4)
    batch = next(iter(data.val_dataloader()))
    first, second = (torch.tensor(grey(batch[name])) for name in ("first", "second"))
    expected = torch.where(batch["same"], (first - second).abs() / data.sampler.scale, 1).clamp(max=1)
    torch.testing.assert_close(batch["label"], expected.float())


def test_batch_size_must_be_positive(library):
    with pytest.raises(ConfigError, match="batch_size"):
        PairDataModule(library, library.frames, None, {}, batch_size=0)


def trained_on(library, where="cpu", rank=0, world_size=1, epoch=0, batch_size=4):
    """Return the first images of an epoch's augmented batches, in the order of the pairs."""
    augmentation = PairAugmentation(augment.policy("thesis"), where, seed=0)
    data = PairDataModule(
        library, library.frames, None, {"label": "room", "seed": 0}, batch_size, augmentation=augmentation
    )
    data.trainer = SimpleNamespace(current_epoch=epoch, global_rank=rank, world_size=world_size)
    batches = [data.on_after_batch_transfer(batch, 0) for batch in data.train_dataloader()]
    assert all("change" not in batch for batch in batches)
    return torch.cat([batch["first"] for batch in batches]), torch.cat([batch["second"] for batch in batches])


def test_augmentation_follows_from_seed_epoch_and_pair_alone(library):
    first, second = trained_on(library)
    again = trained_on(library, batch_size=3)
    assert torch.equal(first, again[0])
    assert torch.equal(second, again[1])
    later = trained_on(library, epoch=1)
    assert not torch.equal(first, later[0])
    shares = [trained_on(library, rank=rank, world_size=2)[0] for rank in range(2)]
    assert torch.equal(torch.stack(shares, dim=1).flatten(0, 1), first[:10])


def test_augmentation_changes_training_images_only(library):
    augmentation = PairAugmentation(augment.policy("thesis"))
    pairs = {"label": "room", "seed": 0}
    data = PairDataModule(library, library.frames, library.frames, pairs, batch_size=4, augmentation=augmentation)
    plain = PairDataModule(library, library.frames, library.frames, pairs, batch_size=4)
    assert not torch.equal(next(iter(data.train_dataloader()))["first"], next(iter(plain.train_dataloader()))["first"])
    assert torch.equal(next(iter(data.val_dataloader()))["first"], next(iter(plain.val_dataloader()))["first"])


def test_augmentation_after_the_transfer_is_the_same(library):
    first, second = trained_on(library, "gpu")
    expected = trained_on(library, "cpu")
    assert torch.equal(first, expected[0])
    assert torch.equal(second, expected[1])
    with pytest.raises(ConfigError, match="cpu or gpu"):
        PairAugmentation(augment.policy("thesis"), "tpu")
