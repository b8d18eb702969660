"""Pictures: the two cameras agree, turning shifts columns, light behaves, surfaces face the viewer."""

from __future__ import annotations

import numpy as np
import pytest

from siamloc.data.cameras import HyperbolicMirror
from siamloc.data.panorama import PanoramaView, unwrap
from siamloc.errors import ConfigError
from siamloc.simulate import Run, build_scene, render
from siamloc.simulate.camera import CAMERAS, develop, expose
from siamloc.simulate.layout import Building
from siamloc.simulate.rendering import frames, meter
from siamloc.simulate.scene import Scene
from siamloc.simulate.sky import sun_direction

POSES = np.array([[2.4, 4.0, 1.0], [6.0, 1.1, 0.0], [5.6, -2.0, -1.6]])


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.corrcoef(a.ravel().astype(float), b.ravel().astype(float))[0, 1])


def test_unwrapping_agrees_with_the_direct_panorama(cloudy: Scene) -> None:
    with pytest.raises(ConfigError, match=r"camera must be .*omnidirectional or panorama, got 'panoramic'"):
        render(cloudy, POSES, "panoramic")
    rings, panoramas = (render(cloudy, POSES, camera) for camera in ("omnidirectional", "panorama"))
    assert (rings.shape, panoramas.shape) == ((3, 480, 640, 3), (3, 128, 512, 3))
    for ring, panorama in zip(rings, panoramas, strict=True):
        assert correlation(unwrap(ring, HyperbolicMirror()), panorama) > 0.95
    assert correlation(unwrap(rings[0], HyperbolicMirror()), panoramas[1]) < 0.8


@pytest.mark.parametrize("columns", [64, 133])
def test_turning_left_moves_the_picture_right(cloudy: Scene, columns: int) -> None:
    delta = columns * 2 * np.pi / 512
    straight, turned = render(cloudy, np.array([POSES[0], POSES[0] + (0, 0, delta)]), "panorama")
    shifts = [correlation(np.roll(straight, shift, axis=1), turned) for shift in range(512)]
    assert int(np.argmax(shifts)) == columns
    assert max(shifts) > 0.97


def test_what_stands_left_appears_left(cloudy: Scene) -> None:
    origin = np.array([[2.4, 1.1, 0.95]], dtype=np.float32)
    view = PanoramaView(height=3, width=360, top=1, bottom=-1)
    directions = view.directions()[1].astype(np.float32)
    _, _, _, distance = cloudy.caster.first_hit(np.repeat(origin, 360, axis=0), directions)
    assert distance[270] < 1.2 < 4.0 < distance[90], "to the right, the corridor's wall; to the left, the office door"


def test_pictures_depend_on_nothing_but_their_frame(cloudy: Scene, mini: Building) -> None:
    track, camera = cloudy.state.track, CAMERAS["panorama"]
    exposure = meter(cloudy, track)
    together = list(frames(cloudy, track, camera, exposure, [3, 40]))
    alone = next(frames(cloudy, track, camera, exposure, [40]))
    np.testing.assert_array_equal(alone, together[1])
    again = build_scene(mini, Run("cloudy", 1))
    np.testing.assert_array_equal(next(frames(again, track, camera, meter(again, track), [40])), alone)


def test_surfaces_show_their_front(cloudy: Scene) -> None:
    directions = PanoramaView(24, 128, 75, -75).directions().reshape(-1, 3).astype(np.float32)
    wrong = total = 0
    for x, y, _ in cloudy.state.track.poses[::15]:
        origins = np.tile(np.array([x, y, 0.95], dtype=np.float32), (len(directions), 1))
        quad, _, _, _ = cloudy.caster.first_hit(origins, directions)
        hit = quad >= 0
        outwards = np.einsum("ij,ij->i", cloudy.surfaces.normals[quad[hit]], directions[hit])
        wrong, total = wrong + int((outwards > 0.02).sum()), total + int(hit.sum())
    assert wrong < 0.002 * total


