"""Baked light against hand-made rooms whose light is known."""

from __future__ import annotations

import numpy as np
import pytest

from siamloc.simulate.layout import Building
from siamloc.simulate.light import LightGrid, LightTransport
from siamloc.simulate.mesh import Caster, MeshBuilder, QuadMesh
from siamloc.simulate.parse import parse_building
from siamloc.simulate.shell import Lamp
from siamloc.simulate.sky import Sky
from siamloc.simulate.textures import Texture, TextureAtlas, sample


def closed_room() -> tuple[Building, QuadMesh]:
    building = parse_building({"rooms": {"cell": {"x": [0, 4], "y": [0, 4]}}}, 0, "cell")
    builder = MeshBuilder({"plain": (0, (1.0, 1.0))})
    builder.slab((0, 4), (0, 4), 0, "plain")
    builder.slab((0, 4), (4, 0), 3, "plain")
    for place, turn in (((2, 0), 0), ((4, 2), 90), ((2, 4), 180), ((0, 2), 270)):
        with builder.at(*place, 0, turn):
            builder.panel((-2, 2), (0, 3), 0, "plain")
    return building, builder.build()


def baked(albedo: float) -> tuple[QuadMesh, np.ndarray, LightGrid]:
    building, mesh = closed_room()
    lamp = Lamp(2.0, 2.0, 2.99, 0.04, (10.0, 10.0, 10.0), "cell")
    black = Sky(np.zeros((16, 64, 3), dtype=np.float32), None, np.zeros(3))
    colours, rng = np.full((len(mesh), 3), albedo), np.random.default_rng(0)
    light = LightTransport(building, mesh, Caster(mesh)).bake(colours, [lamp], black, rng)
    return mesh, light.light, light.grid


def at(light: np.ndarray, grid: LightGrid, quad: int, s: float, t: float) -> float:
    x, y = grid.position(np.array([quad]), np.array([s]), np.array([t]))
    return float(sample(light, x.astype(np.float32), y.astype(np.float32))[0, 0])


def test_direct_light_of_a_small_lamp_is_the_inverse_square_law() -> None:
    _, light, grid = baked(albedo=0.0)
    below = 10 * 0.04 / (np.pi * 2.99**2)
    assert at(light, grid, 0, 0.5, 0.5) == pytest.approx(below, rel=0.03)
    off = np.hypot(1.5, 2.99)
    aside = 10 * 0.04 / (np.pi * off**2) * (2.99 / off) ** 2
    assert at(light, grid, 0, 0.5 + 1.5 / 4, 0.5) == pytest.approx(aside, rel=0.05)


def test_bounces_approach_the_closed_room_limit() -> None:
    """In a closed room all light that is sent out is absorbed: mean light = flux / (area * (1 - albedo))."""
    sums = {}
    for albedo in (0.0, 0.5):
        mesh, light, grid = baked(albedo)
        total = 0.0
        for quad in range(len(mesh)):
            values = [at(light, grid, quad, s, t) for s in np.linspace(0, 1, 9) for t in np.linspace(0, 1, 9)]
            total += float(np.mean(values)) * float(np.prod(mesh.size[quad]))
        sums[albedo] = total
    # Four bounces leave out 0.5 ** 5 of what the endless series would give.
    assert sums[0.5] / sums[0.0] == pytest.approx(2.0 * (1 - 0.5**5), rel=0.1)


def test_texture_lookup_wraps_and_is_upright() -> None:
    image = np.zeros((256, 256, 3), dtype=np.uint8)
    image[:64, :128] = (255, 0, 0)  # the upper left corner is red
    atlas = TextureAtlas([Texture(np.full((256, 256, 3), 128, np.uint8), (1.0, 1.0)), Texture(image, (1.0, 1.0))])
    u, v = np.array([0.2, 0.7, 1.2, -0.8, 0.2]), np.array([0.9, 0.9, 1.9, -0.1, 0.1])
    colours = atlas.lookup(np.ones(5, dtype=int), u, v, np.zeros(5))
    np.testing.assert_allclose(colours[:, 0], [1, 0, 1, 1, 0], atol=1e-3)
    coarse = atlas.lookup(np.zeros(1, dtype=int), u[:1], v[:1], np.array([9.0]))
    np.testing.assert_allclose(coarse, (128 / 255) ** 2.2, atol=1e-3)
