"""Image folders joined with trajectories by time, and the readers of 360Loc and Rawseeds."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import siamloc.data
from siamloc.data.recorded import read_recorded
from siamloc.errors import DataError

START = 1403636580.0


def images(folder, names):
    folder.mkdir(parents=True)
    for name in names:
        (folder / name).write_bytes(b"image")
    return folder


def straight(path, start=START, seconds=10, speed=0.5):
    """A robot that drives along x for some seconds, with an entry each second, in TUM form."""
    path.write_text("".join(f"{start + t} {speed * t} 0 0 0 0 0 1\n" for t in range(seconds + 1)))
    return path


@pytest.fixture
def poses(tmp_path):
    return straight(tmp_path / "groundtruth.txt")


@pytest.mark.parametrize(
    ("name", "digits"),
    [
        ("{:.6f}.png", 6),
        ("frame_{:.2f}.jpg", 2),
        ("{:.0f}000000.png", 0),
        ("cam-{:.0f}.png", 0),
        ("{:.0f}_000000000.png", 0),
    ],
)
def test_times_in_names(tmp_path, poses, name, digits):
    """In seconds, ms, us or ns."""
    names = [name.format(START + t) for t in ((0.5, 2.25) if digits else (1, 3))]
    frames = siamloc.data.read("trajectory", images=images(tmp_path / "run_night/rgb", names), poses=poses)
    np.testing.assert_allclose(frames.x, [0.25, 1.125] if digits else [0.5, 1.5], atol=0.005)
    np.testing.assert_allclose(frames.time - START, [0.5, 2.25] if digits else [1, 3], atol=0.01)
    assert set(frames.sequence.tolist()) == {"run_night"}
    assert set(frames.lighting.tolist()) == {"night"}
    assert siamloc.data.read(**frames.source) == frames


def test_offset_odometry_and_frames_without_a_pose(tmp_path, poses, caplog):
    names = [f"{START + 100 + t}.png" for t in range(-1, 12)]
    folder = images(tmp_path / "monday", names)
    wheels = straight(tmp_path / "odometry.txt", start=START - 5, seconds=30, speed=1.0)
    given = {"images": folder, "poses": poses, "odometry": wheels, "offset": -100.0, "sequence": "one"}
    with caplog.at_level(logging.WARNING, "siamloc"):
        frames = siamloc.data.read("trajectory", **given)
    assert "2 of 13 images of" in caplog.text
    np.testing.assert_allclose(frames.x, 0.5 * np.arange(11))
    np.testing.assert_allclose(frames.odom_x, 5 + np.arange(11.0))
    np.testing.assert_allclose(frames.time, START + np.arange(11.0))
    assert set(frames.sequence.tolist()) == {"one"}
    with pytest.raises(DataError, match=r"2 of 13 images of .* outside of .*groundtruth\.txt, or in a gap"):
        siamloc.data.read("trajectory", **given, on_error="raise")
    for offset, shifted in ((0.0, ""), (-300.0, r"with offset=-300.000, .*")):  # the advice contains what is given
        with pytest.raises(DataError, match=rf"{shifted}two clocks; give offset=SECONDS, .* \(-99\.000 lets both"):
            siamloc.data.read("trajectory", **{**given, "offset": offset})


def test_times_in_another_unit_are_no_matter_of_an_offset(tmp_path, poses):
    """Images in ms since the robot's start, with a fraction, and poses in s since 1970."""
    folder = images(tmp_path / "monday", [f"{100 + t}000.5.png" for t in range(10)])
    with pytest.raises(DataError, match="the images' times seem to count ms, us or ns from a start of their own"):
        read_recorded(folder, poses)


@pytest.mark.parametrize("factor", [1e9, 1e6])
def test_images_in_ns_or_us_since_the_start_of_a_robot(tmp_path, factor):
    """Poses in s since that start; a folder of counted images has no times."""
    poses = straight(tmp_path / "poses.txt", start=3000)
    names = [f"{(3001 + t / 4) * factor:.0f}.png" for t in range(9)]
    np.testing.assert_allclose(read_recorded(images(tmp_path / "monday", names), poses).x, 0.5 + np.arange(9) / 8)
    few = images(tmp_path / "us", [f"{t * 33333:06d}.png" for t in range(3)])
    assert read_recorded(few).time.max() == pytest.approx(0.066666)
    assert np.isnan(read_recorded(images(tmp_path / "counted", ["0.png", "10.png", "20.png"])).time).all()


