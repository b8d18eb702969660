"""A camera that is mounted turned and mirrored: map and robot answer as with a straight one."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import siamloc
from siamloc.data import FrameTable, Mounting, PanoramaLibrary, PanoramaView
from siamloc.maps import Refinement
from siamloc.runtime import Localizer, export
from siamloc.simulate import Run, build_scene, load_building, render
from siamloc.simulate.camera import PanoramaCamera

pytestmark = pytest.mark.slow
MOUNTED = Mounting(90, mirrored=True)
SIZE = (64, 256)


@pytest.fixture(scope="module")
def drives(tmp_path_factory) -> dict[str, FrameTable]:
    """One drive by a straight camera, and by one that is mounted turned and stores its panoramas mirrored."""
    scene = build_scene(load_building("mini", 0), Run("cloudy", 1))
    poses = scene.state.track.poses[::2][:90]
    pictures = render(scene, poses, PanoramaCamera(PanoramaView(*SIZE)))
    found = {}
    for name, images in (("straight", pictures), ("mounted", np.roll(pictures, 64, axis=2)[:, :, ::-1])):
        folder = tmp_path_factory.mktemp(name)
        paths = [str(folder / f"{row}.png") for row in range(len(images))]
        for path, image in zip(paths, images, strict=True):
            cv2.imwrite(path, np.ascontiguousarray(image[..., ::-1]))
        found[name] = FrameTable(path=paths, x=poses[:, 0], y=poses[:, 1], theta=poses[:, 2])
    return found


@pytest.fixture(scope="module")
def robots(drives, tmp_path_factory) -> dict[str, Localizer]:
    network, made = siamloc.models.pretrained(), {}
    for name, frames in drives.items():
        images = PanoramaLibrary(frames, tmp_path_factory.mktemp("cache"), image_size=SIZE)
        known = siamloc.maps.build(network, images, frames.every(2), progress=False)
        folder = tmp_path_factory.mktemp("bundles") / name
        export(network, known, folder, refinement=Refinement("relative", map_digest=known.digest))
        made[name] = Localizer(folder)
    return made


def test_the_map_finds_the_mounting_and_keeps_it(robots):
    assert robots["straight"].map.mounting == Mounting()
    found = robots["mounted"].map.mounting
    assert found.mirrored
    assert found.yaw == pytest.approx(MOUNTED.yaw, abs=1)


@pytest.mark.parametrize(("camera", "yaw"), [("straight", 0), ("mounted", -MOUNTED.yaw)])  # as seen, mirrored
def test_without_poses_a_robot_that_drives_ahead_tells_the_yaw(drives, tmp_path, camera, yaw):
    images = PanoramaLibrary(drives[camera], tmp_path, image_size=SIZE)
    unposed = FrameTable(path=drives[camera].path)
    found = siamloc.maps.build(siamloc.models.pretrained(), images, unposed, progress=False).mounting
    assert found.yaw == pytest.approx(yaw, abs=5 if yaw else 0)
    assert not found.mirrored


def test_panoramas_of_another_size_tell_the_mounting_too(drives, tmp_path):
    images = PanoramaLibrary(drives["mounted"], tmp_path, image_size=(128, 512))
    network = siamloc.models.as_descriptor(siamloc.models.pretrained())
    found = siamloc.data.find_mounting(network, images, drives["mounted"])
    assert found.mirrored
    assert found.yaw == pytest.approx(MOUNTED.yaw, abs=1)


def test_a_drive_without_headings_or_poses_tells_where_it_goes(drives, tmp_path):
    frames = drives["mounted"]
    nowhere = np.full(len(frames), np.nan)
    images = PanoramaLibrary(frames, tmp_path, image_size=SIZE)
    network = siamloc.models.as_descriptor(siamloc.models.pretrained())
    found = siamloc.data.find_mounting(network, images, frames.with_columns(theta=nowhere))
    assert found.mirrored
    assert found.yaw == pytest.approx(MOUNTED.yaw, abs=5), "the robot turns while it drives"
    unposed = frames.with_columns(x=nowhere, y=nowhere, theta=nowhere)
    found = siamloc.data.find_mounting(network, images, unposed)
    assert found.mirrored is None
    assert found.yaw == pytest.approx(-MOUNTED.yaw, abs=5), "as long as the panoramas are taken as they are"


def test_the_robot_answers_as_with_a_straight_camera(drives, robots):
    errors: dict[str, list[float]] = {name: [] for name in robots}
    for name, robot in robots.items():
        queries = drives[name].take(slice(1, None, 4))
        for path, xy, theta in zip(queries.path, queries.xy, queries.theta, strict=True):
            found = robot.locate(path)
            errors[name].append(float(np.hypot(found.x - xy[0], found.y - xy[1])))
            assert abs(np.angle(np.exp(1j * (found.theta - theta)))) < 0.1, "the heading is that of the robot"
    assert np.mean(errors["mounted"]) < np.mean(errors["straight"]) + 0.005


def test_a_panorama_in_memory_is_straightened_as_a_file_is(drives, robots):
    path = drives["mounted"].path[1]
    pixels = cv2.imread(path)[..., ::-1]
    found, expected = robots["mounted"].locate_panorama(np.ascontiguousarray(pixels)), robots["mounted"].locate(path)
    assert (found.x, found.y, found.theta) == (expected.x, expected.y, expected.theta)
