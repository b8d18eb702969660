"""The cameras of training images that are drawn: each effect against its formula or what it must preserve."""

from __future__ import annotations

from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from siamloc.data.panorama import PanoramaView
from siamloc.errors import ConfigError
from siamloc.simulate import imaging
from siamloc.simulate.camera import add_glare, develop, draw_camera, panorama
from siamloc.simulate.imaging import TONES, Imaging, blurred, draw_imaging, scattered, tone
from siamloc.simulate.layout import seeded
from siamloc.simulate.views import draw_views, look_around

SIZE = ROWS, COLUMNS = 16, 64
CAMERA = panorama(PanoramaView(*SIZE))
ONES = np.ones((*SIZE, 3), dtype=np.float32)
SCENE = np.random.default_rng(0).uniform(0.05, 0.45, (*SIZE, 3)).astype(np.float32)
LINE = np.where(np.arange(COLUMNS) == 0, 0.9, 0).astype(np.float32)[:, None] * ONES


def seen(light: np.ndarray, quiet: float = 0.0, **flaws: Any) -> np.ndarray:
    """Return the light that an image shows; without `flaws`, the camera is perfect, its tone curve a square root."""
    perfect = {"passing": ONES, "own": 0 * ONES, "fringes": None, "soft": 0 * ONES, "veil": 0.0, "grain": ONES}
    perfect |= {"colours": np.eye(3, dtype=np.float32), "curve": np.rint(np.linspace(0, 255, 4096)).astype(np.uint8)}
    taken = replace(draw_imaging(seeded(0), CAMERA), **{**perfect, "quality": None, **flaws})
    return (taken(light, 1.0, np.ones(3), True, seeded(0), quiet) / 255) ** 2