@pytest.mark.parametrize("written", ["times", "tum", "euroc", "headed", "turned"])
def test_times_in_a_list(tmp_path, poses, written):
    folder = images(tmp_path / "cam0/data", ["000000.png", "000001.png", "000002.png"])
    text = {
        "times": "".join(f"{START + t}\n" for t in range(3)),
        "tum": f"# color images\n{START + 2} rgb/000002.png\n{START} rgb/000000.png\n",
        "euroc": f"#timestamp [ns],filename\n{START * 1e9 + 1e9:.0f},000001.png\n",
        "headed": "time\n" + "".join(f"{START + t}\n" for t in range(3)),
        "turned": f"image,time\n000000.png,{START}\n000002.png,{START + 2}\n",
    }[written]
    (tmp_path / "list.txt").write_text(text)
    frames = read_recorded(folder, poses, times=tmp_path / "list.txt")
    numbers = {"times": [0, 1, 2], "tum": [0, 2], "headed": [0, 1, 2], "turned": [0, 2], "euroc": [1]}[written]
    assert [path[-8:-4] for path in frames.path.tolist()] == [f"000{number}" for number in numbers]
    np.testing.assert_allclose(frames.x, 0.5 * np.array(numbers))


@pytest.mark.parametrize(
    "line",
    ["{time} {name}", "{name} {time}", '"{name}","{time}"', "{name};{time}", "{time},{name},9", "{time}\t{name}"],
)
@pytest.mark.parametrize("time", ["1372105380.25", "2013-06-24T22:23:00.25+02:00", "2013-06-24 15:23:00.25-0500"])
def test_lists_with_spaces_in_names_and_time_zones(tmp_path, line, time):
    folder = images(tmp_path / "monday", ["im 1.png", "im 12 b.png"])
    rows = [line.format(name="im 12 b.png", time=time), line.format(name="im 1.png", time="1372105382.0")]
    (tmp_path / "list.txt").write_text("\n".join(rows))
    frames = read_recorded(folder, times=tmp_path / "list.txt")
    assert [Path(path).name for path in frames.path.tolist()] == ["im 12 b.png", "im 1.png"]
    np.testing.assert_allclose(frames.time, [1372105380.25, 1372105382])


@pytest.mark.parametrize("separator", [" ", "T"])
def test_dates_beside_the_images(tmp_path, poses, separator, caplog):
    """As in the raw data of KITTI: 2013-06-24 is the day of the start."""
    folder = images(tmp_path / "drive_1/image_02/data", ["0000000000.png", "0000000001.png"])
    dates = [f"2013-06-24{separator}20:23:0{second}.250000000" for second in (0, 2)]
    (folder.parent / "timestamps.txt").write_text("\n".join(dates) + "\n")
    zero = 1372105380.25 - START  # 2013-06-24 20:23:00.25 UTC
    frames = read_recorded(folder, straight(tmp_path / "then.txt", start=1372105380))
    np.testing.assert_allclose(frames.time - START, [zero, zero + 2])
    np.testing.assert_allclose(frames.x, [0.125, 1.125], atol=1e-6)  # times of this size are known to 0.2 us
    assert set(frames.sequence.tolist()) == {"drive_1"}
    named = tmp_path / "list.csv"
    named.write_text(f"image,time\n0000000001.png,{dates[0]}\n")
    np.testing.assert_allclose(read_recorded(folder, times=named).time - START, [zero])
    named.write_text("2013-13-24 20:23:00\n2013-13-24 20:23:01\n")
    with pytest.raises(DataError, match=r"list\.csv cannot be read: month must be in"):
        read_recorded(folder, times=named)
    (folder / "0000000001.png").unlink()  # some of the images were copied
    assert np.isnan(read_recorded(folder).time).all()
    assert "timestamps.txt is not used: it has no time for each of the 1 images" in caplog.text


def test_kitti_has_a_pose_for_each_image(tmp_path):
    """A camera that looks along z of its first pose, drives ahead 2 m and turns right, which is clockwise."""
    folder = images(tmp_path / "image_0", ["000000.png", "000001.png"])
    turn = Rotation.from_euler("y", 90, degrees=True).as_matrix()
    matrices = [np.eye(4)[:3], np.column_stack([turn, [0, 0, 2.0]])]
    (tmp_path / "00.txt").write_text("".join(" ".join(map(str, one.ravel())) + "\n" for one in matrices))
    (tmp_path / "times.txt").write_text("0.0\n0.1\n")
    frames = read_recorded(folder, tmp_path / "00.txt", times=tmp_path / "times.txt")
    heading = np.exp(1j * frames.theta)
    np.testing.assert_allclose(np.diff(frames.x + 1j * frames.y), [2 * heading[0]], atol=1e-9)
    np.testing.assert_allclose(heading[1] / heading[0], -1j, atol=1e-9)
    assert frames.time.tolist() == [0.0, 0.1]
    (folder / "000002.png").write_bytes(b"image")
    with pytest.raises(DataError, match="holds 2 poses without times, and there are 3 images: expected"):
        read_recorded(folder, tmp_path / "00.txt")


