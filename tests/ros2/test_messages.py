"""From ROS messages to arrays, and from locations to ROS messages, without ROS."""

import math
from array import array

import cv2
import numpy as np
import pytest

from siamloc.data.moves import composed
from siamloc.errors import DataError
from siamloc.runtime import Candidate, Location
from tests.ros2.ros import CLASSES

Time, Header = CLASSES["builtin_interfaces/msg/Time"], CLASSES["std_msgs/msg/Header"]
Image, CompressedImage = CLASSES["sensor_msgs/msg/Image"], CLASSES["sensor_msgs/msg/CompressedImage"]
Odometry = CLASSES["nav_msgs/msg/Odometry"]
HEADER = Header(stamp=Time(sec=7, nanosec=5), frame_id="map")


def image(encoding, depth, padding=0):
    pixels = np.random.default_rng(0).integers(0, 256, (3, 4, depth), dtype=np.uint8)
    rows = np.concatenate([pixels.reshape(3, -1), np.full((3, padding), 7, np.uint8)], axis=1)
    return Image(height=3, width=4, step=rows.shape[1], encoding=encoding, data=array("B", rows.tobytes())), pixels


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize(("encoding", "depth"), [("rgb8", 3), ("bgr8", 3), ("rgba8", 4), ("bgra8", 4), ("mono8", 1)])
def test_images_of_every_encoding_are_rgb(messages, encoding, depth, padding):
    message, pixels = image(encoding, depth, padding)
    found = messages.pixels(message)
    assert (found.shape, found.dtype, found.flags.c_contiguous) == ((3, 4, 3), np.uint8, True)
    first = pixels[..., :3] if depth > 1 else np.repeat(pixels, 3, axis=2)
    np.testing.assert_array_equal(found, first[..., ::-1] if encoding.startswith("bgr") else first)


def test_a_compressed_image_is_rgb(messages):
    pixels = image("rgb8", 3)[1]
    data = cv2.imencode(".png", pixels[..., ::-1])[1].tobytes()
    found = messages.pixels(CompressedImage(format="rgb8; png compressed bgr8", data=array("B", data)))
    np.testing.assert_array_equal(found, pixels)


@pytest.mark.parametrize(
    ("form", "grey"), [("bayer_rggb8; jpeg compressed ", False), ("bayer_rggb8; jpeg compressed mono8", True)]
)
def test_a_compressed_mosaic_is_as_colourful_as_those_of_the_map(messages, form, grey):
    mosaic = np.zeros((16, 16), np.uint8)
    mosaic[::2, ::2] = 200
    data = array("B", cv2.imencode(".jpg", mosaic)[1].tobytes())
    red, green, blue = messages.pixels(CompressedImage(format=form, data=data)).reshape(-1, 3).mean(axis=0)
    assert (red == green == blue) if grey else (red > 150 > 40 > max(blue, green))


def test_a_compressed_image_of_twelve_bits_is_as_bright_as_those_of_the_map(messages):
    data = cv2.imencode(".png", np.full((3, 4), 800, np.uint16))[1].tobytes()
    message = CompressedImage(format="16UC1; png compressed", data=array("B", data))
    assert (messages.pixels(message, 12) == 50).all()
    assert (messages.pixels(message) == 200).all(), "it looks like ten bits"


def test_an_image_that_cannot_be_used_is_refused_in_one_sentence(messages):
    with pytest.raises(DataError, match="got 'bayer_rggb8': convert"):
        messages.pixels(image("bayer_rggb8", 1)[0])
    short = image("rgb8", 3)[0]
    short.data = short.data[:-1]
    with pytest.raises(DataError, match="an image of 3 x 4 in rgb8 with 12 bytes a row cannot have 35 bytes"):
        messages.pixels(short)
    with pytest.raises(DataError, match="with 12 bytes a row"):
        messages.pixels(Image(height=3, width=4, step=12, encoding="rgba8", data=array("B", bytes(36))))
    for data in (b"", b"no picture"):
        with pytest.raises(DataError, match="in the format 'jpeg' is damaged"):
            messages.pixels(CompressedImage(format="jpeg", data=array("B", data)))


def location(**known):
    nearest = (Candidate("a.png", 1.0, 2.0, "", 0.1),)
    unknown = {"theta": math.nan, "room": "", "error_m": math.nan, "lost": None, "candidates": nearest, "ms": 1.0}
    return Location(**{"x": 1.0, "y": 2.0, **unknown, **known})


def test_a_pose_with_its_covariance(messages):
    known = location(theta=math.pi / 2, covariance=((0.04, 0.01), (0.01, 0.09)))
    message = messages.pose_message(known, HEADER, 0.1)
    assert message.serialized()
    assert (message.header.frame_id, message.header.stamp.sec, message.header.stamp.nanosec) == ("map", 7, 5)
    pose = message.pose.pose
    assert (pose.position.x, pose.position.y, pose.position.z) == (1.0, 2.0, 0.0)
    assert (pose.orientation.x, pose.orientation.y) == (0.0, 0.0)
    assert 2 * math.atan2(pose.orientation.z, pose.orientation.w) == pytest.approx(math.pi / 2)
    named = dict(zip([a + b for a in "xyzRPY" for b in "xyzRPY"], message.pose.covariance.tolist(), strict=True))
    assert (named["xx"], named["xy"], named["yx"], named["yy"]) == (0.04, 0.01, 0.01, 0.09)
    assert named["YY"] == pytest.approx(0.01)
    assert named["zz"] == named["RR"] == named["PP"] == messages.UNKNOWN
    assert sum(value != 0 for value in named.values()) == 8


