from __future__ import annotations

import re
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

import analytic
from siamloc.data import (
    CentralCamera,
    DoubleSphereCamera,
    DualFisheyeCamera,
    EquirectangularCamera,
    FisheyeCamera,
    FrameTable,
    HyperbolicMirror,
    LensCamera,
    OCamCamera,
    PanoramaLibrary,
    PanoramaView,
    UnifiedCamera,
    check,
    seen,
    unwrap,
)
from siamloc.data.decoding import Preprocessing
from siamloc.data.image_files import UnreadableImageError
from siamloc.errors import ConfigError, DataError
from tests.oracles import cameras as oracle

SIZE = (960, 1280)
WHOLE = (640, 1280)
MATRIX = {"fx": 300.0, "fy": 310.0, "cx": 640.0, "cy": 470.0}
FISHEYE = FisheyeCamera(**MATRIX, k=(0.02, -0.01, 0.002, -0.0003), azimuth=20, elevation=40, roll=10)
UNIFIED = UnifiedCamera(**MATRIX, skew=0.5, xi=0.95, distortion=(-0.15, 0.05, 0.001, -0.002), elevation=-90)
OCAM = OCamCamera(polynomial=(-280, 0, 6e-4, -2e-7, 3e-10), cx=650, cy=470, affine=(1.001, 0.002, -0.001))
MODELS = [
    (FISHEYE, oracle.fisheye, SIZE),
    (replace(FISHEYE, k=(0.0,) * 4, elevation=90, roll=180), oracle.fisheye, SIZE),
    (UNIFIED, oracle.unified, SIZE),
    (replace(UNIFIED, mirrored=True, roll=-33), oracle.unified, SIZE),
    (replace(UNIFIED, fx=900.0, fy=910.0, xi=1.8, elevation=10, azimuth=-120), oracle.unified, SIZE),
    (DoubleSphereCamera(**MATRIX, xi=-0.2, alpha=0.6, elevation=90), oracle.double_sphere, SIZE),
    (DoubleSphereCamera(**MATRIX, xi=0.3, alpha=0.4, azimuth=90, roll=5), oracle.double_sphere, SIZE),
    (replace(OCAM, elevation=-90, mirrored=True), oracle.ocam, SIZE),
    (replace(OCAM, azimuth=70), oracle.ocam, SIZE),
    (EquirectangularCamera(azimuth=30, elevation=-10, roll=5), None, WHOLE),
]
NAMES = [f"{type(model).__name__}{number}" for number, (model, _, _) in enumerate(MODELS)]
LOOKS_UP = {"elevation": 90, "roll": 180}
BELOW_A_MIRROR = {"elevation": -90, "mirrored": True}
ONE_PLACE = {
    "equirectangular": (EquirectangularCamera(), (320, 640)),
    "cropped": (EquirectangularCamera(highest=50, lowest=-60), (200, 640)),
    "dual fisheye": (DualFisheyeCamera(), (320, 640)),
    "unified": (UnifiedCamera(fx=131, xi=0.94, **BELOW_A_MIRROR, distortion=(-0.02, 0.001, 0.0, 0.0)), (480, 640)),
    "double sphere": (DoubleSphereCamera(fx=56, xi=-0.1, alpha=0.52, **LOOKS_UP), (480, 480)),
    "fisheye": (FisheyeCamera(fov=280, **LOOKS_UP), (480, 480)),
    "ocam": (OCamCamera(polynomial=(-90.0, 0.0, 4.5e-3), **BELOW_A_MIRROR), (480, 640)),
    "hyperbolic": (HyperbolicMirror(), (480, 640)),
}
VIEW = PanoramaView(64, 256)