@pytest.mark.parametrize(
    ("names", "more", "says"),
    [
        (["000000.png"], {}, "the images have no times: .* give times=FILE"),
        ([], {}, "holds no images"),
        (["000000.png"], {"times": "0\n1\n"}, "holds 2 times for 1 images in .*: expected one each"),
        (["000000.png"], {"times": "0 a.png\n"}, "names no image of .*: expected a time and the name of an image"),
        (
            ["000000.png"],
            {"times": "now 000000.png\n"},
            "line 1: expected a time and the name of an image, got 'now 000000.png'",
        ),
        (
            ["a.png", "b.png"],
            {"times": "1 a.png\n12:30:01 b.png\n"},
            "line 2: expected a time and the name of an image",
        ),
        (["a.png"], {"times": "name,seq,stamp\na.png,0,17.5\n"}, "names no image of .*: expected a time"),
        (["000000.png"], {"times": "now\n"}, "is not a list of times"),
        (["0.png", "1.png"], {"times": "10:15:30\n10:15:31\n"}, "is not a list of times: .*'10:15:30'"),
        (["a.png"], {"times": "0 a.png\n1 a.png\n"}, "line 2: image 'a.png' is already in line 1: remove one of the"),
    ],
)
def test_what_cannot_be_joined_is_one_sentence(tmp_path, poses, names, more, says):
    folder = images(tmp_path / "rgb", names)
    if more:
        (tmp_path / "times.txt").write_text(more["times"])
        more = {"times": tmp_path / "times.txt"}
    with pytest.raises(DataError, match=says):
        read_recorded(folder, poses, **more)


def test_a_folder_of_folders_names_the_one_with_images(tmp_path):
    images(tmp_path / "euroc/mav0/cam0/data", ["1403636580250000000.png"])
    with pytest.raises(DataError, match=r"euroc holds no images; it holds: mav0; there are some in .*mav0/cam0/data$"):
        read_recorded(tmp_path / "euroc")


def test_a_reader_of_ones_own_is_one_function(tmp_path, monkeypatch):
    """It is known to `read`, to the settings and to the command line, with its own keys."""
    from siamloc.cli.compose import composed
    from siamloc.jobs.options import choices, options

    def read_mine(root, *, floor: int = 1):
        """Read the drives of my robot."""
        return siamloc.data.FrameTable(path=[f"{root}/a.png"], x=[floor], y=[0])

    monkeypatch.setitem(siamloc.data.READERS, "mine", read_mine)
    options.cache_clear()
    try:
        assert siamloc.data.read("mine", root="r", floor=2).x.tolist() == [2]
        assert choices("data")["mine"] == "Read the drives of my robot."
        job = composed("prepare", ["data=mine", "data.root=r", "data.floor=3"])
        assert job.data.read().x.tolist() == [3]
    finally:
        options.cache_clear()


def test_360loc_comes_with_its_camera():
    from siamloc.cli.compose import composed

    job = composed("prepare", ["data=360loc", "data.root=r"])
    assert job.unwrap["kind"] == "equirectangular"
    assert job.data.where == {"root": Path("r")}
    assert composed("prepare", ["data=360loc", "data.root=r", "unwrap=none"]).unwrap["kind"] == "none"


