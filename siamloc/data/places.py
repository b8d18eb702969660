"""Batches of places, with several images of each place, for losses that use all pairs of a batch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from foundation.calls import typed
from foundation.settings import Count, NotNegative, Seed, Settings, Share
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError


@dataclass(frozen=True)
class PlaceSettings(Settings):
    """Which images a batch has.

    Attributes:
        by: "position", or "sequence" if there are no positions: the distance between two images is then the number of
            frames between them, in the order of the table, and images of two sequences are never near each other; or
            "steps": as with "sequence", but counted in the steps of one drive, see `siamloc.training.adapting`.
        places: number of places in a batch.
        images: number of images of each place, from different positions if there are several, and under different
            lightings if the place was seen under several.
        radius: largest distance of the images of a place from its first image, in the unit of the positions, in
            frames or in steps; 0 repeats the first image, of which augmentation makes different views.
        near: share of the places that lie within `reach` of another place of the batch, so that the network also
            learns to tell neighbours apart. They are drawn from all frames within `reach`, so that a batch
            may have the same place twice, most often where few frames lie that near.
        reach: the distance of `near`, in the unit of the positions, in frames or in steps.
        epoch_batches: batches in an epoch; if None, enough to show every frame once on average.
    """

    WHERE = "pairs"
    needs_positions: ClassVar[str] = (
        "places need (the order of the frames does without: experiment=photographs, or rooms where they are labelled)"
    )

    by: Literal["position", "sequence", "steps"] = "position"
    places: Count = 16
    images: Count = 4
    radius: NotNegative = 0.3
    near: Share = 0.0
    reach: NotNegative = 2.0
    epoch_batches: Count | None = None


class PlaceSampler:
    """Draw the batches of an epoch.

    Which images a batch has depends only on the seed, the epoch and the number of the batch. Several processes draw
    one batch together, with the places of all processes, and each process takes its own places from the batch.

    Args:
        frames: the frames to draw from (N), all with positions unless places are drawn by sequence.
        settings: how many places and images a batch has, and how near to each other the images of a place are; the
            defaults of `PlaceSettings` if None.
        seed: seed from which the batches of all epochs follow.

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

    @typed
    def __init__(self, frames: FrameTable, settings: PlaceSettings | None = None, *, seed: Seed = 0) -> None:
        from scipy.spatial import cKDTree

        self.settings = settings = PlaceSettings() if settings is None else settings
        if settings.places < 2:
            raise ConfigError("a batch of one place has nothing to tell apart: set pairs.places to 2 or more")
        missing = int((~frames.has_position).sum())
        if missing and settings.by != "sequence":
            raise DataError(
                f"{missing} of {len(frames)} frames have no position, by which places are drawn: give their x and y, "
                "leave them out, or set pairs.by to sequence"
            )
        self.frames = frames
        self.seed = int(seed)
        self.check_processes(1)
        per_batch = settings.places * settings.images
        self.epoch_batches = settings.epoch_batches or max(1, round(len(frames) / per_batch))
        place, apart = places_of(frames, settings.by)
        # A third coordinate keeps images that are never near each other farther apart than the reach.
        far = 2 * max(settings.radius, settings.reach) + 1.0
        self._points = np.column_stack([place, apart * far])
        self._tree = cKDTree(self._points)
        self._kind = _kinds(frames)
        self._position = np.unique(self._points, axis=0, return_inverse=True)[1].reshape(-1)
        self._nearest = np.full(len(frames), np.inf)
        for number in range(apart.max() + 1):
            rows = apart == number
            if rows.sum() > 1:
                self._nearest[rows] = cKDTree(place[rows]).query(place[rows], k=2)[0][:, 1]

    def __len__(self) -> int:
        return self.epoch_batches

    def summary(self) -> str:
        """Describe the batches of an epoch in a line: their number and their places."""
        return f"{self.epoch_batches} batches of {self.settings.places} places x {self.settings.images} images"

    def notes(self) -> list[str]:
        """Return sentences about frames from which batches cannot be drawn as the settings request."""
        settings = self.settings
        unit = "frames" if settings.by == "sequence" else self.frames.unit
        instead = {
            "radius": "their places have the same image again, which augmentation alone makes different",
            "reach": "places near them are the same place again",
        }
        wanted = {"radius": settings.images > 1 and settings.radius > 0, "reach": settings.near > 0}
        half, notes = float(np.median(self._nearest)), []
        for key in (key for key in instead if wanted[key]):
            within = getattr(settings, key)
            lonely = self._nearest[self._nearest > within]
            if not len(lonely):
                continue
            note = f"{len(lonely)} of {len(self.frames)} frames have no other one within pairs.{key}={within:g} {unit}"
            more = f"; a larger pairs.{key} finds some" if np.isfinite(lonely).any() else ""
            by = f" (half of the frames have one within {half:.3g} {unit})" if within < half < np.inf else ""
            notes.append(f"{note}: {instead[key]}{more}{by}")
        ordered = settings.by == "position" or np.isfinite(self.frames.time).all()
        if not ordered and self.frames.source.get("kind") == "folder" and len(set(self.frames.room.tolist())) > 1:
            notes.append(
                f"pairs.by={settings.by} takes the order of the frames as that of the drive, and frames of data=folder "
                "without COLD names have the order of their rooms and names: give a manifest in the order of the drive"
            )
        return notes

    def check_processes(self, processes: int) -> None:
        """Raise ConfigError unless there are frames for the places of a batch: `places` for each of `processes`."""
        places = self.settings.places * processes
        if places > len(self.frames):
            raise ConfigError(
                f"a batch of {places} places, {self.settings.places} for each process, cannot be drawn from "
                f"{len(self.frames)} frames: set pairs.places lower, train with fewer processes, or give more frames"
            )

    def batch(self, epoch: int, number: int, rank: int = 0, world_size: int = 1) -> NDArray[np.int64]:
        """Return the rows of the frames in one process's batch (places * images,), place after place.

        Args:
            epoch: number of the epoch, from 0.
            number: number of the batch in the epoch, from 0.
            rank: number of this process among those that train together.
            world_size: number of those processes.

        Raises:
            ConfigError: there are more places than frames.
        """
        each = self.settings.places * self.settings.images
        return self.whole_batch(epoch, number, world_size)[rank * each : (rank + 1) * each]

    def whole_batch(self, epoch: int, number: int, world_size: int = 1) -> NDArray[np.int64]:
        """Return the rows of the frames in the batch of all processes (places * images * world_size,).

        Args:
            epoch: number of the epoch, from 0.
            number: number of the batch in the epoch, from 0.
            world_size: number of processes that train together.

        Raises:
            ConfigError: there are more places than frames.
        """
        self.check_processes(world_size)
        generator = np.random.default_rng([self.seed, epoch, number, 0x91ACE])
        centres = self._centres(generator, self.settings.places * world_size)
        return np.concatenate([self._images(generator, centre) for centre in centres])

    def _centres(self, generator: np.random.Generator, count: int) -> NDArray[np.int64]:
        """Draw the first frame of each place, in random order: some places anywhere, the others near these places."""
        near = min(round(self.settings.near * count), count - 1)
        first = generator.choice(len(self.frames), count - near, replace=False)
        anchors = first[generator.integers(0, len(first), near)]
        around = self._tree.query_ball_point(self._points[anchors], self.settings.reach, return_sorted=True)
        second = [found[generator.integers(0, len(found))] for found in around]
        return generator.permutation(np.concatenate([first, np.asarray(second, dtype=np.int64)]))

    def _images(self, generator: np.random.Generator, centre: np.int64) -> NDArray[np.int64]:
        """Draw the images of a place, its lightings in turn; a place with too few images repeats them."""
        found = np.asarray(self._tree.query_ball_point(self._points[centre], self.settings.radius), dtype=np.int64)
        found = generator.permutation(found[found != centre])
        order = np.concatenate([[centre], found])
        turn = _turns(self._kind[order])
        if (again := _turns(self._position[order])).any():  # images from one position under several lights
            # First those that share neither position nor lighting, then other positions, then these ones again.
            first = self._apart(order)
            again += np.isin(self._position[order], self._position[order][first])
            again[first] = -1
            turn = again * len(order) + _turns(self._kind[order] + again * len(self._kind))
        chosen = order[np.argsort(turn, kind="stable")][: self.settings.images]
        return np.resize(chosen, self.settings.images)

    def _apart(self, order: NDArray[np.int64]) -> list[int]:
        """Return which of some frames to take, in order, so that all positions and all lightings differ."""
        positions, kinds, found = set(), set(), []
        pairs = zip(self._position[order].tolist(), self._kind[order].tolist(), strict=True)
        for number, (position, kind) in enumerate(pairs):
            if position not in positions and kind not in kinds:
                positions.add(position)
                kinds.add(kind)
                found.append(number)
        return found


def places_of(frames: FrameTable, by: str = "position") -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return where frames were taken (N, 2), and a group number (N,); frames of different groups are never near.

    By position or steps, the two are positions and buildings; by sequence, the number of each frame in its sequence,
    and the sequences.
    """
    if by != "sequence":
        return frames.xy.copy(), np.unique(frames.building, return_inverse=True)[1]
    drive = np.unique(frames.sequence, return_inverse=True)[1]
    return np.column_stack([_turns(drive), np.zeros(len(drive))]).astype(np.float64), drive


def _kinds(frames: FrameTable) -> NDArray[np.int64]:
    """Number the lightings, or the drives if all have the same lighting."""
    names = frames.lighting if len(set(frames.lighting.tolist())) > 1 else frames.sequence
    return np.unique(names, return_inverse=True)[1]


def _turns(kinds: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return, for each item, the number of earlier items of the same kind."""
    order = np.argsort(kinds, kind="stable")
    ordered = kinds[order]
    first = np.flatnonzero(np.diff(ordered, prepend=ordered[0] - 1))
    starts = np.repeat(first, np.diff(np.append(first, len(ordered))))
    turns = np.empty(len(kinds), dtype=np.int64)
    turns[order] = np.arange(len(ordered)) - starts
    return turns
