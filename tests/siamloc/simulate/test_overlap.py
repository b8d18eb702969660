"""Visual overlap against small pieces of surface, and its properties."""

from __future__ import annotations

import numpy as np
import pytest

from siamloc.data.panorama import PanoramaView
from siamloc.simulate.mesh import Caster, MeshBuilder, QuadMesh
from siamloc.simulate.overlap import visual_overlap
from tests.oracles import visual_overlap as oracle

EYES = np.array([[1.0, 1.0, 1.0], [1.3, 1.2, 1.0], [3.2, 1.5, 1.1], [4.8, 1.5, 1.1], [7.0, 2.5, 0.9]])


def halls(door: float) -> QuadMesh:
    """Build two rooms of 4 m x 3 m with a wall between them, which ends a door's width before the room's end."""
    builder = MeshBuilder({"paint": (0, None)})
    builder.box((0, 0, 0), (8, 3, 2.5), "paint")
    builder.box((3.95, 0, 0), (4.05, 3 - door, 2.5), "paint")
    builder.box((1.8, 0.2, 0), (2.4, 1.0, 1.4), "paint")  # a cupboard
    return builder.build()


@pytest.mark.parametrize("door", [0.0, 1.0])
def test_agrees_with_small_pieces_of_surface(door: float) -> None:
    mesh, view = halls(door), PanoramaView()
    expected = oracle.visual_overlap(mesh.corners, EYES, view.bottom, view.top)
    assert expected[:3, 3:].any() == (door > 0), "a wall separates, and a door connects"
    np.testing.assert_allclose(visual_overlap(mesh, Caster(mesh), EYES, rays=20_000), expected, atol=0.003)
    np.testing.assert_allclose(visual_overlap(mesh, Caster(mesh), EYES), expected, atol=0.08)


@pytest.mark.parametrize("field", [60.0, 190.0])
def test_of_ordinary_images_only_what_lies_in_both_fields_of_view_counts(field: float) -> None:
    mesh, view = halls(1.0), PanoramaView()
    headings = np.array([170.0, -170.0, 60.0, 150.0, 180.0])
    wanted = oracle.visual_overlap(mesh.corners, EYES, view.bottom, view.top, 0.03, headings, field)
    radians = {"headings": np.radians(headings), "field": np.radians(field)}
    found = visual_overlap(mesh, Caster(mesh), EYES, rays=20_000, **radians)
    np.testing.assert_allclose(found, wanted, atol=0.01)
    away = visual_overlap(mesh, Caster(mesh), EYES[[0, 0]], headings=[0.0, np.pi], field=np.radians(60))
    np.testing.assert_array_equal(away, np.eye(2), err_msg="one place, but back to back")


def test_is_a_share_whatever_the_order() -> None:
    mesh = halls(1.0)
    caster = Caster(mesh)
    found = visual_overlap(mesh, caster, EYES)
    np.testing.assert_array_equal(found, found.T)
    np.testing.assert_array_equal(found.diagonal(), 1)
    assert ((found >= 0) & (found <= 1)).all()
    np.testing.assert_allclose(visual_overlap(mesh, caster, EYES[::-1]), found[::-1, ::-1], atol=1e-6)
    again = visual_overlap(mesh, caster, EYES[[0, 0, 1]])
    np.testing.assert_allclose(again[0, 1:], [1, found[0, 1]], atol=1e-3)


def test_what_is_outside_of_the_building_is_no_surface() -> None:
    builder = MeshBuilder({"paint": (0, None)})
    builder.slab((0, 4), (0, 4), 0.0, "paint")
    mesh = builder.build()
    found = visual_overlap(mesh, Caster(mesh), np.array([[1.0, 1, 1], [1, 1, -1], [90, 1, 1]]))
    np.testing.assert_array_equal(found, np.eye(3))
