"""The kinds of things: each one builds, and nothing sticks far out of its box."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

from siamloc.errors import DataError
from siamloc.simulate.items import KINDS, add_items
from siamloc.simulate.layout import Building, Item
from siamloc.simulate.mesh import MeshBuilder
from siamloc.simulate.parse import Options
from siamloc.simulate.prints import print_textures
from siamloc.simulate.textures import base_textures, pattern_textures
from siamloc.simulate.things import THINGS, made_of


@pytest.fixture(scope="module")
def textures() -> dict[str, tuple[int, tuple[float, float] | None]]:
    drawn = base_textures(np.random.default_rng(0)) | print_textures(np.random.default_rng(0))
    drawn |= pattern_textures(np.random.default_rng(0))
    drawn["mirror"] = drawn["metal"]
    return {name: (number, texture.tile) for number, (name, texture) in enumerate(drawn.items())}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_builds_within_its_size(textures: dict, mini: Building, kind: str) -> None:
    builder = MeshBuilder(textures)
    add_items(builder, mini, [Item(kind, 0.0, 0.0, 90.0, KINDS[kind].size, 0.0, "kitchen")])
    mesh = builder.build()
    assert len(mesh)
    width, depth, _ = KINDS[kind].size
    assert (np.abs(mesh.corners[..., :2]) < np.array([width, depth]) / 2 + 0.5).all()
    assert set(KINDS[kind].options) <= set(vars(Options()))


@pytest.mark.parametrize("wood", ["oak", "plastic", "cork", "walnut"])
def test_every_wood_that_a_file_may_name_is_a_texture(textures: dict, wood: str) -> None:
    with pytest.raises(DataError) if wood not in textures else nullcontext():
        Options(wood=wood)


def test_an_item_without_room_for_its_parts_is_refused(textures: dict, mini: Building) -> None:
    fridge = Item("fridge", 0.0, 0.0, 90.0, (0.6, 0.6, 0.5), 0.0, "kitchen")
    with pytest.raises(DataError, match=r": room 'kitchen': fridge is too small for its parts at \(0\.6, 0\.6"):
        add_items(MeshBuilder(textures), mini, [fridge])


def test_a_part_takes_its_share_of_the_size_of_its_item(textures: dict, mini: Building) -> None:
    builder = MeshBuilder(textures)
    item = Item("drum", 0.0, 0.0, 90.0, (2.0, 1.0, 3.0), 0.0, "kitchen", {"colour": [0.1, 0.2, 0.3]})
    parts = made_of("""
        box -1 -.5 0 0 1 .5 metal colour;
        tube .5 0 .5 1 .2 .1 plastic .4 .5 .6;
        front -1 1 .25 .75 1 screen#""")
    parts(builder, item, np.random.default_rng(0), *item.size)
    mesh = builder.build()
    box, tube, panel = mesh.corners[:6], mesh.corners[6:-1], mesh.corners[-1]
    np.testing.assert_allclose([box.min(axis=(0, 1)), box.max(axis=(0, 1))], [[-1, -0.25, 0], [0, 0.5, 1.5]])
    np.testing.assert_allclose(tube[..., 2].max(), 3.0)
    np.testing.assert_allclose(np.abs(tube[..., 0] - 0.5).max(), 0.2, atol=1e-9)
    np.testing.assert_allclose([panel.min(axis=0), panel.max(axis=0)], [[-1, 0.5, 0.75], [1, 0.5, 2.25]])
    np.testing.assert_allclose(mesh.tint[[0, 6, -1]], [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [1, 1, 1]], atol=1e-6)
    assert [one > 0 for one in mesh.emission.max(axis=1)] == [False] * (len(mesh) - 1) + [True]


class Parts:
    """A mesh builder that notes where the parts of an item are: their lowest and highest corners."""

    def __init__(self) -> None:
        self.solid: list[np.ndarray] = []
        self.flat: list[np.ndarray] = []

    def box(self, low: Any, high: Any, *_: Any) -> None:
        self.solid.append(np.array([low, high]))

    def prism(self, x: float, y: float, z: Any, radius: Any, *_: Any) -> None:
        half = min(radius) / np.sqrt(2)  # the thinnest square within it
        self.solid.append(np.array([(x - half, y - half, z[0]), (x + half, y + half, z[1])]))

    def panel(self, x: Any, z: Any, y: float, *_: Any, **__: Any) -> None:
        self.flat.append(np.array([(x[0], y, z[0]), (x[1], y, z[1])]))


def nearest(part: np.ndarray, others: list[np.ndarray]) -> float:
    gaps = [np.maximum(np.maximum(part[0] - other[1], other[0] - part[1]), 0) for other in others]
    return float(np.linalg.norm(gaps, axis=1).min())


@pytest.mark.parametrize("scale", [(1, 1, 1), (0.85, 1.2, 1), (1.2, 0.85, 1)], ids=str)
@pytest.mark.parametrize("kind", THINGS)
def test_no_part_of_a_thing_hangs_in_the_air(kind: str, scale: tuple[float, float, float]) -> None:
    known = THINGS[kind]
    w, d, h = (float(value) for value in np.multiply(known.size, scale))
    built: Any = Parts()
    known.build(built, Item(kind, 0, 0, 90, (w, d, h), known.z, ""), np.random.default_rng(0), w, d, h)
    fixed = [np.array([(-9, -9, -9), (9, 9, -known.z)])]  # the floor
    if known.z > 0:
        fixed.append(np.array([(-9, -9, -9), (9, -d / 2, 9)]))  # the wall that it hangs on
    left = list(range(len(built.solid)))
    while touching := [number for number in left if nearest(built.solid[number], fixed) < 0.001]:
        fixed += [built.solid[number] for number in touching]
        left = [number for number in left if number not in touching]
    assert not left, "parts that hang in the air"
    assert all(nearest(panel, built.solid) < 0.03 for panel in built.flat)
