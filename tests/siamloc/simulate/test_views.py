"""Training images: the fast way of rendering shows the same as the plain one."""

from __future__ import annotations

from typing import Any, get_args

import cv2
import numpy as np
import pytest

from siamloc.data.names import LIGHTINGS
from siamloc.data.panorama import PanoramaView
from siamloc.simulate import Run, build_scene, load_building, render, views
from siamloc.simulate.camera import Cameras, PanoramaCamera, ViewCamera, fisheye, panorama
from siamloc.simulate.light import ROUGH
from siamloc.simulate.run import draw_light, draw_run
from siamloc.simulate.scene import Scene, relit
from siamloc.simulate.sky import make_sky, sun_direction
from siamloc.simulate.views import Exposures, camera_of, draw_views, look_around


def quick(scene: Scene, camera: ViewCamera, seed: int = 0, exposure: Exposures = "drawn") -> np.ndarray:
    x, y, heading = scene.state.track.poses[40]
    return look_around([scene], [[x, y, 0.95, heading]], camera, np.random.default_rng(seed), exposure)[0, 0]


@pytest.mark.parametrize("lighting", LIGHTINGS)
def test_light_that_is_switched_on_later_is_the_light_of_the_run(night: Scene, lighting: str) -> None:
    building = night.building
    light = draw_run(building, Run(lighting, 2)).light
    once, again = relit(night, light), relit(night, light)
    np.testing.assert_array_equal(once.light.light, again.light.light)
    alone = build_scene(building, Run("night", 1), light=light)
    np.testing.assert_array_equal(once.surfaces.emission, alone.surfaces.emission)
    np.testing.assert_array_equal(once.sky.image, alone.sky.image)
    # The rays that gather what surfaces throw back are drawn once for all lights: equal up to their noise.
    assert once.light.light.mean() == pytest.approx(alone.light.light.mean(), rel=0.02)
    assert np.abs(once.light.light - alone.light.light).mean() < 0.1 * alone.light.light.mean()


def test_a_quick_picture_shows_what_a_plain_one_shows(night: Scene) -> None:
    view = PanoramaView(64, 256)
    pictures = quick(night, panorama(view)), render(night, night.state.track.poses[40], PanoramaCamera(view))[0]
    smooth = [cv2.blur(picture, (3, 3)) for picture in pictures]  # one ray per pixel has rough edges
    for channel in range(3):  # whatever the exposure
        assert np.corrcoef(*(picture[..., channel].ravel() for picture in smooth))[0, 1] > 0.95


def test_rough_light_is_about_the_fine_one(night: Scene) -> None:
    rough = build_scene(night.building, Run("night", 1), ROUGH)
    fine, other = (quick(scene, panorama(PanoramaView(32, 128))).astype(float) for scene in (night, rough))
    assert np.abs(fine - other).mean() < 6, "grey levels"


def test_the_sun_of_a_drawn_light_stands_above_the_horizon() -> None:
    building, rng = load_building("random", 3), np.random.default_rng(0)
    for lighting in ["sunny"] * 20 + ["night"]:
        light = draw_light(building, lighting, rng)
        sun = sun_direction(light.hour, building.north, light.declination)
        assert (make_sky(lighting, rng, rng, sun, 16).sun is not None) == (lighting == "sunny")


