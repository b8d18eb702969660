"""Find ways for a robot through a furnished building: into its rooms and back, around the furniture."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra

from siamloc.errors import DataError
from siamloc.simulate.items import KINDS
from siamloc.simulate.layout import Array, Building, Interval, Rng
from siamloc.simulate.trajectory import resampled

_CELL = 0.1
#: Distance in metres of the robot's middle from walls and furniture; smoothing may reduce it a little.
_CLEARANCE = 0.38
_SMOOTHED = 0.31
_SPACING = 0.45


class FreeSpace:
    """Where a robot can be in a building, as a grid of 10 cm cells.

    Args:
        building: the building with its walls, doors and items.

    Raises:
        DataError: there is no free space.
    """

    def __init__(self, building: Building) -> None:
        (x0, x1), (y0, y1) = building.bounds
        self._origin = np.array([x0 - 0.5, y0 - 0.5])
        fine = 2  # the distance to the nearest obstacle is measured at half the cell size
        shape = [round((high - low + 1.0) / _CELL) * fine for low, high in ((y0, y1), (x0, x1))]
        free = np.zeros(shape, np.uint8)

        def fill(points: Array, value: int) -> None:
            pixels = (points - self._origin) * (fine / _CELL) - 0.5
            cv2.fillPoly(free, [np.round(pixels * 16).astype(np.int32)], value, shift=4)

        for room in building.rooms.values():
            fill(room.inner(0.02).corners(), 255)
        for opening in building.openings:
            if opening.passable:
                fill(opening.doorway(0.03, 0.1).corners(), 255)
        for item in building.items:
            if KINDS[item.kind].blocks:
                fill(item.footprint(0.02), 0)
        distance = cv2.distanceTransform(free, cv2.DIST_L2, 5)[::fine, ::fine] * (_CELL / fine)
        self.clearance = distance
        rows, columns = np.nonzero(distance >= _CLEARANCE)
        if not len(rows):
            raise DataError("a robot does not fit anywhere in this building")
        self._number: Array = np.full(distance.shape, -1)
        self._number[rows, columns] = np.arange(len(rows))
        self.points = np.column_stack([columns, rows]) * _CELL + self._origin + _CELL / 4
        self.margin = distance[rows, columns]
        self._graph = self._edges(rows, columns)

    def _edges(self, rows: Array, columns: Array) -> csr_array:
        """Join neighbouring cells (n, n); a step costs more the nearer an obstacle is."""
        starts, ends, costs = [], [], []
        dear = 1 + 0.35 / self.margin**2
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            y, x = rows + down, columns + right
            inside = (y >= 0) & (x >= 0) & (y < self._number.shape[0]) & (x < self._number.shape[1])
            other = np.full(len(rows), -1)
            other[inside] = self._number[y[inside], x[inside]]
            found = np.flatnonzero(other >= 0)
            starts.append(found)
            ends.append(other[found])
            costs.append(np.hypot(down, right) * _CELL * (dear[found] + dear[other[found]]) / 2)
        count = len(rows)
        joined = (np.concatenate(costs), (np.concatenate(starts), np.concatenate(ends)))
        return coo_array(joined, shape=(count, count)).tocsr()

    def inside(self, x: Interval, y: Interval) -> Array:
        """Return the indices of the cells whose middles lie inside a rectangle, from its extents in metres."""
        inside = (self.points > (x[0], y[0])) & (self.points < (x[1], y[1]))
        return np.flatnonzero(inside.all(axis=1))

    def reachable(self, start: int) -> Array:
        """Return True for the cells (n,) that a robot can reach from the cell with the index `start`."""
        return np.isfinite(dijkstra(self._graph, directed=False, indices=start))

    def way(self, stops: list[int]) -> Array:
        """Return the points (n, 2) in metres of a way through some cells in turn, smooth where there is room.

        Args:
            stops: indices of the cells, in the order in which the way passes them.

        Raises:
            DataError: a cell cannot be reached from the cell before it.
        """
        cells = [stops[0]]
        for start, end in pairwise(stops):
            before = dijkstra(self._graph, directed=False, indices=start, return_predecessors=True)[1]
            part = [end]
            while part[-1] != start:
                previous = int(before[part[-1]])
                if previous < 0:
                    raise DataError("a robot cannot reach every room")
                part.append(previous)
            cells += part[-2::-1]
        raw = self.points[cells]
        smooth = gaussian_filter1d(raw, 2.5, axis=0, mode="nearest")
        pixel = np.rint((smooth - self._origin) / _CELL - 0.25).astype(int)
        fits = self.clearance[pixel[:, 1], pixel[:, 0]] >= _SMOOTHED
        fits = cv2.erode(fits.astype(np.uint8)[:, None], np.ones((7, 1), np.uint8))[:, 0] > 0
        share = gaussian_filter1d(fits.astype(np.float64), 1.5, mode="nearest")[:, None] * fits[:, None]
        line = share * smooth + (1 - share) * raw
        return resampled(line, _SPACING)


def visits(space: FreeSpace, x: Interval, y: Interval, seen: Array, rng: Rng) -> list[int]:
    """Choose the spots that a robot visits in a room: well away from obstacles and each other; more in larger rooms.

    Args:
        space: free space of the building.
        x: start and end of the room along x in metres.
        y: start and end of the room along y in metres.
        seen: whether each cell can be reached (n,).
        rng: draws among equally good spots.
    """
    cells = space.inside((x[0] + 0.3, x[1] - 0.3), (y[0] + 0.3, y[1] - 0.3))
    cells = cells[seen[cells]]
    if not len(cells):
        return []
    points = space.points[cells]
    margin = np.minimum(space.margin[cells], 0.8)
    chosen: list[int] = []
    score = margin + rng.uniform(0, 0.4, len(cells))
    wanted = 2 + int((x[1] - x[0]) * (y[1] - y[0]) // 30)
    while len(chosen) < min(wanted, 4):
        best = int(np.argmax(score))
        if score[best] <= 0:
            break
        chosen.append(best)
        apart = np.linalg.norm(points - points[best], axis=1)
        score = np.minimum(score, np.minimum(apart / 1.6, 1.0) - 0.3) * (apart > 0.5)
    return cells[chosen].tolist()
