"""Recordings: bags written by rosbags, which is another program's code, and videos written by OpenCV."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import siamloc.data
from foundation.extras import lacking
from siamloc.cli import main
from siamloc.data.bags import METADATA, proposed
from siamloc.data.films import Film, quiet
from siamloc.errors import ConfigError, DataError

pytest.importorskip("rosbags", reason="the extra `recordings` is not installed")
from rosbags import rosbag2
from rosbags.typesys import get_types_from_msg

from tests.bags import Written, jpeg

START = 1_700_000_000_000_000_000
FORMS = ("ros1", "sqlite3", "mcap")
RNG = np.random.default_rng(3)
PICTURES = [cv2.resize(RNG.integers(0, 256, (6, 8, 3), dtype=np.uint8), (64, 48)) for _ in range(5)]


def drive(path, form, compressed=False):
    """Five pictures, one a second; poses at half seconds along a line, odometry on an arc, and frames."""
    bag = Written(path, form)
    with bag.writer:
        for number, picture in enumerate(PICTURES):
            time = START + number * 1_000_000_000
            if compressed:
                fields = {"format": "jpeg", "data": np.frombuffer(jpeg(picture), dtype=np.uint8)}
                name = "sensor_msgs/msg/CompressedImage"
                bag.write("/omni/compressed", name, time + 7, header=bag.header(time), **fields)
            else:
                bag.image("/omni/image_raw", time, picture, received=time + 200_000_000)
            bag.image("/front/image_raw", time, picture[:8])
        for number in range(-1, 11):
            time = START + number * 500_000_000
            pose = bag.covariant(bag.pose(number, 2.0, 0.5 + 0.1 * number))
            kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
            bag.write("/slam_pose", kind, time, header=bag.header(time, "map"), pose=pose)
            bag.odometry("/odom", time, 0.1 * number, 0.0, 0.2 * number)
            bag.transform("/tf", time, "odom", "base_link", 0.1 * number, 0.0, 0.2 * number)
        bag.transform("/tf", START, "map", "odom", 10.0, 20.0, np.pi / 2)
        matrix = np.array([300.0, 0, 32, 0, 300, 24, 0, 0, 1])
        roi = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
        fields = {"d": np.array([0.1, 0.2]), "k": matrix, "r": np.eye(3).ravel(), "p": np.zeros(12)}
        fields |= {"binning_x": 0, "binning_y": 0, "roi": bag.make("sensor_msgs/msg/RegionOfInterest", **roi)}
        fields |= {"height": 48, "width": 64, "distortion_model": "plumb_bob", "header": bag.header(START)}
        bag.write("/omni/camera_info", "sensor_msgs/msg/CameraInfo", START, **fields)
    return bag.path


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags")
    return {form: drive(folder / f"night_{form}", form) for form in FORMS}


@pytest.mark.parametrize("form", FORMS)
def test_a_bag_is_read_as_it_was_written(bags, tmp_path, form):
    found = siamloc.data.contents(bags[form])
    assert found.topics["/omni/image_raw"] == ("sensor_msgs/msg/Image", 5)
    assert set(found.frames) == {"odom:base_link", "map:odom"}
    assert found.proposal == {"images": "/omni/image_raw", "poses": "/slam_pose", "odometry": "/odom"}
    assert "/slam_pose" in found.describe()
    frames = siamloc.data.extract(bags[form], tmp_path)
    assert [Path(path).name for path in frames.path.tolist()] == [f"{START + t * 10**9:019d}.jpg" for t in range(5)]
    np.testing.assert_allclose(frames.xy, [[2 * t, 2] for t in range(5)], atol=1e-6)
    np.testing.assert_allclose(frames.theta, [0.5 + 0.2 * t for t in range(5)], atol=1e-6)
    np.testing.assert_allclose(frames.odometry, [[0.2 * t, 0, 0.4 * t] for t in range(5)], atol=1e-6)
    assert set(frames.sequence.tolist()) == {f"night_{form}"}
    assert set(frames.lighting.tolist()) == {"night"}
    for path, picture in zip(frames.path.tolist(), PICTURES, strict=True):
        assert np.abs(cv2.imread(path).astype(float) - picture).mean() < 6
    cameras = json.loads((tmp_path / "camera_info.json").read_text())
    assert cameras["/omni/camera_info"]["k"][0] == 300
    assert cameras["/omni/camera_info"]["distortion_model"] == "plumb_bob"
    assert siamloc.data.read("manifest", manifest=tmp_path / "frames.csv") == frames


@pytest.mark.parametrize("form", ["ros1", "mcap"])
def test_compressed_images_are_kept_as_they_are(tmp_path, form):
    bag = drive(tmp_path / "bag", form, compressed=True)
    frames = siamloc.data.extract(bag, tmp_path / "out", poses="none", odometry="none", every=2, sequence="monday")
    assert [Path(path).read_bytes() for path in frames.path.tolist()] == [jpeg(picture) for picture in PICTURES[::2]]
    assert not frames.has_position.any()
    assert set(frames.sequence.tolist()) == {"monday"}


def test_a_frame_in_two_others_is_found_in_both(tmp_path):
    bag = Written(tmp_path / "bag", "mcap")
    with bag.writer:
        for number, picture in enumerate(PICTURES):
            time = START + number * 10**9
            bag.image("/omni/image_raw", time, picture)
            bag.transform("/tf", time, "odom", "base_link", number, 0, 0)
            bag.transform("/tf", time, "map", "base_link", 10 + number, 0, 0)
    frames = siamloc.data.extract(bag.path, tmp_path / "out", poses="map:base_link", odometry="odom:base_link")
    np.testing.assert_allclose(frames.x, 10 + np.arange(5), atol=1e-6)
    np.testing.assert_allclose(frames.odometry[:, 0], np.arange(5), atol=1e-6)


@pytest.mark.parametrize("form", ["sqlite3", "mcap"])
def test_the_folder_of_a_bag_of_ros_2_may_end_like_one_of_ros_1(tmp_path, form):
    bag = drive(tmp_path / "drive", form).rename(tmp_path / "drive.bag")
    assert len(siamloc.data.extract(bag, tmp_path / "out")) == 5


def test_frames_are_chained(bags, tmp_path):
    """The robot's way in odom, turned by 90 degrees and moved to (10, 20)."""
    frames = siamloc.data.extract(bags["sqlite3"], tmp_path, poses="map:base_link", odometry="none")
    np.testing.assert_allclose(frames.xy, [[10, 20 + 0.2 * t] for t in range(5)], atol=1e-6)
    turned = np.exp(1j * frames.theta) / [1j * np.exp(0.4j * t) for t in range(5)]
    np.testing.assert_allclose(turned, 1, atol=1e-6)