def test_views_follow_from_their_seed() -> None:
    one, again = (draw_views(5, (16, 64), drives=2, lights=3, poses=4) for _ in range(2))
    np.testing.assert_array_equal(one.images, again.images)
    assert one.images.shape == (24, 3, 16, 64)
    assert set(one.lighting[:3]) == set(LIGHTINGS), "every drive under every light"
    assert len(one.xy) == len(one.room) == len(one.heading) == len(one.light) == len(one)
    assert (one.room >= 0).all()
    np.testing.assert_array_equal(one.pose, np.repeat(np.arange(8), 3))
    np.testing.assert_array_equal(one.xy, one.xy[::3][one.pose])
    between = np.linalg.norm(one.xy[:12:3, None] - one.xy[None, 12::3], axis=2)
    assert np.corrcoef(between.ravel(), one.overlap[:4, 4:].ravel())[0, 1] < -0.5, "also across drives"
    # One place under three lights, then the next one; the second drive passes nearby.
    np.testing.assert_array_equal(one.xy[0], one.xy[2])
    np.testing.assert_array_equal(one.light[:6], [0, 1, 2, 0, 1, 2])
    apart = np.linalg.norm(one.xy[:12, None] - one.xy[None, 12:], axis=2).min(axis=1)
    assert apart.max() < 1.5
    assert not np.array_equal(draw_views(6, (16, 64), drives=1, lights=3, poses=4).images[:12], one.images[:12])


def test_other_worlds_are_other_buildings_for_the_same_camera() -> None:
    one, other = (draw_views(7, (16, 64), 1, 2, 3, worlds=worlds) for worlds in ("offices", "any"))
    assert one.wraps == other.wraps == camera_of(7, (16, 64)).wraps
    assert not np.array_equal(one.xy, other.xy)
    np.testing.assert_array_equal(one.images, draw_views(7, (16, 64), 1, 2, 3).images)


def test_the_exposure_reaches_the_camera() -> None:
    exposures = get_args(Exposures)
    bright = {exposure: draw_views(4, (8, 32), 1, 2, 12, exposure=exposure).images for exposure in exposures}
    spread = {exposure: images.reshape(12, 2, -1).mean(axis=2).std(axis=0) for exposure, images in bright.items()}
    assert (spread["metered"] < spread["drawn"] / 2).all(), "all images of a light are equally bright"


def test_an_ordinary_camera_looks_in_one_direction_on_every_drive() -> None:
    together = {}
    for wraps in (False, True):
        seed = next(seed for seed in range(20) if camera_of(seed, (16, 64)).wraps == wraps)
        headings = draw_views(seed, (16, 64), drives=2, lights=1, poses=30, spacing=0.7).heading
        together[wraps] = abs(np.exp(1j * headings).mean())
    assert together[False] > 0.98, "all within a few degrees"
    assert together[True] < 0.9, "as the robot turns"
    assert not draw_views(seed, (16, 64), 1, 1, 2, cameras="ordinary").wraps


@pytest.mark.parametrize("cameras", ["ordinary", "panoramas"])
def test_the_overlap_is_that_of_the_fields_of_view(monkeypatch: pytest.MonkeyPatch, cameras: Cameras) -> None:
    asked: list[dict[str, Any]] = []

    def noted(_mesh: object, _caster: object, eyes: np.ndarray, **given: Any) -> np.ndarray:
        asked.append(given)
        return np.eye(len(eyes))

    monkeypatch.setattr(views, "visual_overlap", noted)
    drawn = draw_views(3, (8, 32), 2, 2, 3, cameras=cameras)
    (given,) = asked
    if cameras == "ordinary":
        np.testing.assert_array_equal(given["headings"], drawn.heading[::2])
        assert 0.9 < given["field"] < 3.4
    else:
        assert given == {"headings": None, "field": 2 * np.pi}


def test_a_metered_camera_takes_nearly_the_same_picture_again(night: Scene) -> None:
    camera, change = panorama(PanoramaView(32, 128)), {}
    for exposure in get_args(Exposures):
        one, other = (quick(night, camera, seed, exposure).astype(float) for seed in (0, 1))
        change[exposure] = np.abs(one - other).mean()
    assert change["metered"] < change["drawn"] / 2, "all that differs is where the rays pass in their pixels"


def test_a_fisheye_lens_leaves_its_rim_dark(night: Scene) -> None:
    camera = fisheye((32, 128), 0.9, 1.4, 1.5)
    picture = quick(night, camera)
    assert camera.shown is not None
    assert picture[~camera.shown].max() < 12
    assert picture[camera.shown].mean() > 20
