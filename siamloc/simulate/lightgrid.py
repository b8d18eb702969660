"""Ray casting against a quad mesh, and grids of light values on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from siamloc.simulate.layout import Array
from siamloc.simulate.mesh import QuadMesh


class Caster:
    """Ray casting against a quad mesh (Embree)."""

    def __init__(self, mesh: QuadMesh) -> None:
        from embreex import rtcore_scene
        from embreex.mesh_construction import TriangleMesh

        self._scene: Any = rtcore_scene.EmbreeScene()
        TriangleMesh(self._scene, np.ascontiguousarray(mesh.triangles, dtype=np.float32))

    def first_hit(self, origins: Array, directions: Array) -> tuple[Array, Array, Array, Array]:
        """Return the quad hit (n,), -1 for none, the position on it s, t (n,) and the distance (n,)."""
        hit = self._scene.run(origins, directions, output=True)
        triangle = hit["primID"]
        second = (triangle & 1).astype(bool)
        s = np.where(second, 1 - hit["u"], hit["u"])
        t = np.where(second, 1 - hit["v"], hit["v"])
        return np.where(triangle < 0, -1, triangle >> 1), s, t, hit["tfar"]

    def blocked(self, origins: Array, directions: Array, distances: Array | None = None) -> Array:
        """Return True where anything stands within the distance (n,)."""
        if distances is None:
            return self._scene.run(origins, directions, query="OCCLUDED") == 0
        return self._scene.run(origins, directions, dists=distances, query="OCCLUDED") == 0


@dataclass(frozen=True)
class LightGrid:
    """A grid of nodes on every quad, packed into one image.

    Attributes:
        corner: pixel of each quad's first node (Q, 2).
        count: nodes along the first and the last edge (Q, 2).
        shape: rows and columns of the image.
        quad: quad of each node (N,).
        place: s and t of each node (N, 2).
        pixel: flat index of each node in the image (N,).
    """

    corner: Array
    count: Array
    shape: tuple[int, int]
    quad: Array
    place: Array
    pixel: Array

    @classmethod
    def over(cls, mesh: QuadMesh, spacing: float, single_below: float) -> LightGrid:
        """Lay a grid with about the given spacing in metres; edges shorter than `single_below` get one node."""
        size = mesh.size
        count = np.where(size < single_below, 1, np.clip(np.ceil(size / spacing).astype(int) + 1, 2, 160))
        corner, shape = _pack(count)
        cells = count[:, 0] * count[:, 1]
        quad = np.repeat(np.arange(len(mesh)), cells)
        within = np.arange(len(quad)) - np.repeat(np.cumsum(cells) - cells, cells)
        i, j = within % count[quad, 0], within // count[quad, 0]
        steps = np.maximum(count[quad] - 1, 1)
        place = np.where(count[quad] == 1, 0.5, np.stack([i, j], axis=1) / steps)
        pixel = (corner[quad, 1] + j) * shape[1] + corner[quad, 0] + i
        return cls(corner, count, shape, quad, place, pixel)

    def position(self, quad: Array, s: Array, t: Array) -> tuple[Array, Array]:
        """Return the columns and rows in the image that belong to positions on quads."""
        steps = (self.count - 1).astype(np.float32)[quad]
        corner = self.corner[quad]
        return corner[:, 0] + s * steps[:, 0], corner[:, 1] + t * steps[:, 1]

    def image(self, values: Array) -> Array:
        """Return the image (rows, columns[, channels]) of values (N[, channels])."""
        image = np.zeros((self.shape[0] * self.shape[1], *values.shape[1:]), dtype=np.float32)
        image[self.pixel] = values
        return image.reshape(*self.shape, *values.shape[1:])


def _pack(count: Array) -> tuple[Array, tuple[int, int]]:
    """Place rectangles of (columns, rows) nodes into an image with one free pixel between them."""
    width = 2048
    order = np.argsort(-count[:, 1], kind="stable")
    corner = np.zeros((len(count), 2), dtype=np.int64)
    x = y = shelf = 0
    for index, (columns, rows) in zip(order.tolist(), count[order].tolist(), strict=True):
        if x + columns > width:
            x, y, shelf = 0, y + shelf + 1, 0
        corner[index] = (x, y)
        x += columns + 1
        shelf = max(shelf, rows)
    return corner, (y + shelf + 1, width)
