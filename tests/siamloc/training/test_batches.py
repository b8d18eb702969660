from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from torch import nn

import augment
from augment.torchvision_compat import ensure_torchvision
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.pairs import PairSampler, PairSettings
from siamloc.errors import ConfigError
from siamloc.models.siamese import SiameseModule
from siamloc.training.batches import BatchAugmentation, Panoramas
from siamloc.training.pair_batches import PairBatches, PairDataModule
from tests.siamloc.models.conftest import trainer

ensure_torchvision()
from lightning.pytorch import LightningModule  # noqa: E402

ROOM = PairSettings(label="room")


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """Images identified by their grey level; one of them is not readable."""
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


def sampled(frames, **settings):
    return PairSampler(frames, PairSettings(label="room", **settings))


def test_batches_hold_the_pairs_of_the_epoch(library):
    frames = library.frames.take(slice(None, None, -1))
    sampler = sampled(frames, epoch_pairs=7)
    batches = PairBatches(Panoramas(library, frames), sampler, batch_size=3)
    assert len(batches) == 3
    for epoch in (0, 2):
        pairs = sampler.epoch(epoch)
        joined = [batches[epoch, number] for number in range(3)]
        assert [len(batch["label"]) for batch in joined] == [3, 3, 1]
        sides = [batch["images"].chunk(2) for batch in joined]
        for side, rows in ((0, pairs.first), (1, pairs.second)):
            assert grey(torch.cat([parts[side] for parts in sides])) == frames.x[rows].tolist()
        assert torch.cat([batch["label"] for batch in joined]).tolist() == pairs.label.tolist()
        assert torch.cat([batch["same"] for batch in joined]).tolist() == pairs.same.tolist()


def test_fewer_pairs_than_processes_are_refused(library):
    few = PairDataModule(library, library.frames, pairs=PairSettings(label="room", epoch_pairs=3))
    with pytest.raises(ConfigError, match=r"3 pairs are fewer than the 4 processes .* more with pairs\.epoch_pairs"):
        few.check_processes(4)
    train, validation = library.frames.take(slice(0, 8)), library.frames.take(slice(8, None))
    data = PairDataModule(library, train, validation, pairs=ROOM)
    data.check_processes(3)
    with pytest.raises(ConfigError, match=r"3 validation pairs are fewer than the 4 .*: give more frames, or tr"):
        data.check_processes(4)
    alone = PairDataModule(library, train, library.frames.select(room="A"), pairs=ROOM)
    assert alone.validation_sampler.same_room_share == 1


class Seen(LightningModule):
    """Notes the grey levels of the first images, epoch by epoch."""

    def __init__(self):
        super().__init__()
        self.layer = torch.nn.Linear(1, 1)
        self.epochs = {}
        self.validated = []

    def training_step(self, batch, batch_index):
        self.epochs.setdefault(self.current_epoch, []).extend(grey(batch["first"].cpu()))
        return self.layer(torch.ones(1, 1)).sum()

    def validation_step(self, batch, batch_index):
        self.validated.append(grey(batch["first"].cpu()))

    def configure_optimizers(self):
        return torch.optim.SGD(self.parameters(), lr=0.1)


@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.filterwarnings("ignore:.*does not have many workers")
def test_a_plain_trainer_draws_new_pairs_in_every_epoch_also_after_resuming(library, workers, tmp_path):
    sampler, roles = sampled(library.frames), (library.frames, library.frames)
    expected = {epoch: library.frames.x[sampler.epoch(epoch).first].tolist() for epoch in range(4)}
    first, data = Seen(), PairDataModule(library, *roles, pairs=ROOM, batch_size=4, workers=workers)
    training = trainer(max_epochs=3, num_sanity_val_steps=0)
    training.fit(first, datamodule=data)
    assert first.epochs == {epoch: expected[epoch] for epoch in range(3)}
    assert first.validated[:3] == first.validated[3:6] == first.validated[6:], "validation has the same pairs each time"
    training.save_checkpoint(tmp_path / "last.ckpt")
    resumed, data = Seen(), PairDataModule(library, *roles, pairs=ROOM, batch_size=4, workers=workers)
    again = trainer(max_epochs=4, num_sanity_val_steps=0)
    again.fit(resumed, datamodule=data, ckpt_path=tmp_path / "last.ckpt", weights_only=True)
    assert resumed.epochs == {3: expected[3]}


