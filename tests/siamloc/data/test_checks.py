from __future__ import annotations

import re

import cv2
import numpy as np
import pytest

from siamloc.data import FrameTable, PanoramaLibrary, check
from siamloc.data.checks import summary
from tests.drawn import written


def drive(n: int = 60, **columns) -> FrameTable:
    """A drive along an eight, headings as they should be; there are no images."""
    at = np.linspace(0, 2 * np.pi, n, endpoint=False)
    x, y = 3 * np.sin(at), 2 * np.sin(2 * at)
    theta = np.arctan2(np.roll(y, -1) - y, np.roll(x, -1) - x)
    given = {"path": [f"{i}.jpg" for i in range(n)], "x": x, "y": y, "theta": theta, "time": np.arange(n) * 0.5}
    return FrameTable(**{**given, **columns})


def test_nothing_is_said_about_data_as_they_should_be():
    assert check(drive()) == []
    assert check(drive(theta=drive().theta + 0.3, time=None)) == []
    assert check(drive(theta=np.unwrap(drive().theta) + 4 * np.pi)) == [], "radians that count full turns"
    assert check(FrameTable(path=[])) == []


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda frames: {"theta": np.degrees(frames.theta)}, "theta looks like degrees: .*multiply by pi / 180"),
        (lambda frames: {"theta": np.degrees(frames.theta) % 360}, "theta looks like degrees"),
        (lambda frames: {"theta": -frames.theta}, "if it runs clockwise.* Give -theta"),
        (lambda frames: {"theta": np.pi / 2 - frames.theta}, "x and y are exchanged, as a compass bearing does"),
        (lambda frames: {"x": frames.y, "y": frames.x}, "x and y are exchanged"),
        (lambda frames: {"y": -frames.y}, "runs clockwise.*check the sign of y"),
    ],
)
def test_headings_of_another_kind_are_recognized(change, says):
    frames = drive()
    (finding,) = check(frames.with_columns(**change(frames)))
    assert re.search(says, finding)


def test_degrees_of_a_robot_that_hardly_turns_are_recognized_by_its_way():
    n = 100
    theta = np.radians(5) * np.sin(np.arange(n) / 5)
    xy = np.cumsum(np.stack([np.cos(theta), np.sin(theta)], axis=1), axis=0) - [1, 0]
    frames = FrameTable(path=[f"{i}.jpg" for i in range(n)], x=xy[:, 0], y=xy[:, 1], theta=np.degrees(theta))
    (finding,) = check(frames.with_columns(x=np.r_[0, xy[:-1, 0]], y=np.r_[0, xy[:-1, 1]]))
    assert "if it counts degrees: give radians" in finding


def wheels(frames: FrameTable, theta) -> FrameTable:
    return frames.with_columns(odom_x=frames.x + 3, odom_y=frames.y, odom_theta=theta)


def test_odometry_in_degrees_is_recognized():
    frames = drive()
    assert check(wheels(frames, frames.theta)) == []
    assert check(wheels(frames, np.unwrap(frames.theta) - 20)) == [], "radians that count full turns"
    again = np.r_[np.arange(30.0), np.arange(30.0)]
    assert check(frames.with_columns(odom_theta=again)) == [], "radians that began again"
    (finding,) = check(wheels(frames, np.degrees(frames.theta) % 360))
    assert re.search("odom_theta looks like degrees: the robot turns by up to 3.*multiply by pi / 180", finding)
    (finding,) = check(frames.with_columns(odom_theta=np.degrees(frames.theta) % 360))
    assert "odom_theta looks like degrees" in finding, "without odom_x and odom_y, by the size of the turns"
    n = 100
    turn = np.radians(5) * np.sin(np.arange(n) / 5)
    xy = np.cumsum(np.stack([np.cos(turn), np.sin(turn)], axis=1), axis=0)
    slow = FrameTable(path=[f"{i}.jpg" for i in range(n)], odom_x=np.r_[0, xy[:-1, 0]], odom_y=np.r_[0, xy[:-1, 1]])
    assert not any("odom" in finding for finding in check(slow.with_columns(odom_theta=turn)))
    assert any("odom_theta looks" in finding for finding in check(slow.with_columns(odom_theta=np.degrees(turn))))


