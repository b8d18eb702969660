"""Visual overlap: the share of the visible surfaces that two images, or two months, have in common."""

from __future__ import annotations

import numpy as np

from siamloc.data.panorama import PanoramaView
from siamloc.simulate.layout import Array, single
from siamloc.simulate.mesh import Caster, QuadMesh

_LOWEST, _HIGHEST = np.sin(np.radians([PanoramaView.bottom, PanoramaView.top]))
_LEAST = 0.05  # a shadow ray that can contribute less than this share of a ray is not cast
_MOVED = 0.05  # metres by which the corners of a surface may differ before it counts as another one
_FREE = np.float32(0.999)  # share of the way to a surface that must be free: the surface itself is no obstacle


def visual_overlap(
    mesh: QuadMesh, caster: Caster, eyes: Array, rays: int = 32, headings: Array | None = None, field: float = 2 * np.pi
) -> Array:
    """Estimate the visual overlap of every two of P images, which have the elevations of `PanoramaView`.

    Two images show each piece of surface under two solid angles; the angle is 0 where the piece is hidden, too high,
    too low, or outside the field of view. The overlap is the sum of the smaller angles over all pieces, divided by the
    sum of the larger angles. It is 1 if both images show the same surfaces at the same size, and 0 if they have no
    surface in common. What is outside of the building, behind its windows, does not count.

    Each eye casts rays that stand for equal solid angles. An eye at height h above the plane of a piece of surface, and
    at distance r from the piece, sees it under the solid angle h / r^3 per area. So another eye, which sees the end of
    the ray from height h' and distance r', sees the share min(1, (h' / r'^3) / (h / r^3)) of what the ray stands for.
    The mean of both directions counts: with 32 rays, overlaps have a standard error of about 0.03.

    Args:
        mesh: all surfaces of the building.
        caster: casts rays against that mesh.
        eyes: where the images are taken, x, y, z in metres (P, 3).
        rays: number of rays from each point.
        headings: directions in rad in which the images look (P,); 0 if None.
        field: horizontal angle of view in rad; a full turn for panoramas.

    Returns:
        (P, P) float32, from 0 to 1, symmetric, with 1 on the diagonal.

    >>> from siamloc.simulate.mesh import MeshBuilder
    >>> room = MeshBuilder({"paint": (0, None)})
    >>> room.box((0, 0, 0), (6, 4, 2.5), "paint")
    >>> mesh = room.build()
    >>> print(visual_overlap(mesh, Caster(mesh), [[1, 1, 1], [1.5, 1, 1], [5, 3, 1]], rays=1000)[0].round(2))
    [1.   0.62 0.13]
    """
    eyes, count = single(eyes), len(eyes)
    ahead = np.zeros((count, 1)) if headings is None else np.reshape(headings, (-1, 1))
    spiral = _spiral(ahead, rays, field)
    quad, _, _, reach = caster.first_hit(np.repeat(eyes, rays, axis=0), spiral)
    hit = np.flatnonzero(quad >= 0)
    view, directions, reach = hit // rays, spiral[hit], reach[hit]
    points = eyes[view] + reach[:, None] * directions
    normals = single(mesh.normals)[quad[hit]]
    normals *= -np.sign(np.einsum("ij,ij->i", normals, directions))[:, None]  # towards the eye
    plane = np.einsum("ij,ij->i", normals, points)
    own = (np.einsum("ij,ij->i", normals, eyes[view]) - plane) / reach**3
    shared = np.empty((count, count))
    for number, eye in enumerate(eyes):
        height = np.einsum("ij,j->i", normals, eye) - plane  # unlike a product, the same on every machine
        rows = np.flatnonzero(height > 0)
        towards = points[rows] - eye
        distance = np.sqrt(np.einsum("ij,ij->i", towards, towards))
        share = np.minimum(height[rows] / distance**3 / own[rows], 1)
        rise = towards[:, 2] / distance
        aside = np.arctan2(towards[:, 1], towards[:, 0]) - ahead[number]
        seen = np.abs((aside + np.pi) % (2 * np.pi) - np.pi) <= field / 2
        keep = (share > _LEAST) & (rise > _LOWEST) & (rise < _HIGHEST) & seen
        rows, share = rows[keep], share[keep]
        free = ~caster.blocked(np.tile(eye, (len(rows), 1)), towards[keep], np.full(len(rows), _FREE))
        shared[:, number] = np.bincount(view[rows], share * free, minlength=count)
    shared = (shared + shared.T) / 2
    total = np.bincount(view, minlength=count)
    overlap = single(shared / np.maximum(total[:, None] + total - shared, 1))
    np.fill_diagonal(overlap, 1)
    return overlap


def changed_share(then: QuadMesh, now: QuadMesh, eyes: Array, rays: int = 256) -> Array:
    """Return the share of the surfaces in view that are different in another state of a building.

    Each eye casts rays that stand for equal solid angles, over the elevations of `PanoramaView`. A ray meets the same
    surface in both states if the two quads that it hits first have the same texture and colour and lie within 5 cm
    of each other. What is outside of the building, in both states, does not count.

    Args:
        then: all surfaces of the building in one state.
        now: all surfaces in the other state, with the same textures.
        eyes: where the panoramas are taken, x, y, z in metres (P, 3).
        rays: number of rays from each point.

    Returns:
        (P,) from 0 to 1; 0 for an eye that sees no surface.

    >>> from siamloc.simulate.mesh import MeshBuilder
    >>> room = MeshBuilder({"paint": (0, None)})
    >>> room.box((0, 0, 0), (6, 4, 2.5), "paint")
    >>> bare = room.build()
    >>> room.box((4, 1, 0), (5, 2, 2), "paint", (0.5, 0.1, 0.1))
    >>> print(changed_share(bare, room.build(), [[1, 1, 1], [3, 1, 1]]).round(2))
    [0.03 0.12]
    """
    spiral = _spiral(np.zeros((len(eyes), 1)), rays)
    origins = np.repeat(single(eyes), rays, axis=0)
    first, other = (Caster(mesh).first_hit(origins, spiral)[0] for mesh in (then, now))
    same = (np.abs(then.corners[first] - now.corners[other]) < _MOVED).all(axis=(1, 2))
    same &= (then.texture[first] == now.texture[other]) & (then.tint[first] == now.tint[other]).all(axis=1)
    seen, outside = (first >= 0) | (other >= 0), (first < 0) | (other < 0)
    different = (seen & (outside | ~same)).reshape(-1, rays).sum(axis=1)
    return different / np.maximum(seen.reshape(-1, rays).sum(axis=1), 1)


def _spiral(ahead: Array, rays: int, field: float = 2 * np.pi) -> Array:
    """Return directions (P * rays, 3) around P headings (P, 1), even over the sphere by the golden angle."""
    sine = _LOWEST + (np.arange(rays) + 0.5) / rays * (_HIGHEST - _LOWEST)
    turns = (1 + 5**0.5) / 2 * np.arange(rays)
    azimuth = ahead + field * ((turns + 0.5) % 1 - 0.5)
    level = np.sqrt(1 - sine**2)
    spiral = np.stack(np.broadcast_arrays(level * np.cos(azimuth), level * np.sin(azimuth), sine), axis=-1)
    return single(spiral.reshape(-1, 3))
