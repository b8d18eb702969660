"""Trajectories as the formats' specifications write them, against scipy's rotations and interpolation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

import siamloc.data
from siamloc.data.recorded import read_recorded
from siamloc.data.trajectory import Trajectory, read_trajectory, seconds
from siamloc.errors import ConfigError, DataError

RNG = np.random.default_rng(5)
TIME = 1305031102.0 + np.cumsum(RNG.uniform(0.02, 0.2, 60))
HEADING = np.cumsum(RNG.uniform(-0.2, 0.35, 60))
XY = np.cumsum(RNG.normal(0, 0.1, (60, 2)), axis=0)
# A camera looks along z, its y points down; the robot's x points ahead, its z up.
OF_CAMERA = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def turns(axes="robot", sway=0.0):
    """Rotations from the frame to a world with z up."""
    upright = Rotation.from_euler("z", HEADING[:, None]) * Rotation.from_rotvec(RNG.normal(0, sway + 1e-12, (60, 3)))
    return upright if axes == "robot" else upright * OF_CAMERA


def lines(*columns, separator=" ", head="# written by the test\n"):
    rows = np.column_stack(columns)
    return head + "".join(separator.join(f"{value:.9f}" for value in row) + "\n" for row in rows)


def tum(rotations, order=(0, 1, 2, 3)):
    return lines(TIME, XY, np.full(60, 0.3), rotations.as_quat()[:, order])


def euroc(rotations):
    head = "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v\n"
    quaternion = rotations.as_quat()[:, [3, 0, 1, 2]]
    rows = zip(TIME, np.column_stack([XY, np.full(60, 0.3), quaternion, np.zeros(60)]), strict=True)
    return head + "".join(f"{round(time * 1e9)},{','.join(f'{v:.9f}' for v in row)}\n" for time, row in rows)


def kitti(rotations):
    poses = np.concatenate([rotations.as_matrix(), np.column_stack([XY, np.full(60, 0.3)])[:, :, None]], axis=2)
    return lines(poses.reshape(60, 12), head="")


def test_whole_matrices_are_those_of_kitti_too(tmp_path):
    poses = tmp_path / "poses.txt"
    poses.write_text(kitti(turns("camera")))
    whole = tmp_path / "whole.txt"
    whole.write_text(poses.read_text().replace("\n", " 0 0 0 1\n"))
    np.testing.assert_array_equal(read_trajectory(whole).quaternion, read_trajectory(poses).quaternion)


def test_poses_and_odometry_may_be_of_a_camera_and_of_a_robot(tmp_path):
    for name in ("robot", "camera"):
        (tmp_path / f"{name}.txt").write_text(tum(turns(name)))
        own = read_trajectory(tmp_path / f"{name}.txt")
        assert own.own_axes("robot") == "robot"
        assert own.own_axes("camera") == own.own_axes("camera", beside=True) == name
    images = tmp_path / "images"
    images.mkdir()
    for time in TIME:
        (images / f"{time:.9f}.png").write_bytes(b"image")
    one, other = (tmp_path / f"{name}.txt" for name in ("robot", "camera"))
    for files in ((one, other), (other, one)):
        frames = read_recorded(images, files[0], odometry=files[1], axes="camera")
        np.testing.assert_allclose(np.exp(1j * frames.theta), np.exp(1j * HEADING), atol=1e-6)
        np.testing.assert_allclose(np.exp(1j * frames.odom_theta), np.exp(1j * HEADING), atol=1e-6)


@pytest.mark.parametrize(("unit", "factor"), [("s", 1), ("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_the_unit_of_times_is_known_by_their_size_or_by_their_steps(unit, factor, caplog):
    """From the start of a robot, 20 minutes in ns are as many as the time since 1970 in ms."""
    since_1970 = 1.7e9 + np.arange(0.0, 600, 60)
    np.testing.assert_allclose(seconds(since_1970 * factor, "a"), since_1970, rtol=1e-12)
    rare = 1.7e9 + np.arange(0.0, 72000, 7200)
    np.testing.assert_allclose(seconds(rare * 1e9, "rare"), rare, rtol=1e-12)
    assert not caplog.records
    for start, step in ((0, 0.5), (1200, 1 / 32), (40000, 0.1), (1200, 2.0)):
        since_start = start + np.arange(0, 20 * step, step)
        written = since_start * factor if factor == 1 else np.round(since_start * factor)
        np.testing.assert_allclose(seconds(written, f"{unit} {start} {step}"), since_start, atol=1e-3)
        said = f"{unit} {start} {step}: the times from" in caplog.text and f"are taken for {unit} since" in caplog.text
        assert said == (factor > 1)
    seconds(written, "once")
    seconds(written, "once")
    assert caplog.text.count("once: the times") == (factor > 1)


def test_planar_poses(tmp_path, caplog):
    """Lines of time, x, y and heading in rad, with a line of names, between spaces or commas."""
    rows = np.column_stack([TIME, XY, HEADING])
    for separator in (" ", ","):
        head = separator.join(["time", "x", "y", "theta"]) + "\n"
        (tmp_path / "poses").write_text(lines(*rows.T, separator=separator, head=head))
        found = read_trajectory(tmp_path / "poses")
        np.testing.assert_allclose(found.flat()[:, :2], XY, atol=1e-9)
        same_heading(found.flat()[:, 2], HEADING)
        np.testing.assert_allclose(found.time, TIME)
    assert not caplog.records
    (tmp_path / "degrees").write_text(lines(TIME, XY, np.degrees(HEADING) % 360))
    read_trajectory(tmp_path / "degrees", form="planar")
    assert "are taken for rad: convert them if they are degrees" in caplog.text


@pytest.mark.parametrize("axes", ["robot", "camera"])
def test_roll_and_pitch_are_those_of_the_frame(tmp_path, axes):
    roll, pitch = RNG.uniform(-0.2, 0.2, (2, 60))
    tilted = Rotation.from_euler("ZYX", np.column_stack([HEADING, pitch, roll]))
    (tmp_path / "poses").write_text(tum(tilted if axes == "robot" else tilted * OF_CAMERA))
    poses = read_trajectory(tmp_path / "poses").tilted(axes)
    np.testing.assert_allclose(poses[:, 3:], np.column_stack([roll, pitch]), atol=1e-6)
    level = Trajectory.planar(TIME, np.column_stack([XY, HEADING]), "level")
    assert np.isnan(level.tilted()[:, 3:]).all()


def same_heading(found, expected):
    np.testing.assert_allclose(np.angle(np.exp(1j * (found - expected))), 0, atol=1e-6)


@pytest.mark.parametrize("axes", ["robot", "camera"])
@pytest.mark.parametrize("write", [tum, euroc, kitti])
def test_each_form_gives_the_poses_that_were_written(tmp_path, write, axes):
    file = tmp_path / "poses"
    file.write_text(write(turns(axes)))
    found = read_trajectory(file)
    poses = found.flat(axes)
    np.testing.assert_allclose(poses[:, :2], XY, atol=1e-8)
    same_heading(poses[:, 2], HEADING)
    np.testing.assert_allclose(found.time, np.full(60, np.nan) if write is kitti else TIME, atol=1e-6)


@pytest.mark.parametrize("world", ["z", "-z", "y", "-y", "x", "-x"])
def test_whatever_axis_of_the_world_points_up(world):
    """A robot that turns left and drives ahead does so, seen from above."""
    axis = np.zeros(3)
    axis["xyz".index(world[-1])] = -1 if world[0] == "-" else 1
    to_world = Rotation.align_vectors([axis], [[0, 0, 1.0]])[0]
    position = to_world.apply(np.column_stack([np.cos(HEADING), np.sin(HEADING), np.zeros(60)]))
    poses = Trajectory.of(TIME, position, (to_world * turns()).as_quat(), "poses").flat()
    # It looks away from the centre of a circle, wherever x of the plane lies, and goes around it counter-clockwise.
    same_heading(poses[:, 2], np.arctan2(poses[:, 1], poses[:, 0]))
    same_heading(np.diff(poses[:, 2]), np.diff(HEADING))


@pytest.mark.parametrize("down", [1, 4, 8, 20])
@pytest.mark.parametrize("axes", ["robot", "camera"])
def test_the_world_of_a_first_pose_that_looks_down_is_turned_level(axes, down):
    """As poses by visual odometry: the world's axes are those of the first camera, which looks down ahead."""
    pitched = Rotation.from_euler("ZYX", np.column_stack([HEADING, np.full(60, np.radians(down)), np.zeros(60)]))
    camera = pitched if axes == "robot" else pitched * OF_CAMERA
    xyz = np.column_stack([XY, np.random.default_rng(1).normal(0, 0.005, 60)])
    first = camera[0].inv()
    poses = Trajectory.of(TIME, first.apply(xyz - xyz[0]), (first * camera).as_quat(), "poses")
    if axes == "camera":
        with pytest.raises(DataError, match="those of a camera, not of a robot: give axes=camera"):
            poses.tilted("robot")
    found = poses.tilted(axes)
    off = np.abs(np.degrees(found[:, 3:]) - [0, down]).max()
    assert (1 < off < 2.1) if down == 1 else off < 0.7, "a ground that leans by less than 2 degrees is taken as level"
    turn = np.angle(np.exp(1j * (np.diff(found[:, 2]) - np.diff(HEADING))))
    assert np.abs(turn).max() < np.radians(1)
    apart = np.hypot(*np.diff(found[:, :2], axis=0).T) - np.hypot(*np.diff(XY, axis=0).T)
    assert np.abs(apart).max() < 0.01


