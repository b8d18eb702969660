"""From the picture of a camera to a location: the library, the map, the bundle and the robot use the same camera."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from siamloc.data import (
    DualFisheyeCamera,
    EquirectangularCamera,
    FisheyeCamera,
    FrameTable,
    PanoramaLibrary,
    PanoramaView,
    PolarRing,
    check,
    concatenate,
    read,
    unwrap,
)
from siamloc.data.two_lenses import two_circles
from siamloc.errors import ConfigError, DataError
from siamloc.jobs import Evaluate, Prepare
from siamloc.jobs.robot import Localize
from siamloc.maps import build
from siamloc.models import as_descriptor, load, pretrained
from siamloc.models import build as build_network
from siamloc.runtime import Bundle, Localizer, export, locate_all
from siamloc.runtime.own_camera import SampledCamera
from siamloc.training import fit
from tests.siamloc.data.test_ring import drive as ring_pictures

SIZE = (32, 128)
WHOLE = (128, 256)


def sphere(rays, place):
    rng = np.random.default_rng(place)
    level = 127 + 60 * np.sin(rays @ rng.normal(0, 4, (3, 8)) + rng.uniform(0, 6, 8)).sum(axis=-1) / 3
    return np.nan_to_num(level).clip(0, 255).astype(np.uint8)


def seen_by(camera, size, place, turn=None):
    rows, columns = np.mgrid[: size[0], : size[1]].astype(float)
    rays = camera.back_project(np.stack([columns, rows], axis=-1), size)
    return np.repeat(sphere(rays if turn is None else rays @ turn.T, place)[..., None], 3, axis=-1)


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """Four places in whole 360-degree pictures."""
    folder = tmp_path_factory.mktemp("places")
    paths = [str(folder / f"{place}.png") for place in range(4)]
    for place, path in enumerate(paths):
        cv2.imwrite(path, seen_by(EquirectangularCamera(), WHOLE, place))
    return FrameTable(path=paths, x=np.arange(4.0), y=np.zeros(4), theta=np.zeros(4), sequence=["monday"] * 4)


def library(frames, tmp_path, camera, **options):
    return PanoramaLibrary(frames, tmp_path / "cache", unwrap=camera, **{"image_size": SIZE, **options})


@dataclass(frozen=True)
class Third:
    """A camera of one's own: whole pictures whose columns begin a third of a turn later."""

    share: float = 1 / 3

    def sampling(self, view, image_size):
        x, y, z = np.moveaxis(view.directions(), -1, 0)
        column = (0.5 + self.share - np.arctan2(y, x) / (2 * np.pi)) % 1 * (image_size[1] - 1)
        return column, (0.5 - np.arcsin(z) / np.pi) * image_size[0] - 0.5


LOCATE = """
import sys
from siamloc.errors import SiamlocError
from siamloc.runtime import Localizer

for name in sys.argv[2:]:
    try:
        print(Localizer(sys.argv[1]).locate(name).x)
    except SiamlocError as error:
        print(error)
"""


def test_a_camera_of_ones_own_travels_in_the_bundle_without_its_code(frames, tmp_path):
    images = library(frames, tmp_path, Third())
    known = build("hog", images, frames, progress=False)
    with pytest.raises(ConfigError, match=r"unwrap\.level=true needs a camera model that siamloc knows"):
        export("hog", known, tmp_path / "bundle", images=library(frames, tmp_path, Third(), level=True))
    export("hog", known, tmp_path / "bundle")
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((64, 128, 3), np.uint8))
    command = [sys.executable, "-c", LOCATE, str(tmp_path / "bundle"), frames.path[2], str(tmp_path / "small.png")]
    found, refused = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert float(found) == 2.0
    assert "holds its camera for level pictures of 256 x 128 px, got 128 x 64" in refused
    here = Localizer(tmp_path / "bundle")
    assert here.bundle.preprocessing == images.preprocessing, "the class is at hand here"
    assert here.locate(frames.path[1], tilt=[0, 0]).x == 1.0
    sampled = Bundle.open(tmp_path / "bundle").load("camera.npz")
    whole = cv2.imread(frames.path[3])
    view = images.preprocessing.view
    np.testing.assert_allclose(unwrap(whole, sampled, view).astype(int), unwrap(whole, Third(), view), atol=1)


