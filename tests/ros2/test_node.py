"""The node with a real bundle: what it publishes for an image, for odometry and for a question."""

import math
from array import array
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import siamloc
from siamloc import maps, runtime
from siamloc.errors import ConfigError
from tests.ros2 import ros

Time, Header = ros.CLASSES["builtin_interfaces/msg/Time"], ros.CLASSES["std_msgs/msg/Header"]
Image, Odometry = ros.CLASSES["sensor_msgs/msg/Image"], ros.CLASSES["nav_msgs/msg/Odometry"]
CompressedImage = ros.CLASSES["sensor_msgs/msg/CompressedImage"]
POSE, MATCH, INITIAL = "~/pose", "~/match/compressed", "initialpose"


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A bundle with headings and pictures, and the frames of another drive."""
    example = siamloc.data.example()
    folder = tmp_path_factory.mktemp("ros")
    images = siamloc.data.PanoramaLibrary(example.frames, folder / "cache", image_size=(32, 64))
    monday, tuesday = (example.frames.select(sequence=day) for day in ("monday", "tuesday"))
    known = maps.build("hog", images, monday, progress=False)
    runtime.export("hog", known, folder / "robot", images=images, thumbnails=True)
    return folder / "robot", tuesday


@pytest.fixture
def started(node, world, monkeypatch):
    def start(**given):
        monkeypatch.setattr(ros.Node, "given", {"bundle": str(world[0]), **given})
        return node.LocalizerNode()

    return start


def stamp(second):
    sec, part = divmod(second, 1)
    return Time(sec=int(sec), nanosec=round(part * 1e9))


def photo(world, row, second=10.0):
    pixels = cv2.imread(str(world[1].path[row]))
    header = Header(stamp=stamp(second), frame_id="camera")
    height, width, _ = pixels.shape
    step = 3 * width
    return Image(
        header=header, height=height, width=width, encoding="bgr8", step=step, data=array("B", pixels.tobytes())
    )


def odometry(x, y, theta, second):
    message = Odometry(header=Header(stamp=stamp(second), frame_id="odom"), child_frame_id="base_link")
    pose = message.pose.pose
    pose.position.x, pose.position.y = float(x), float(y)
    pose.orientation.z, pose.orientation.w = math.sin(theta / 2), math.cos(theta / 2)
    return message


def heading(turn):
    return 2 * math.atan2(turn.z, turn.w)


def test_an_image_gives_pose_diagnostics_and_the_matched_picture(started, world):
    node = started()
    assert list(node.subscribed) == ["image", "odom"]
    node.subscribed["image"](photo(world, 3))
    expected = node.localizer.locate(world[1].path[3])
    (pose,), (told,), (match,) = (node.published[topic] for topic in (POSE, "/diagnostics", MATCH))
    assert (pose.header.frame_id, pose.header.stamp.sec) == ("map", 10)
    assert (pose.pose.pose.position.x, pose.pose.pose.position.y) == (expected.x, expected.y)
    assert heading(pose.pose.pose.orientation) == pytest.approx(expected.theta)
    assert (told.status[0].level, told.status[0].hardware_id) == (0, "robot")
    picture = cv2.imdecode(np.frombuffer(match.data, np.uint8), cv2.IMREAD_COLOR)
    assert (match.format, picture.ndim) == ("jpeg", 3)
    assert set(node.published) == {POSE, "/diagnostics", MATCH}


def test_a_compressed_image_is_located_too(started, world):
    node = started(compressed=True)
    assert list(node.subscribed) == ["image/compressed", "odom"]
    data = array("B", Path(world[1].path[3]).read_bytes())
    node.subscribed["image/compressed"](CompressedImage(format="png", data=data))
    assert len(node.published[POSE]) == 1


def test_an_image_that_cannot_be_used_is_reported_and_the_next_one_located(started, world):
    node = started()
    wrong = photo(world, 3)
    wrong.encoding = "bayer_rggb8"
    node.subscribed["image"](wrong)
    assert set(node.published) == {"/diagnostics"}
    (status,) = node.published["/diagnostics"][0].status
    assert (status.level, status.values) == (2, [])
    assert status.message in node.said
    answer = node.services["~/where_am_i"](None, ros.Trigger.Response())
    assert (answer.success, answer.message) == (False, status.message)
    node.subscribed["image"](photo(world, 3))
    assert len(node.published[POSE]) == 1


def status(node):
    (found,) = node.published["/diagnostics"][-1].status
    return found.level, found.message, {one.key: one.value for one in found.values}


def test_the_transform_joins_map_and_odometry_and_stays_while_nothing_is_known(started, world, monkeypatch):
    node = started(publish_tf=True, transform_tolerance=0.25)
    (tick,) = node.timers
    node.subscribed["image"](photo(world, 3))
    tick()
    assert "/tf" not in node.published
    assert status(node)[:2] == (1, "located; no odometry has arrived")
    assert node.said == ["no odometry has arrived"]
    for second in (9.9, 10.1):
        node.subscribed["odom"](odometry(1, 2, 0.5, second))
    node.subscribed["image"](photo(world, 3))
    monkeypatch.setattr(ros.Node, "now", (10, 500_000_000))
    tick()
    (shift,) = node.published["/tf"][0].transforms
    assert (shift.header.frame_id, shift.child_frame_id) == ("map", "odom")
    assert (shift.header.stamp.sec, shift.header.stamp.nanosec) == (10, 750_000_000)
    pose, move = node.published[POSE][-1].pose.pose, shift.transform
    turn = heading(move.rotation)
    assert pose.position.x == pytest.approx(move.translation.x + math.cos(turn) - 2 * math.sin(turn))
    assert pose.position.y == pytest.approx(move.translation.y + math.sin(turn) + 2 * math.cos(turn))
    assert math.remainder(heading(pose.orientation) - turn - 0.5, math.tau) == pytest.approx(0)
    locate = node.localizer.locate
    monkeypatch.setattr(node.localizer, "locate", lambda *given, **more: replace(locate(*given, **more), lost=True))
    node.subscribed["odom"](odometry(2, 2, 0.5, 11.0))
    node.subscribed["image"](photo(world, 3, 11.0))
    wrong = photo(world, 3)
    wrong.encoding = "bayer_rggb8"
    node.subscribed["image"](wrong)  # not even an image that cannot be used ends the transform
    monkeypatch.setattr(ros.Node, "now", (11, 0))
    tick()
    (same,) = node.published["/tf"][-1].transforms
    assert same.transform == move
    assert same.header.stamp.sec == 11
    assert len(node.published[POSE]) == 2
    assert node.published["/diagnostics"][-2].status[0].message == "lost"


def test_odometry_that_arrives_while_an_image_is_located_renews_the_transform(started, world, monkeypatch):
    node = started(publish_tf=True)
    quality, groups = node.qualities, node.groups
    assert (quality["odom"].reliability, quality["image"].reliability, quality["image"].depth) == (2, 2, 1)
    assert groups["odom"] is groups["timer"] is not None
    assert groups["image"] is None
    locate = node.localizer.locate

    def slow(*given, **more):
        node.subscribed["odom"](odometry(1, 2, 0.5, 10.0))  # by the other thread
        return locate(*given, **more)

    node.subscribed["odom"](odometry(0, 0, 0, 9.1))
    monkeypatch.setattr(node.localizer, "locate", slow)
    node.subscribed["image"](photo(world, 3))
    assert status(node)[0] == 0
    assert np.isfinite(node.correction).all()
    np.testing.assert_allclose(node.last, [1, 2, 0.5])


def test_stamps_that_are_far_apart_are_a_warning(started, world):
    node = started(publish_tf=True)
    node.subscribed["odom"](odometry(1, 2, 0.5, 9.1))
    node.subscribed["image"](photo(world, 3))
    level, text, told = status(node)
    assert (level, told["odometry age [s]"]) == (1, "0.900")
    assert text.startswith("located; the stamps of the image and of the nearest odometry are 0.90 s apart")
    assert node.said[-1] in text
    node = started()  # which needs no odometry
    node.subscribed["image"](photo(world, 3))
    assert status(node)[:2] == (0, "located")


def test_odometry_that_cannot_be_used_is_dropped_with_one_sentence(started):
    node = started()
    wrong = odometry(0, 0, 0, 9.0)
    wrong.header.frame_id = ""
    for _ in range(2):
        node.subscribed["odom"](wrong)
    assert node.said == ["odometry is dropped: its frame_id is empty"]
    assert len(node.odometry) == 0
    node.subscribed["odom"](odometry(0, 0, 0, 9.0))
    node.subscribed["odom"](odometry(0, 0, 0, 8.9))
    assert (len(node.odometry), len(node.said)) == (1, 2)


def test_parameters_are_checked(started):
    assert started(transform_tolerance=1).given["transform_tolerance"] == 1.0
    for given, text in (
        ({"odometry_gap": "wide"}, "odometry_gap must be a number, got 'wide'"),
        ({"odometry_gap": -1}, "odometry_gap must be above 0, got -1"),
        ({"track": 1}, "track must be true or false, got 1"),
        ({"bundle": 5}, "bundle must be text, got 5"),
        ({"map_frame": "/map"}, "map_frame '/map' begins with a slash, which tf2 refuses"),
        ({"base_frame": ""}, "base_frame is empty"),
    ):
        with pytest.raises(ConfigError, match=text):
            started(**given)


def test_a_tracker_gets_how_the_robot_moved(started, world, monkeypatch):
    node, motions = started(track=True), []
    locate = node.localizer.locate
    monkeypatch.setattr(
        node.localizer,
        "locate",
        lambda image, tracker, motion: motions.append((tracker, motion)) or locate(image, tracker, motion=motion),
    )
    node.subscribed["image"](photo(world, 3, 9.0))
    for second, x in ((10.0, 1.0), (11.0, 1.5)):
        node.subscribed["odom"](odometry(x, 0, 0, second))
        node.subscribed["image"](photo(world, 3, second))
    assert [tracker for tracker, _ in motions] == [node.tracker] * 3
    assert motions[0][1] is None
    assert np.isnan(motions[1][1]).all()
    np.testing.assert_allclose(motions[2][1], [0.5, 0, 0], atol=1e-12)


@pytest.mark.parametrize("wanted", [False, True])
def test_where_am_i_answers_and_sets_the_initial_pose(started, world, wanted):
    node = started(set_initial_pose=wanted, track=True)
    ask = node.services["~/where_am_i"]
    answer = ask(None, ros.Trigger.Response())
    assert (answer.success, answer.message) == (False, "no image has arrived yet")
    node.subscribed["image"](photo(world, 3))
    answer = ask(None, ros.Trigger.Response())
    expected = node.localizer.locate(world[1].path[3])  # by this image alone
    assert answer.success
    assert answer.message.startswith(f"x {expected.x:.2f} m, y {expected.y:.2f} m")
    poses = node.published[INITIAL]
    assert len(poses) == wanted
    assert [(pose.header.frame_id, pose.pose.pose.position.x) for pose in poses] == [("map", expected.x)] * wanted


def test_a_wrong_bundle_ends_the_node_with_one_sentence(node, started, monkeypatch, tmp_path):
    monkeypatch.setattr(ros.Node, "given", {"bundle": str(tmp_path / "none")})
    with pytest.raises(SystemExit, match=r"siamloc: .*none"):
        node.main()
    monkeypatch.setattr(runtime.Localizer, "unit", "frames")
    with pytest.raises(ConfigError, match="has a map in frames, but ROS takes metres"):
        started()
