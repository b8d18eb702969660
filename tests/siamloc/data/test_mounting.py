from __future__ import annotations

import cv2
import numpy as np
import pytest

import siamloc
from analytic import Description, Descriptor, descriptor
from siamloc.data import (
    FrameTable,
    Mounting,
    MountingEstimate,
    PanoramaView,
    PolarRing,
    azimuth_column,
    column_azimuth,
    unwrap,
)
from siamloc.data.drive_pairs import near_pairs, travel
from siamloc.data.mounting import GivenMounting, estimate, usual_rows
from siamloc.data.moves import inverse, relative, wrapped
from siamloc.errors import ConfigError
from tests.drawn import written

WIDTH = 72


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("yaw", [0, 5, 90, -90, 180, 355])
def test_what_is_ahead_comes_to_the_middle(yaw, mirrored):
    ahead = round(float(azimuth_column(-np.radians(yaw + 2.5), WIDTH)))  # 2.5 degrees: half a column
    panorama = np.zeros((3, 4, WIDTH), np.uint8)
    panorama[..., ahead] = 255
    stored = panorama[..., ::-1] if mirrored else panorama
    straight = Mounting(yaw, mirrored).straight(stored)
    assert straight[0, 0].argmax() == WIDTH // 2
    assert straight.shape == panorama.shape
    assert straight.flags.c_contiguous


def test_the_camera_s_offset_turns_with_the_robot():
    found = Mounting(ahead=0.3, left=0.1).offset(np.array([0, np.pi / 2]))
    assert np.allclose(found, [[0.3, 0.1], [-0.1, 0.3]])


def test_wrong_values_are_refused():
    with pytest.raises(ConfigError, match=r"mounting\.yaw must be a number, got 'left'"):
        Mounting.of({"yaw": "left"})


def drive(n: int = 80, turns: bool = True) -> FrameTable:
    """A drive along an eight, or straight on, with steps of about 0.2 m."""
    at = np.linspace(0, 2 * np.pi, n, endpoint=False)
    x, y = (2 * np.sin(at), 1.5 * np.sin(2 * at)) if turns else (0.2 * np.arange(n), np.zeros(n))
    theta = np.arctan2(np.gradient(y), np.gradient(x))
    return FrameTable(path=[f"{row}.png" for row in range(n)], x=x, y=y, theta=theta)


def arc(n: int) -> FrameTable:
    """A drive of n frames along an arc, with steps of 0.3 m."""
    theta = np.linspace(0, 1, n)
    x, y = 0.3 * np.cumsum(np.cos(theta)), 0.3 * np.cumsum(np.sin(theta))
    return FrameTable(path=[f"{row}.png" for row in range(n)], x=x, y=y, theta=theta)


def off_the_centre(frames: FrameTable, ahead: float = 0, left: float = 0) -> FrameTable:
    """Return the poses of a camera that is mounted there."""
    x, y = (frames.xy + Mounting(ahead=ahead, left=left).offset(frames.theta)).T
    return frames.with_columns(x=x, y=y)


def moves_of(frames: FrameTable, queries, known):
    """Return the moves (n, 3) between frames, of which the orientation parts hold the numbers."""
    return relative(np.column_stack([frames.xy, frames.theta]), *(one[:, 0, 0].astype(int) for one in (known, queries)))


def answers(pose, deviation=0.1, match=1):
    """Return what a network says of pairs of images, from the moves (n, 3) between them."""
    return pose, np.tile(np.eye(3) / deviation**2, (len(pose), 1, 1)), np.full(len(pose), match)


def estimated(frames: FrameTable, mounting: Mounting, noise: float = 0.03, says=None, posed=True) -> MountingEstimate:
    """Estimate the mounting from comparisons by a camera that is mounted so; parts hold the numbers of the frames."""
    centred = off_the_centre(frames, mounting.ahead, mounting.left)
    camera = centred.with_columns(theta=frames.theta + np.radians(mounting.yaw))
    rng = np.random.default_rng(0)

    def compares(queries, known):
        pose = moves_of(camera, queries, known) * ([1, -1, -1] if mounting.mirrored else [1, 1, 1])
        return answers(pose + rng.normal(0, noise, pose.shape), noise)

    parts = np.arange(len(frames), dtype=np.float32)[:, None, None]
    return estimate(frames, parts, says or compares, posed)


