"""Light baking: compute once per run how much light arrives where.

Every quad carries a small grid of light values. Lamps and windows are sampled directly with shadow rays; the light that
surfaces reflect is gathered on a coarser grid, whose rays are cast once and reused for every bounce.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import cv2
import numpy as np

from siamloc.simulate.layout import SIDES, Array, Building, Rng, side_at
from siamloc.simulate.mesh import Caster, QuadMesh
from siamloc.simulate.shell import Lamp
from siamloc.simulate.sky import Sky
from siamloc.simulate.textures import sample

_LIFT = 0.004
_FAINT = 0.003


@dataclass(frozen=True)
class Detail:
    """Level of detail at which light is computed.

    Attributes:
        fine: metres between the nodes that receive light directly.
        fine_single: length in metres below which an edge gets one node.
        coarse: metres between the nodes that gather reflected light.
        coarse_single: length in metres below which an edge gets one node.
        rays: number of rays cast from each gathering node.
        bounces: how often light is reflected.
        sky: number of rows of the image of the world outside.
    """

    fine: float = 0.11
    fine_single: float = 0.12
    coarse: float = 0.35
    coarse_single: float = 0.45
    rays: int = 64
    bounces: int = 4
    sky: int = 512


#: For images with 512 columns, and for those with 256.
FULL, ROUGH = Detail(), Detail(0.2, 0.2, 0.5, 0.6, 32, 3, 192)


@dataclass(frozen=True)
class BakedLight:
    """How much light arrives at each surface of a building in one run.

    Attributes:
        grid: the grid of nodes that the values belong to.
        light: arriving light without the sun (rows, columns, 3).
        sunny: 255 where the sun may shine, else 0 (rows, columns) uint8; None if it shines nowhere.
    """

    grid: LightGrid
    light: Array
    sunny: Array | None


@dataclass(frozen=True)
class _Reach:
    """Where the light of a lamp or a piece of a window arrives: nodes, share of the light, directions towards it."""

    nodes: Array
    share: Array
    towards: Array


class LightTransport:
    """How light spreads in a building whose items stay in place, independent of the light sources.

    What every lamp, window and surface can see is computed once; `bake` is then quick for any light.

    Args:
        building: rooms and windows.
        mesh: all surfaces of the building.
        caster: casts rays against that mesh.
        detail: how finely light is sampled: spacing of the nodes, rays and reflections; `FULL`, or the faster `ROUGH`.
    """

    def __init__(self, building: Building, mesh: QuadMesh, caster: Caster, detail: Detail = FULL) -> None:
        self.building, self.mesh, self.caster, self.detail = building, mesh, caster, detail
        self.fine = LightGrid.over(mesh, detail.fine, detail.fine_single)
        self.coarse = LightGrid.over(mesh, detail.coarse, detail.coarse_single)
        rooms = mesh.room[self.fine.quad]
        self._by_room = [np.flatnonzero(rooms == index) for index in range(len(building.rooms))]
        self._points = _world(mesh, self.fine.quad, self.fine.place).astype(np.float32)
        self._normals = mesh.normals[self.fine.quad].astype(np.float32)
        self._lamps: dict[tuple[float, float, float], tuple[float, _Reach]] = {}
        self._seen: Array | None = None

    def bake(self, albedo: Array, lamps: list[Lamp], sky: Sky, rng: Rng) -> BakedLight:
        """Compute the light on every quad.

        Args:
            albedo: mean colour of every quad (Q, 3).
            lamps: the lamps that are lit.
            sky: the light that comes in through the windows.
            rng: draws the gathering directions, once, and the points from which the sun is looked for.
        """
        mesh, fine, coarse = self.mesh, self.fine, self.coarse
        direct = self._direct(lamps, sky)
        start, sunny = self._averaged(fine.image(direct)), None
        if sky.sun is not None:
            sunny, sun_share = _sun_patches(mesh, self.caster, fine, sky.sun, rng)
            facing = np.clip(mesh.normals @ sky.sun, 0, None)[coarse.quad]
            start += self._averaged(fine.image(sun_share))[:, None] * facing[:, None] * sky.sun_radiosity
        if self._seen is None:
            self._seen = _gathered_from(mesh, self.caster, coarse, self.detail.rays, rng)
        indirect = _indirect(self._seen, albedo[coarse.quad], start, self.detail.bounces)
        x, y = coarse.position(fine.quad, *fine.place.T)
        return BakedLight(fine, fine.image(direct + sample(_smoothed(coarse, indirect), x, y)), sunny)

    def _direct(self, lamps: list[Lamp], sky: Sky) -> Array:
        light = np.zeros((len(self._points), 3), dtype=np.float32)
        for lamp in lamps:
            radiosity = np.array(lamp.radiosity)
            least = _FAINT / max(float(radiosity.max()), 1e-6)
            found = self._of_lamp(lamp, least)
            bright = found.share > least
            light[found.nodes[bright]] += found.share[bright, None] * radiosity.astype(np.float32)
        outside = sky.softened()
        for found in self._windows:
            light[found.nodes] += found.share[:, None] * outside.look(found.towards)
        return light

    @cached_property
    def _windows(self) -> list[_Reach]:
        return [self._reach(*portal, _FAINT, ends=False) for portal in _portals(self.building)]

    def _of_lamp(self, lamp: Lamp, least: float) -> _Reach:
        """Return where a lamp's light arrives; computed again only if it shines brighter than before."""
        key = (lamp.x, lamp.y, lamp.z)
        if key not in self._lamps or self._lamps[key][0] > least:
            down = np.array([0, 0, -1.0])
            self._lamps[key] = (least, self._reach(np.array(key), down, lamp.area, lamp.room, least, ends=True))
        return self._lamps[key][1]

    def _reach(self, position: Array, axis: Array, area: float, room: str, least: float, ends: bool) -> _Reach:
        """Find the nodes that see a surface shining along an axis; with `ends`, only obstacles in front of it count."""
        building, caster, points = self.building, self.caster, self._points
        nodes = np.concatenate([self._by_room[building.room_index(name)] for name in building.neighbours(room)])
        towards = position.astype(np.float32) - points[nodes]
        distance = np.sqrt(np.einsum("ij,ij->i", towards, towards))
        towards /= np.maximum(distance, 1e-4)[:, None]
        arriving = np.einsum("ij,ij->i", towards, self._normals[nodes])
        leaving = -(towards @ axis.astype(np.float32))
        share = area * np.clip(arriving, 0, None) * np.clip(leaving, 0, None) / (np.pi * distance**2 + area)
        keep = share > least
        nodes, towards, distance, share = nodes[keep], towards[keep], distance[keep], share[keep]
        until = np.maximum(distance - 0.03, 0.0).astype(np.float32) if ends else None
        seen = ~caster.blocked(points[nodes], towards, until)
        return _Reach(nodes[seen], share[seen], towards[seen])

    def _averaged(self, image: Array) -> Array:
        """Return the mean of a fine image around each coarse node (N, ...)."""
        fine, coarse = self.fine, self.coarse
        radius = max(1, round(self.detail.coarse / self.detail.fine / 2))
        total = np.zeros((len(coarse.quad), *image.shape[2:]), dtype=np.float32)
        steps = np.maximum(fine.count[coarse.quad] - 1, 1)
        reach = np.where(fine.count[coarse.quad] > 1, radius / steps, 0.0)
        reach = np.where(coarse.count[coarse.quad] == 1, 0.5, reach)
        for offset in product((-0.8, -0.4, 0.0, 0.4, 0.8), repeat=2):
            place = np.clip(coarse.place + reach * offset, 0, 1)
            total += sample(image, *fine.position(coarse.quad, *place.T))
        return total / 5**2