def test_a_ground_is_shown_by_many_positions_in_a_plane_on_which_the_frame_stands():
    noise = np.random.default_rng(2).normal(0, 1, (60, 3))
    slope = Rotation.from_euler("Y", -0.2)
    ramp = slope.apply(np.column_stack([XY, 0 * HEADING]))
    line = np.outer(HEADING, slope.apply([1.0, 0, 0])) + [0, 1e-3, 0] * noise

    def tilt(position, rotations):
        found = Trajectory.of(TIME[: len(position)], position, rotations[: len(position)].as_quat(), "poses").tilted()
        return np.abs(np.nan_to_num(found[:, 3:])).max()

    on_it = slope * turns()
    assert tilt(ramp, on_it) < 1e-6
    assert tilt(ramp + 0.3 * noise, on_it) > 0.19, "no plane"
    assert tilt(line, on_it) > 0.19, "a line"
    assert tilt(ramp[:9], on_it) > 0.1, "too few"
    assert tilt(ramp, turns()) < 1e-6, "the frame stays upright in the world, as in a lift or where heights drift"


@pytest.mark.parametrize("sway", [0.0, 0.15])
def test_poses_between_two_entries(sway):
    rotations = turns(sway=sway)
    xyz = np.column_stack([XY, np.zeros(60)])
    given = RNG.permutation(60)  # in any order
    trajectory = Trajectory.of(TIME[given], xyz[given], -rotations[given].as_quat(), "poses")
    times = np.sort(RNG.uniform(TIME[0], TIME[-1], 200))
    found = trajectory.at(times)
    for axis in range(3):
        np.testing.assert_allclose(found.position[:, axis], np.interp(times, TIME, xyz[:, axis]), atol=1e-9)
    apart = (Slerp(TIME, rotations)(times).inv() * Rotation.from_quat(found.quaternion)).magnitude()
    assert apart.max() < 1e-7
    np.testing.assert_array_equal(trajectory.at(TIME).position, xyz)
    outside = trajectory.at(np.array([TIME[0] - 1e-3, TIME[-1] + 1e-3]))
    assert np.isnan(outside.position).all()
    assert np.isnan(outside.flat(whole=trajectory)).all()