@pytest.mark.parametrize(
    "mounting",
    [*map(Mounting, (0, 30)), Mounting(-120, True), Mounting(180, False, 0.3, -0.1), Mounting(30, False, 0.6, -0.3)],
)
def test_a_mounting_is_found_from_noisy_comparisons(mounting):
    found = estimated(drive(), mounting)
    apart = np.degrees(wrapped(np.radians(found.yaw - mounting.yaw)))
    assert abs(apart) < min(1, 4 * found.yaw_deviation), found
    assert found.mirrored is mounting.mirrored
    assert np.allclose(found.offset, (mounting.ahead, mounting.left), atol=0.02)
    assert found.reasons == ()


def test_deviations_are_as_large_as_the_errors():
    off = [estimated(drive(60 + n), Mounting(40), noise=0.1) for n in range(30)]
    share = np.mean([abs(one.yaw - 40) < 2 * one.yaw_deviation for one in off])
    assert share > 0.8, "95 % of normal errors, fewer because deviations are themselves estimated"


def test_what_does_not_matter_is_left_as_it_is():
    assert estimated(drive(), Mounting(1, ahead=0.01)).mounting == Mounting()
    assert estimated(drive(), Mounting(30)).mounting.yaw == pytest.approx(30, abs=1)


def test_a_drive_that_never_turns_tells_only_the_yaw():
    found = estimated(drive(turns=False), Mounting(30, ahead=0.3))
    assert abs(found.yaw - 30) < 1
    assert found.mirrored is None
    assert np.isnan(found.offset).all()
    assert (
        "the drive hardly turns: whether panoramas are mirrored, and the camera's offset, are unknown" in found.reasons
    )
    assert found.mounting.mirrored is False


@pytest.mark.parametrize(("mirrored", "yaw"), [(False, 30), (True, -30)])
def test_a_robot_that_drives_ahead_tells_the_yaw_without_poses(mirrored, yaw):
    """In panoramas that are mirrored, and not known to be, what is to the left of the middle is to its right."""
    found = estimated(drive(), Mounting(30, mirrored), posed=False)
    assert abs(found.yaw - yaw) < 2, "steps are chords, up to some degrees off the headings at their ends"
    assert found.mirrored is None
    assert "unknown without poses" in found.summary()
    assert found.ring(PolarRing(mirrored=True)).forward == pytest.approx(-yaw % 360, abs=2)


def test_a_robot_that_drives_in_all_directions_tells_no_yaw_without_poses():
    rng = np.random.default_rng(0)

    found = estimated(drive(), Mounting(), says=lambda one, _: answers(rng.normal(0, 0.3, (len(one), 3))), posed=False)
    assert np.isnan(found.yaw)
    assert found.reasons == ("how the camera moves in the images is not ahead, in one direction",)


def test_the_direction_of_travel_stands_in_for_headings():
    frames = drive()
    assert np.allclose(wrapped(travel(frames) - frames.theta)[1:-1], 0)
    some = travel(frames.with_columns(x=np.where(np.arange(len(frames)) < 5, np.nan, frames.x)))
    assert np.isnan(some[:5]).all()
    assert np.isfinite(some[5:]).all()


@pytest.mark.parametrize("used", [PolarRing(forward=90, mirrored=True), PolarRing(forward=90, mirrored=False)])
@pytest.mark.parametrize("front", [PolarRing(forward=120, mirrored=True), PolarRing(forward=20, mirrored=False)])
def test_a_ring_is_turned_to_the_front(used, front):
    """The middle of a panorama that `used` makes, and its right, are where they are in the picture."""
    mirrored = used.mirrored != front.mirrored
    picture = np.zeros((201, 201), np.uint8)
    angle = np.radians(front.forward)
    cv2.circle(picture, (round(100 + 70 * np.sin(angle)), round(100 - 70 * np.cos(angle))), 6, 255, -1)
    at = unwrap(picture, used, PanoramaView(16, 360)).astype(float).sum(axis=0).argmax()
    left = np.degrees(column_azimuth(360)[at])  # of the front, in the panorama as it is
    found = MountingEstimate(left if mirrored else -left, 0.1, mirrored)
    assert found.ring(used).forward == pytest.approx(front.forward, abs=6), "half the width of the spot"
    assert found.ring(used).mirrored is front.mirrored
    assert MountingEstimate().ring(used) == used


