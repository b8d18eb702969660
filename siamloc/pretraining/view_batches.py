"""`ViewDataModule`: batches of places in random buildings, which other processes render before they are needed."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import count, islice
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import DataLoader, Dataset

from siamloc.data.frames import FrameTable, concatenate
from siamloc.data.places import PlaceSampler, PlaceSettings
from siamloc.errors import DataError
from siamloc.pretraining.settings import ViewSettings
from siamloc.progress import track
from siamloc.simulate.produce import rendering_processes
from siamloc.simulate.views import Views, camera_of, draw_views
from siamloc.training.batches import BatchAugmentation, DriveBatches, EpochDataModule
from siamloc.training.place_batches import origins_of

_SEEDS = 1 << 30  # of the training buildings; those of the validation follow
_STEP = 1_000_003
_VALIDATION_BUILDINGS, _VALIDATION_POSES = 3, 120
Wanted = tuple[Any, ...]
"""Arguments of `draw_views`."""


class Renderer:
    """Render buildings, several at once.

    Args:
        processes: number of rendering processes; 0 renders in this process, when a building is requested.
    """

    def __init__(self, processes: int) -> None:
        self._processes = processes
        self._pool: ProcessPoolExecutor | None = None
        self._coming: dict[Wanted, Future[Views]] = {}

    def begin(self, wanted: Wanted) -> None:
        """Start rendering a building in a process, unless it has been started.

        Args:
            wanted: positional arguments of `siamloc.simulate.views.draw_views`, beginning with the building's seed.

        Raises:
            DataError: a rendering process has died.
        """
        if not self._processes or wanted in self._coming:
            return
        if self._pool is None:
            self._pool = rendering_processes(self._processes)
        try:
            self._coming[wanted] = self._pool.submit(draw_views, *wanted)
        except BrokenProcessPool as error:
            raise self._died() from error

    def views(self, wanted: Wanted) -> Views:
        """Return the images of a building; waits if they are not ready.

        Args:
            wanted: as for `begin`.

        Raises:
            DataError: a rendering process has died.
        """
        if not self._processes:
            return draw_views(*wanted)
        self.begin(wanted)
        try:
            return self._coming.pop(wanted).result()
        except BrokenProcessPool as error:
            raise self._died() from error

    def _died(self) -> DataError:
        self.close()
        return DataError(
            "a process that renders buildings died, perhaps for lack of memory: call it again with fewer "
            "views.processes, or with 0; in your own script, call pretrain under `if __name__ == '__main__':`"
        )

    def close(self) -> None:
        """End the processes; each finishes the building that it has begun, which is discarded."""
        pool, self._pool = self._pool, None
        self._coming.clear()
        if pool is not None:
            pool.shutdown(wait=False, cancel_futures=True)


def building_seed(seed: int, number: int) -> int:
    """Return the seed, for `draw_views`, of a building of a training.

    Args:
        seed: seed of the training.
        number: number of the building over all processes, from 0.
    """
    return (seed * _STEP + number) % _SEEDS


def frames_of(views: Views, name: str, ordinary: bool = False) -> FrameTable:
    """List the images of a building as frames; each light counts as its own lighting.

    Args:
        views: the images.
        name: name of the building, which distinguishes its frames from those of other buildings.
        ordinary: whether images of an ordinary camera keep their headings, for a network of such images. A network of
            panoramas must not learn turns from them, since their columns are not a full turn.
    """
    count = len(views)
    return FrameTable(
        path=np.array([f"{name}, picture {number}" for number in range(count)]),
        x=views.xy[:, 0],
        y=views.xy[:, 1],
        room=np.array([f"room {room}" for room in views.room.tolist()]),
        lighting=np.array([f"light {light}" for light in views.light.tolist()]),
        building=np.full(count, name),
        theta=np.where(views.wraps or ordinary, views.heading, np.nan),
    )


@dataclass(eq=False)
class ViewBatches(Dataset[dict[str, Any]]):
    """The training batches of every epoch, of views: rendered images of places in random buildings.

    Item (epoch, i) is the i-th batch of an epoch, both counted from 0: a dictionary with the keys of an item of
    `siamloc.training.place_batches.PlaceBatches`, and `overlap` (N, N) float32, the visual overlap of its images, 0
    between buildings. It depends only on the seed, the epoch and i, not on how fast buildings are rendered.

    Attributes:
        renderer: renders the buildings, before they are needed.
        image_size: rows and columns of the images.
        views: how many drives, lights and poses each building has, and how many buildings are in memory.
        places: how many places and images a batch has, and how places are drawn; `epoch_batches` is required.
        seed: seed of the training, from which the seed of each building follows.
        rank: number of this process among those that train together; each has its own buildings.
        world_size: number of processes that train together.
        augmentation: changes the rendered images, such as their contrast; None leaves them as they are.
    """

    renderer: Renderer
    image_size: Sequence[int]
    views: ViewSettings
    places: PlaceSettings
    seed: int
    rank: int = 0
    world_size: int = 1
    augmentation: BatchAugmentation | None = None

    def __post_init__(self) -> None:
        self._here: dict[int, tuple[Views, FrameTable]] = {}

    def __len__(self) -> int:
        return self.places.epoch_batches or 0

    def drawn(self, epoch: int, batch: int) -> tuple[list[Views], FrameTable, NDArray[np.int64]]:
        """Return the buildings of a batch, the frames of all their images, and the rows of the batch's frames.

        Args:
            epoch: number of the epoch, from 0.
            batch: number of the batch in the epoch, from 0.
        """
        number = epoch * len(self) + batch
        held = self.held(number // self.views.batches)
        rng = np.random.default_rng([self.seed, number, self.rank, 0xB1D6])
        chosen = rng.permutation(len(held))[: self.views.together]
        frames = concatenate([held[one][1] for one in chosen])
        sampler = PlaceSampler(frames, self.places, seed=self.seed)
        return [held[one][0] for one in chosen], frames, sampler.batch(number, self.rank)

    def __getitem__(self, number: tuple[int, int]) -> dict[str, Any]:
        views, frames, rows = self.drawn(*number)
        first = np.cumsum([0, *(len(one) for one in views)])
        which = np.searchsorted(first, rows, side="right") - 1
        pictures = np.stack([views[one].images[row - first[one]] for one, row in zip(which, rows, strict=True)])
        overlap = np.zeros((len(rows), len(rows)), dtype=np.float32)
        for one, building in enumerate(views):
            mine = np.flatnonzero(which == one)
            pose = building.pose[rows[mine] - first[one]]
            overlap[np.ix_(mine, mine)] = building.overlap[np.ix_(pose, pose)]
        item: dict[str, Any] = {"images": torch.from_numpy(pictures), "overlap": torch.from_numpy(overlap)}
        item |= {name: value[rows] for name, value in origins_of(frames).items()}
        # The processes that train together number their buildings, rooms and frames separately.
        for name in ("building", "room", "frame"):
            item[name] = item[name] * self.world_size + self.rank
        if self.augmentation is not None:
            self.augmentation.add(item, number, pictures.shape[1:], self.rank, self.world_size)
        return item

    def held(self, newest: int) -> list[tuple[Views, FrameTable]]:
        """Return the images and frames of the buildings in memory up to building `newest`; wait for their rendering.

        Raises:
            DataError: a rendering process has died.
        """
        numbers = range(max(0, newest + 1 - self.views.held), newest + 1)
        self._here = {number: here for number, here in self._here.items() if number in numbers}
        for number in range(numbers.start, numbers.stop + max(2, 2 * self.views.processes)):
            if number not in self._here:
                self.renderer.begin(self._wanted(number))
        for number in numbers:
            if number not in self._here:
                views = self.renderer.views(self._wanted(number))
                name = f"building {number * self.world_size + self.rank}"
                self._here[number] = views, frames_of(views, name, self.views.cameras == "ordinary")
        return [self._here[number] for number in numbers]

    def _wanted(self, number: int) -> Wanted:
        seed = building_seed(self.seed, number * self.world_size + self.rank)
        return self.views.drawn(seed, self.image_size)


def validation_views(renderer: Renderer, image_size: Sequence[int], ordinary: bool = False) -> DriveBatches:
    """Render images of drives through three buildings that are not used for training.

    Each building is mapped with its first drive in cloudy light, and queried with its second drive in every lighting.

    Args:
        renderer: renders the buildings.
        image_size: rows and columns of the images.
        ordinary: whether ordinary cameras take the images; panorama cameras if False.
    """
    # The head of panoramas is not used for images of ordinary cameras.
    seeds = (_SEEDS + number for number in count() if ordinary or camera_of(_SEEDS + number, image_size).wraps)
    shape = tuple(image_size), 2, 3, _VALIDATION_POSES, 0.4, "ordinary" if ordinary else "any"
    wanted = [(seed, *shape) for seed in islice(seeds, _VALIDATION_BUILDINGS)]
    for one in wanted:
        renderer.begin(one)
    images, frames, known = [], [], []
    for number, one in enumerate(track(wanted, len(wanted), "rendering buildings to validate with")):
        views = renderer.views(one)
        # One light of the first drive is the map, and all lights of the second drive are queries.
        of_map = views.light == views.lighting[:3].index("cloudy")
        rows = np.flatnonzero(of_map | (views.light >= 3))
        images.append(views.images[rows])
        frames.append(frames_of(views, f"building {number}", ordinary).take(rows))
        known.append(of_map[rows])
    columns = {"images": torch.from_numpy(np.concatenate(images)), **origins_of(*frames)}
    return DriveBatches({**columns, "known": torch.from_numpy(np.concatenate(known))})


class ViewDataModule(EpochDataModule):
    """Serve batches of places in random buildings to a `PlaceModule`; see `PlaceDataModule`.

    Args:
        image_size: rows and columns of the images.
        views: which buildings are rendered, and how many are in use at a time.
        places: how many places and images a batch has, and how places are drawn; `epoch_batches` is required.
        augmentation: changes the rendered images, such as their contrast; None leaves them as they are.
        seed: seed of the buildings and batches.
    """

    def __init__(
        self,
        image_size: Sequence[int],
        views: ViewSettings,
        places: PlaceSettings,
        augmentation: BatchAugmentation | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__(None, 0, augmentation)
        self.views, self.places, self.seed = views, places, seed
        self._size = tuple(image_size)
        self._renderer = Renderer(views.processes)
        self._validation: DriveBatches | None = None

    def train_dataloader(self) -> DataLoader[Any]:
        """Make the loader of the training batches."""
        shared = self._renderer, self._size, self.views, self.places, self.seed, *self.share()
        return self.loader(ViewBatches(*shared, self.augmentation), self.next_epoch())

    def val_dataloader(self) -> DataLoader[Any]:
        """Make the loader of the validation images, which are rendered once."""
        if self._validation is None:
            self._validation = validation_views(self._renderer, self._size, self.views.cameras == "ordinary")
        return self.loader(self._validation, None)

    def teardown(self, stage: str) -> None:
        """End the rendering processes."""
        super().teardown(stage)
        self._renderer.close()