def test_the_poses_at_times_of_which_some_are_outside_lie_in_the_plane_of_the_others():
    poses = np.column_stack([XY, HEADING])
    trajectory = Trajectory.planar(TIME, poses, "poses.txt")
    some = trajectory.at(np.append(TIME, TIME[-1] + 1))
    np.testing.assert_allclose(some.flat()[:-1], trajectory.flat(), atol=1e-9)
    assert np.isnan(some.flat()[-1]).all()
    assert np.isnan(some.tilted()[-1]).all()
    with pytest.raises(DataError, match=r"poses\.txt: none of the 1 poses is known"):
        trajectory.at(TIME[-1:] + 1).flat()
    tumbling = Trajectory.of(
        TIME, np.zeros((60, 3)), Rotation.random(60, rng=np.random.default_rng(0)).as_quat(), "poses"
    )
    with pytest.raises(DataError, match="no axis of the world stays upright"):
        tumbling.at(np.append(TIME, TIME[-1] + 1)).flat()


def test_no_pose_inside_of_a_gap():
    trajectory = Trajectory.planar(np.array([0.0, 1, 4, 5]), np.zeros((4, 3)), "poses")
    known = np.isfinite(trajectory.at(np.array([0.5, 1, 2, 4, 4.5]), gap=2.0).position[:, 0])
    assert known.tolist() == [True, True, False, True, True]
    assert np.isfinite(trajectory.at(np.array([2.0]), gap=3.0).position).all()
    one = Trajectory.planar(np.array([7.0]), np.array([[1.0, 2, 3]]), "poses")
    assert one.at(np.array([7.0])).flat().round(9).tolist() == [[1, 2, 3]]


