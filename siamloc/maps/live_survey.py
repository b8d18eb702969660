"""`LiveSurvey`: a survey to which a robot adds frames while it drives."""

from __future__ import annotations

from dataclasses import replace
from os.path import abspath
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import typed
from siamloc.data.frames import concatenate
from siamloc.data.moves import composed, way_along
from siamloc.errors import DataError
from siamloc.maps.comparing import ODDS, scaled
from siamloc.maps.loops import Loops, agreed, loops_of
from siamloc.maps.pose_graph import Array, Edges, PoseGraph, solve
from siamloc.maps.survey_checks import comparing_descriptor
from siamloc.maps.survey_steps import (
    BEFORE,
    odometry_of,
    odometry_steps,
    start_of,
    trusted,
    wheel_edges,
    with_odometry,
)
from siamloc.maps.surveying import Survey, SurveySettings, concluded
from siamloc.maps.visual_map import VisualMap

if TYPE_CHECKING:
    from torch import nn

    from analytic import Descriptor

_WINDOW = 30  # frames whose poses a new frame changes at once
_ROUNDS = 6  # of the solution of a window, which begins near its end


class LiveSurvey:
    """Add frames to the last drive of a survey, one by one, in some milliseconds each, not counting their description.

    A new frame is compared with the frames just before it and with those that look alike, as in `survey`. Then the
    poses of the last 30 frames follow by least squares, with all older ones as they are: a robot that comes back to a
    known place has its pose there at once. What drifted on the way is mended by `survey`, which solves the whole and
    takes seconds for hundreds of frames.

    Args:
        network: the network of the survey.
        found: the survey.
        known: its map, `siamloc.maps.build(network, images, found.frames)`.
        settings: how loops are searched, and how exact odometry is.

    Raises:
        ConfigError: a network that does not compare panoramas.
        DataError: a map of other frames.

    Example:
        >>> live = siamloc.maps.LiveSurvey("pretrained", found, known)  # doctest: +SKIP
        >>> x, y, theta = live.add(panorama, "0421.jpg", odometry=(4.1, 0.2, 1.57))  # doctest: +SKIP
        >>> found = live.survey()  # doctest: +SKIP
    """

    @typed
    def __init__(
        self,
        network: Descriptor | nn.Module | str,
        found: Survey,
        known: VisualMap,
        *,
        settings: SurveySettings | None = None,
    ) -> None:
        self._network = comparing_descriptor(network, circular=True)
        self._settings = SurveySettings() if settings is None else settings
        parts = known.turning().orientation
        if parts is None or known.frames.identities() != found.frames.identities():
            raise DataError("a live survey needs the map of its frames: give build(network, images, found.frames)")
        self._mounting = known.mounting
        self._descriptors, self._parts = _Growing(known.learned), _Growing(scaled(parts))
        self._continue(found)

    def _continue(self, found: Survey) -> None:
        self._found, self._loops, self._paths, self._floor = found, found.loops, list[str](), found.floor
        self._files = {path for name, path in found.frames.identities() if name == found.frames.sequence[-1]}
        self._steps, self._wheels, self._drive = found.graph.pictures, found.graph.wheels, found.graph.drive
        self._odometry, self._poses = found.frames.odometry, found.solution.poses.copy()
        self._way = way_along(self._poses)

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def poses(self) -> Array:
        """Poses of all frames (n, 3): x, y and heading in rad."""
        return self._poses.copy()

    @typed
    def add(self, panorama: NDArray[np.uint8], path: str, *, odometry: ArrayLike | None = None) -> Array:
        """Add a frame, and return its pose (3,): x, y and heading in rad.

        Args:
            panorama: (3, H, W), uint8, as a `PanoramaLibrary` gives it.
            path: the file of the image.
            odometry: x, y and heading by the robot's wheels, in the frame of the drive's odometry; None if unknown.

        Raises:
            DataError: odometry that is not three numbers, or whose heading is not in rad; a frame that the drive has
                already; or a panorama of another type or shape.
        """
        if panorama.dtype != np.uint8 or panorama.ndim != 3 or len(panorama) != 3:
            raise DataError(f"a panorama is uint8 of shape (3, H, W), got {panorama.dtype} {panorama.shape}")
        place = abspath(path)  # noqa: PTH100
        if place in self._files:
            raise DataError(f"the drive has the frame {path} already: give each frame a path of its own")
        wheels = odometry_of(np.full((1, 3), np.nan) if odometry is None else np.asarray(odometry)[None], 1)
        turn = float(np.abs(wheels[0, 2] - self._odometry[-1, 2]))
        if turn > 2 * np.pi and abs(wheels[0, 2]) > 2 * np.pi:
            raise DataError(f"odometry turned by {turn:.4g} since the last frame: give its heading in rad")
        n, description = len(self), self._network.describe(self._mounting.straight(panorama)[None])
        parts = scaled(description.orientation)
        learned = description.position[:, : self._descriptors.rows.shape[1]]
        before = n - np.array(BEFORE)
        before = before[(before >= 0) & (self._drive[before] == self._drive[-1])]
        rows, close = np.concatenate([before, self._alike(learned[0])]), len(before)
        pose, information, odds = self._network.compare(np.repeat(parts, len(rows), axis=0), self._parts.rows[rows])
        edges = Edges(rows, np.full(len(rows), n), pose, information)
        if self._floor is not None:
            self._floor = replace(self._floor, factors=np.append(self._floor.factors, self._floor.factors[-1]))
            edges = self._floor.lengthened(edges)
        # As the robot moved since the last frame, by odometry if it has any.
        pair = np.zeros(2, dtype=np.int64)
        self._odometry = np.concatenate([self._odometry, wheels])
        moved = odometry_steps(self._odometry[-2:], edges.pose[:1], odds[:1] >= ODDS, pair, ["(unnamed)"], [])
        rolled = wheel_edges(moved, self._settings.drift)
        start = composed(self._poses[-1:], start_of(moved, edges.pose[:1], pair)[1:])
        self._steps = Edges.concatenate([self._steps, trusted(edges.take(slice(close)), odds[:close])])
        rolled = replace(rolled, first=rolled.first + n - 1, second=rolled.second + n - 1)
        self._wheels = Edges.concatenate([self._wheels, rolled])
        self._way = np.append(self._way, self._way[-1] + np.hypot(*(start - self._poses[-1:])[0, :2]))
        self._poses, self._drive = np.concatenate([self._poses, start]), np.append(self._drive, self._drive[-1])
        self._descriptors.append(learned)
        self._parts.append(parts)
        self._paths.append(path)
        self._files.add(place)
        loops = loops_of(edges.take(slice(close, None)), odds[close:])
        self._loops = agreed(Loops.concatenate([self._loops, loops]), self._poses, self._drive, n)
        self._solve()
        return np.array(self._poses[-1])

    def survey(self) -> Survey:
        """Solve for all frames at once, and return the survey."""
        old = self._found.frames
        new = old.take([len(old) - 1] * len(self._paths)).with_columns(
            path=self._paths, time=[np.nan] * len(self._paths)
        )
        frames = with_odometry(concatenate([old, new]), self._odometry)
        graph = replace(self._found.graph, pictures=self._steps, wheels=self._wheels, drive=self._drive)
        notes = self._found.notes
        self._continue(concluded(frames, graph, self._loops, self._poses, notes, self._floor))
        return self._found

    def _alike(self, descriptor: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return the frames that look most like a descriptor (D,), without the frames just before it."""
        unlike = self._descriptors.squares - 2 * self._descriptors.rows @ descriptor
        unlike[(self._drive == self._drive[-1]) & (self._way[-1] - self._way < self._settings.apart)] = np.inf
        best = np.argpartition(unlike, min(self._settings.alike, len(unlike) - 1))[: self._settings.alike]
        return best[np.isfinite(unlike[best])]

    def _solve(self) -> None:
        """Improve the poses of the last frames, with all others, the scales and the biases as they are."""
        begin, found, drive = max(0, len(self) - _WINDOW), self._found.solution, self._drive[-1]
        used = self._loops.take((self._loops.second >= begin) & self._loops.accepted)
        pictures = Edges.concatenate([self._steps.take(self._steps.second >= begin), used])
        wheels = self._wheels.take(self._wheels.second >= begin)
        turned = np.hypot(wheels.pose[:, 0], wheels.pose[:, 1]) * found.gyro_bias[drive]
        wheels = replace(wheels, pose=wheels.pose / [*[found.wheel_scale[drive]] * 2, 1] - np.outer(turned, [0, 0, 1]))
        pictures = replace(pictures, pose=pictures.pose / [found.scale, found.scale, 1])
        every = np.unique(np.concatenate([pictures.first, pictures.second, wheels.first, wheels.second]))
        pictures, wheels = (
            replace(one, first=np.searchsorted(every, one.first), second=np.searchsorted(every, one.second))
            for one in (pictures, wheels)
        )
        fixed = np.flatnonzero((every < begin) | np.isin(every, self._found.graph.fixed))
        graph = PoseGraph(pictures, wheels, np.zeros(len(every), dtype=np.int64), fixed)
        self._poses[every] = solve(graph, self._poses[every], rounds=_ROUNDS).poses


class _Growing:
    """An array (n, ...) that grows without being copied for each row; `squares` are the squared lengths of its rows."""

    def __init__(self, rows: NDArray[np.float32]) -> None:
        self._held, self._count = np.array(rows, dtype=np.float32), len(rows)
        self.squares = np.square(self._held.reshape(len(rows), -1)).sum(axis=1)

    @property
    def rows(self) -> NDArray[np.float32]:
        return self._held[: self._count]

    def append(self, row: NDArray[np.float32]) -> None:
        if self._count == len(self._held):
            self._held = np.concatenate([self._held, np.empty_like(self._held)])
        self._held[self._count] = row[0]
        self._count += 1
        self.squares = np.append(self.squares, np.square(row).sum())