@pytest.mark.parametrize(
    ("encoding", "picture"),
    [
        ("rgb8", PICTURES[0][:, :, ::-1]),
        ("bgra8", np.dstack([PICTURES[0], PICTURES[0][:, :, 0]])),
        ("mono8", PICTURES[0][:, :, 1]),
        ("8UC4", np.dstack([PICTURES[0], PICTURES[0][:, :, 0]])),
        ("mono16", PICTURES[0][:, :, 1].astype("<u2") << 8),
        ("16UC1", PICTURES[0][:, :, 1].astype("<u2") << 8),
        ("rgb16", PICTURES[0][:, :, ::-1].astype("<u2") << 8),
        ("yuyv", cv2.cvtColor(PICTURES[0], cv2.COLOR_BGR2YUV_YUY2)),
        ("uyvy", cv2.cvtColor(PICTURES[0], cv2.COLOR_BGR2YUV_UYVY)),
        ("yuv422_yuy2", cv2.cvtColor(PICTURES[0], cv2.COLOR_BGR2YUV_YUY2)),
    ],
)
def test_encodings(tmp_path, encoding, picture):
    """Each row of the picture is followed by bytes that do not count."""
    raw = np.ascontiguousarray(picture).view(np.uint8).reshape(48, -1)
    padded = np.pad(raw, ((0, 0), (0, 5)))
    bag = Written(tmp_path / "bag", "sqlite3")
    with bag.writer:
        bag.image("/image", START, padded, encoding, width=64)
    (path,) = siamloc.data.extract(bag.path, tmp_path / "out").path.tolist()
    expected = PICTURES[0] if picture.ndim == 3 else np.repeat(PICTURES[0][:, :, 1:2], 3, axis=2)
    assert np.abs(cv2.imread(path).astype(float) - expected).mean() < 8