BAD = {
    "is empty": "# nothing\n",
    "in the other order: give order=wxyz": tum(turns(), order=(3, 0, 1, 2)),
    "those of a camera, not of a robot: give axes=camera": tum(turns("camera")),
    "no axis of the world stays upright": tum(Rotation.random(60, rng=np.random.default_rng(0))),
    r"pose 2, .* is not three numbers and a quaternion of length 1, but of length 1\.04": (
        "0 0 0 0 0 0 0 1\n1 0 0 0 0.3 0 0 1\n"
    ),
    r"quaternion, the first: pose 1, 0 0 0 0 0 0 0; nothing remains": "0 0 0 0 0 0 0 0\n",
    r"line 3: expected 8 numbers, got '1 0 0': it is cut short": "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n1 0 0",
    r"line 2: expected 8 numbers, got '1 0 0 x": "0 0 0 0 0 0 0 1\n1 0 0 x 0 0 0 1\n",
    "line 1: expected 3 numbers, got '0,5 1,5'": "0,5 1,5\n1,5 1,5\n",
    "line 2: expected lines of numbers, .*, got '0,5;1,5'": "time;x\n0,5;1,5\n",
    "line 1: expected lines of numbers, 4, 8 or 12 for a trajectory, got 'some notes'": "some notes\nthe robot\n",
    "has 5 numbers on a line, and a trajectory in tum form has 8": "0 1 2 3 4\n",
    "has the columns time, theta, x, y: expected the time, x and y first": "time,theta,x,y\n0,1,2,3\n1,1,2,3\n",
    "has the column 'z' where a trajectory in planar form has the heading: name it theta": "time,x,y,z\n0,1,2,3\n",
    "has the column 'theta_deg': convert it to m or rad": "time,x,y,theta_deg\n0,1,2,3\n1,1,2,3\n",
    "has the column 'yaw_deg': convert it to m or rad": "# a drive\n# time x y yaw_deg\n0 1 2 3\n1 1 2 3\n",
    "has the column 'x_mm': convert it to m or rad": "time x_mm y_mm yaw\n0 1 2 3\n1 1 2 3\n",
    "the matrix of pose 2 is not a rotation": "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 2 0 0 0 0 1 0\n",
    "1 of 1 poses .* are not three finite numbers": "0 0 nan 0 0 0 0 1\n",
    "pose 2, nan 0 0 0 0 0 1, is not three numbers": "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 nan 0 1 0 0 0 0 1 0\n",
}