def _world(mesh: QuadMesh, quad: Array, place: Array) -> Array:
    """Return points (n, 3) slightly above their quads, at least 2 cm away from the edges where there is room."""
    inset = np.minimum(0.35, 0.02 / np.maximum(mesh.size, 1e-6))[quad]
    place = np.clip(place, inset, 1 - inset)
    a, b, c, d = mesh.corners[quad].transpose(1, 0, 2)
    s, t = place[:, :1], place[:, 1:]
    lower = s + t <= 1
    point = np.where(lower, a + s * (b - a) + t * (d - a), c + (1 - s) * (d - c) + (1 - t) * (b - c))
    return point + _LIFT * mesh.normals[quad]


def _portals(building: Building) -> list[tuple[Array, Array, float, str]]:
    """Split every window into pieces; return middle, direction into the room, area and room of each."""
    pieces = []
    for opening in building.openings:
        if opening.kind != "window":
            continue
        room = building.rooms[opening.rooms[0]]
        side = SIDES[side_at(room, opening.along, opening.level)]
        radians = np.radians(side.facing)
        axis = np.array([np.cos(radians), np.sin(radians), 0.0])
        columns = max(1, round(opening.width / 0.8))
        rows = max(1, round((opening.top - opening.bottom) / 0.8))
        area = opening.width * (opening.top - opening.bottom) / (columns * rows)
        for i, j in product(range(columns), range(rows)):
            along = opening.interval[0] + (i + 0.5) / columns * opening.width
            z = opening.bottom + (j + 0.5) / rows * (opening.top - opening.bottom)
            plan = side.plan(along, side.level(room.inner()))
            pieces.append((np.array([*plan, z]), axis, area, room.name))
    return pieces