@pytest.mark.parametrize("json_only", [False, True])
def test_360loc(tmp_path, json_only):
    """Camera to world with COLMAP's axes, in a world whose z points up: looking along +y, then along -x."""
    looks = [Rotation.from_matrix(m) for m in ([[1, 0, 0], [0, 0, 1], [0, -1, 0]], [[0, 0, -1], [1, 0, 0], [0, -1, 0]])]
    scene = tmp_path / "360Loc/atrium"
    (scene / "pose").mkdir(parents=True)
    for part, sequence, file in (
        ("mapping", "daytime_360_0", "360_mapping_gt.txt"),
        ("query_360", "nighttime_360_1", "query_gt_360_night.txt"),
    ):
        folder = images(scene / part / sequence / "image", ["0000.jpg", "0001.jpg", "0002.jpg"])
        matrices, rows = {}, []
        for number, look in enumerate(looks):
            name = f"{number:04d}.jpg"
            x, y, z, w = look.as_quat()
            rows.append(f"{part}/{sequence}/image/{name} {number} 5.0 1.6 {w} {x} {y} {z}\n")
            matrix = np.eye(4)
            matrix[:3, :3], matrix[:3, 3] = look.as_matrix(), [number, 5.0, 1.6]
            matrices[name] = matrix.tolist()
        if json_only:
            (folder.parent / "camera_pose.json").write_text(json.dumps(matrices))
        else:
            (scene / "pose" / file).write_text("".join(rows))
    frames = siamloc.data.read("360loc", root=tmp_path / "360Loc")
    assert list(frames.rows_by("sequence")) == ["atrium_mapping_daytime_360_0", "atrium_query_nighttime_360_1"]
    assert frames.lighting.tolist() == ["day"] * 2 + ["night"] * 2
    np.testing.assert_allclose(frames.xy, [[0, 5], [1, 5]] * 2)
    np.testing.assert_allclose(frames.theta, [np.pi / 2, np.pi] * 2)
    assert set(frames.building.tolist()) == {"atrium"}
    with pytest.raises(DataError, match="has no scene 'hal'; valid: atrium"):
        siamloc.data.read("360loc", root=tmp_path / "360Loc", scene="hal")
    with pytest.raises(DataError, match=r"holds no scene of 360Loc: expected <scene>/"):
        siamloc.data.read("360loc", root=scene / "pose")
    if not json_only:
        turns = ("1 0 0 0", "0.70710678 0 0 0.70710678", "0 0 0 1")
        level = [
            f"mapping/daytime_360_0/image/000{number}.jpg {number} 5 0 {turn}" for number, turn in enumerate(turns)
        ]
        (scene / "pose/360_mapping_gt.txt").write_text("\n".join(level))
        with pytest.raises(
            DataError, match=r"daytime_360_0: the poses seem to be those of a robot, .*: give axes=robot"
        ):
            siamloc.data.read("360loc", root=scene)
        (scene / "pose/query_gt_360_night.txt").unlink()
        np.testing.assert_allclose(
            siamloc.data.read("360loc", root=scene, axes="robot").theta, [0, np.pi / 2, np.pi], atol=1e-6
        )
        (scene / "pose/360_mapping_gt.txt").write_text("0000.jpg 1 2 3 1 0 0 0\n")
        with pytest.raises(DataError, match=r"360_mapping_gt\.txt, line 1: expected SEQUENCE/image/NAME x y z qw"):
            siamloc.data.read("360loc", root=scene)


def test_rawseeds(tmp_path, caplog):
    for name in ("Bicocca_2009-02-25a", "Bicocca_2009-02-27a"):
        images(tmp_path / name / "OMNI", [f"OMNI_{START + t}.png" for t in range(4)])
        truth = "".join(f"{START + t:.6f}, {t}, 2.0, 1.5\n" for t in range(3))
        (tmp_path / name / f"{name}-GROUNDTRUTH.csv").write_text(truth)
        wheels = "".join(f"{START + t:.6f},7,11,12,{2 * t},0.5,0.25\n" for t in range(-1, 6))
        (tmp_path / name / f"{name}-ODOMETRY_XYT.csv").write_text(wheels)
    with caplog.at_level(logging.WARNING, "siamloc"):
        frames = siamloc.data.read("rawseeds", root=tmp_path)
    assert "1 of 4 images of" in caplog.text
    assert list(frames.rows_by("sequence")) == ["Bicocca_2009-02-25a", "Bicocca_2009-02-27a"]
    np.testing.assert_allclose(frames.x, [0, 1, 2] * 2)
    np.testing.assert_allclose(frames.theta, 1.5)
    np.testing.assert_allclose(frames.odometry, [[0, 0.5, 0.25], [2, 0.5, 0.25], [4, 0.5, 0.25]] * 2, atol=1e-6)
    (tmp_path / name / f"{name}-GROUNDTRUTH.csv").write_text("1,2\n")
    with pytest.raises(DataError, match=r"27a-GROUNDTRUTH\.csv has 2 columns, expected at least 4"):
        siamloc.data.read("rawseeds", root=tmp_path / name)
    with pytest.raises(DataError, match=r"holds no drive of Rawseeds: expected <drive>/OMNI/OMNI_<seconds>\.png"):
        siamloc.data.read("rawseeds", root=tmp_path / name / "OMNI")
