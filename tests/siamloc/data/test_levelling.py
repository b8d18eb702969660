from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from siamloc.data import EquirectangularCamera, FisheyeCamera, PanoramaLibrary, PanoramaView, Preprocessing
from siamloc.data.levelling import tilt_of
from siamloc.data.picture_checks import horizon
from siamloc.errors import ConfigError
from siamloc.maps.identities import exchangeable

VIEW = PanoramaView(128, 512)
WORLD = np.random.default_rng(0).integers(30, 220, (3, 40))  # grey levels of upright stripes between horizontal ones


def seen(directions):
    """Grey levels (..., 3) of a building of upright stripes, whose walls have a dado and a picture rail."""
    azimuth, up = np.arctan2(directions[..., 1], directions[..., 0]), directions[..., 2]
    band = np.digitize(up / np.linalg.norm(directions[..., :2], axis=-1), [-0.5, 0.3])
    grey = WORLD[band, ((azimuth / (2 * np.pi) + 0.5) * 40).astype(int) % 40]
    return np.repeat(grey[..., None], 3, axis=-1)


@cache
def picture(roll, pitch, rows=1024):
    """What an equirectangular camera shows of the building from a robot that is tilted by degrees."""
    azimuth = np.pi - (np.arange(2 * rows) + 0.5) * np.pi / rows
    elevation = np.pi / 2 - (np.arange(rows) + 0.5) * np.pi / rows
    azimuth, elevation = np.meshgrid(azimuth, elevation)
    flat = np.cos(elevation)
    own = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1)
    tilt = Rotation.from_euler("xy", [roll, pitch], degrees=True).as_matrix()
    shown = cv2.resize(seen(own @ tilt.T).astype(np.float32), (rows, rows // 2), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(1).normal(0, 3, shown.shape)
    return np.clip(shown + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize(("roll", "pitch"), [(0, 0), (3, 0), (0, -4), (-5, 2), (7, 7)])
def test_upright_edges_tell_how_a_picture_was_tilted_and_it_is_levelled_by_them(roll, pitch):
    made = Preprocessing(VIEW, EquirectangularCamera())
    tilted = made.prepare(picture(roll, pitch))
    off = np.degrees(tilt_of(tilted.transpose(1, 2, 0), VIEW)) - [roll, pitch]
    assert np.abs(off).max() < 0.5, "small angles are presumed, and pixels show steps in place of slanted edges"
    level = made.prepare(picture(0, 0)).astype(int)
    off_before, off_after = (
        np.abs(one - level)[:, 4:-4].mean() for one in (tilted, replace(made, level=True).prepare(picture(roll, pitch)))
    )
    assert off_after < off_before / 2 if roll or pitch else off_after < 6


def test_a_picture_without_edges_and_a_known_tilt_are_left_alone():
    assert not tilt_of(np.full((128, 512, 3), 90, np.uint8), VIEW).any()
    made, shown = Preprocessing(VIEW, EquirectangularCamera(), level=True), picture(3, -2)
    known = np.radians([3.0, -2.0])
    assert (made.prepare(shown, known) == replace(made, level=False).prepare(shown, known)).all()
    assert (made.prepare(shown, [np.nan, np.nan]) == made.prepare(shown)).all()


def test_a_library_levels_its_pictures_and_says_so_in_its_settings(tmp_path):
    from siamloc.data import FrameTable

    cv2.imwrite(str(tmp_path / "1.png"), picture(4, 0))
    options = {"kind": "equirectangular", "level": True}
    images = PanoramaLibrary(FrameTable(path=[tmp_path / "1.png"]), tmp_path / "cache", unwrap=options)
    made = images.preprocessing
    assert np.abs(np.degrees(tilt_of(images.batch([0])[0].transpose(1, 2, 0), VIEW))).max() < 0.6
    assert Preprocessing.of(made.parameters()) == made == Preprocessing.checked((128, 512), made.unwrap_settings())
    assert made.words() == "unwrap=equirectangular unwrap.level=true"
    assert made == Preprocessing.checked((128, 512), EquirectangularCamera(), level=True)
    other = replace(made, level=False).parameters()["camera"]
    assert exchangeable(made.parameters()["camera"], other), "panoramas that were taken level need no levelling"
    for kind in ("none", "polar", "auto"):
        with pytest.raises(ConfigError, match=r"unwrap\.level=true needs a camera model that knows the elevation"):
            Preprocessing.checked((128, 512), {"kind": kind, "level": True})
    assert not Preprocessing.checked((128, 512), {**options, "level": False}, level=True).level


@pytest.mark.parametrize(
    ("roll", "pitch", "lower"), [(5, 0, "on the left"), (-5, 0, "on the right"), (0, -5, "ahead"), (0, 5, "behind")]
)
def test_a_camera_that_is_mounted_tilted_or_sways_is_named(roll, pitch, lower):
    made = Preprocessing(VIEW, EquirectangularCamera())
    tilted, against, level = (made.prepare(picture(*tilt)) for tilt in ((roll, pitch), (-roll, -pitch), (0, 1)))
    said = f"things appear about 5 degrees lower {lower}. Mount the camera upright, or set unwrap.level=true"
    assert said in (horizon(np.stack([tilted]), made) or "")
    assert "the camera sways: it is tilted by 5 degrees" in (horizon(np.stack([tilted, against]), made) or "")
    assert "and leave the given tilt out" in (horizon(np.stack([tilted]), made, tilt_given=True) or "")
    assert "or choose the camera model" in (horizon(np.stack([tilted]), replace(made, camera=None)) or "")
    assert horizon(np.stack([level]), made) is None


def test_what_fills_the_pixels_that_a_camera_does_not_see_says_nothing(tmp_path):
    camera, tilt = FisheyeCamera(fov=200, elevation=90, roll=180), Rotation.from_euler("x", 5, degrees=True).as_matrix()
    own = camera.back_project(np.stack(np.meshgrid(np.arange(640.0), np.arange(640.0)), axis=-1), (640, 640))
    inside = np.isfinite(own).all(axis=-1, keepdims=True)
    shown = np.where(inside, seen(np.where(inside, own, [1.0, 0.0, 0.0]) @ tilt.T), 0).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "1.png"), cv2.GaussianBlur(shown, (0, 0), 1))
    (found,) = np.degrees(Preprocessing(VIEW, camera).tilts([tmp_path / "1.png", tmp_path / "missing.png"], 2))
    np.testing.assert_allclose(found, [5, 0], atol=0.7)