def _sun_patches(mesh: QuadMesh, caster: Caster, grid: LightGrid, sun: Array, rng: Rng) -> tuple[Array, Array]:
    """Return where the sun may shine (an image, 0 or 255) and the share of each node's surroundings that it reaches."""
    facing = np.flatnonzero((mesh.normals @ sun > 0.01)[grid.quad])
    reach = 1.0 / np.maximum(grid.count[grid.quad[facing]], 1)
    share = np.zeros(len(grid.quad), dtype=np.float32)
    tries = 6
    towards = np.tile(sun.astype(np.float32), (len(facing), 1))
    for step in range(tries):
        shift = (np.array([(step % 3) / 3, (step // 3) / 2]) + rng.random((len(facing), 2)) * (1 / 3, 1 / 2)) - 0.5
        places = np.clip(grid.place[facing] + shift * reach, 0, 1)
        share[facing] += ~caster.blocked(_world(mesh, grid.quad[facing], places).astype(np.float32), towards)
    share /= tries
    mask = grid.image((share > 0).astype(np.float32))
    return np.uint8(255) * (cv2.dilate(mask, np.ones((3, 3), np.uint8)) > 0), share


def _gathered_from(mesh: QuadMesh, caster: Caster, grid: LightGrid, rays: int, rng: Rng) -> Array:
    """Return the node that each ray of each node hits (rays, N); N if it leaves the building."""
    n = len(grid.quad)
    points = _world(mesh, grid.quad, grid.place).astype(np.float32)
    normals = mesh.normals
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    tangent = np.cross(helper, normals)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    bitangent = np.cross(normals, tangent)
    frame = np.stack([tangent, bitangent, normals], axis=1).astype(np.float32)[grid.quad]
    turn = rng.random(n).astype(np.float32)
    seen = np.empty((rays, n), dtype=np.int64)
    cells = grid.count.prod(axis=1)
    first = np.cumsum(cells) - cells
    for ray in range(rays):
        angle = 2 * np.pi * ((ray * 0.61803399 + turn) % 1)
        radius = np.float32(np.sqrt((ray + 0.5) / rays))
        local = (radius * np.cos(angle), radius * np.sin(angle), np.full(n, np.sqrt(1 - radius**2), dtype=np.float32))
        directions = np.stack([sum(local[k] * frame[:, k, axis] for k in range(3)) for axis in range(3)], axis=1)
        quad, s, t, _ = caster.first_hit(points, directions.astype(np.float32))
        count = grid.count[quad]
        row, column = (np.rint(place * (count[:, axis] - 1)).astype(np.int64) for axis, place in ((1, t), (0, s)))
        node = first[quad] + row * count[:, 0] + column
        seen[ray] = np.where(quad < 0, n, node)
    return seen


def _indirect(seen: Array, albedo: Array, start: Array, bounces: int) -> Array:
    """Gather the reflected light of all surfaces: `seen` (rays, N), `albedo` (N, 3), `start` their direct light."""
    rays, n = seen.shape
    colour = np.concatenate([albedo, np.zeros((1, 3))]).astype(np.float32)
    lit = np.concatenate([start, np.zeros((1, 3))]).astype(np.float32)
    gathered: Array = np.zeros((n, 3), dtype=np.float32)
    for _ in range(bounces):
        thrown = colour * (lit + np.concatenate([gathered, np.zeros((1, 3), dtype=np.float32)]))
        total = np.zeros((n, 3), dtype=np.float32)
        for ray in range(rays):
            total += thrown[seen[ray]]
        gathered = total / rays
    return gathered


def _smoothed(grid: LightGrid, values: Array) -> Array:
    """Return the image of the values, smoothed within each quad's grid but not across its borders."""
    image = grid.image(values)
    known = grid.image(np.ones(len(values), dtype=np.float32))
    weight = cv2.blur(known, (3, 3))
    smooth = cv2.blur(image, (3, 3)) / np.maximum(weight, 1e-6)[..., None]
    return np.where(known[..., None] > 0, smooth, 0).astype(np.float32)


@dataclass(frozen=True)
class LightGrid:
    """A grid of nodes on every quad, packed into one image.

    Attributes:
        corner: pixel of each quad's first node (Q, 2).
        count: nodes along the first and the last edge (Q, 2).
        shape: rows and columns of the image.
        quad: quad of each node (N,).
        place: position s, t of each node on its quad (N, 2).
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
        """Return the columns and rows in the image of light values for positions s, t on quads."""
        steps, corner = (self.count - 1).astype(np.float32).take(quad, axis=0), self.corner.take(quad, axis=0)
        return corner[:, 0] + s * steps[:, 0], corner[:, 1] + t * steps[:, 1]

    def image(self, values: Array) -> Array:
        """Return the image (rows, columns[, channels]) with the values of the N nodes (N[, channels])."""
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
