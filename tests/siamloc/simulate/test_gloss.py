"""What reflects: compared with mirror images, which show at another place what a mirror shows at its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from siamloc.simulate import Run, build_scene
from siamloc.simulate.gloss import PANE, schlick
from siamloc.simulate.layout import Building
from siamloc.simulate.light import ROUGH
from siamloc.simulate.scene import Scene


@pytest.fixture(scope="module")
def glossy(mini: Building) -> Scene:
    scene = build_scene(replace(mini, materials="natural"), Run("night", 1), ROUGH)
    assert scene.gloss is not None
    floor = (np.abs(scene.surfaces.mesh.corners[..., 2]) < 1e-9).all(axis=1)
    return replace(scene, gloss=replace(scene.gloss, head_on=np.where(floor, 0.05, 0).astype(np.float32)))


def rays(scene: Scene, count: int = 4000) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    directions = np.random.default_rng(0).standard_normal((count, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    x, y, _ = scene.state.track.poses[40]
    origins = np.tile(np.array([x, y, 0.95], dtype=np.float32), (count, 1))
    return origins, directions, np.full(count, 0.01, dtype=np.float32)


def exact(cosine: np.ndarray, index: float = 1.5) -> np.ndarray:
    """Fresnel's equations: share of unpolarised light that glass throws back."""
    inside = np.sqrt(1 - (1 - cosine**2) / index**2)
    across = (cosine - index * inside) / (cosine + index * inside)
    along = (inside - index * cosine) / (inside + index * cosine)
    return (across**2 + along**2) / 2


def test_the_share_that_a_surface_throws_back_is_about_that_of_glass() -> None:
    cosine = np.linspace(0.02, 1, 50)
    share = schlick(np.full(50, 0.04), cosine)
    assert np.abs(share - exact(cosine)).max() < 0.05
    assert share[-1] == pytest.approx(exact(cosine)[-1])


def test_a_polished_floor_shows_what_its_mirror_image_shows(glossy: Scene) -> None:
    origins, directions, spread = rays(glossy)
    hits = glossy.hits(origins, directions, spread)
    assert hits.mirrored is not None
    rows, share, mirrored = hits.mirrored
    below = directions[rows, 2] < 0
    down = rows[below & (glossy.gloss.head_on[hits.quad[rows]] > 0)]  # type: ignore[union-attr]
    assert len(down) > 500
    # From an eye as far below the floor as the camera is above it, the same points lie straight ahead.
    here = np.isin(rows, down)
    points = mirrored.origins[here] + mirrored.distance[here, None] * mirrored.directions[here]
    ahead = directions[down] * (1, 1, -1)
    away = np.linalg.norm(points - origins[down] * (1, 1, -1), axis=1, keepdims=True)
    known = mirrored.quad[here] >= 0
    np.testing.assert_allclose((points - origins[down] * (1, 1, -1))[known], (away * ahead)[known], atol=0.01)
    steep = np.clip(-directions[down, 2], 0, 1)
    polish = glossy.gloss.polish[hits.quad[down]]  # type: ignore[union-attr]
    np.testing.assert_allclose(share[here, 0], polish * (0.05 + 0.95 * (1 - steep) ** 5), atol=1e-5)


def test_lamps_are_reflected_in_the_windows_at_night(glossy: Scene) -> None:
    room = glossy.building.rooms["office_west"]
    window = next(one for one in glossy.building.openings if one.rooms == ("office_west", "") and one.along == "x")
    lamp = next(one for one in glossy.lamps if one.room == "office_west")
    level = window.level + 0.13  # the pane lies 19 cm behind the inner face
    image = np.array([lamp.x, 2 * level - lamp.y, lamp.z])
    eye = np.array([2 * window.centre - lamp.x, lamp.y - 0.6, 1.0])  # the way to the image leads through the window
    across = np.linspace(-0.2, 0.2, 9)
    towards = np.concatenate([image + np.array([dx, dy, 0]) - eye for dx in across for dy in across]).reshape(-1, 3)
    directions = (towards / np.linalg.norm(towards, axis=1, keepdims=True)).astype(np.float32)
    origins = np.tile(eye.astype(np.float32), (len(directions), 1))
    spread = np.full(len(directions), 0.01, dtype=np.float32)
    assert room.inner()[1][0] < eye[1] < level
    with_panes, _, _ = glossy.trace(origins, directions, spread)
    without, _, quad = replace(glossy, gloss=None).trace(origins, directions, spread)
    outside = quad < 0
    assert outside.sum() > 30
    more = (with_panes - without)[outside].max(axis=1)
    shining = max(glossy.state.light.lamps_on["office_west"])
    assert (more > 1.4 * PANE * shining).mean() > 0.5, "most of these rays meet the lamp's luminous face"
    assert more.max() < 6 * PANE * shining


def test_both_faces_of_a_pane_reflect(glossy: Scene) -> None:
    origins, directions, spread = rays(glossy, 20_000)
    hits = glossy.hits(origins, directions, spread)
    assert hits.mirrored is not None
    rows, share, mirrored = hits.mirrored
    panes = hits.quad[rows] < 0
    assert panes.sum() > 100
    # A mirrored ray differs from its ray by twice the cosine, along the normal of the pane.
    cosine = np.linalg.norm(directions[rows[panes]] - mirrored.directions[panes], axis=1) / 2
    face = schlick(np.full(len(cosine), PANE), cosine)
    thrown = face.copy()
    for passes in range(200):  # through the first face, back and forth within the glass, and out again
        thrown += (1 - face) ** 2 * face ** (2 * passes + 1)
    np.testing.assert_allclose(share[panes, 0], thrown, rtol=1e-3)
    assert thrown.min() < 0.09, "also head-on"


def test_nothing_reflects_unless_it_is_asked_for(night: Scene) -> None:
    assert night.gloss is None
    assert night.hits(*rays(night, 10)).mirrored is None