def test_without_positions_degrees_show_by_their_range():
    degrees, unplaced = check(drive(x=None, y=None, theta=np.arange(60) * 6.0))
    assert "theta looks like degrees" in degrees
    assert unplaced.startswith("all 60 frames have no position: they can be located and, as map frames, recognized")


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ({"room": ["A"] * 59 + [""]}, "1 of 60 frames have no room, .* rooms are measured, grouped and"),
        ({"x": np.repeat(drive().x[::3], 3), "y": np.repeat(drive().y[::3], 3)}, "stands still in 40 of 60 frames"),
        ({"x": drive().x + 100 * (np.arange(60) > 30)}, "jumps by 99.7 m at 31.jpg.*several drives share the name"),
        ({"x": 1000 * drive().x, "y": 1000 * drive().y}, "the usual step of .* is [0-9]+ m.*millimetres, divide by"),
        ({"x": drive().x / 1000, "y": drive().y / 1000}, "kilometres, multiply by 1000, or name their unit"),
        ({"time": np.arange(60) + 300.0 * (np.arange(60) > 20)}, "pauses for 301 s before 21.jpg"),
        ({"time": np.arange(60) * 500.0}, "m in 29500 s: if they count ms, divide them by 1000"),
        ({"time": np.arange(60) * 5e8 + 1e11 * (np.arange(60) > 20)}, "if they count ns, divide them by 1000000000"),
        ({"time": 1.7e9 + 1.7e12 * (np.arange(60) > 20) + np.arange(60)}, "before 21.jpg.* different units. Give all"),
        ({"time": np.arange(60) // 2}, "30 of 60 frames of .* have the time of the frame before"),
        ({"path": ["a.jpg"] + [f"{i}.jpg" for i in range(1, 59)] + ["a.jpg"]}, "1 of 60 frames show an image that"),
    ],
)
def test_each_surprise_is_one_sentence(columns, says):
    (finding,) = [finding for finding in check(drive().with_columns(**columns)) if re.search(says, finding)]
    assert finding.endswith(".")


def test_copies_of_images_are_found(tmp_path):
    for name, value in (("a", 1), ("b", 2), ("c", 1), ("d", 3)):
        cv2.imwrite(str(tmp_path / f"{name}.bmp"), np.full((8, 32, 3), value, np.uint8))
    frames = FrameTable(path=[str(tmp_path / f"{name}.bmp") for name in "abcd"], sequence=["one", "one", "two", "two"])
    (copies,) = [finding for finding in check(frames) if "copies" in finding]
    says = f"1 images are copies of others, 1 of them of another sequence's, the first: {tmp_path / 'c.bmp'} of "
    assert copies.startswith(says + f"{tmp_path / 'a.bmp'}. A query")


def test_shapes_of_images_are_compared_with_each_other_and_with_the_panoramas(tmp_path):
    paths = written(tmp_path, [np.full((rows, 64, 3), number, np.uint8) for number, rows in enumerate((48, 48, 16))])
    frames = FrameTable(path=paths, x=[0, 1, 2], y=[0, 0, 0])
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=(8, 32))
    mixed, squeezed = check(frames, images)
    assert "images have different shapes, among those looked at 64 x 48 px (2), 64 x 16 px (1)" in mixed
    assert "images of 64 x 48 px (columns x rows) are resized to 32 x 8 without unwrapping" in squeezed
    assert check(frames.take([2]), images) == []


def test_pictures_of_a_ring_that_are_only_resized_are_told_nothing_else(tmp_path):
    """A black corner, as around a ring, would else be called the robot's own picture or a long exposure."""
    for name, size in (("ring", (48, 64)), ("panorama", (16, 64))):
        (tmp_path / name).mkdir()
        pictures = np.random.default_rng(0).integers(0, 255, (12, *size, 3), np.uint8)
        pictures[:, :, :32] = 0
        frames = FrameTable(path=written(tmp_path / name, pictures), x=np.arange(12), y=np.zeros(12))
        images = PanoramaLibrary(frames, tmp_path / "cache", image_size=(8, 32))
        (said,) = check(frames, images)
        assert ("without unwrapping" in said) is (name == "ring")
        assert ("50% of the panorama is black" in said) is (name == "panorama")


def test_a_single_frame_is_one_frame():
    lines = summary(FrameTable(path=["1.jpg"], room=["hall"], sequence=["monday"])).splitlines()
    assert (lines[0], lines[2]) == ("1 frame", "  room hall: 1 frame")
    assert lines[1].startswith("  monday: 1 frame, lighting unknown")