def test_a_camera_that_no_name_leads_to_is_taken_as_the_object(frames, tmp_path):
    @dataclass(frozen=True)
    class Local(Third):
        pass

    images = library(frames, tmp_path, Local())
    known = build("hog", images, frames, progress=False)
    bundle = export("hog", known, tmp_path / "bundle", images=images)
    assert "camera.npz" in bundle.files
    assert Localizer(bundle.path).locate(frames.path[2]).x == 2.0
    with pytest.raises(ConfigError, match=r"import the module .* first, .* object itself; a command .* unwrap\.kind="):
        export("hog", known, tmp_path / "other")


def test_another_camera_can_find_its_place_in_the_map(frames, tmp_path):
    images = library(frames, tmp_path, EquirectangularCamera())
    known = build("hog", images, frames, progress=False)
    export("hog", known, tmp_path / "bundle")
    dual = DualFisheyeCamera()
    localizer = Localizer(tmp_path / "bundle", camera=dual)
    assert localizer.locate(seen_by(dual, WHOLE, 3)).x == 3.0
    cv2.imwrite(str(tmp_path / "dual.png"), seen_by(dual, WHOLE, 3))
    others = library(FrameTable(path=[tmp_path / "dual.png"]), tmp_path, dual)
    known.check_images(others.preprocessing.parameters())
    with pytest.raises(ConfigError, match=r"images\.top is 30.* in the map, 20"):
        known.check_images(library(others.frames, tmp_path, dual, elevations=(20, -45)).preprocessing.parameters())
    with pytest.raises(ConfigError, match=r"images\.camera\.kind"):
        known.check_images(library(frames, tmp_path, {"kind": "polar"}).preprocessing.parameters())


def test_two_lenses_and_whole_pictures_are_not_taken_for_each_other(frames, tmp_path, caplog):
    dual, whole = DualFisheyeCamera(), EquirectangularCamera()
    (tmp_path / "dual").mkdir()
    paths = [tmp_path / "dual" / f"{place}.png" for place in range(4)]
    for place, path in enumerate(paths):
        cv2.imwrite(str(path), seen_by(dual, WHOLE, place))
    for camera, right, wrong, says in (
        (whole, frames.path.tolist(), paths, "it shows the circles of two fisheye lenses.*unwrap=dual_fisheye"),
        (dual, paths, frames.path.tolist(), "it is not dark where two fisheye lenses.*unwrap=equirectangular"),
    ):
        both = FrameTable(path=[*right, *wrong[2:]], x=np.arange(6.0), y=np.zeros(6), sequence=["monday"] * 6)
        images = library(both, tmp_path, camera)
        assert re.search(f"2 of 6 images cannot be read, the first: .*{says}", caplog.text)
        export("hog", build("hog", images, images.frames, progress=False), tmp_path / "bundle")
        localizer = Localizer(tmp_path / "bundle")
        assert localizer.locate(right[3]).x == 3.0
        for image in (str(wrong[3]), cv2.imread(str(wrong[3]))):
            with pytest.raises(DataError, match=says):
                localizer.locate(image)


def test_a_whole_picture_without_ceiling_and_floor_shows_no_two_circles():
    picture = np.full((256, 512, 3), 90, np.uint8)
    picture[:86], picture[192:] = 0, 0  # beyond 30 and -45 degrees
    assert not two_circles(picture)
    assert two_circles(np.where(seen_by(DualFisheyeCamera(), WHOLE, 0) > 0, 90, 0))