def test_validation_pairs_share_label_and_scale(library):
    train, validation = library.frames.take(slice(0, 6)), library.frames.take(slice(6, None))
    data = PairDataModule(library, train, validation, pairs=PairSettings(label="distance"), batch_size=4)
    batch = next(iter(data.val_dataloader()[0]))
    first, second = torch.tensor(grey(batch["images"])).chunk(2)
    expected = torch.where(batch["same"], (first - second).abs() / data.sampler.scale, 1).clamp(max=1)
    torch.testing.assert_close(batch["label"], expected.float())


@pytest.mark.parametrize("where", ["cpu", "gpu"])
def test_a_training_loop_without_a_trainer(library, where):
    augmentation = BatchAugmentation(augment.policy("thesis"), where, seed=0)
    data = PairDataModule(library, library.frames, pairs=ROOM, batch_size=4, augmentation=augmentation)
    module = SiameseModule(nn.Sequential(nn.AdaptiveAvgPool2d(2), nn.Flatten(), nn.Linear(12, 2)))
    for batch in data.train_dataloader():
        loss = module.training_step(data.on_after_batch_transfer(batch, 0), 0)
        loss.backward()
    assert module.network[2].weight.grad.any()


def trained_on(library, where="cpu", rank=0, world_size=1, epoch=0, batch_size=4):
    """Return the first and second images (2, N, 3, H, W) of an epoch's augmented pairs, in their order."""
    augmentation = BatchAugmentation(augment.policy("thesis"), where, seed=0)
    data = PairDataModule(library, library.frames, pairs=ROOM, batch_size=batch_size, augmentation=augmentation)
    fit_loop = SimpleNamespace(epoch_progress=SimpleNamespace(current=SimpleNamespace(processed=epoch)))
    strategy = SimpleNamespace(root_device=torch.device("cpu"))
    data.trainer = SimpleNamespace(fit_loop=fit_loop, global_rank=rank, world_size=world_size, strategy=strategy)
    batches = [data.on_after_batch_transfer(batch, 0) for batch in data.train_dataloader()]
    assert all("change" not in batch for batch in batches)
    return torch.stack([torch.cat([batch[side] for batch in batches]) for side in ("first", "second")])


def test_augmentation_follows_from_seed_epoch_and_pair_alone(library):
    expected = trained_on(library)
    assert torch.equal(trained_on(library, batch_size=3), expected)
    assert torch.equal(trained_on(library, "gpu"), expected), "after the transfer"
    assert not torch.equal(trained_on(library, epoch=1)[0], expected[0])
    shares = [trained_on(library, rank=rank, world_size=2) for rank in range(2)]
    assert torch.equal(torch.stack(shares, dim=2).flatten(1, 2), expected[:, :10])
    with pytest.raises(ConfigError, match="cpu or gpu"):
        BatchAugmentation(augment.policy("thesis"), "tpu")


def test_augmentation_changes_training_images_only(library):
    augmentation = BatchAugmentation(augment.policy("thesis"))
    options = {"pairs": ROOM, "batch_size": 4}
    data = PairDataModule(library, library.frames, library.frames, augmentation=augmentation, **options)
    plain = PairDataModule(library, library.frames, library.frames, **options)
    changed, as_it_was = (
        [next(iter(one)) for one in (d.train_dataloader(), *d.val_dataloader())] for d in (data, plain)
    )
    assert not torch.equal(changed[0]["images"], as_it_was[0]["images"])
    assert torch.equal(changed[1]["images"], as_it_was[1]["images"])
