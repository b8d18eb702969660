"""What reflects like a mirror in a building: polished floors and table tops, mirrors, and window panes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from siamloc.simulate.layout import HALF_WALL, SIDES, Array, Building, Rng, side_at, single
from siamloc.simulate.mesh import Caster, MeshBuilder

#: Textures that may be polished, each in about half of the buildings: on floors and tops, and on upright surfaces too.
LEVEL = ("parquet", "planks", "linoleum", "linoleum_green", "terrazzo", "checker", "concrete")
UPRIGHT = (
    "tiles_floor", "tiles_wall", "tiles_blue", "marble", "wood", "beech", "walnut", "drawers", "cabinet_doors",
    "kitchen_fronts",
)  # fmt: skip
#: Share of the light that each of the two faces of a pane throws back head-on.
PANE = 0.04
_FRAME = 0.19  # metres from the inner face of the wall to the pane of a window
_LIFT = 0.002


@dataclass(frozen=True)
class Gloss:
    """The surfaces of a building that reflect.

    Attributes:
        head_on: share of the light that each quad throws back head-on (Q,), float32; 0 for matt ones.
        polish: factor on the share that each quad throws back (Q,), float32; below 1 if it scatters the rest.
        normals: unit normals of the quads (Q, 3).
        panes: casts rays against the panes of the windows; None without windows.
        facing: unit normals of the panes (P, 3).
    """

    head_on: Array
    polish: Array
    normals: Array
    panes: Caster | None
    facing: Array

    @classmethod
    def drawn(cls, rng: Rng, building: Building, names: Iterable[str], texture: Array, normals: Array) -> Gloss:
        """Draw which textures of a building are polished.

        Args:
            rng: draws the polish.
            building: its windows have panes.
            names: names of all textures.
            texture: index of the texture of each quad (Q,).
            normals: unit normals of the quads (Q, 3).
        """
        drawn = {
            name: (rng.uniform(0.03, 0.07) * (rng.random() < 0.5), rng.uniform(0.3, 1.0), lowest)
            for polished, lowest in ((LEVEL, 0.5), (UPRIGHT, -0.5))
            for name in polished
        }
        drawn["mirror"] = (rng.uniform(0.8, 0.95), 1.0, -0.5)
        head_on, polish, lowest = single([drawn.get(name, (0.0, 1.0, 0.0)) for name in names]).T[:, texture]
        head_on[normals[:, 2] < lowest] = 0  # nobody polishes a ceiling
        return cls(head_on, polish, normals, *_panes(building))

    def reflected(
        self, origins: Array, directions: Array, quad: Array, distance: Array, missed: Array
    ) -> tuple[Array, ...]:
        """Find the m rays out of n that meet a mirror, and how they continue.

        Args:
            origins: starting points in metres (n, 3), float32.
            directions: unit vectors (n, 3), float32.
            quad: index of the quad hit (n,).
            distance: distance to the quad in metres (n,).
            missed: indices of the rays that hit nothing: they leave through a window.

        Returns:
            Which rays they are (m,), and in single precision the share of the light that the mirror throws back (m,),
            the points in metres just in front of the mirrors (m, 3), the new directions (m, 3), and the metres to the
            mirror (m,).
        """
        shiny = self.head_on.take(quad) > 0
        shiny[missed] = False
        rows = np.flatnonzero(shiny)
        on = quad[rows]
        head_on, polish, normal, before = self.head_on[on], self.polish[on], self.normals[on], distance[rows]
        if self.panes is not None and len(missed):
            pane, _, _, near = self.panes.first_hit(origins[missed], directions[missed])
            through = pane >= 0
            count = int(through.sum())
            rows, before = np.concatenate([rows, missed[through]]), np.concatenate([before, near[through]])
            head_on, polish = np.append(head_on, np.full(count, single(PANE))), np.append(polish, np.ones(count, "f4"))
            normal = np.concatenate([normal, self.facing[pane[through]]])
        coming = directions.take(rows, axis=0)
        cosine = np.einsum("ij,ij->i", coming, normal)[:, None]
        share = polish * schlick(head_on, np.abs(cosine[:, 0]))
        share[len(on) :] *= 2 / (1 + share[len(on) :])  # both faces of the panes, and all the ways between them
        points = origins.take(rows, axis=0) + before[:, None] * coming - _LIFT * np.sign(cosine) * normal
        return rows, share, points, coming - 2 * cosine * normal, before


def schlick(head_on: Array, cosine: Array) -> Array:
    """Return the share of the light that smooth surfaces throw back (n,): Schlick (1994), F0 + (1 - F0)(1 - cos)^5.

    >>> float(schlick(np.array(0.04), np.array(1.0)))
    0.04
    """
    return head_on + (1 - head_on) * (1 - np.minimum(cosine, 1)) ** 5


def _panes(building: Building) -> tuple[Caster | None, Array]:
    """Return the panes of the windows, and their normals (P, 3)."""
    builder = MeshBuilder({"glass": (0, None)})
    for opening in building.openings:
        if opening.kind == "window":
            room = building.rooms[opening.rooms[0]]
            off = -SIDES[side_at(room, opening.along, opening.level)].inwards * (_FRAME - HALF_WALL)
            (x0, y0), (x1, y1) = (opening.point(end, off) for end in opening.interval)
            low, high = opening.bottom, opening.top
            builder.quad((x0, y0, low), (x1, y1, low), (x1, y1, high), (x0, y0, high), "glass")
    if not len(builder):
        return None, np.zeros((0, 3), dtype=np.float32)
    mesh = builder.build()
    return Caster(mesh), single(mesh.normals)