def test_light_of_the_three_lightings(cloudy: Scene, night: Scene, sunny: Scene) -> None:
    window = np.array([[1.2, 5.0, 1.4]], dtype=np.float32)
    outwards = np.array([[0.0, 1.0, 0.1]], dtype=np.float32) / np.float32(np.sqrt(1.01))
    spread = np.array([0.01], dtype=np.float32)
    seen = [scene.trace(window, outwards, spread) for scene in (cloudy, night, sunny)]
    assert all(np.isinf(distance[0]) for _, distance, _ in seen)
    day, dark, bright = (float(light.mean()) for light, _, _ in seen)
    assert dark < 0.1 < day
    assert bright > 0.5
    assert (cloudy.sky.sun, night.light.sunny) == (None, None)
    assert sunny.light.sunny is not None
    assert sunny.light.sunny.any()
    assert all(room in night.state.light.lamps_on for room in night.building.rooms)


def test_sun_patches_match_shadow_rays(sunny: Scene) -> None:
    sun = sunny.sky.sun
    assert sun is not None
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(0.2, 8.8, 60), np.linspace(-4.0, 6.6, 60)))
    origins = np.column_stack([x, y, np.full(len(x), 2.0)]).astype(np.float32)
    down = np.tile(np.array([0, 0, -1], dtype=np.float32), (len(origins), 1))
    quad, s, t, distance = sunny.caster.first_hit(origins, down)
    hit = (quad >= 0) & (sunny.surfaces.normals[quad, 2] > 0.99)
    points = (origins + distance[:, None] * down + [0, 0, 0.003]).astype(np.float32)[hit]
    lit = ~sunny.caster.blocked(points, np.tile(sun.astype(np.float32), (len(points), 1)))
    column, row = sunny.light.grid.position(quad, s, t)
    assert sunny.light.sunny is not None
    near = sunny.light.sunny[np.rint(row).astype(int), np.rint(column).astype(int)][hit] > 0
    assert lit.sum() > 10
    assert (near & lit).sum() >= 0.97 * lit.sum()  # no lit place is left out


def test_exposure_follows_slowly(cloudy: Scene) -> None:
    exposure = meter(cloudy, cloudy.state.track)
    steps = np.abs(np.diff(np.log(exposure.gain)))
    assert exposure.gain.max() / exposure.gain.min() > 1.15
    assert steps.max() < 0.6
    assert ((exposure.seconds >= 0.004) & (exposure.seconds <= 0.06)).all()


def test_a_camera_in_the_dark_takes_pictures_of_its_noise() -> None:
    exposure = expose(np.zeros((2, 5)), np.zeros(3), np.arange(2.0), 0.0)
    np.testing.assert_array_equal(exposure.balance, 1)
    dark = np.zeros((64, 256, 3), dtype=np.float32)
    picture = develop(dark, exposure.gain[0], exposure.balance, False, np.random.default_rng(0), 1.0)
    assert 5 < picture.mean() < 20
    assert 10 < picture.std() < 20
    assert picture.max() < 80


def test_the_sun_goes_from_east_to_west_and_highest_at_noon() -> None:
    east, west = np.array([0.0, -1.0, 0.0]), np.array([0.0, 1.0, 0.0])  # north is +x
    hours = [sun_direction(hour, 0.0, 5.0) for hour in (8.0, 12.0, 16.0)]
    assert min(hours[0] @ east, hours[2] @ west) > 0.5
    assert hours[1][2] == max(hour[2] for hour in hours)
    assert hours[1][0] < 0  # from the south
    np.testing.assert_allclose([np.linalg.norm(hour) for hour in hours], 1)
    turned = sun_direction(8.0, 90.0, 5.0)
    np.testing.assert_allclose(turned, [-hours[0][1], hours[0][0], hours[0][2]], atol=1e-12)