@pytest.mark.parametrize("form", FORMS)
def test_images_of_twelve_bits_are_brightened_alike(tmp_path, form, caplog):
    """The first image is dark: only the second one shows how many bits are used."""
    bag = Written(tmp_path / "bag", form)
    grey = PICTURES[0][:, :, 1].astype("<u2")
    with bag.writer:
        for number, picture in enumerate((grey // 4 << 4, (grey << 4) + 15)):
            bag.image("/image", START + number * 10**9, picture, "mono16")
    frames = siamloc.data.extract(bag.path, tmp_path / "out")
    for path, expected in zip(frames.path.tolist(), (grey // 4, grey), strict=True):
        assert np.abs(cv2.imread(path)[:, :, 0].astype(float) - expected).mean() < 8
    (said,) = caplog.records
    assert "use 12 of 16 bits" in said.getMessage()


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("ending", ["", "jpeg", "png"])
def test_the_order_of_bayer_patterns(tmp_path, bits, ending):
    """A picture of one colour shows which pixels are red, also where the mosaic is compressed."""
    mosaic = np.zeros((48, 64), f"<u{bits // 8}")
    mosaic[::2, ::2] = 200 << (bits - 8)
    bag = Written(tmp_path / "bag", "sqlite3")
    with bag.writer:
        if ending:
            data = cv2.imencode(f".{ending}", mosaic)[1].ravel()
            fields = {"header": bag.header(START), "format": f"bayer_rggb{bits}; {ending} compressed ", "data": data}
            bag.write("/image/compressed", "sensor_msgs/msg/CompressedImage", START, **fields)
        else:
            bag.image("/image", START, mosaic, f"bayer_rggb{bits}")
    (path,) = siamloc.data.extract(bag.path, tmp_path / "out").path.tolist()
    blue, green, red = cv2.imread(path).reshape(-1, 3).mean(axis=0)
    assert red > 150 > 40 > max(blue, green)


def test_another_clock(tmp_path):
    """The camera counts from its start; the recorder's times, or an offset, bring both together."""
    bag = Written(tmp_path / "bag", "sqlite3")
    with bag.writer:
        for number in range(4):
            received = START + number * 10**9
            bag.image("/image", 5 * 10**9 + number * 10**9, PICTURES[0], received=received)
            bag.odometry("/odom", received, number, 0, 0)
    with pytest.raises(DataError, match=r"these are two clocks; give offset=SECONDS.*; if the camera .* clock=bag"):
        siamloc.data.extract(bag.path, tmp_path / "out")
    for given in ({"clock": "bag"}, {"offset": START / 1e9 - 5}):
        frames = siamloc.data.extract(bag.path, tmp_path / "out", **given)
        np.testing.assert_allclose(frames.odom_x, [0, 1, 2, 3], atol=1e-5)


@pytest.mark.parametrize("form", FORMS)
def test_the_poses_along_a_drive_are_proposed(tmp_path, form):
    """Not where somebody sent the robot, nor a topic that says little; frames with static ones that are repeated."""
    bag = Written(tmp_path / "bag", form)
    with bag.writer:
        bag.image("/image", START, PICTURES[0])
        for number in range(12):
            received = START + number * 10**9
            for topic in ("/goal_pose", "/initialpose", "/target", "/arm_pose", *["/some_pose"] * (number < 9)):
                header = bag.header(received, "map")
                name = "geometry_msgs/msg/PoseStamped"
                bag.write(topic, name, received, header=header, pose=bag.pose(0, 0, 0))
            bag.transform("/tf", received, "map", "base_link", number, 0, 0)
            bag.transform("/tf_static", received, "base_link", "camera", 0.5 if number > 3 else 9.0, 0, 0)
    assert siamloc.data.contents(bag.path).proposal["poses"] == "map:base_link"
    # The stamps of the frames are the recorder's times here; every repetition moves nothing.
    frames = siamloc.data.extract(bag.path, tmp_path / "out", poses="/map:/camera")
    np.testing.assert_allclose(frames.x, [0.5])
    topics = {"/goal_pose": ("geometry_msgs/msg/PoseStamped", 99), "/arm_pose": ("geometry_msgs/msg/PoseStamped", 12)}
    assert proposed(topics, []) == {"poses": "/arm_pose"}
    with_amcl = {**topics, "/amcl_pose": ("geometry_msgs/msg/PoseWithCovarianceStamped", 10)}
    assert proposed(with_amcl, []) == {"poses": "/amcl_pose"}
    assert proposed(with_amcl, [("map", "base_link")])["poses"] == "map:base_link", "the same poses, more often"
    cameras = {"/depth/image": ("sensor_msgs/msg/Image", 99), "/color/image": ("sensor_msgs/msg/Image", 9)}
    assert proposed(cameras, []) == {"images": "/color/image"}
    topics["/ground_truth"] = ("geometry_msgs/msg/PoseStamped", 10)
    assert proposed(topics, [("map", "base_link")])["poses"] == "/ground_truth"


@pytest.mark.parametrize("base", ["base_link", "base_footprint"])
def test_frames_up_and_down_the_tree(tmp_path, base):
    """Odometry that sees the map from the robot, whose camera is 0.9 m above a base."""
    bag = Written(tmp_path / "bag", "sqlite3")
    with bag.writer:
        bag.image("/image", START, PICTURES[0], header=bag.header(START, "/camera"))
        bag.transform(
            "/tf_static", START, "base_link", "camera", 0.1, 0, 0.7, z=0.8 if base == "base_footprint" else 0.9
        )
        if base == "base_footprint":
            bag.transform("/tf_static", START, "base_link", base, 0.1, 0, 0, z=-0.1)
        for number in range(2):  # of a robot at (1, 2) that looks along y
            bag.transform("/tf", START + number * 10**9, "base_link", "map", -2, 1, -np.pi / 2)
    found = siamloc.data.contents(bag.path)
    assert found.height == pytest.approx({base: 0.9})
    assert f"0.90 m above {base}: survey.height=0.90" in found.describe()
    frames = siamloc.data.extract(bag.path, tmp_path / "out", poses="map:base_link")
    np.testing.assert_allclose([frames.x[0], frames.y[0], frames.theta[0]], [1, 2, np.pi / 2], atol=1e-9)


def test_frames_in_a_loop_are_refused_unless_a_pair_is_named(tmp_path):
    bag = Written(tmp_path / "bag", "sqlite3")
    with bag.writer:
        bag.image("/image", START, PICTURES[0], header=bag.header(START, "camera"))
        bag.transform("/tf_static", START, "base_link", "camera", 0.1, 0, 0)
        bag.transform("/tf", START, "odom", "base_link", 3, 0, 0)
        bag.transform("/tf", START, "base_link", "odom", -2, 0, 0)
    found = siamloc.data.contents(bag.path)
    assert found.proposal == {"images": "/image", "odometry": "odom:base_link"}
    with pytest.raises(DataError, match=r"base_link, odom form a loop: .* such as odom:base_link, or a topic"):
        siamloc.data.extract(bag.path, tmp_path / "out", poses="odom:camera")
    below = siamloc.data.extract(bag.path, tmp_path / "below", poses="base_link:camera")
    np.testing.assert_allclose(below.x, [0.1])
    frames = siamloc.data.extract(bag.path, tmp_path / "out", poses="odom:base_link")
    np.testing.assert_allclose(frames.x, [3])


def test_frames_by_the_clock_of_the_recorder(tmp_path):
    """The robot counts from its start, also in the frames."""
    bag = Written(tmp_path / "bag", "sqlite3")
    with bag.writer:
        for number in range(4):
            received, stamp = START + number * 10**9, (5 + number) * 10**9
            bag.image("/image", stamp + 77 * 10**9, PICTURES[0], received=received)
            bag.transform("/tf", stamp, "map", "base_link", number, 0, 0, received=received)
    frames = siamloc.data.extract(bag.path, tmp_path / "out", poses="map:base_link", clock="bag")
    np.testing.assert_allclose(frames.x, [0, 1, 2, 3], atol=1e-5)
    with pytest.raises(DataError, match="two clocks") as error:
        siamloc.data.extract(bag.path, tmp_path / "out", poses="map:base_link", clock="bag", offset=1e6)
    assert "clock=bag" not in str(error.value)


def test_poses_are_looked_at_before_images_are_written(bags, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HOME", str(tmp_path))
    rows = [(START / 1e9 - 1 + t, t, 0, 0, np.cos(0.6 * t), 0, 0, np.sin(0.6 * t)) for t in range(8)]
    (tmp_path / "poses.txt").write_text("".join(" ".join(map(str, row)) + "\n" for row in rows))
    out = tmp_path / "out"
    assert main(["prepare", str(bags["mcap"]), f"recording.out={out}", f"recording.poses={tmp_path}/poses.txt"])
    assert "recording.order=wxyz, or recording.order=xyzw" in capsys.readouterr().err
    assert not out.exists()
    frames = siamloc.data.extract(bags["mcap"], out, poses="~/poses.txt", order="wxyz")
    np.testing.assert_allclose(frames.x, 1 + np.arange(5.0), atol=1e-5)


def test_doubts_about_poses_are_said(bags, tmp_path, caplog):
    """A robot that never turns: in the other order of its quaternions it is upright, too, but on its head."""
    rows = [(START / 1e9 - 1 + t, t, 0, 0, 1, 0, 0, 0) for t in range(8)]
    (tmp_path / "poses.txt").write_text("".join(" ".join(map(str, row)) + "\n" for row in rows))
    siamloc.data.extract(bags["mcap"], tmp_path / "out", poses=str(tmp_path / "poses.txt"))
    assert "stands on its head" in caplog.text


def test_a_bag_cut_short_is_one_sentence(bags, tmp_path):
    for form, suffix in (("ros1", ".bag"), ("sqlite3", ".db3"), ("mcap", ".mcap")):
        file = bags[form] if form == "ros1" else next(bags[form].glob(f"*{suffix}"))
        content = file.read_bytes()
        for share in (0, 0.3, 0.6, 0.9, 0.99):
            cut = tmp_path / f"cut{suffix}"
            cut.write_bytes(content[: int(share * len(content))])
            try:
                siamloc.data.extract(cut, tmp_path / f"{form}{share}")
            except DataError as error:
                assert str(cut) in str(error)  # noqa: PT017
            else:
                assert share > 0.5, f"{form} cut at {share}"


@pytest.mark.parametrize("form", ["sqlite3", "mcap"])
def test_a_file_of_a_bag_that_needs_its_folder_says_so(tmp_path, form, caplog):
    bag = Written(tmp_path / "bag", form)
    bag.writer.set_compression(rosbag2.CompressionMode.MESSAGE, rosbag2.CompressionFormat.ZSTD)
    with bag.writer:
        bag.image("/image", START, PICTURES[0])
    assert siamloc.data.contents(bag.path).topics["/image"][1] == 1
    (file,) = (path for path in bag.path.iterdir() if path.name != METADATA)
    with pytest.raises(DataError, match=rf"name its folder, {bag.path}, and if"):
        siamloc.data.extract(file, tmp_path / "out")
    whole = file.with_name(f"{file.name}.zstd")
    whole.touch()
    with pytest.raises(DataError, match="zstd: name the folder of the ROS 2 bag"):
        siamloc.data.contents(whole)
    plain = drive(tmp_path / "plain", form)
    part = next(path for path in plain.iterdir() if path.name != METADATA)
    siamloc.data.contents(part)
    assert not caplog.text
    part.with_stem("plain_1").touch()
    siamloc.data.contents(part)
    assert f"a part of the bag {plain}: name the folder to read all 2 parts" in caplog.text


def test_poses_of_a_camera_are_offered_and_depths_are_no_pictures(tmp_path):
    bag = Written(tmp_path / "bag", "mcap")
    with bag.writer:
        bag.image("/depth/image", START, PICTURES[0][:, :, 1].astype("<u2"), "16UC1")
        bag.transform("/tf", START, "map", "camera", 0, 0, 0)
    assert "recording.poses=map:camera, with recording.axes=camera" in siamloc.data.contents(bag.path).describe()
    with pytest.raises(DataError, match="hold depths"):
        siamloc.data.extract(bag.path, tmp_path / "out")


def test_messages_that_nobody_knows(tmp_path):
    bag = Written(tmp_path / "bag", "sqlite3")
    bag.types.register(get_types_from_msg("float64 warmth", "my_msgs/msg/Oven"))
    with bag.writer:
        bag.write("/oven", "my_msgs/msg/Oven", START, warmth=1.0)
    assert siamloc.data.contents(bag.path).topics == {"/oven": ("my_msgs/msg/Oven", 1)}
    with pytest.raises(DataError, match="holds no images; its topics: /oven"):
        siamloc.data.extract(bag.path, tmp_path / "out")
    with pytest.raises(DataError, match=r"/oven holds my_msgs/msg/Oven, expected sensor_msgs/msg/Image or .*: none"):
        siamloc.data.extract(bag.path, tmp_path / "out", images="/oven")


@pytest.mark.parametrize(
    ("given", "error", "says"),
    [
        ({"images": "/omni/image"}, DataError, "has no topic '/omni/image'; did you mean '/omni/image_raw'"),
        ({"poses": "/nowhere"}, ConfigError, "recording.poses=/nowhere is no topic of .*, no frame such as map:base"),
        ({"poses": "map:camera"}, DataError, "has no frames from 'map' to 'camera'; .*valid: odom:base_link, map:odom"),
        ({"poses": "/omni/image_raw"}, DataError, "holds sensor_msgs/msg/Image, expected nav_msgs/msg/Odometry or"),
        ({"every": 0}, ConfigError, "recording.every must be a whole number from 1"),
    ],
)
def test_what_is_not_in_a_recording(bags, tmp_path, given, error, says):
    with pytest.raises(error, match=says):
        siamloc.data.extract(bags["mcap"], tmp_path, **given)


def test_bad_images_and_poses(tmp_path):
    bag = Written(tmp_path / "bag", "sqlite3")
    with bag.writer:
        bag.image("/strange", START, PICTURES[0], "bgr10")
        bag.image("/short", START, PICTURES[0], height=1000)
        data = {"format": "h264", "data": np.zeros(9, np.uint8)}
        bag.write("/film", "sensor_msgs/msg/CompressedImage", START, header=bag.header(START), **data)
        data["format"] = "16UC1; compressedDepth png"
        bag.write("/depth", "sensor_msgs/msg/CompressedImage", START, header=bag.header(START), **data)
        bag.image("/good", START, PICTURES[0])
        bag.odometry("/odom", START, 0, 0, 0)
        pose = bag.pose(0, 0, 0)
        pose.orientation.w = 0.0
        bag.write("/zero", "geometry_msgs/msg/PoseStamped", START, header=bag.header(START), pose=pose)
    for given, says in (
        ({"images": "/strange"}, "have the encoding 'bgr10'; did you mean"),
        ({"images": "/short"}, "has 9216 bytes, too few for 64 x 1000 px in bgr8"),
        ({"images": "/film"}, "compressed as 'h264', expected JPEG or PNG"),
        ({"images": "/depth"}, "compressed as '16UC1; compressedDepth png', expected JPEG or PNG"),
        (
            {"images": "/good", "poses": "/zero"},
            "not three finite numbers and a quaternion, the first: pose 1, 0 0 0 0 0 0 0; nothing remains",
        ),
    ):
        with pytest.raises(DataError, match=says):
            siamloc.data.extract(bag.path, tmp_path / "out", **given)


@pytest.mark.parametrize("content", [b"", jpeg(PICTURES[0])[:-99]])
def test_a_damaged_image_does_not_end_an_extraction(tmp_path, caplog, content):
    bag = Written(tmp_path / "bag", "sqlite3")
    grey = PICTURES[0][:, :, 1].astype("<u2")
    with bag.writer:
        for number in range(4):
            time = START + number * 10**9
            data = np.frombuffer(jpeg(PICTURES[number]) if number else content, dtype=np.uint8)
            fields = {"format": "bgr8; jpeg compressed bgr8", "data": data}
            name = "sensor_msgs/msg/CompressedImage"
            bag.write("/compressed", name, time, header=bag.header(time), **fields)
            bag.image("/raw", time, grey, "mono16", **({"height": 99} if number == 2 else {}))
    for topic, left_out in (("/compressed", 0), ("/raw", 2)):
        caplog.clear()
        frames = siamloc.data.extract(bag.path, tmp_path / topic[1:], images=topic, poses="none")
        np.testing.assert_allclose(frames.time - START / 1e9, [t for t in range(4) if t != left_out])
        assert f"1 of 4 images of {topic} in {bag.path} cannot be used, the first: the image at" in caplog.text
        with pytest.raises(DataError, match="on_error=skip leaves them out"):
            siamloc.data.extract(bag.path, tmp_path / "strict", images=topic, poses="none", on_error="raise")
    strict = siamloc.data.extract(bag.path, tmp_path / "third", images="/raw", poses="none", on_error="raise", every=3)
    np.testing.assert_allclose(strict.time - START / 1e9, [0, 3])


@pytest.mark.parametrize("rate", [None, 1.0])
def test_damaged_pictures_of_a_folder_are_left_out(tmp_path, caplog, rate):
    pictures = written(tmp_path / "monday", [f"{100 + number}.0.png" for number in range(5)])
    whole = (pictures / "101.0.png").read_bytes()
    (pictures / "101.0.png").write_bytes(whole[: len(whole) // 2])
    (pictures / "103.0.png").write_bytes(b"no picture")
    frames = siamloc.data.extract(pictures, tmp_path / "out", rate=rate)
    assert frames.time.tolist() == [100, 102, 104]
    assert len(list((tmp_path / "out").glob("*.png"))) == 3
    first = f"the first: {pictures / '101.0.png'}: the file is cut short"
    assert f"2 of 5 images of pictures in {pictures} cannot be used, {first}" in caplog.text
    with pytest.raises(DataError, match=r"1 of 5 images .* the file is cut short \(on_error=skip leaves them out\)"):
        siamloc.data.extract(pictures, tmp_path / "strict", rate=rate, on_error="raise")
    assert len(list((tmp_path / "strict").glob("*.png"))) == 1


def test_an_interrupted_call_decodes_only_the_pictures_that_are_not_there(tmp_path, monkeypatch):
    decoded = []
    monkeypatch.setattr("siamloc.data.extracting.decode_image", decoded.append)
    pictures = written(tmp_path / "monday", [f"{100 + number}.0.png" for number in range(5)])
    first = siamloc.data.extract(pictures, tmp_path / "out")
    Path(first.path[3]).unlink()
    again = siamloc.data.extract(pictures, tmp_path / "out")
    assert len(decoded) == 5 + 1
    assert again.path.tolist() == first.path.tolist()


def film(path, times=1):
    code = cv2.VideoWriter_fourcc(*("MJPG" if path.suffix == ".avi" else "mp4v"))
    writer = cv2.VideoWriter(str(path), code, 10, (64, 48))
    for picture in PICTURES * times:
        writer.write(picture)
    writer.release()
    return path


@pytest.mark.parametrize("ending", [".mp4", ".avi"])
def test_odometry_of_another_clock_is_refused_before_a_video_is_decoded(tmp_path, ending):
    path, wheels = film(tmp_path / f"walk{ending}", 3), tmp_path / "wheels.txt"
    wheels.write_text("".join(f"{START / 1e9 + k} {0.1 * k} 0 0 0 0 0 1\n" for k in range(9)))
    with pytest.raises(DataError, match=r"taken between 0\.000 and 1\.500 s, .*: these are two clocks"):
        siamloc.data.extract(path, tmp_path / "out", odometry=str(wheels))
    assert not list((tmp_path / "out").glob("*.jpg"))
    assert len(siamloc.data.extract(path, tmp_path / "out", odometry=str(wheels), offset=START / 1e9)) == 15


@pytest.mark.parametrize("ending", [".mp4", ".avi"])
def test_a_video_with_a_trajectory(tmp_path, ending):
    """The video begins 2 s after the trajectory."""
    path = film(tmp_path / f"walk{ending}")
    poses = tmp_path / "poses.txt"
    poses.write_text("".join(f"{100 + t} {t} 1 0 0 0 0 1\n" for t in range(5)))
    assert siamloc.data.contents(path).proposal == {"images": "video"}
    frames = siamloc.data.extract(path, tmp_path / "out", poses=str(poses), offset=102.0)
    np.testing.assert_allclose(frames.x, 2 + 0.1 * np.arange(5), atol=1e-3)
    np.testing.assert_allclose(frames.time, 102 + 0.1 * np.arange(5), atol=1e-3)
    assert [Path(file).name for file in frames.path.tolist()][:2] == [
        "0000000000000000000.jpg",
        "0000000000100000000.jpg",
    ]
    for file, picture in zip(frames.path.tolist(), PICTURES, strict=True):
        assert np.abs(cv2.imread(file).astype(float) - picture).mean() < 20
    path.write_bytes(b"no video")
    with pytest.raises(DataError, match="cannot be read as a video"):
        siamloc.data.contents(path)


def test_the_calibration_of_a_recording_is_read_after_it_was_written(bags, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = [f"recording.{what}" for what in ("out=new", "poses=none", "odometry=none")]
    assert main(["prepare", str(bags["mcap"]), *words, "unwrap=calibrated", "unwrap.file=new/camera_info.json"]) != 0
    assert "has the distortion model plumb_bob" in capsys.readouterr().err
    assert len(siamloc.data.read("manifest", manifest="new/frames.csv")) == 5
    camera = ["unwrap=calibrated", "unwrap.file=robot/frames/camera_info.json"]
    assert main(["walk", str(bags["mcap"]), "out=robot", *camera]) != 0
    assert "has the distortion model plumb_bob" in capsys.readouterr().err


def test_a_video_goes_on_after_a_picture_that_is_damaged_and_says_if_its_end_is_missing(tmp_path, caplog):
    path = film(tmp_path / "walk.avi", 5)
    content = path.read_bytes()
    starts = [found.start() for found in re.finditer(b"\xff\xd8\xff", content)]
    end = starts[5] - 16  # before the head of the next picture
    path.write_bytes(content[: starts[4]] + bytes(end - starts[4]) + content[end:])
    frames = siamloc.data.extract(path, tmp_path / "out")
    np.testing.assert_allclose(frames.time, np.delete(0.1 * np.arange(25), 4), atol=1e-3)
    assert f"1 of 25 images of video in {path} cannot be used, the first: {path}#4 cannot be decoded" in caplog.text
    assert "early" not in caplog.text
    assert "lacks" not in caplog.text
    with pytest.raises(DataError, match=r"#4 cannot be decoded: .* \(on_error=skip leaves them out\)"):
        siamloc.data.extract(path, tmp_path / "strict", on_error="raise")
    path.write_bytes(content[: starts[15]])
    assert len(siamloc.data.extract(path, tmp_path / "short")) == 15
    assert "walk.avi ends 1.0 s early, after 15 of the 25 pictures that it announces" in caplog.text
    with pytest.raises(DataError, match="s early, after 15 of the 25"):
        siamloc.data.extract(path, tmp_path / "strict short", on_error="raise")


@pytest.mark.parametrize(("pictures", "head"), [((23, 24), 0), ((4, 9, 13), -8)])
def test_pictures_that_a_video_does_not_even_give_as_damaged_are_said(tmp_path, caplog, pictures, head):
    """The last pictures are damaged, or the heads of some: OpenCV passes over both."""
    path = film(tmp_path / "walk.avi", 5)
    content = bytearray(path.read_bytes())
    starts = [found.start() for found in re.finditer(b"\xff\xd8\xff", content)]
    for number in pictures:
        content[starts[number] + head : starts[number] + 300] = bytes(300 - head)
    path.write_bytes(content)
    frames = siamloc.data.extract(path, tmp_path / "out", on_error="raise")
    assert len(frames) == 25 - len(pictures)
    assert f"{path} lacks {len(pictures)} of the 25 pictures that it announces: they are damaged" in caplog.text


def test_the_command_looks_first_and_then_extracts(bags, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SIAMLOC_CACHE", str(tmp_path / "cache"))
    assert main(["prepare", str(bags["ros1"])]) == 0
    shown = capsys.readouterr().out
    assert "5 x sensor_msgs/msg/Image, " in shown
    assert not list(tmp_path.iterdir())
    command = shown.splitlines()[-1].removeprefix("next: siamloc ").split()
    assert command[-1] == "recording.out=night_ros1_frames"
    spaced = shutil.copy(bags["ros1"], tmp_path / "my drive (1), it's to Köln.bag")
    assert main(["prepare", str(spaced)]) == 0
    assert shlex.split(capsys.readouterr().out.splitlines()[-1])[3] == f'recording.file="{spaced}"'
    spaced.unlink()
    words = [f"protocol.map.sequences=[{','.join(['drive'] * 99)}]", "data.image_size=[16,32]"]
    assert main(["prepare", str(bags["ros1"]), *words]) == 0  # no file has so long a name
    capsys.readouterr()
    assert main(["prepare", str(bags["ros1"]), "unwrap=polar", "unwrap.inner=3"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].endswith(" unwrap=polar unwrap.inner=3")
    assert main([*command, "data.image_size=[16,32]", "data.circular=false"]) == 0  # no network, which takes long
    assert "decoded: 5 panoramas of 16 x 32 px" in capsys.readouterr().out
    frames = siamloc.data.read("manifest", manifest="night_ros1_frames/frames.csv")
    assert len(frames) == 5
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "night_ros1_frames").glob("*.jpg")}
    siamloc.data.extract(bags["ros1"], "night_ros1_frames")
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "night_ros1_frames").glob("*.jpg")} == before
    with pytest.raises(DataError, match=r"there is no recording nowhere\.bag"):
        siamloc.data.contents("nowhere.bag")
    with pytest.raises(DataError, match="holds no images"):
        siamloc.data.contents(tmp_path)
    (tmp_path / "monday").mkdir()
    (tmp_path / "monday" / "night_0.db3").touch()
    with pytest.raises(
        DataError, match=r"no images, and no metadata\.yaml .*: `siamloc prepare .*/night_0\.db3` reads .* joins parts"
    ):
        siamloc.data.contents(tmp_path / "monday")
    (tmp_path / "monday" / "night_0.db3").unlink()
    for name, remedy in (("a.HEIC", "; .heic: convert them to JPEG"), ("b.insp", "; .insp: export .* renamed to .jpg")):
        (tmp_path / "monday" / name).touch()
        with pytest.raises(DataError, match=remedy):
            siamloc.data.contents(tmp_path / "monday")
        with pytest.raises(DataError, match=remedy):
            siamloc.data.contents(tmp_path / "monday" / name)
    written(tmp_path / "pictures", ["1.png", "2.png"])
    (tmp_path / "times.txt").write_text("5.5\n7.5\n")
    capsys.readouterr()
    assert main(["prepare", "pictures", "recording.times=times.txt", "recording.offset=3"]) == 0
    shown = capsys.readouterr().out
    assert "pictures: 2.0 s, 1 topic" in shown
    assert shown.splitlines()[-1].endswith("recording.times=times.txt recording.offset=3 recording.out=pictures_frames")
    (tmp_path / "notes.txt").touch()
    with pytest.raises(DataError, match=r"is no recording: expected a file \.bag, \.db3"):
        siamloc.data.contents(tmp_path / "notes.txt")


def test_no_command_is_proposed_for_a_bag_without_images(tmp_path, capsys):
    bag = Written(tmp_path / "bag", "sqlite3")
    with bag.writer:
        bag.odometry("/odom", START, 0.0, 0.0, 0.0)
    assert main(["prepare", str(bag.path)]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("there is nothing to extract: no topic of ")


def test_the_drive_of_a_folder_has_its_whole_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(written(tmp_path / "2024.05.13", ["1.png", "2.png"]))
    assert main(["prepare", "."]) == 0
    assert capsys.readouterr().out.splitlines()[-1].endswith("recording.out=2024.05.13_frames")
    for recording in (".", "../2024.05.13"):
        assert set(siamloc.data.extract(recording, tmp_path / "out").sequence) == {"2024.05.13"}


def test_a_camera_that_stamps_nothing_anew_is_warned_of(tmp_path, caplog):
    bag = Written(tmp_path / "bag", "sqlite3")
    with bag.writer:
        for number in range(4):
            bag.image("/image", START, PICTURES[0], received=START + number * 10**9)
    assert len(siamloc.data.extract(bag.path, tmp_path / "one")) == 1
    assert "3 of 4 images of" in caplog.text
    assert "clock=bag takes the times at which they were recorded" in caplog.text
    assert len(siamloc.data.extract(bag.path, tmp_path / "all", clock="bag")) == 4


def test_messages_without_a_stamp_are_warned_of(tmp_path, caplog):
    bag = Written(tmp_path / "bag", "sqlite3")
    with bag.writer:
        for number in range(4):
            time = START + number * 10**9
            bag.image("/image", time, PICTURES[0], header=bag.header(0 if number == 2 else time))
            pose = bag.pose(number, 0, 0)
            bag.write("/pose", "geometry_msgs/msg/PoseStamped", time, header=bag.header(0), pose=pose)
            bag.transform("/tf", 0, "map", "base_link", number, 0, 0, received=time)
            bag.transform("/tf_static", 0, "base_link", "camera", 0, 0, 0, received=time)  # as many robots send it
    said = r": {} of {} have no time in their header and get that at which they were recorded.*clock=bag takes"
    for poses, of_poses in (
        ("/pose", said.format("4 of the messages", "/pose")),
        ("map:camera", said.format("4 of the frames", "/tf")),
    ):
        caplog.clear()
        frames = siamloc.data.extract(bag.path, tmp_path / "out", poses=poses)
        np.testing.assert_allclose(frames.x, np.arange(4))
        assert [bool(re.search(of_poses, text)) for text in caplog.messages] == [True, False]
        assert re.search(said.format("1 of the messages", "/image"), caplog.messages[1])
    caplog.clear()
    siamloc.data.extract(bag.path, tmp_path / "out", clock="bag")
    assert not caplog.messages


def test_a_strict_extraction_stops_at_the_first_image_that_is_left_out(tmp_path):
    strict = {"on_error": "raise"}
    names = [f"{time}.png" for time in (100.0, 100.5, 101.0, 104.0)]
    pictures = written(tmp_path / "monday", names)
    poses = tmp_path / "poses.txt"
    poses.write_text("100.2 0 0 0 0 0 0 1\n101 1 0 0 0 0 0 1\n")
    with pytest.raises(DataError, match=r"at 100.000 s has no pose in .*, from 100.200 to 101.000 s, with offset=0"):
        siamloc.data.extract(pictures, tmp_path / "none", poses=str(poses), **strict)
    assert not (tmp_path / "none").exists()
    (pictures / names[0]).rename(pictures / "0100.5.png")  # the same time again
    with pytest.raises(DataError, match=r"1 of 3 images of .* have the time of another one"):
        siamloc.data.extract(pictures, tmp_path / "one", poses="none", **strict)
    assert [path.name for path in (tmp_path / "one").iterdir()] == ["0000000100500000000_0100.5.png"]


def test_without_rosbags_the_extra_is_named(bags, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(ModuleNotFoundError) as error:
        siamloc.data.contents(bags["ros1"])
    assert "pip install '.[recordings]'" in str(error.value)
    assert "pip install '.[recordings]'" in lacking(error.value)


def test_a_folder_with_the_images_of_another_recording_is_refused(tmp_path):
    for name in ("monday.avi", "tuesday.avi"):
        film(tmp_path / name)
    first = siamloc.data.extract(tmp_path / "monday.avi", tmp_path / "out")
    assert siamloc.data.extract(tmp_path / "monday.avi", tmp_path / "out").path.tolist() == first.path.tolist()
    with pytest.raises(DataError, match="holds the images of another recording"):
        siamloc.data.extract(tmp_path / "tuesday.avi", tmp_path / "out")


def written(folder, names):
    """Write a picture of its own for each name."""
    folder.mkdir()
    for picture, name in zip(PICTURES, names, strict=False):
        cv2.imwrite(str(folder / name), picture)
    return folder


def test_a_folder_of_pictures_is_a_recording(tmp_path):
    pictures = written(tmp_path / "monday", [f"left {number / 4 + 100:.2f}.png" for number in range(5)])
    found = siamloc.data.contents(pictures)
    assert (found.topics, found.seconds, found.proposal) == ({"pictures": ("pictures", 5)}, 1.0, {"images": "pictures"})
    wheels = tmp_path / "wheels.txt"
    wheels.write_text("99 0 0 0 0 0 0 1\n103 4 0 0 0 0 0 1\n")
    frames = siamloc.data.extract(pictures, tmp_path / "out", odometry=str(wheels), gap=9.0)
    np.testing.assert_allclose(frames.time, [100, 100.25, 100.5, 100.75, 101])
    np.testing.assert_allclose(frames.odom_x, [1, 1.25, 1.5, 1.75, 2])
    assert set(frames.sequence.tolist()) == {"monday"}
    assert Path(frames.path[1]).name == "0000000100250000000_left_100.25.png"
    for path, picture in zip(frames.path.tolist(), PICTURES, strict=True):
        np.testing.assert_array_equal(cv2.imread(path), picture)


@pytest.mark.parametrize("odometry", ["robot", "camera"])
@pytest.mark.parametrize("poses", [None, "robot", "camera"])
def test_odometry_may_be_that_of_a_camera(tmp_path, poses, odometry):
    """On a circle of 2 m to the left; as a camera writes it, z ahead and y down, in a world of such axes, too."""
    pictures = written(tmp_path / "monday", [f"{100 + number}.0.png" for number in range(5)])
    turned = 0.3 * np.arange(5)
    x, y = 2 * np.sin(turned), 2 * (1 - np.cos(turned))
    rows = {
        "robot": [f"{100 + n} {x[n]} {y[n]} 0 0 0 {np.sin(a / 2)} {np.cos(a / 2)}" for n, a in enumerate(turned)],
        "camera": [f"{100 + n} {-y[n]} 0 {x[n]} 0 {-np.sin(a / 2)} 0 {np.cos(a / 2)}" for n, a in enumerate(turned)],
    }
    for name, lines in rows.items():
        (tmp_path / name).write_text("\n".join(lines))
    given = {"odometry": str(tmp_path / odometry), "poses": str(tmp_path / poses) if poses else "none"}
    frames = siamloc.data.extract(pictures, tmp_path / "out", **given, axes="camera")
    for found in [frames.odometry, *([np.column_stack([frames.xy, frames.theta])] if poses else [])]:
        start = np.tile(found[0], (5, 1))
        moved = siamloc.data.moves.composed(siamloc.data.moves.inverse(start), found)
        np.testing.assert_allclose(moved, np.column_stack([x, y, turned]), atol=1e-4)
    if "camera" in (poses, odometry):
        with pytest.raises(DataError, match="those of a camera, not of a robot: give axes=camera"):
            siamloc.data.extract(pictures, tmp_path / "out", **given)


def test_pictures_without_times_in_their_names_are_taken_a_second_apart(tmp_path):
    pictures = written(tmp_path / "monday", [f"picture_{number}.png" for number in (1, 2, 10)])
    frames = siamloc.data.extract(pictures, tmp_path / "out")
    assert frames.time.tolist() == [0, 1, 2]
    for path, picture in zip(frames.path.tolist(), PICTURES, strict=False):
        np.testing.assert_array_equal(cv2.imread(path), picture, "in the order of the numbers")
    with pytest.raises(ConfigError, match="is the recording itself"):
        siamloc.data.extract(pictures, pictures)
    assert "3 x pictures without times (give recording.times=FILE," in siamloc.data.contents(pictures).describe()
    (tmp_path / "00.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3)
    with pytest.raises(DataError, match=r"holds poses without times, .* data\.poses=.*00\.txt takes them in order"):
        siamloc.data.extract(pictures, tmp_path / "none", poses=str(tmp_path / "00.txt"))
    (tmp_path / "times.txt").write_text("100.5\n101.5\n103.5\n")
    frames = siamloc.data.extract(pictures, tmp_path / "timed", times=str(tmp_path / "times.txt"))
    assert frames.time.tolist() == [100.5, 101.5, 103.5]
    for path, picture in zip(frames.path.tolist(), PICTURES, strict=False):
        np.testing.assert_array_equal(cv2.imread(path), picture, "in the order of the numbers")
    with pytest.raises(ConfigError, match=r"recording\.times is for a folder of pictures"):
        siamloc.data.extract(film(tmp_path / "monday.avi"), tmp_path / "film", times="times.txt")


@pytest.mark.parametrize(("name", "parts"), [("lens{}{}.png", ("_00_", "_10_")), ("{} {}.5.png", ("front", "my back"))])
def test_the_second_pictures_of_two_lenses_go_with_the_first(tmp_path, name, parts):
    pictures = written(tmp_path / "monday", [name.format(part, number) for number in (7, 8) for part in parts])
    siamloc.data.extract(pictures, tmp_path / "out")
    two = siamloc.data.DualFisheyeCamera(second=parts)
    frames = siamloc.data.extract(pictures, tmp_path / "out", second=two.second)
    assert np.diff(frames.time).tolist() == [1.0]
    for path, pair in zip(frames.path.tolist(), (PICTURES[:2], PICTURES[2:4]), strict=True):
        both = siamloc.data.Preprocessing.checked((8, 32), two).files(path)
        np.testing.assert_array_equal([cv2.imread(str(one)) for one in both], pair)
    assert siamloc.data.contents(pictures, second=parts).topics["pictures"][1] == 2
    with pytest.raises(ConfigError, match="second must be a list of 2"):
        siamloc.data.extract(pictures, tmp_path / "one", second=parts[:1])


def test_second_pictures_are_those_of_a_folder(tmp_path):
    for recording in (film(tmp_path / "monday.avi"), drive(tmp_path / "tuesday", "sqlite3")):
        with pytest.raises(ConfigError, match=r"is no folder of pictures, for which unwrap\.second is: extract"):
            siamloc.data.contents(recording, second=("front_", "back_"))


def test_a_list_of_times_may_name_both_pictures_of_two_lenses_and_a_damaged_second_one_is_taken_once_whole(tmp_path):
    pictures = written(tmp_path / "monday", [f"{part}_{number}.png" for number in (7, 8) for part in "ab"])
    rows = [f"{number}.5 {part}_{number}.png\n" for number in (7, 8) for part in "ab"]
    (pictures / "timestamps.txt").write_text("".join(rows))
    whole = (pictures / "b_8.png").read_bytes()
    for held, seconds in ((whole[:99], 1), (whole, 2)):
        (pictures / "b_8.png").write_bytes(held)
        frames = siamloc.data.extract(pictures, tmp_path / "out", second=("a_", "b_"))
        assert frames.time.tolist() == [7.5, 8.5]
        assert len(list((tmp_path / "out").glob("*_b_*.png"))) == seconds
    (pictures / "timestamps.txt").write_text("".join([*rows[1:], "9 a_9.png\n", "10 b_10.png\n"]))
    assert siamloc.data.extract(pictures, tmp_path / "all", second=("a_", "b_")).time.tolist() == [0.0, 1.0]


def test_a_rate_takes_at_most_so_many_pictures_per_second(tmp_path):
    names = [f"{time}.png" for time in (100.0, 100.3, 100.5, 100.8, 102.0)]
    frames = siamloc.data.extract(written(tmp_path / "monday", names), tmp_path / "out", rate=2.0)
    assert frames.time.tolist() == [100.0, 100.5, 102.0]


@pytest.mark.parametrize(("hertz", "kept"), [(5, 20), (30, 20), (7.5, 20)])
def test_pictures_that_come_a_little_early_or_late_are_not_lost(tmp_path, hertz, kept):
    rng = np.random.default_rng(0)
    times = 100 + np.arange(int(4 * hertz)) / hertz + rng.uniform(-0.01, 0.01, int(4 * hertz))
    (tmp_path / "monday").mkdir()
    for time in times:
        cv2.imwrite(str(tmp_path / "monday" / f"{time:.4f}.png"), PICTURES[0])
    found = siamloc.data.extract(tmp_path / "monday", tmp_path / "out", rate=5.0).time
    assert abs(len(found) - kept) <= 2
    assert np.diff(found).min() > 0.1


def test_pictures_that_were_recorded_out_of_order_are_taken_without_a_rate_and_reported_with_one(
    tmp_path, monkeypatch, caplog
):
    film(tmp_path / "monday.avi")
    stamps = [2_000_000_000, 1_000_000_000, 1_000_000_000, 3_000_000_000]
    messages = [(stamp, picture, ".png") for stamp, picture in zip(stamps, PICTURES, strict=False)]
    monkeypatch.setattr(Film, "images", lambda *_: iter(messages))
    monkeypatch.setattr(Film, "check_whole", lambda *_: None)
    frames = siamloc.data.extract(tmp_path / "monday.avi", tmp_path / "out")
    assert frames.time.tolist() == [1, 2, 3]
    (said,) = caplog.records
    assert re.search(r"1 of 4 images of .* the time of another one, the first: 1\.000 s", said.getMessage())
    frames = siamloc.data.extract(tmp_path / "monday.avi", tmp_path / "fewer", rate=1.0)
    assert frames.time.tolist() == [2, 3]
    assert re.search(r"2 of 4 images of .* after later ones, which a rate leaves out, the first: 1\.000 s", caplog.text)


def test_older_versions_of_opencv_are_silenced_as_well(monkeypatch):
    levels = [3]
    monkeypatch.setattr(cv2, "getLogLevel", lambda: levels[-1], raising=False)
    monkeypatch.setattr(cv2, "setLogLevel", levels.append, raising=False)
    monkeypatch.delattr(cv2.utils, "logging")  # where OpenCV 4.13 moved these functions
    with quiet():
        pass
    assert levels == [3, 0, 3]