def test_turns_that_agree_only_in_part_tell_nothing():
    def half(queries, known):
        sign = np.where(known[:, 0, 0] // 10 % 2, 1, -1)
        return answers(moves_of(drive(), queries, known) * np.column_stack([np.ones(len(sign)), sign, sign]), 1.0)

    found = estimated(drive(), Mounting(), says=half)
    assert found.mirrored is None
    assert np.isnan(found.yaw)


def test_a_network_that_always_says_the_same_does_not_pass_for_a_yaw():
    always = np.array([0.2, 0.2, 0])
    found = estimated(drive(turns=False), Mounting(), says=lambda one, _: answers(np.tile(always, (len(one), 1))))
    assert np.isnan(found.yaw)
    assert found.mounting == Mounting()
    assert found.reasons[0].startswith("how the camera moves in the images does not follow from the poses")


def says_more_to_the_left(share):
    """Return a comparison of a network that takes some of each move for one to the left, whichever way it goes."""

    def says(queries, known):
        pose = moves_of(drive(), queries, known)
        pose[:, 1] += share * np.hypot(pose[:, 0], pose[:, 1])
        return answers(pose, 0.03)

    return says


def test_a_yaw_on_which_moves_onwards_and_back_disagree_is_unknown():
    found = estimated(drive(), Mounting(), says=says_more_to_the_left(0.2))
    assert np.isnan(found.yaw)
    assert found.mirrored is False, "turns still say which way the columns run"
    ring = PolarRing(forward=33.33, mirrored=True)
    assert found.ring(ring) == ring
    assert np.isfinite(estimated(drive(), Mounting(), says=says_more_to_the_left(0.02)).yaw)


def test_a_yaw_that_leaves_much_of_the_moves_unexplained_is_unknown():
    assert np.isfinite(estimated(drive(), Mounting(30), noise=0.1).yaw)
    assert np.isnan(estimated(drive(), Mounting(30), noise=0.6).yaw)


@pytest.mark.parametrize("count", [6, 12, 24])
def test_one_arc_and_few_frames_tell_the_yaw_but_no_offset(count):
    """Along one arc, an offset as large as its radius would explain all moves, whatever the images show."""
    found = estimated(arc(count), Mounting(30, ahead=0.3))
    assert abs(found.yaw - 30) < 15, "the offset turns the moves of the camera by up to half of the arc"
    assert np.isnan(found.offset).all()
    assert abs(estimated(arc(count), Mounting(30)).yaw - 30) < 3


def weave(n: int = 80) -> FrameTable:
    """A drive that turns by 30 degrees in all, to and fro, as along a corridor, with steps of 0.3 m."""
    theta = np.radians(15) * np.sin(np.linspace(0, 8 * np.pi, n))
    x, y = 0.3 * np.cumsum(np.cos(theta)), 0.3 * np.cumsum(np.sin(theta))
    return FrameTable(path=[f"{row}.png" for row in range(n)], x=x, y=y, theta=theta)


@pytest.mark.parametrize("ahead", [0, -0.3])
def test_an_offset_that_comparisons_along_a_corridor_pass_for_is_unknown(ahead):
    """All moves are seen 5 % of their length to the side of the turn, as if the camera were 0.24 m further ahead."""

    def says(queries, known):
        pose = moves_of(off_the_centre(weave(), ahead), queries, known)
        pose[:, 1] += 0.05 * np.hypot(pose[:, 0], pose[:, 1]) * np.sign(pose[:, 2])
        return answers(pose, 0.02)

    found = estimated(weave(), Mounting(), says=says)
    assert found.mounting == Mounting()
    assert np.isnan(found.offset).all()
    assert np.isnan(found.offset_deviation).all()
    assert "the camera's offset is unknown" in found.summary()


def test_an_offset_is_known_from_its_own_direction_however_unsure_the_other_one_is():
    rng = np.random.default_rng(0)

    def says(queries, known):
        ahead, left = (moves_of(off_the_centre(drive(), 0.5, left), queries, known) for left in (0, 1))
        return answers(ahead + rng.normal(0, 1, (len(ahead), 1)) * (left - ahead), 0.02)

    found = estimated(drive(), Mounting(), says=says)
    assert found.offset_deviation[1] > 0.1 > found.offset_deviation[0]
    assert found.mounting.ahead == pytest.approx(0.4, abs=0.15)


def test_the_rows_of_a_ring_come_to_the_elevations_of_a_usual_mirror():
    view = PanoramaView(64, 8)
    outer, inner = np.tan(np.radians([25, -50]))
    shown = outer + (np.arange(64) + 0.5) / 64 * (inner - outer)  # tangents of the elevations in the ring's rows
    ring = np.broadcast_to((shown[:, None] + 1.25) * 100, (2, 3, 64, 8)).round().astype(np.uint8)
    rows = usual_rows(ring, view)
    wanted = np.tan(view.row_elevation()).clip(inner, outer)
    assert rows.shape == ring.shape
    np.testing.assert_allclose(rows[1, 2, :, 4] / 100 - 1.25, wanted, atol=0.02, err_msg="half a row and rounding")


def test_wrong_headings_do_not_pass_for_a_yaw():
    frames = drive()
    found = estimated(frames.with_columns(theta=np.zeros(len(frames))), Mounting())
    assert found.mounting == Mounting()


def test_pictures_that_cannot_be_compared_say_so():
    nowhere = estimated(drive(), Mounting(), says=lambda one, _: answers(np.zeros((len(one), 3)), match=-1))
    assert nowhere.reasons[0].startswith("only 0 pairs of successive images")
    unposed = FrameTable(path=["1.png", "2.png"])
    assert estimated(unposed, Mounting()).reasons == ("no successive frames with headings are near each other",)


def test_positions_in_another_unit_tell_the_yaw_too():
    frames = drive()
    found = estimated(frames.with_columns(x=frames.x * 1.1, y=frames.y * 1.1), Mounting(30))
    assert abs(found.yaw - 30) < 1


def test_a_summary_names_what_is_known():
    found = estimated(drive(), Mounting(30, True, ahead=0.3))
    assert found.summary().startswith(("it looks 30.", "it looks 29."))
    assert "its panoramas are mirrored; it is 0.3" in found.summary()


def test_only_networks_that_compare_are_taken():
    images = siamloc.data.example()
    with pytest.raises(ConfigError, match="hog does not compare images: take the network that ships with siamloc"):
        siamloc.data.find_mounting(descriptor("hog"), images, images.frames)


class Numbered(Descriptor):
    """A network that compares pictures by their numbers, which are their grey values."""

    name, compares = "numbered", True

    def __init__(self, frames: FrameTable) -> None:
        self.frames = frames

    @property
    def identity(self):
        return {"name": self.name}

    def describe(self, batch):
        numbers = batch[:, 0, :1, :1].astype(np.float32)
        return Description(numbers[:, 0], numbers, self.identity)

    def compare(self, queries, known):
        return answers(moves_of(self.frames, queries, known), 0.03)


def test_poses_of_the_map_as_seen_from_the_robot_are_recognized(tmp_path):
    frames = drive().with_columns(path=written(tmp_path, [np.full((8, 32, 3), n, np.uint8) for n in range(80)]))
    images = siamloc.data.PanoramaLibrary(frames, tmp_path / "cache", image_size=(8, 32))
    assert siamloc.data.find_mounting(Numbered(frames), images, frames).reasons == ()
    x, y, theta = inverse(np.column_stack([frames.xy, frames.theta])).T
    found = siamloc.data.find_mounting(Numbered(frames), images, frames.with_columns(x=x, y=y, theta=theta))
    assert "exchange the two frames, such as map:base_link for base_link:map" in found.summary()
    assert not found.mirrored
    wrong = frames.with_columns(theta=np.random.default_rng(0).uniform(-3, 3, len(frames)))
    assert "does not follow from the poses" in siamloc.data.find_mounting(Numbered(frames), images, wrong).summary()


@pytest.mark.parametrize("count", [180, 200, 400, 800])
def test_all_reaches_are_compared_however_long_the_drive(count):
    frames = FrameTable(path=[f"{n}.png" for n in range(count)], x=0.1 * np.arange(count), y=np.zeros(count))
    first, second = near_pairs(frames.with_columns(theta=np.zeros(count)))
    apart = np.abs(second - first)
    shares = [((least <= apart) & (apart <= most)).mean() for least, most in ((1, 1), (4, 5), (8, 9), (16, 17))]
    assert min(shares) > 0.1
    assert sum(shares) == pytest.approx(1)


def test_a_robot_that_stands_still_has_no_direction_of_travel():
    frames = FrameTable(path=[f"{n}.png" for n in range(6)], x=[0.0, 0, 0, 0, -1, -2], y=np.zeros(6))
    assert np.isnan(travel(frames)[:3]).all()
    np.testing.assert_allclose(np.abs(travel(frames)[3:]), np.pi)


def test_a_few_images_next_to_each_other_do_not_pass_for_a_drive():
    few = drive().with_columns(theta=np.where(np.arange(80) < 75, np.nan, drive().theta))
    found = estimated(few, Mounting(yaw=30))
    assert np.isnan(found.yaw)
    assert found.reasons


def test_a_yaw_counts_if_it_is_many_deviations_off_even_if_they_are_large():
    assert MountingEstimate(-110.3, 2.1, None, pairs=400).mounting == Mounting(-110.3)
    assert MountingEstimate(9.0, 3.2, None, pairs=400).mounting == Mounting()


def test_mirrored_panoramas_are_flipped_even_if_the_yaw_is_unknown():
    assert MountingEstimate(mirrored=True, pairs=20).mounting == Mounting(mirrored=True)
    assert MountingEstimate(pairs=20).mounting == Mounting()
    assert GivenMounting(yaw=270).known == GivenMounting(yaw=-90).known == Mounting(-90)
