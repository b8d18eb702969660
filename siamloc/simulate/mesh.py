"""Textured, planar quadrilaterals: building a scene from them, and casting rays against it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from foundation.extras import installing
from siamloc.errors import SiamlocError
from siamloc.simulate.layout import Array

Point = Sequence[float] | Array
WHITE = (1.0, 1.0, 1.0)
BLACK = (0.0, 0.0, 0.0)

# Corners of the unit cube's faces, counter-clockwise seen from outside, starting at the lower left.
_FACES = {
    "front": ((1, 1, 0), (0, 1, 0), (0, 1, 1), (1, 1, 1)),
    "back": ((0, 0, 0), (1, 0, 0), (1, 0, 1), (0, 0, 1)),
    "right": ((1, 0, 0), (1, 1, 0), (1, 1, 1), (1, 0, 1)),
    "left": ((0, 1, 0), (0, 0, 0), (0, 0, 1), (0, 1, 1)),
    "top": ((0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)),
    "bottom": ((0, 1, 0), (1, 1, 0), (1, 0, 0), (0, 0, 0)),
}
_CORNERS = {name: np.array(corners, dtype=np.float64) for name, corners in _FACES.items()}


@dataclass(frozen=True)
class QuadMesh:
    """Q quadrilaterals with their textures, colours and emission.

    Attributes:
        corners: corners in metres (Q, 4, 3), counter-clockwise seen from the visible side; the first is the lower
            left corner of the texture.
        texture: index of the texture (Q,).
        repeat: how often the texture repeats along the first and the last edge (Q, 2).
        phase: position of the first corner in the texture (Q, 2).
        tint: colour that multiplies the texture (Q, 3), linear.
        emission: radiosity that the quad itself emits where its texture is white (Q, 3).
        room: index of the room that the quad belongs to (Q,).
        lamp: share of the radiosity of its room's lamps that the quad emits in addition while they are lit (Q,).
    """

    corners: Array
    texture: Array
    repeat: Array
    phase: Array
    tint: Array
    emission: Array
    room: Array
    lamp: Array

    def __len__(self) -> int:
        return len(self.corners)

    @property
    def normals(self) -> Array:
        """Unit normals (Q, 3) on the visible side."""
        a, b, d = self.corners[:, 0], self.corners[:, 1], self.corners[:, 3]
        normal = np.cross(b - a, d - a)
        return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)

    @property
    def size(self) -> Array:
        """Lengths in metres of the first and the last edge (Q, 2)."""
        return np.linalg.norm(self.corners[:, [1, 3]] - self.corners[:, :1], axis=2)


@dataclass
class MeshBuilder:
    """Collect quads in local coordinates: x to the right, y forwards, z up.

    Attributes:
        textures: index and tile size in metres by texture name; a size of None stretches the texture over the quad.
        room: index of the room that the next quads belong to.
    """

    textures: dict[str, tuple[int, tuple[float, float] | None]]
    room: int = 0
    _origin: Array = field(default_factory=lambda: np.zeros(3))
    _axes: Array = field(default_factory=lambda: np.eye(3))
    _corners: list[Array] = field(default_factory=list)
    _rows: list[tuple[Any, ...]] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self._rows)

    @contextmanager
    def at(self, x: float, y: float, z: float = 0.0, degrees: float = 0.0) -> Iterator[None]:
        """Put the local frame at a point of the outer frame, and turn it counter-clockwise by `degrees`."""
        origin, axes = self._origin, self._axes
        cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        self._origin = origin + np.array([x, y, z]) @ axes
        self._axes = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]]) @ axes
        try:
            yield
        finally:
            self._origin, self._axes = origin, axes

    def quad(
        self,
        a: Point,
        b: Point,
        c: Point,
        d: Point,
        texture: str,
        tint: Point = WHITE,
        emission: Point = BLACK,
        phase: Point = (0.0, 0.0),
        lamp: float = 0.0,
    ) -> None:
        """Add a planar convex quad; the corners run counter-clockwise from the texture's lower left corner.

        The quad can emit light itself, or the share `lamp` of the light of its room's lamps while they are lit.
        """
        corners = np.array([a, b, c, d], dtype=np.float64)
        index, tile = self.textures[texture]
        width, height = (float(np.linalg.norm(corners[end] - corners[0])) for end in (1, 3))
        repeat = (1.0, 1.0) if tile is None else (width / tile[0], height / tile[1])
        self._corners.append(corners @ self._axes + self._origin)
        self._rows.append((index, repeat, tuple(phase), tuple(tint), tuple(emission), self.room, lamp))

    def slab(self, x: Point, y: Point, z: float, texture: str, tint: Point = WHITE, **more: Any) -> None:
        """Add a level rectangle, visible from above if x[0] < x[1] and y[0] < y[1], from below if y[0] > y[1]."""
        self.quad((x[0], y[0], z), (x[1], y[0], z), (x[1], y[1], z), (x[0], y[1], z), texture, tint, **more)

    def panel(self, x: Point, z: Point, y: float, texture: str, tint: Point = WHITE, **more: Any) -> None:
        """Add an upright rectangle, visible from the front (+y), between x[0] < x[1] and z[0] < z[1]."""
        self.quad((x[1], y, z[0]), (x[0], y, z[0]), (x[0], y, z[1]), (x[1], y, z[1]), texture, tint, **more)

    def box(self, low: Point, high: Point, texture: str, tint: Point = WHITE, skip: str = "", **faces: str) -> None:
        """Add a box between two corners.

        Args:
            low: corner with the smallest coordinates.
            high: corner with the largest coordinates.
            texture: name of the texture of all faces.
            tint: linear colour that multiplies that texture.
            skip: faces to leave out, separated by spaces, such as "back bottom"; the six faces are "front" (+y),
                "back", "right" (+x), "left", "top" (+z) and "bottom".
            faces: textures of single faces by the face's name; these faces are not tinted.
        """
        start, extent = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64) - np.asarray(low)
        for name, unit in _CORNERS.items():
            if name not in skip:
                a, b, c, d = start + unit * extent
                self.quad(a, b, c, d, faces.get(name, texture), WHITE if name in faces else tint)

    def prism(
        self,
        x: float,
        y: float,
        z: tuple[float, float],
        radius: float | tuple[float, float],
        texture: str,
        tint: Point = WHITE,
        sides: int = 8,
        stretch: float = 1.0,
        lamp: float = 0.0,
    ) -> None:
        """Add an upright prism or frustum with a lid and without a bottom.

        Args:
            x: position of its axis in metres.
            y: position of its axis in metres.
            z: heights of its bottom and its lid in metres.
            radius: radius in metres, or radii at the bottom and at the lid.
            texture: name of the texture.
            tint: linear colour that multiplies the texture.
            sides: number of sides.
            stretch: factor on its depth (y), below 1 for flat bodies.
            lamp: share of the light of the room's lamps that it emits, as for `quad`.
        """
        below, above = radius if isinstance(radius, tuple) else (radius, radius)
        angle = np.arange(sides + 1) * (2 * np.pi / sides)
        ring = np.stack([np.cos(angle), stretch * np.sin(angle)], axis=1)
        low = np.column_stack([ring * below + (x, y), np.full(sides + 1, z[0])])
        high = np.column_stack([ring * above + (x, y), np.full(sides + 1, z[1])])
        for i in range(sides):
            self.quad(low[i], low[i + 1], high[i + 1], high[i], texture, tint, lamp=lamp)
        for i in range(1, sides - 1, 2):
            self.quad(high[0], high[i], high[i + 1], high[min(i + 2, sides)], texture, tint, lamp=lamp)

    def build(self) -> QuadMesh:
        """Return the mesh of all quads added so far."""
        kinds = (np.int32, np.float32, np.float32, np.float32, np.float32, np.int32, np.float64)
        columns = zip(*self._rows, strict=True)
        return QuadMesh(np.stack(self._corners), *map(np.array, columns, kinds))


def embree() -> tuple[Any, Any]:
    """Return the ray caster: embreex's scene class and its mesh class.

    Raises:
        SiamlocError: embreex is not installed; the extra "simulate" installs it.
    """
    try:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene
    except ImportError as error:
        raise SiamlocError(f"rendering needs the package embreex: {installing('simulate')}") from error
    return EmbreeScene, TriangleMesh


class Caster:
    """Ray casting against a quad mesh (Embree)."""

    def __init__(self, mesh: QuadMesh) -> None:
        scene, triangles = embree()
        self._scene: Any = scene()
        halves = mesh.corners[:, [[0, 1, 3], [2, 3, 1]]]  # of each quad (a, b, c, d): (a, b, d) and (c, d, b)
        triangles(self._scene, np.ascontiguousarray(halves.reshape(-1, 3, 3), dtype=np.float32))

    def first_hit(self, origins: Array, directions: Array) -> tuple[Array, Array, Array, Array]:
        """Return the quad that rays hit (n,), -1 for none, the position s, t on it (n,) and the distance (n,) in m."""
        hit = self._scene.run(origins, directions, output=True)
        triangle = hit["primID"]
        second = (triangle & 1).astype(bool)
        s = np.where(second, 1 - hit["u"], hit["u"])
        t = np.where(second, 1 - hit["v"], hit["v"])
        return np.where(triangle < 0, -1, triangle >> 1), s, t, hit["tfar"]

    def blocked(self, origins: Array, directions: Array, distances: Array | None = None) -> Array:
        """Return True (n,) for rays that hit something within a distance (n,), m."""
        until = {} if distances is None else {"dists": distances}
        return self._scene.run(origins, directions, query="OCCLUDED", **until) == 0