def directions(count=400):
    found = np.random.default_rng(0).normal(size=(count, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


def texture(rays, seed=0):
    """A smooth pattern on the sphere: grey levels (...) of unit rays (..., 3)."""
    rng = np.random.default_rng(seed)
    waves = rng.normal(0, 4, (12, 3))
    return 127 + 40 * np.sin(rays @ waves.T + rng.uniform(0, 6, 12)).sum(axis=-1) / 12**0.5


def picture(camera, size, seed=0, turn=None):
    """What a camera sees of the sphere, (rows, columns, 3), black where it sees nothing."""
    rows, columns = np.mgrid[: size[0], : size[1]].astype(float)
    rays = camera.back_project(np.stack([columns, rows], axis=-1), size)
    level = texture(rays if turn is None else rays @ turn.T, seed)
    return np.repeat(np.nan_to_num(level).clip(0, 255).round().astype(np.uint8)[..., None], 3, axis=-1)


@pytest.mark.parametrize(("camera", "project", "size"), MODELS, ids=NAMES)
def test_every_model_projects_as_its_paper_says(camera, project, size):
    project = project or (lambda x, y, z, _: oracle.equirectangular(x, y, z, *size))
    found, shown = camera.project(5.3 * directions(), size), 0
    for direction, pixel in zip(directions(), found, strict=True):
        if np.isfinite(pixel).all():
            np.testing.assert_allclose(pixel, project(*oracle.turned(direction, camera), camera), atol=1e-5)
            shown += 1
    assert shown > 200


@pytest.mark.parametrize(("camera", "project", "size"), MODELS, ids=NAMES)
def test_projecting_and_projecting_back_are_inverse(camera, project, size):
    pixels = np.random.default_rng(1).uniform([0, 0], [size[1] - 1, size[0] - 1], (2000, 2))
    rays = camera.back_project(pixels, size)
    there = np.isfinite(rays).all(axis=1)
    assert there.mean() > 0.5
    np.testing.assert_allclose(np.linalg.norm(rays[there], axis=1), 1)
    np.testing.assert_allclose(camera.project(rays[there], size), pixels[there], atol=1e-5)


def test_fisheye_agrees_with_opencv():
    camera = FisheyeCamera(**MATRIX, k=(0.02, -0.01, 0.002, -0.0003), skew=0.7)
    rays = directions(500)
    rays = rays[rays[:, 0] > 0.1]
    inside = np.stack([-rays[:, 1], -rays[:, 2], rays[:, 0]], axis=1)
    matrix = np.array([[300, 0.7, 640], [0, 310, 470], [0, 0, 1.0]])
    still = np.zeros(3)
    expected, _ = cv2.fisheye.projectPoints(
        inside[:, None], still, still, matrix, np.array(camera.k), alpha=camera.skew / camera.fx
    )
    np.testing.assert_allclose(camera.project(rays, SIZE), expected[:, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("angles", "ahead", "left"),
    [
        ({}, (50, 50), None),  # looks ahead
        (LOOKS_UP, (50, 0), (100, 50)),  # the floor plan mirrored: left on the right
        ({"elevation": 90, "roll": 90}, (100, 50), (50, 100)),
        ({"elevation": -90}, (50, 0), (0, 50)),
        (BELOW_A_MIRROR, (50, 0), (100, 50)),
        ({"azimuth": 90, "roll": 30}, None, (50, 50)),
    ],
)
def test_where_the_front_and_the_left_of_the_robot_appear(angles, ahead, left):
    camera = FisheyeCamera(fx=100 / np.pi, cx=50, cy=50, fov=200, **angles)
    for expected, direction in ((ahead, (1, 0, 0)), (left, (0, 1, 0))):
        if expected is not None:
            np.testing.assert_allclose(camera.project(np.array([direction]), (101, 101))[0], expected, atol=1e-9)


def test_a_lens_without_numbers_fills_the_shorter_side():
    lens = FisheyeCamera(fov=190)
    edge = np.radians(95 - 1e-6)
    column, row = lens.project(np.array([np.cos(edge), -np.sin(edge), 0]), (480, 640))
    assert (column, row) == pytest.approx((319.5 + 240, 239.5), abs=1e-4)
    assert np.isnan(lens.project(np.array([np.cos(edge + 0.01), -np.sin(edge + 0.01), 0]), (480, 640))).all()
    assert FisheyeCamera().project(np.array([-0.01, 0, 1.0]), (480, 640)) == pytest.approx([np.nan] * 2, nan_ok=True)


def test_what_a_model_folds_is_not_seen():
    folding = FisheyeCamera(**MATRIX, k=(-0.2, 0.0, 0.0, 0.0))  # rises up to 1.29 rad
    assert np.isfinite(folding.project(np.array([np.cos(1.28), np.sin(1.28), 0]), SIZE)).all()
    assert np.isnan(folding.project(np.array([np.cos(1.31), np.sin(1.31), 0]), SIZE)).all()
    assert np.isnan(UnifiedCamera(fx=100, xi=0.5).project(np.array([-0.51, 0.86, 0]), SIZE)).all()


def test_each_direction_is_taken_from_the_nearer_lens():
    camera = DualFisheyeCamera()
    pixels = camera.project(directions(), WHOLE)
    assert np.isfinite(pixels).all()
    assert ((pixels[:, 0] < 639.5) == (directions()[:, 0] > 0)).all()
    np.testing.assert_allclose(camera.back_project(pixels, WHOLE), directions(), atol=1e-9)
    front, back = camera.project(np.array([[1, 0, 0], [-1, 0, 0]]), WHOLE)
    assert (front.tolist(), back.tolist()) == ([319.5, 319.5], [959.5, 319.5])
    one_sided = DualFisheyeCamera(back=FisheyeCamera(fov=60))
    shown = np.isfinite(one_sided.project(directions(), WHOLE)[:, 0])
    angle = np.degrees(np.arccos(directions()[:, 0]))
    np.testing.assert_array_equal(shown, (angle <= 95) | (angle >= 150))


def test_the_field_of_view_of_two_lenses_is_that_of_each():
    camera = DualFisheyeCamera(fov=195)
    assert camera == DualFisheyeCamera(*[FisheyeCamera(fov=195)] * 2)
    assert np.isfinite(camera.project(directions(), WHOLE)).all()
    assert Preprocessing.checked((16, 64), {"kind": "dual_fisheye", "fov": 195}).camera == camera
    assert DualFisheyeCamera.of(camera.plain()) == camera


def test_two_pictures_of_two_lenses_are_read_as_one(tmp_path):
    whole = picture(DualFisheyeCamera(), (64, 128))
    for name, half in (("a_00_1.png", whole[:, :64]), ("a_10_1.png", whole[:, 64:])):
        cv2.imwrite(str(tmp_path / name), half)
    made = Preprocessing.checked((16, 64), {"kind": "dual_fisheye", "second": ["_00_", "_10_"]})
    np.testing.assert_array_equal(made.panorama(tmp_path / "a_00_1.png"), made.prepare(whole))
    assert made.files(tmp_path / "a_00_1.png")[1].name == "a_10_1.png"
    frames = FrameTable(path=[tmp_path / "a_00_1.png"])
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=(16, 64), unwrap=made.camera)
    assert images.seen("").all()
    assert not any("see" in one for one in check(frames, images))
    cv2.imwrite(str(tmp_path / "a_10_1.png"), whole)
    with pytest.raises(UnreadableImageError, match=r"second picture a_10_1\.png has another size"):
        made.panorama(tmp_path / "a_00_1.png")
    cv2.imwrite(str(tmp_path / "b.png"), whole[:, :64])
    with pytest.raises(UnreadableImageError, match=r"its name lacks what unwrap\.second replaces"):
        made.panorama(tmp_path / "b.png")
    (tmp_path / "a_10_1.png").unlink()
    with pytest.raises(UnreadableImageError, match=r"its second picture a_10_1\.png: the file does not exist"):
        made.panorama(tmp_path / "a_00_1.png")


@pytest.mark.parametrize("name", ONE_PLACE)
def test_one_place_gives_one_panorama_and_one_descriptor_through_any_camera(name):
    camera, size = ONE_PLACE[name]
    found = unwrap(picture(camera, size), camera, VIEW)
    expected, other = (texture(VIEW.directions(), seed).clip(0, 255) for seed in (0, 1))
    assert seen(camera, VIEW, size).all()
    assert np.abs(found[..., 0] - expected).mean() < 2
    hog = analytic.descriptor("hog")
    same, apart, mine = (hog.describe(one.astype(np.uint8)).position for one in (expected, other, found[..., 0]))
    assert np.linalg.norm(mine - same) < 0.15 * np.linalg.norm(apart - same)


@pytest.mark.parametrize("name", ["equirectangular", "dual fisheye", "fisheye"])
def test_a_tilt_is_taken_out(name):
    camera, size = ONE_PLACE[name]
    roll, pitch = 0.12, -0.2
    about_ahead = cv2.Rodrigues(np.array([roll, 0, 0]))[0]
    turn = cv2.Rodrigues(np.array([0, pitch, 0]))[0] @ about_ahead  # of the robot against the level
    image = picture(camera, size, turn=turn)
    expected = texture(VIEW.directions()).clip(0, 255)
    level = unwrap(image, camera, VIEW.tilted(roll, pitch))[..., 0]
    ours = seen(camera, VIEW.tilted(roll, pitch), size)
    assert ours.mean() > 0.9
    assert np.abs(level - expected)[ours].mean() < 2
    assert np.abs(unwrap(image, camera, VIEW)[..., 0] - expected).mean() > 8
    assert (unwrap(image, camera, VIEW.tilted(0, 0)) == unwrap(image, camera, VIEW)).all()


@pytest.mark.parametrize("rows", [240, 800])
@pytest.mark.parametrize(
    "camera", [FisheyeCamera(elevation=90, fov=210.0), DualFisheyeCamera(*[FisheyeCamera(fov=180.0)] * 2)]
)
def test_the_black_around_a_circle_is_not_mixed_into_a_panorama(camera, rows):
    size = (rows, rows * (2 if isinstance(camera, DualFisheyeCamera) else 1))
    pixels = np.stack(np.meshgrid(np.arange(size[1]), np.arange(rows)), axis=-1)
    picture = np.where(camera.shows(pixels, size), 158, 0).astype(np.uint8)
    view = PanoramaView(64, 256, top=30.0, bottom=-15.0)  # down to the edge of the fisheye's circle
    assert seen(camera, view, size).all()
    assert (unwrap(picture, camera, view) == 158).all()


def test_the_seam_of_a_whole_picture_is_closed_and_no_other_camera_wraps():
    ramp = np.tile(np.abs(np.linspace(-255, 255, 512)).astype(np.uint8), (256, 1))  # bright behind
    panorama = unwrap(ramp, EquirectangularCamera(), PanoramaView(32, 1024))
    assert panorama[:, [0, -1]].min() > 250
    half, view = EquirectangularCamera(turn=180, highest=45, lowest=-45), PanoramaView(32, 128)
    assert seen(half, view, (256, 512)).mean() == 0.5
    assert unwrap(ramp, half, view)[:, 33].min() > 240


def test_a_fine_picture_is_averaged_into_a_coarse_panorama():
    stripes = np.tile(np.array([0, 255], np.uint8), (1024, 1024))
    assert np.abs(unwrap(stripes, EquirectangularCamera(), VIEW).astype(int) - 127).max() < 12


@dataclass(frozen=True)
class Stereographic(LensCamera):
    """A model of one's own: two methods."""

    def to_plane(self, rays):
        scale = 2 / (1 + rays[..., 2])
        return scale * rays[..., 0], scale * rays[..., 1]

    def from_plane(self, x, y):
        return np.stack([x, y, 1 - (x**2 + y**2) / 4], axis=-1)


def test_a_model_of_ones_own_needs_two_methods():
    camera = Stereographic(fx=45.0, **LOOKS_UP)
    assert np.abs(unwrap(picture(camera, (480, 480)), camera, VIEW)[..., 0] - texture(VIEW.directions())).mean() < 2
    made = Preprocessing.checked((64, 256), camera)
    assert made.parameters()["camera"]["kind"] == f"{__name__}:Stereographic"
    assert Preprocessing.of(made.parameters()) == made
    assert Preprocessing.checked((64, 256), made.unwrap_settings()) == made


@dataclass(frozen=True)
class OneWay(CentralCamera):
    """A model of one's own that lacks the way back."""

    def to_image(self, rays, size):
        return 100 * rays[..., :2] + np.array(size) / 2


@dataclass(frozen=True)
class Apart(OneWay):
    """A model of one's own that returns columns and rows apart."""

    def to_image(self, rays, size):
        return rays[..., 0], rays[..., 1]


def test_a_picture_of_another_shape_is_left_out_if_it_does_not_fit_and_others_do(tmp_path, caplog):
    for name, rows in (("fits", 320), ("odd", 480), ("too", 320)):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.zeros((rows, 640, 3), np.uint8))
    fits, odd, too = (tmp_path / f"{name}.png" for name in ("fits", "odd", "too"))
    given = {"cache": tmp_path / "cache", "image_size": (8, 32), "unwrap": EquirectangularCamera()}
    says = r"odd\.png .*a whole equirectangular picture is twice as wide as high, and this one has 640 x 480 px"
    assert PanoramaLibrary(FrameTable(path=[fits, odd]), **given).frames.path.tolist() == [str(fits)]
    assert re.search(rf"1 of 2 images cannot be read, the first: .*{says}", caplog.text)
    with pytest.raises(DataError, match=r"odd\.png cannot be read: a whole equirectangular picture is"):
        PanoramaLibrary(FrameTable(path=[fits, odd]), **given | {"cache": tmp_path / "strict"}, on_error="raise")
    with pytest.raises(ConfigError, match=r"odd\.png: a whole equirectangular picture is twice as wide"):
        PanoramaLibrary(FrameTable(path=[odd]), **given)
    with pytest.raises(ConfigError, match=r"odd\.png: a whole equirectangular picture is twice as wide"):
        PanoramaLibrary(FrameTable(path=[odd] * 11 + [fits]), **given)  # the camera is another one
    with pytest.raises(ConfigError, match=r"odd\.png: a whole equirectangular picture is twice as wide"):
        PanoramaLibrary(FrameTable(path=[fits, odd, odd]), **given)
    assert len(PanoramaLibrary(FrameTable(path=[odd] * 11 + [fits] * 12), **given)) == 12
    assert len(Preprocessing.checked((8, 32), EquirectangularCamera()).tilts([odd, fits, too], 3)) == 2


def test_a_calibrated_camera_takes_pictures_of_its_shape_and_leaves_others_out(tmp_path, caplog):
    for name, size in {"turned": (128, 96), "half": (48, 64), "a": (96, 128), "b": (96, 128), "c": (96, 128)}.items():
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.zeros((*size, 3), np.uint8))
    frames = FrameTable(path=[str(tmp_path / f"{name}.png") for name in ("turned", "half", "a", "b", "c")])
    given = {"image_size": (8, 32), "unwrap": FisheyeCamera(fov=280, **LOOKS_UP, image_size=(96, 128))}
    images = PanoramaLibrary(frames, tmp_path / "cache", **given)
    assert [item["path"] for item in images.rejected] == [str(tmp_path / "turned.png")]
    assert "the pictures have 64 x 48 px, and the camera's parameters count in those of 128 x 96" in caplog.text
    with pytest.raises(ConfigError, match=r"calibrated on pictures of 128 x 96 px, and this one has 64 x 48"):
        PanoramaLibrary(frames.take([1]), tmp_path / "cache", **given)


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (EquirectangularCamera(), "twice as wide as high, and this one has 640 x 480 px: cut .*unwrap.highest"),
        (DualFisheyeCamera(), "two fisheye lenses side by side is twice as wide as high.*640 x 480"),
        (replace(FISHEYE, image_size=SIZE), "calibrated on pictures of 1280 x 960 px.* has 640 x 480"),
        (FisheyeCamera(elevation=90, fov=60), "sees 0% of a panorama from 30 to -45 deg.*where it looks"),
        (UnifiedCamera(), "unwrap.fx is not set: give the focal length"),
        (OneWay(), "OneWay lacks the method `to_ray`, which returns the rays of pixels: implement it"),
        (CentralCamera(), "CentralCamera lacks the method `to_image`"),
        (LensCamera(fx=9), "LensCamera lacks the method `to_plane`"),
        (Apart(), r"Apart.to_image must return pixels .*\(128, 512, 2\) for .*, got \(2, 128, 512\): stack columns"),
    ],
)
def test_cameras_that_do_not_fit_or_lack_a_method(camera, message):
    with pytest.raises(ConfigError, match=message):
        unwrap(np.zeros((480, 640, 3), np.uint8), camera)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"kind": "fish"}, "unknown unwrap.kind 'fish': did you mean 'fisheye'"),
        ({"kind": "fisheye", "fov": 400}, "unwrap.fov must be an angle in degrees.*, got 400"),
        ({"kind": "equirectangular", "highest": -50, "lowest": 0}, "-90 <= unwrap.lowest < unwrap.highest <= 90"),
        ({"kind": "double_sphere", "alpha": 2}, "unwrap.alpha must be a number from 0 to 1, got 2"),
        ({"kind": "nowhere:Camera"}, "import the module nowhere first"),
        ({"kind": f"{__name__}:SIZE"}, "is a class of your own"),
        ({"kind": f"{__name__}:Stereographic", "focal": 3}, "cannot be made from .*focal"),
        (EquirectangularCamera, "must be an object, got the class EquirectangularCamera: call it"),
    ],
)
def test_settings_that_make_no_camera(settings, message):
    with pytest.raises(ConfigError, match=message):
        Preprocessing.checked((64, 256), settings)


def test_a_camera_needs_the_size_of_the_picture():
    with pytest.raises(ConfigError, match="FisheyeCamera has no image_size"):
        FisheyeCamera(fx=100).project(np.eye(3))
    assert FisheyeCamera(fx=100, image_size=SIZE).project(np.eye(3)).shape == (3, 2)


def test_a_picture_much_finer_than_the_panorama_does_not_alias():
    """Stripes that a picture of 5760 px shows, and a panorama of 256 columns cannot, become their mean."""
    camera, view = EquirectangularCamera(highest=1.5, lowest=-1.5), PanoramaView(4, 256, 1, -1)
    stripes, edge = (np.where(dark, 0, 255) for dark in (np.arange(5760) % 6 < 3, np.arange(5760) < 2880))
    found = unwrap(np.tile(stripes.astype(np.uint8), (96, 1)), camera, view)
    assert np.abs(found.astype(float) - 127.5).max() < 16
    found = unwrap(np.tile(edge.astype(np.uint8), (96, 1)), camera, view)
    assert (found[:, 4:124] == 0).all()
    assert (found[:, 132:-4] == 255).all()