@pytest.mark.parametrize("says", BAD)
def test_what_is_no_trajectory_is_one_sentence(tmp_path, says):
    file = tmp_path / "poses.txt"
    file.write_text(BAD[says])
    with pytest.raises(DataError, match=says):
        read_trajectory(file).flat()


def test_poses_from_before_a_robot_knows_one_are_left_out(tmp_path, caplog):
    file = tmp_path / "poses.txt"
    file.write_text("0 0 0 0 0 0 0 0\n1 nan nan nan 0 0 0 1\n2 5 0 0 0 0 0 1\n3 6 0 0 0 0 0 1\n")
    found = read_trajectory(file)
    np.testing.assert_array_equal(found.time, [2, 3])
    np.testing.assert_array_equal(found.position[:, 0], [5, 6])
    assert "2 of 4 poses" in caplog.text


@pytest.mark.parametrize("mark", ["", "# ", "\ufeff# "])
@pytest.mark.parametrize("separator", [",", " "])
@pytest.mark.parametrize(("names", "order"), [("qx qy qz qw", [0, 1, 2, 3]), ("q_w q_x q_y q_z", [3, 0, 1, 2])])
def test_the_names_of_the_columns_say_the_order(tmp_path, names, order, separator, mark):
    head = mark + separator.join(f"time x y z {names}".split()) + "\n"
    columns = (TIME, XY, np.full(60, 0.3), turns().as_quat()[:, order])
    (tmp_path / "poses").write_text(lines(*columns, separator=separator, head=head))
    same_heading(read_trajectory(tmp_path / "poses").flat()[:, 2], HEADING)


def test_the_other_order_can_be_given(tmp_path):
    file = tmp_path / "poses.txt"
    file.write_text(tum(turns(), order=(3, 0, 1, 2)))
    same_heading(read_trajectory(file, order="wxyz").flat()[:, 2], HEADING)
    file.write_text(euroc(turns()))
    with pytest.raises(DataError, match="give order=wxyz, or order=xyzw if w stands last"):
        read_trajectory(file, order="xyzw").flat()
    with pytest.raises(DataError, match=r"nowhere\.txt cannot be read: No such file"):
        read_trajectory(tmp_path / "nowhere.txt")
    with pytest.raises(ConfigError, match="form must be tum or kitti or euroc"):
        siamloc.data.read_trajectory(file, "tom")


@pytest.mark.parametrize("names", ["", "# time x y z qx qy qz qw\n"])
def test_quaternions_are_left_as_they_are_if_the_file_names_them_or_the_frame_hardly_turns(tmp_path, names):
    file = tmp_path / "poses"
    looks_down = Rotation.from_euler("Z", HEADING[:, None] / 100) * Rotation.from_quat([0.61, 0.6, -0.33, -0.4])
    file.write_text(lines(TIME, XY, np.full(60, 1.6), looks_down.as_quat(), head=names))
    with pytest.raises(DataError, match=r"^((?!order).)*$" if names else r"are read, unless .* in the other order"):
        read_trajectory(file).flat("camera")
    file.write_text(lines(TIME, XY, np.full(60, 1.6), turns().as_quat()[:, [3, 0, 1, 2]], head=names))
    with pytest.raises(DataError, match=r"^((?!order).)*$" if names else "in the other order"):
        read_trajectory(file).flat()


def test_how_far_a_camera_is_tilted_is_said_where_that_is_too_far():
    looks_down = Rotation.from_euler("ZY", np.column_stack([HEADING, np.full(60, np.radians(30))])) * OF_CAMERA
    poses = Trajectory.of(TIME, np.column_stack([XY, np.ones(60)]), looks_down.as_quat(), "poses")
    with pytest.raises(
        DataError, match=r"axes=camera .* by 30 degrees .*, with axes=robot by 60, and up to 25 are read"
    ):
        poses.flat("camera")
