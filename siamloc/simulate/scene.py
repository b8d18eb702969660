"""A building in one run: geometry, textures and baked light, ready for ray casting."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from foundation.calls import typed
from siamloc.simulate.gloss import Gloss
from siamloc.simulate.items import add_items
from siamloc.simulate.layout import Array, Building, Item, seeded, single
from siamloc.simulate.light import FULL, BakedLight, Detail, LightTransport
from siamloc.simulate.mesh import Caster, MeshBuilder, QuadMesh
from siamloc.simulate.natural import natural_textures
from siamloc.simulate.prints import print_textures
from siamloc.simulate.run import Light, Run, RunState, draw_run
from siamloc.simulate.shell import Lamp, add_shell, draw_style
from siamloc.simulate.sky import Sky, make_sky, sun_direction
from siamloc.simulate.textures import TextureAtlas, base_textures, pattern_textures, recoloured, sample

LOOKS = 6


@dataclass(frozen=True)
class Surfaces:
    """A mesh of quads with everything needed to shade a point that a ray hits, in single precision.

    Attributes:
        mesh: the Q quads.
        normals: unit normals on the visible side (Q, 3).
        texels: texels per metre in the largest copy of the quad's texture (Q,).
        emission: radiosity that the quad emits where its texture is white, with the lamps as they are lit (Q, 3).
        glows: whether the quad emits any light (Q,).
    """

    mesh: QuadMesh
    normals: Array
    texels: Array
    emission: Array
    glows: Array

    @classmethod
    def of(cls, mesh: QuadMesh, atlas: TextureAtlas) -> Surfaces:
        """Prepare a mesh for shading with the textures of an atlas; no lamps are lit."""
        stretched = 256 / np.sqrt(np.maximum(mesh.size[:, 0] * mesh.size[:, 1], 1e-8))
        texel = atlas.texel[mesh.texture]
        texels = np.where(np.isnan(texel), stretched, 1 / np.where(np.isnan(texel), 1, texel))
        return cls(mesh, single(mesh.normals), single(texels), mesh.emission, mesh.emission.max(axis=1) > 0)

    def lit(self, lamps: Array) -> Surfaces:
        """Return the same surfaces with the lamps of the R rooms lit at the given radiosities (R, 3)."""
        emission = self.mesh.emission + self.mesh.lamp[:, None] * lamps[self.mesh.room]
        return replace(self, emission=emission.astype(np.float32), glows=emission.max(axis=1) > 0)

    def colour(self, atlas: TextureAtlas, quad: Array, s: Array, t: Array, footprint: Array, smooth: bool) -> Array:
        """Return textures' linear colours (n, 3) at the points that rays hit, without tint.

        Args:
            atlas: the textures.
            quad: index of the quad hit (n,).
            s: position along the first edge of the quad, from 0 to 1 (n,).
            t: position along its last edge, from 0 to 1 (n,).
            footprint: size of a pixel at the point in metres (n,).
            smooth: whether textures are interpolated; otherwise the nearest texel counts.
        """
        s, t = np.clip(s, 0, 0.99999), np.clip(t, 0, 0.99999)
        phase, repeat = self.mesh.phase.take(quad, axis=0), self.mesh.repeat.take(quad, axis=0)
        u = phase[:, 0] + s * repeat[:, 0]
        v = phase[:, 1] + t * repeat[:, 1]
        level = np.log2(np.maximum(footprint * self.texels.take(quad), 1.0))
        return (atlas.lookup if smooth else atlas.nearest)(self.mesh.texture.take(quad), u, v, level)


@dataclass(frozen=True)
class Hits:
    """What n rays hit, independent of the light.

    Attributes:
        origins: starting points in metres (n, 3).
        directions: unit vectors (n, 3).
        quad: index of the quad hit (n,); -1 for none.
        distance: distance in metres (n,); 1 for rays that hit nothing.
        missed: indices of the rays that hit nothing.
        colour: linear colour of the texture (n, 3).
        albedo: that colour multiplied by the tint (n, 3).
        x: column in the image of the baked light (n,).
        y: row in the image of the baked light (n,).
        mirrored: rows of the rays that meet a mirror, the share (m,) of the light that it throws back, and what the
            mirrored rays hit; None if nothing reflects.
    """

    origins: Array
    directions: Array
    quad: Array
    distance: Array
    missed: Array
    colour: Array
    albedo: Array
    x: Array
    y: Array
    mirrored: tuple[Array, Array, Hits] | None = None


@dataclass(frozen=True)
class Scene:
    """A building in the state of one run, with everything that rendering needs.

    Attributes:
        building: the floor plan.
        run: lighting, number and path of the drive.
        state: everything drawn for the drive.
        atlas: the images of all textures, for lookups by index.
        surfaces: all quads of the building, with texture, tint and emission.
        caster: casts rays against the surfaces.
        transport: how light spreads in the building.
        lamps: all lamps, with radiosity 1.
        gloss: which surfaces reflect; None if none does.
        light: how much light arrives at each quad, computed by `transport`.
        sky: what is seen outside the windows, and where the sun stands.
    """

    building: Building
    run: Run
    state: RunState
    atlas: TextureAtlas
    surfaces: Surfaces
    caster: Caster
    transport: LightTransport
    lamps: tuple[Lamp, ...]
    gloss: Gloss | None = None
    light: BakedLight = field(default=None)  # type: ignore[assignment]  # until `relit` bakes it
    sky: Sky = field(default=None)  # type: ignore[assignment]

    @cached_property
    def people(self) -> tuple[tuple[Surfaces, Caster], ...]:
        """Surfaces of the walkers, each standing at the origin and facing +x."""
        building, people = self.building, []
        index = _textures(building.name, building.seed, building.materials)[1]
        for look in range(LOOKS):
            builder = MeshBuilder(index)
            size = (0.5, 0.4, 1.62 + 0.05 * look)
            standing = Item("person", 0.0, 0.0, 0.0, size, 0.0, next(iter(building.rooms)))
            add_items(builder, replace(building, name=f"{building.name} walker {look}"), [standing])
            mesh = builder.build()
            people.append((Surfaces.of(mesh, self.atlas), Caster(mesh)))
        return tuple(people)

    def __repr__(self) -> str:
        return f"Scene({self.building.name!r}, {self.run.name}: {len(self.state.track)} frames)"

    def trace(self, origins: Array, directions: Array, spread: Array) -> tuple[Array, Array, Array]:
        """Return the radiosity (n, 3) seen along rays, their lengths in metres (n,), and what they hit (n,).

        Rays that leave the building have infinite length and hit -1. Other rays hit the number of the quad, plus the
        number of quads if the sun shines on that point: there is no edge between pixels with equal numbers.

        Args:
            origins: starting points in metres (n, 3), float32.
            directions: unit vectors (n, 3), float32.
            spread: angle in rad that a pixel covers (n,).
        """
        hits = self.hits(origins, directions, spread)
        radiosity, lit = self.shine(hits)
        distance = np.where(hits.quad < 0, np.inf, hits.distance)
        hits.quad[lit] += len(self.surfaces.mesh)
        return radiosity, distance, hits.quad

    def hits(self, origins: Array, directions: Array, spread: Array, smooth: bool = True) -> Hits:
        """Return what rays hit, independent of the light.

        Args:
            origins: starting points in metres (n, 3), float32.
            directions: unit vectors (n, 3), float32.
            spread: angle in rad that a pixel covers (n,).
            smooth: whether textures are interpolated; otherwise the nearest texel counts, which is faster.
        """
        hits = self._hits(origins, directions, spread, smooth, 0.0)
        if self.gloss is None:
            return hits
        met = self.gloss.reflected(origins, directions, hits.quad, hits.distance, hits.missed)
        rows, share, points, away, before = met
        mirrored = self._hits(points, away, spread[rows], smooth, before)
        return replace(hits, mirrored=(rows, share[:, None], mirrored))

    def _hits(self, origins: Array, directions: Array, spread: Array, smooth: bool, before: Array | float) -> Hits:
        """Return what rays hit that have gone some metres before, without what they mirror."""
        quad, s, t, distance = self.caster.first_hit(origins, directions)
        missed = np.flatnonzero(quad < 0)
        distance[missed] = 1.0
        surfaces = self.surfaces
        facing = np.abs(np.einsum("ij,ij->i", surfaces.normals.take(quad, axis=0), directions))
        footprint = (distance + before) * spread / np.sqrt(np.maximum(facing, 0.05))
        colour = surfaces.colour(self.atlas, quad, s, t, footprint, smooth)
        x, y = self.light.grid.position(quad, s, t)
        return Hits(
            origins, directions, quad, distance, missed, colour, colour * surfaces.mesh.tint.take(quad, axis=0), x, y
        )

    def shine(self, hits: Hits) -> tuple[Array, Array]:
        """Return the radiosity (n, 3) of the points that rays hit, and the indices of the rays to sunlit points."""
        arriving = sample(self.light.light, hits.x, hits.y)
        lit = hits.missed[:0]
        if self.light.sunny is not None:
            lit = self._add_sun(arriving, hits)
        radiosity = hits.albedo * arriving
        glowing = np.flatnonzero(self.surfaces.glows.take(hits.quad))
        radiosity[glowing] += hits.colour[glowing] * self.surfaces.emission[hits.quad[glowing]]
        radiosity[hits.missed] = self.sky.look(hits.directions[hits.missed])
        if hits.mirrored is not None:
            rows, share, mirrored = hits.mirrored
            own = radiosity.take(rows, axis=0)
            radiosity[rows] = own + share * (self.shine(mirrored)[0] - own)
        return radiosity, lit

    def _add_sun(self, arriving: Array, hits: Hits) -> Array:
        """Add the sun where a shadow ray reaches it, only near spots that baking found sunny; return those rays."""
        assert self.sky.sun is not None
        assert self.light.sunny is not None
        near = self.light.sunny[np.rint(hits.y).astype(np.int64), np.rint(hits.x).astype(np.int64)] > 0
        rows = np.flatnonzero(near & (hits.quad >= 0))
        sun, normals = single(self.sky.sun), self.surfaces.normals
        facing = normals[hits.quad[rows]] @ sun
        rows, facing = rows[facing > 0.01], facing[facing > 0.01]
        if not len(rows):
            return rows
        points = hits.origins[rows] + (hits.distance[rows, None] - 0.003) * hits.directions[rows]
        points += 0.003 * normals[hits.quad[rows]]
        seen = ~self.caster.blocked(points, np.tile(sun, (len(rows), 1)))
        arriving[rows[seen]] += facing[seen, None] * self.sky.sun_radiosity.astype(np.float32)
        return rows[seen]

    def light_at(self, x: float, y: float) -> Array:
        """Return the light (3,) that the floor receives at x, y in metres, without the sun."""
        origin = np.array([[x, y, 0.3]], dtype=np.float32)
        quad, s, t, _ = self.caster.first_hit(origin, np.array([[0, 0, -1]], dtype=np.float32))
        return sample(self.light.light, *self.light.grid.position(quad, s, t))[0]


@typed
def build_scene(building: Building, run: Run, detail: Detail = FULL, light: Light | None = None) -> Scene:
    """Put a building into the state of one run and bake its light.

    Args:
        building: the floor plan with its items.
        run: lighting, number and path of the drive.
        detail: how finely light is computed: `light.FULL`, or the faster `light.ROUGH`.
        light: light to bake; the light of the run if None.

    >>> from siamloc.simulate import load_building
    >>> build_scene(load_building("mini"), Run("night", 1, spacing=1.0))
    Scene('mini', seq2_night1: 75 frames)

    Raises:
        ConfigError: the building has no such path.
        DataError: the run's path leads into a wall or furniture, or an item is too small for its parts.
        SiamlocError: embreex is not installed.
    """
    state = draw_run(building, run)
    building, (mesh, lamps) = state.building, built(state)
    atlas, index = _textures(building.name, building.seed, building.materials)
    caster = Caster(mesh)
    transport = LightTransport(building, mesh, caster, detail)
    gloss, surfaces = None, Surfaces.of(mesh, atlas)
    if building.materials == "natural":
        gloss = Gloss.drawn(building.rng("gloss"), building, index, mesh.texture, surfaces.normals)
    scene = Scene(building, run, state, atlas, surfaces, caster, transport, tuple(lamps), gloss)
    return relit(scene, state.light if light is None else light)


def built(state: RunState) -> tuple[QuadMesh, list[Lamp]]:
    """Return all quads of a building in the state of one run, and its lamps, with radiosity 1.

    Raises:
        DataError: an item is too small for its parts.
    """
    building = state.building
    builder = MeshBuilder(_textures(building.name, building.seed, building.materials)[1])
    style = draw_style(building.rng("style"), building.materials)
    lamps = add_shell(builder, building, state.fixtures, style)
    add_items(builder, building, state.items)
    return builder.build(), lamps


@typed
def relit(scene: Scene, light: Light) -> Scene:
    """Return a scene in which only the light differs; quick, since the visibility of surfaces is kept."""
    building, transport, mesh = scene.building, scene.transport, scene.surfaces.mesh
    rng, clouds = (building.rng(key, light.lighting, light.number) for key in ("light", "sky"))
    view = building.rng("view")
    sun = sun_direction(light.hour, building.north, light.declination)
    sky = make_sky(light.lighting, clouds, view, sun, transport.detail.sky, light.overcast)
    on = [replace(lamp, radiosity=light.lamps_on[lamp.room]) for lamp in scene.lamps if lamp.room in light.lamps_on]
    baked = transport.bake(scene.atlas.mean[mesh.texture] * mesh.tint, on, sky, rng)
    lamps = np.array([light.lamps_on.get(name, (0.0, 0.0, 0.0)) for name in building.rooms])
    return replace(scene, surfaces=scene.surfaces.lit(lamps), light=baked, sky=sky)


@lru_cache(maxsize=2)
def _textures(name: str, seed: int, materials: str) -> tuple[TextureAtlas, dict[str, Any]]:
    rng = seeded(seed, name, "textures")
    textures = base_textures(rng) | print_textures(rng)
    rng = seeded(seed, name, "patterns")
    textures |= pattern_textures(rng)
    if materials != "standard":
        textures = recoloured(textures, rng)
    if materials == "natural":
        textures |= natural_textures(seeded(seed, name, "natural"))
    textures["mirror"] = textures["metal"]
    index = {key: (number, texture.tile) for number, (key, texture) in enumerate(textures.items())}
    return TextureAtlas(textures.values()), index