def test_the_robot_gets_size_and_bits_of_the_pictures_of_the_map(tmp_path, caplog):
    """The camera of the robot gives larger pictures, and a dark image of its own says nothing of its sensor."""
    bright = [np.repeat(picture[..., None], 3, axis=2) for picture in ring_pictures(6, (151.3, 108.6))[0]]
    (tmp_path / "monday").mkdir()
    paths = [tmp_path / "monday" / f"{number}.png" for number in range(6)]
    for path, picture in zip(paths, bright, strict=True):
        cv2.imwrite(str(path), picture.astype(np.uint16) << 4)
    ring = PolarRing(centre=(151.3, 108.6), inner=20, outer=95)
    images = library(FrameTable(path=paths, x=np.arange(6.0), y=np.zeros(6)), tmp_path, ring)
    bundle = export("hog", build("hog", images, images.frames, progress=False), tmp_path / "bundle")
    assert bundle.about["pictures"] == {"size": [220, 300], "bits": 12}
    localizer = Localizer(tmp_path / "bundle")
    assert localizer.locate(cv2.resize(bright[4], (600, 440))).x == 4.0
    assert "600 x 440 px, and the camera's parameters count in those of 300 x 220: they are scaled" in caplog.text
    with pytest.raises(DataError, match=r"300 x 300 px, .* give pictures of that size"):
        localizer.locate(np.zeros((300, 300, 3), np.uint8))
    cv2.imwrite(str(tmp_path / "square.png"), np.zeros((300, 300, 3), np.uint8))
    job = {"bundle": tmp_path / "bundle", "images": (str(tmp_path / "square.png"),), "out": tmp_path / "found.csv"}
    with pytest.raises(DataError, match=r"none of the 1 images could be located: .*300 x 300 px"):
        Localize(**job).run()
    (tmp_path / "alone").mkdir()
    cv2.imwrite(str(tmp_path / "alone/0.png"), (bright[2] // 8).astype(np.uint16) << 4)
    shown = []
    localizer.locate(tmp_path / "alone/0.png", seen=shown.append)
    assert shown[0].max() <= 32
    whole = library(FrameTable(path=paths[:2], x=np.arange(2.0), y=np.zeros(2)), tmp_path, None)
    about = export("hog", build("hog", whole, whole.frames, progress=False), tmp_path / "other").about
    assert about["pictures"] == {"size": [220, 300], "bits": 12}
    Localizer(tmp_path / "other").locate(np.zeros((300, 300, 3), np.uint8))
    assert "there are pictures of another shape than 300 x 220 px" in caplog.text


def test_the_robot_knows_the_size_of_pictures_that_are_gone_or_were_stored_turned(tmp_path):
    """Of TIFF files no header is read, and a picture has the size with which it is decoded."""
    pictures = [np.repeat(picture[..., None], 3, axis=2) for picture in ring_pictures(4, (151.3, 108.6))[0]]
    paths = [tmp_path / "monday" / f"{number}.tif" for number in range(4)]
    paths[0].parent.mkdir()
    turned = Image.Exif()
    turned[0x112] = 6
    for path, picture in zip(paths, pictures, strict=True):
        Image.fromarray(picture).transpose(Image.Transpose.ROTATE_90).save(path, exif=turned)
    ring = PolarRing(centre=(151.3, 108.6), inner=20, outer=95)
    images = library(FrameTable(path=paths, x=np.arange(4.0), y=np.zeros(4)), tmp_path, ring)
    sees = images.seen("")
    assert sees is not None
    assert sees.all()
    known = build("hog", images, images.frames, progress=False)
    shutil.rmtree(tmp_path / "monday")
    export("hog", known, tmp_path / "bundle")
    localizer = Localizer(tmp_path / "bundle")
    assert localizer.locate(pictures[2]).x == 2.0
    assert localizer.locate(cv2.resize(pictures[2], (600, 440))).x == 2.0


def test_the_robot_gets_the_ring_that_the_drive_of_the_map_shows(tmp_path):
    tables = []
    for name, centre in (("monday", (151.3, 108.6)), ("friday", (147.0, 110.0))):
        (tmp_path / name).mkdir()
        paths = [tmp_path / name / f"{number}.png" for number in range(6)]
        for path, picture in zip(paths, ring_pictures(6, centre)[0], strict=True):
            cv2.imwrite(str(path), picture)
        tables.append(FrameTable(path=paths, x=np.arange(6.0), y=np.zeros(6), sequence=[name] * 6))
    images = library(concatenate(tables), tmp_path, {"kind": "auto"})
    known = build("hog", images, tables[0], progress=False)
    known.check_images(images.preprocessing.parameters())
    export("hog", known, tmp_path / "bundle", images=images)
    assert Bundle.open(tmp_path / "bundle").preprocessing.camera == images.cameras["monday"]
    assert Localizer(tmp_path / "bundle").locate(tables[0].path[2]).x == 2.0
    with pytest.raises(ConfigError, match=r"images\.camera\.forward"):
        known.check_images(library(tables[1], tmp_path, {"kind": "auto", "forward": 90.0}).preprocessing.parameters())


def test_the_two_pictures_of_two_lenses_in_a_folder_are_located_together(frames, tmp_path):
    export("hog", build("hog", library(frames, tmp_path, EquirectangularCamera()), frames), tmp_path / "bundle")
    dual = DualFisheyeCamera(second=("front_", "back_"))
    (tmp_path / "both").mkdir()
    for place in range(3):
        for name, half in zip(dual.second, np.hsplit(seen_by(dual, WHOLE, place), 2), strict=True):
            cv2.imwrite(str(tmp_path / "both" / f"{name}{place}.png"), half)
    (tmp_path / "both" / "front_0.png").unlink()  # its second picture is then shown to be alone
    found = list(locate_all(Localizer(tmp_path / "bundle", camera=dual), tmp_path / "both"))
    assert [Path(one.image).name for one in found] == ["back_0.png", "front_1.png", "front_2.png"]
    assert "its name lacks what unwrap.second replaces" in found[0].fault
    assert [one.location.x for one in found[1:]] == [1.0, 2.0]


def test_the_tilt_of_each_frame_is_taken_out(frames, tmp_path):
    roll, pitch = 0.15, -0.1
    turn = cv2.Rodrigues(np.array([0, pitch, 0]))[0] @ cv2.Rodrigues(np.array([roll, 0, 0]))[0]
    angle = cv2.Rodrigues(turn)[0].ravel()
    half = np.linalg.norm(angle) / 2
    w, (x, y, z) = np.cos(half), np.sin(half) * angle / (2 * half)
    cv2.imwrite(str(tmp_path / "0.png"), seen_by(EquirectangularCamera(), WHOLE, 0, turn))
    (tmp_path / "robot.csv").write_text(f"image,x,y,qw,qx,qy,qz\n0.png,0,0,{w},{x},{y},{z}\n")
    tilted = read("manifest", manifest=tmp_path / "robot.csv")
    assert (tilted.roll[0], tilted.pitch[0], tilted.theta[0]) == pytest.approx((roll, pitch, 0), abs=1e-9)
    level = library(frames, tmp_path, EquirectangularCamera()).batch([0]).astype(int)
    for table, off in ((tilted, 3.0), (tilted.with_columns(roll=[0.0], pitch=[0.0]), None)):
        found = library(table, tmp_path, EquirectangularCamera()).batch([0]).astype(int)
        assert (np.abs(found - level).mean() < 3) == (off is not None)
    known = build("hog", library(frames, tmp_path, EquirectangularCamera()), frames, progress=False)
    export("hog", known, tmp_path / "bundle")
    localizer, steep = Localizer(tmp_path / "bundle"), Localizer(tmp_path / "bundle").locate(tmp_path / "0.png")
    straight = localizer.locate(tmp_path / "0.png", tilt=[roll, pitch])
    assert straight.candidates[0].distance < 0.2 * steep.candidates[0].distance
    (tmp_path / "wheels.csv").write_text(f"image,odom_x,odom_y,odom_theta,roll,pitch\n0.png,0,0,0,{roll},{pitch}\n")
    (one,) = locate_all(localizer, tmp_path / "0.png", track=True, odometry=tmp_path / "wheels.csv")
    assert one.location.candidates[0].distance == pytest.approx(straight.candidates[0].distance)
    with pytest.raises(DataError, match="a tilt is roll and pitch in rad, two numbers"):
        localizer.locate(tmp_path / "0.png", tilt=[0.1])
    (tmp_path / "robot.csv").write_text("image,qw,qx,qy,qz\n0.png,2,0,0,0\n")
    with pytest.raises(DataError, match=r"line 2: the quaternion qw, qx, qy, qz has the length 2, expected 1"):
        read("manifest", manifest=tmp_path / "robot.csv")


def test_what_a_camera_does_not_see_or_nobody_unwraps_is_said(frames, tmp_path, caplog):
    small = library(frames, tmp_path, FisheyeCamera(fov=200, elevation=90))
    findings = [one for one in check(frames, small) if "does not see" in one]
    assert findings[0].startswith(
        "the camera does not see 53% of a panorama from 30 to -45 degrees (it sees all around"
    )
    assert not [one for one in check(frames, library(frames, tmp_path, EquirectangularCamera())) if "see" in one]
    leaning = frames.with_columns(roll=np.full(4, 0.1))
    assert any("are not levelled" in one for one in check(leaning, library(leaning, tmp_path, None)))
    upright = frames.with_columns(roll=np.zeros(4), pitch=np.zeros(4))
    assert not any("are not levelled" in one for one in check(upright, library(upright, tmp_path, None)))
    caplog.clear()
    cv2.imwrite(str(tmp_path / "whole.png"), seen_by(EquirectangularCamera(), (256, 512), 0))
    whole = FrameTable(path=[tmp_path / "whole.png"])
    library(whole, tmp_path, EquirectangularCamera())
    assert "equirectangular" not in caplog.text
    library(whole, tmp_path, None)
    assert "look like equirectangular pictures, squeezed into panoramas of 128 x 32: use unwrap=" in caplog.text


def test_a_network_says_which_view_it_is_for_and_the_library_makes_it(frames, tmp_path):
    assert pretrained().view == {"image_size": (64, 256), "elevations": (30.0, -45.0)}
    network = build_network("simple1", "fc500_500_5", SIZE, elevations=(20.0, -40.0))
    images = library(frames, tmp_path, EquirectangularCamera(), **network.view)
    assert images.preprocessing.view == PanoramaView(*SIZE, 20.0, -40.0)
    build(network, images, frames, progress=False)
    with pytest.raises(
        ConfigError, match=r"trained on panoramas from 20 to -40 degrees.*these show 30 to -45.*unwrap.top"
    ):
        build(as_descriptor(network), library(frames, tmp_path, EquirectangularCamera()), frames, progress=False)
    build(network, library(frames, tmp_path, {"kind": "polar"}), frames, progress=False)


def test_a_run_keeps_its_camera_and_its_view_for_other_cameras(frames, tmp_path):
    rows = [f"{path},{room}" for path, room in zip(frames.path.tolist(), "aabb", strict=True)]
    (tmp_path / "robot.csv").write_text("\n".join(["image,room", *rows]))
    table = read("manifest", manifest=tmp_path / "robot.csv")
    camera = EquirectangularCamera(azimuth=10)
    images = library(table, tmp_path, camera, elevations=(20, -40))
    network = build_network("simple1", "fc500_500_5", SIZE)
    run = fit(network, images, table, run=tmp_path / "run", epochs=1, batch_size=2)
    assert load(run).view == network.view == {"image_size": SIZE, "elevations": (20, -40)}
    kept = Evaluate.of({"run": str(run.folder)})
    assert kept.preprocessing == images.preprocessing
    other = Evaluate.of({"run": str(run.folder), "unwrap": "dual_fisheye"}).preprocessing
    assert (other.camera, other.view) == (DualFisheyeCamera(), images.preprocessing.view)


def test_commands_take_every_camera(frames, tmp_path, monkeypatch):
    lines = ["image", *frames.path.tolist()]
    (tmp_path / "robot.csv").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "own_camera.py").write_text(
        "from siamloc.data import EquirectangularCamera\nclass Mine(EquirectangularCamera):\n    pass\n"
    )
    (tmp_path / "two.csv").write_text("image\ntwo.png\n")
    cv2.imwrite(str(tmp_path / "two.png"), seen_by(DualFisheyeCamera(), WHOLE, 0))
    data = {"manifest": str(tmp_path / "robot.csv"), "image_size": list(SIZE), "cache": str(tmp_path / "cache")}
    for how, name in (
        ("equirectangular", "EquirectangularCamera"),
        ({"kind": "dual_fisheye", "roll": 5}, "DualFisheyeCamera"),
        ({"kind": "own_camera:Mine"}, "Mine"),
    ):
        manifest = tmp_path / ("two.csv" if name == "DualFisheyeCamera" else "robot.csv")
        images = Prepare.of({"data": {**data, "manifest": str(manifest)}, "unwrap": how}).run()
        assert type(images.preprocessing.camera).__name__ == name
        again = PanoramaLibrary(images.frames, **images.settings())
        np.testing.assert_array_equal(again.batch([0]), images.batch([0]))
    with pytest.raises(ConfigError, match=r"unwrap\.kind=nowhere:Mine cannot be imported"):
        Prepare.of({"data": data, "unwrap": {"kind": "nowhere:Mine"}})
    assert "own_camera" in sys.modules
    assert Path(sys.modules["own_camera"].__file__).parent == tmp_path


def test_a_camera_without_its_code_keeps_the_black_around_a_circle_out():
    camera, view, size = FisheyeCamera(elevation=90, fov=210.0), PanoramaView(64, 256, 30.0, -15.0), (240, 240)
    pixels = np.stack(np.meshgrid(np.arange(240), np.arange(240)), axis=-1)
    picture = np.where(camera.shows(pixels, size), 158, 0).astype(np.uint8)
    assert (unwrap(picture, SampledCamera.of(camera, view, size), view) == 158).all()
