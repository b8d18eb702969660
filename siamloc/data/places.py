"""Batches of places: several images of each of several places, for losses that use all pairs of a batch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError
from siamloc.settings import Count, NotNegative, Settings, Share


@dataclass(frozen=True)
class PlaceSettings(Settings):
    """Which images a batch has.

    Attributes:
        by: "position", or "sequence" where there are no positions: how near two images are is then counted in frames
            between them, in the order of the table, and images of two sequences are never near each other.
        places: in a batch.
        images: of each place, under different lightings where the place was seen under several.
        radius: images of a place lie this near each other, in the unit of the positions, or in frames.
        near: share of the places that lie within `reach` of another place of the batch, so that it learns to tell
            neighbours apart, too.
        reach: how near that is, in the unit of the positions, or in frames.
        epoch_batches: batches in an epoch; if None as many as show every frame once on average.
    """

    WHERE = "pairs"
    needs_positions: ClassVar[str] = (
        "places need (the order of the frames does without: experiment=photographs, or rooms where they are labelled)"
    )

    by: Literal["position", "sequence"] = "position"
    places: Count = 16
    images: Count = 4
    radius: NotNegative = 0.3
    near: Share = 0.0
    reach: NotNegative = 2.0
    epoch_batches: Count | None = None


class PlaceSampler:
    """Draw the batches of an epoch.

    Which images a batch has depends on the seed, the epoch and the number of the batch alone. Several processes draw
    one batch together, as large as all of theirs, and each takes its own places of it.

    Args:
        frames: the frames to draw from (N), all with positions unless places are drawn by sequence.
        settings: which images; the defaults of `PlaceSettings` if None.
        seed: any whole number, not negative.

    Raises:
        ConfigError: a batch of fewer than two places, or more than there are frames.
        DataError: frames without positions.

    Example:
        >>> lighting = ["sunny", "night", "sunny", "night"]
        >>> frames = FrameTable(path=["a", "b", "c", "d"], x=[0, 0.1, 5, 5.1], y=[0] * 4, lighting=lighting)
        >>> sampler = PlaceSampler(frames, PlaceSettings(places=2, images=2))
        >>> rows = sampler.batch(epoch=0, number=0)
        >>> frames.lighting[rows].reshape(2, 2).tolist()[0] in (["sunny", "night"], ["night", "sunny"])
        True
    """

    def __init__(self, frames: FrameTable, settings: PlaceSettings | None = None, *, seed: int = 0) -> None:
        from scipy.spatial import cKDTree

        self.settings = settings = PlaceSettings() if settings is None else settings
        if settings.places < 2:
            raise ConfigError("a batch of one place has nothing to tell apart: set pairs.places to 2 or more")
        if int(seed) < 0:
            raise ConfigError(f"the seed must be a whole number from 0, got {seed}")
        missing = int((~frames.has_position).sum())
        if missing and settings.by == "position":
            raise DataError(
                f"{missing} of {len(frames)} frames have no position, by which places are drawn: give their x and y, "
                "leave them out, or set pairs.by to sequence"
            )
        self.frames = frames
        self.seed = int(seed)
        self._check_count(settings.places)
        per_batch = settings.places * settings.images
        self.epoch_batches = settings.epoch_batches or max(1, round(len(frames) / per_batch))
        place, apart = places_of(frames, settings.by)
        # Where images are never near each other, a third coordinate keeps them farther apart than the reach.
        far = 2 * max(settings.radius, settings.reach) + 1.0
        self._points = np.column_stack([place, apart * far])
        self._tree = cKDTree(self._points)
        self._kind = _kinds(frames)

    def __len__(self) -> int:
        return self.epoch_batches

    def summary(self) -> str:
        """Say what an epoch has."""
        return f"{self.epoch_batches} batches of {self.settings.places} places x {self.settings.images} images"

    def batch(self, epoch: int, number: int, rank: int = 0, world_size: int = 1) -> NDArray[np.int64]:
        """Return the rows of a batch (places * images,), those of one place after those of another.

        Raises:
            ConfigError: the rank is not in [0, world_size), or more places than frames.
        """
        if not 0 <= rank < world_size or epoch < 0:
            raise ConfigError(f"need epoch >= 0 and 0 <= rank < world_size, got {epoch}, {rank} and {world_size}")
        count = self.settings.places * world_size
        self._check_count(count)
        generator = np.random.default_rng([self.seed, epoch, number, 0x91ACE])
        centres = self._centres(generator, count)
        rows = [self._images(generator, centre) for centre in centres]
        return np.concatenate(rows[rank * self.settings.places : (rank + 1) * self.settings.places])

    def _check_count(self, places: int) -> None:
        if places > len(self.frames):
            raise ConfigError(
                f"a batch of {places} places cannot be drawn from {len(self.frames)} frames: set pairs.places smaller"
            )

    def _centres(self, generator: np.random.Generator, count: int) -> NDArray[np.int64]:
        """Draw the first frame of each place: some anywhere, the rest near those, in mixed order."""
        near = min(round(self.settings.near * count), count - 1)
        first = generator.choice(len(self.frames), count - near, replace=False)
        anchors = first[generator.integers(0, len(first), near)]
        around = self._tree.query_ball_point(self._points[anchors], self.settings.reach, return_sorted=True)
        second = [found[generator.integers(0, len(found))] for found in around]
        return generator.permutation(np.concatenate([first, np.asarray(second, dtype=np.int64)]))

    def _images(self, generator: np.random.Generator, centre: np.int64) -> NDArray[np.int64]:
        """Draw the images of a place, of every lighting in turn; the same again where it has too few."""
        found = np.asarray(self._tree.query_ball_point(self._points[centre], self.settings.radius), dtype=np.int64)
        found = generator.permutation(found[found != centre])
        order = np.concatenate([[centre], found])
        turn = _turns(self._kind[order])
        chosen = order[np.argsort(turn, kind="stable")][: self.settings.images]
        return np.resize(chosen, self.settings.images)


def places_of(frames: FrameTable, by: str = "position") -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return where frames were taken (N, 2), and the number (N,) of what sets them apart wherever that is.

    By position these are positions and buildings; by sequence the number of the frame in its sequence, and sequences.
    """
    if by == "position":
        return frames.xy.copy(), np.unique(frames.building, return_inverse=True)[1]
    drive = np.unique(frames.sequence, return_inverse=True)[1]
    return np.column_stack([_turns(drive), np.zeros(len(drive))]).astype(np.float64), drive


def _kinds(frames: FrameTable) -> NDArray[np.int64]:
    """Number the lightings, or the drives where all have one lighting."""
    names = frames.lighting if len(set(frames.lighting.tolist())) > 1 else frames.sequence
    return np.unique(names, return_inverse=True)[1]


def _turns(kinds: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return for each item how many of its kind come before it."""
    order = np.argsort(kinds, kind="stable")
    ordered = kinds[order]
    first = np.flatnonzero(np.diff(ordered, prepend=ordered[0] - 1))
    starts = np.repeat(first, np.diff(np.append(first, len(ordered))))
    turns = np.empty(len(kinds), dtype=np.int64)
    turns[order] = np.arange(len(ordered)) - starts
    return turns