@pytest.mark.parametrize("contrast", [-0.3, 0.0, 0.7])
@pytest.mark.parametrize("strength", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("family", TONES)
def test_a_tone_curve_rises_from_0_to_1(family, strength, contrast):
    found = tone(np.linspace(0, 1, 1000), family, strength, contrast)
    assert (found[0], found[-1]) == (0, pytest.approx(1))
    assert (np.diff(found) > 0).all()


def test_tone_curves_have_the_values_of_their_formulas():
    srgb = tone(0.18, "srgb", 0.0, 0.0)
    assert srgb == pytest.approx(0.4613561), "IEC 61966-2-1"
    assert tone(0.18, "srgb", 0.0, 0.5) == pytest.approx(srgb + 0.5 * srgb * (1 - srgb) * (2 * srgb - 1))
    assert tone(0.18, "gamma", 0.0, 0.0) == pytest.approx(0.18 ** (1 / 1.8))
    assert tone(0.18, "log", 0.0, 0.0) == pytest.approx(np.log(1 + 8 * 0.18) / np.log(9))
    # x (1 + x / white^2) / (1 + x) of light x with white = 1.5, on a display of gamma 2.2.
    assert tone(0.18, "film", 0.0, 0.0) == pytest.approx((0.27 * (1 + 0.27 / 2.25) / 1.27) ** (1 / 2.2))


@pytest.mark.parametrize("wraps", [True, False])
def test_blur_and_glare_keep_the_light_and_go_around_the_edge_of_a_panorama(wraps):
    for found in (blurred(LINE, (1.5, 0.8), wraps), scattered(LINE, 12.0, wraps)):
        np.testing.assert_allclose(found.mean(axis=(0, 1)), LINE.mean(axis=(0, 1)), rtol=1e-5)
        assert (found[3, -1] > 0.1 * found[3, 1]).all() == wraps
    weights = np.exp(-0.5 * (np.arange(-10, 11) / 1.5) ** 2)
    expected = 0.9 * weights / weights.sum()
    reflected = 0 if wraps else expected[11:14]
    np.testing.assert_allclose(blurred(LINE, (1.5, 0.8), wraps)[3, :3, 0], expected[10:13] + reflected, atol=1e-3)


@pytest.mark.parametrize(
    "flaws", [{"soft": 0.8 * ONES}, {"veil": 0.9, "spread": 7.0}, {}], ids=["blur", "veil", "glare"]
)
def test_turning_a_panorama_turns_its_image(flaws):
    lamp = SCENE.copy()
    lamp[4:12, :8] = 0.9 if flaws else 20.0
    image, turned = (seen(np.roll(lamp, shift, axis=1), **flaws) for shift in (0, 32))
    np.testing.assert_allclose(np.roll(image, 32, axis=1), turned, atol=0.01)
    assert np.abs(image - lamp)[4:12, -4:].max() > 0.05, "the lamp shines beyond the left edge"


def test_glare_has_no_seam_except_in_data_sets():
    lamp = SCENE.copy()
    lamp[4:12, :4] = 20.0
    for joined in (True, False):
        value, turned = lamp.copy(), np.roll(lamp, 32, axis=1)
        for one in (value, turned):
            add_glare(one, True, joined)
        assert np.allclose(np.roll(value, 32, axis=1), turned, atol=1e-4) == joined
    image, turned = (develop(np.roll(lamp, by, axis=1), 1.0, np.ones(3), True, seeded(0), 0.0) for by in (0, 32))
    assert (np.roll(image, 32, axis=1) != turned).any()


def test_each_flaw_changes_the_light_by_its_formula():
    np.testing.assert_allclose(seen(SCENE), SCENE, atol=0.005)
    soft = np.where(np.arange(ROWS) < 8, 0, 0.5).astype(np.float32)[:, None, None] * ONES
    expected = LINE + soft * (blurred(LINE, (1.5, 0.8), True) - LINE)
    np.testing.assert_allclose(seen(LINE, soft=soft, blur=(1.5, 0.8)), expected, atol=0.005)
    expected = 0.8 * LINE + 0.2 * scattered(LINE, 12.0, True)
    np.testing.assert_allclose(seen(LINE, veil=0.2, spread=12.0), expected, atol=0.005)
    mixing = np.array([[0.9, 0.1, 0], [0.05, 0.8, 0.15], [0, 0.3, 0.7]], dtype=np.float32)
    np.testing.assert_allclose(seen(SCENE, colours=mixing), SCENE @ mixing.T, atol=0.005)
    colour = np.float32([0.3, 0.5, 0.8]) * ONES
    found = seen(colour, passing=0.1 * ONES, own=np.float32([0.2, 0.3, 0.4]) * ONES)
    np.testing.assert_allclose(found, [0.09, 0.2, 0.4] * ONES, atol=0.005, err_msg="lit by the mean light")
    np.testing.assert_allclose(seen(colour, quality=60), colour, atol=0.03)
    slope = np.linspace(0.1, 0.9, ROWS, dtype=np.float32)[:, None, None] * ONES
    points = np.stack(np.meshgrid(np.arange(COLUMNS), np.arange(ROWS))).astype(np.float32)
    below = np.array([0, 0.5], dtype=np.float32)[:, None, None]
    step = np.array([1, 0, -1]) * 0.5 * 0.8 / (ROWS - 1)
    found = seen(slope, fringes=np.stack([points + below, points - below]))
    np.testing.assert_allclose(found[1:-1], (slope + step)[1:-1], atol=0.006)
    noise = seen(colour, quiet=1.0, grain=1 + 4 * soft) - colour
    assert noise[8:].std() / noise[:8].std() == pytest.approx(3, rel=0.2)


def test_drawn_cameras_are_different_and_most_see_little_of_the_robot():
    covered = []
    for seed in range(80):
        camera, _ = draw_camera(seeded(seed, "views"), SIZE)
        one, again = (draw_imaging(seeded(seed, "imaging"), camera) for _ in range(2))
        for field in fields(Imaging):
            np.testing.assert_equal(getattr(one, field.name), getattr(again, field.name))
        assert one.passing.shape == one.own.shape == (*SIZE, 3)
        assert min(one.passing.min(), one.own.min()) >= 0
        np.testing.assert_allclose(one.colours.sum(axis=1), 1, atol=0.25, err_msg="white stays nearly white")
        assert (one.curve[0], one.curve[-1]) == (0, 255)
        wall = one.curve[round(4095 * np.sqrt(0.2 * np.median(one.passing)))]
        assert 80 < wall < 170, "about as bright as under the response of a data set"
        covered.append((one.passing < 0.1 * np.median(one.passing)).mean())
    assert 0.005 < np.mean(covered) < 0.04
    assert np.mean(np.array(covered) == 0) > 0.5


def test_dirt_dims_spots_of_half_of_the_cameras_and_dust_shines_there(monkeypatch):
    nothing = 0 * ONES[..., :1], 0 * ONES
    monkeypatch.setattr(imaging, "_draw_robot", lambda *_: nothing)
    drawn = [draw_imaging(seeded(seed), CAMERA) for seed in range(300)]
    passing = np.stack([one.passing[..., 0] for one in drawn])
    lost = 1 - passing / passing.max(axis=2, keepdims=True)  # without dirt, the rows of a panorama are even
    own = np.stack([one.own[..., 0] for one in drawn])
    dirty, dusty = (values.max(axis=(1, 2)) > 0.01 for values in (lost, own))
    assert 0.35 < dirty.mean() < 0.6
    assert lost.max() < 0.8
    assert 0.1 < dusty.mean() < dirty.mean()
    assert (own[~dirty] < 0.01).all()
    brightest = own[dusty].reshape(dusty.sum(), -1).argmax(axis=1)
    assert np.take_along_axis(lost[dusty].reshape(dusty.sum(), -1), brightest[:, None], axis=1).min() > 0.02
    across, beside = np.abs(lost[..., 0] - lost[..., -1]).mean(), np.abs(np.diff(lost, axis=2)).mean()
    assert across < 1.5 * beside, "spots go around the edge"


def test_drawn_cameras_mix_each_two_colours_differently():
    colours = np.stack([draw_imaging(seeded(seed), CAMERA).colours for seed in range(100)])
    others = colours[:, ~np.eye(3, dtype=bool)]
    assert 0.02 < others.mean() < 0.08
    assert others.std(axis=1).mean() > 0.02
    assert colours[:, np.eye(3, dtype=bool)].min() > 0.4


def test_the_robot_is_below_the_camera():
    drawn = [draw_imaging(seeded(seed), CAMERA) for seed in range(200)]
    hidden = np.stack([(one.passing == 0).all(axis=2) for one in drawn])
    whole = hidden.all(axis=2).mean(axis=0)  # share of the cameras of which a deck fills a row
    assert 0.1 < whole[-1] < 0.4
    assert not whole[: ROWS // 2].any()
    assert hidden[:, -1].mean() > hidden[:, 0].mean() + 0.1
    own = np.stack([one.own.min(axis=2) for one in drawn])
    assert own[hidden].min() > 0.005, "what it hides it shows"


def test_only_the_images_differ_from_those_of_the_plain_camera():
    plain, drawn = (draw_views(5, SIZE, 1, 2, 3, imaging=imaging) for imaging in ("plain", "drawn"))
    for name in ("xy", "heading", "room", "light", "lighting", "wraps"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(drawn, name))
    assert np.abs(plain.images.astype(int) - drawn.images).mean() > 2
    for one, other in zip(plain.images, drawn.images, strict=True):
        assert np.corrcoef(one.mean(axis=0).ravel(), other.mean(axis=0).ravel())[0, 1] > 0.6, "the same scene"


def test_a_drawn_camera_exposes_longer_at_night():
    dim: Any = SimpleNamespace(hits=lambda eyes, *_, **__: eyes, shine=lambda hits: [np.full_like(hits, 0.012)])
    plain, drawn = (
        look_around([dim], np.zeros((1, 4)), CAMERA, seeded(0), imaging=imaging).mean()
        for imaging in (None, draw_imaging(seeded(0), CAMERA))
    )
    assert plain < 90 < 110 < drawn


@pytest.mark.parametrize("cameras", ["panoramas", "ordinary"])
@pytest.mark.parametrize("size", [(1, 4), (3, 5), (2, 128), (512, 2048)], ids=str)
def test_images_have_any_size(size, cameras):
    camera, _ = draw_camera(seeded(0), size, cameras)
    light = seeded(0).uniform(0, 3, (*size, 3)).astype(np.float32)  # bright enough for glare
    for camera_like in (develop, draw_imaging(seeded(0), camera)):
        image = camera_like(light, 1.0, np.ones(3), camera.wraps, seeded(0), 1.0)
        assert (image.shape, image.dtype) == (light.shape, np.uint8)
        assert image.std() > 5


@pytest.mark.parametrize("size", [(0, 64), (16,), (16, 64, 3), (16, 20_000)], ids=str)
def test_sizes_without_a_meaning_are_refused_before_the_work(size):
    with pytest.raises(ConfigError, match=r"image_size must be \[rows, columns\], each from 1 to 16,384 pixels, got"):
        draw_views(0, size)