def test_what_is_not_known_has_no_weight(messages):
    for unknown in (location(), location(theta=1.0)):  # a heading at an unknown place may be any
        spread = messages.pose_message(unknown, HEADER, 0.1).pose.covariance.reshape(6, 6)
        np.testing.assert_allclose(spread, np.diag([messages.UNKNOWN] * 5 + [math.pi**2 / 3]))
    spread = messages.pose_message(location(error_m=0.2), HEADER, 0.1).pose.covariance.reshape(6, 6)
    assert spread[0, 0] == spread[1, 1] == pytest.approx(0.02)


def test_times(messages):
    assert messages.seconds(Time(sec=3, nanosec=250_000_000)) == 3.25
    for by, sec, nanosec in ((0.5, 4, 250_000_000), (-0.5, 3, 250_000_000), (0.0, 3, 750_000_000)):
        later = messages.later(Time(sec=3, nanosec=750_000_000), by)
        assert (later.sec, later.nanosec) == (sec, nanosec)


def odometry_message(messages):
    message = Odometry(header=Header(frame_id="odom"), child_frame_id="base_link")
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y, pose.orientation = 3.0, -1.0, messages.turned(-2.0)
    twist.linear.x, twist.linear.y, twist.angular.z = 0.5, math.nan, 0.25
    return message


def test_odometry_is_read_in_the_plane(messages):
    pose, velocity = messages.odometry_motion(odometry_message(messages), "base_link")
    np.testing.assert_allclose(pose, [3, -1, -2], atol=1e-12)
    np.testing.assert_array_equal(velocity, [0.5, 0, 0.25])  # a velocity that is not told is none


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda one: setattr(one.header, "frame_id", ""), "its frame_id is empty"),
        (lambda one: setattr(one.header, "frame_id", "/odom"), "'/odom' begins with a slash"),
        (lambda one: setattr(one, "child_frame_id", "camera"), "of 'camera', not of 'base_link'"),
        (lambda one: one.pose.pose.orientation.__init__(w=0.0), "no unit quaternion"),
        (lambda one: setattr(one.pose.pose.position, "x", math.nan), "not finite"),
    ],
)
def test_odometry_that_says_nothing_is_refused_in_one_sentence(messages, change, text):
    message = odometry_message(messages)
    change(message)
    with pytest.raises(DataError, match=text):
        messages.odometry_motion(message, "base_link")


def test_the_transform_takes_the_robot_from_its_odometry_to_the_map(messages):
    random = np.random.default_rng(0)
    for x, y, theta, *odometry in random.uniform(-3, 3, (20, 6)).tolist():
        correction = messages.map_to_odom(location(x=x, y=y, theta=theta), np.array(odometry))
        found = composed(correction[None], np.array([odometry]))[0]
        np.testing.assert_allclose(found[:2], [x, y], atol=1e-9)
        assert math.cos(found[2] - theta) == pytest.approx(1)
    assert np.isnan(messages.map_to_odom(location(), np.zeros(3))).any()
    message = messages.transform_message(np.array([1.0, 2.0, math.pi / 2]), HEADER, "odom")
    assert message.serialized()
    assert (message.header.frame_id, message.child_frame_id) == ("map", "odom")
    move = message.transform
    assert (move.translation.x, move.translation.y, move.translation.z) == (1.0, 2.0, 0.0)
    assert (move.rotation.z, move.rotation.w) == (pytest.approx(0.5**0.5), pytest.approx(0.5**0.5))


@pytest.mark.parametrize(
    ("seen", "level", "text"),
    [
        (location(error_m=0.1, lost=False), 0, "located"),
        (location(lost=None), 0, "located"),
        (location(lost=True), 1, "lost"),
        (location(x=math.nan), 1, "no position in the map"),
        (None, 2, "damaged"),
    ],
)
def test_diagnostics(messages, seen, level, text):
    message = messages.diagnostic_message(HEADER.stamp, "robot", seen, "" if seen else "damaged", 0.25)
    assert message.serialized()
    (status,) = message.status
    assert (status.level, status.message, status.hardware_id) == (bytes([level]), text, "robot")
    told = {one.key: one.value for one in status.values}
    assert ("lost" in told) == (seen is not None)
    if seen is not None:
        assert told["lost"] == {None: "unknown", True: "true", False: "false"}[seen.lost]
        assert (told["time [ms]"], told["odometry age [s]"]) == ("1.0", "0.250")


def test_diagnostics_warn_of_a_fault_beside_the_location(messages):
    (status,) = messages.diagnostic_message(HEADER.stamp, "robot", location(lost=False), "no odometry").status
    assert (status.level, status.message) == (b"\1", "located; no odometry")
    assert {one.key: one.value for one in status.values}["odometry age [s]"] == "nan"
