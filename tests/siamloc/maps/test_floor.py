"""Lengths by the floor, of panoramas that show a drawn floor through a projection of the test's own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import siamloc
from siamloc.data import (
    EquirectangularCamera,
    FisheyeCamera,
    FrameTable,
    PanoramaLibrary,
    PanoramaView,
    PolarRing,
)
from siamloc.data.moves import relative
from siamloc.data.ring import likely_mirror
from siamloc.errors import ConfigError
from siamloc.maps import SurveySettings, survey
from siamloc.maps.floor import Floor, elevations_known, floor_scale, lengthening, shows_floor
from siamloc.maps.pose_graph import Edges
from siamloc.maps.surveying import _told_by_floor

VIEW = PanoramaView(height=64, width=256)
HEIGHT = 0.7
STREAKS = np.uint8(90 + 60 * np.cos(np.arange(256) * 2 * np.pi / 16))  # away from the robot, in all rows
WAVES = np.random.default_rng(3).normal(0, 6, (60, 2)), np.random.default_rng(4).uniform(0, 6, 60)


def pattern(x, y) -> np.ndarray:
    """A floor with a pattern of waves 0.5 m long and longer, from 0 to 1."""
    waves, phases = WAVES
    return 0.5 + 0.05 * np.cos(np.multiply.outer(x, waves[:, 0]) + np.multiply.outer(y, waves[:, 1]) + phases).sum(-1)


def panorama(pose, contrast=200.0, pitch=0.0) -> np.ndarray:
    """What a camera sees at x, y, theta (3, 64, 256): posts before a wall above the horizon, the floor below.

    One that is pitched looks down ahead.
    """
    x, y, theta = pose
    slope = (np.tan(np.radians(30)) - (np.arange(64) + 0.5) / 64 * (np.tan(np.radians(30)) + 1))[:, None]
    azimuth = np.pi - (np.arange(256) + 0.5) * 2 * np.pi / 256
    ahead, left = np.cos(azimuth), np.broadcast_to(np.sin(azimuth), (64, 256))
    ahead, up = ahead * np.cos(pitch) + slope * np.sin(pitch), slope * np.cos(pitch) - ahead * np.sin(pitch)
    image = 90 + 50 * np.tanh(9 * np.cos(20 * np.arctan2(left, ahead)))
    floor = up < 0
    reach = HEIGHT / -up[floor] * np.exp(1j * theta) * (ahead[floor] + 1j * left[floor])
    image[floor] = 20 + contrast * pattern(x + reach.real, y + reach.imag)
    return np.repeat(image.clip(0, 255).astype(np.uint8)[None], 3, axis=0)


@pytest.fixture(scope="module")
def drive():
    """Poses of a drive along a bend, its panoramas, and its true steps to the next frame and the one after it."""
    t = np.linspace(0, 1, 40)
    x, y = 9 * np.sin(1.3 * t), 5 * (1 - np.cos(1.3 * t))
    poses = np.column_stack([x, y, np.arctan2(np.gradient(y), np.gradient(x))])
    first = np.concatenate([np.arange(39), np.arange(38)])
    second = np.concatenate([np.arange(1, 40), np.arange(2, 40)])
    steps = Edges(first, second, relative(poses, first, second), np.tile(np.eye(3), (len(first), 1, 1)))
    return poses, np.stack([panorama(pose) for pose in poses]), steps


@pytest.fixture(scope="module")
def plain(drive):
    """The floor of that drive, and its scale."""
    _, panoramas, steps = drive
    floor = Floor.seen([panoramas], VIEW)
    return floor, floor_scale(floor, steps, np.arange(40) * 0.27, HEIGHT)[0]


def scaled(panoramas, steps, height=HEIGHT):
    """The scale of a drive, and its steps as the floor tells."""
    return floor_scale(Floor.seen([panoramas], VIEW), steps, np.arange(40) * 0.27, height)


def shortened(steps, by) -> Edges:
    """The steps as a comparison sees them whose lengths are wrong by a factor at each frame."""
    factor = np.sqrt(by[steps.first] * by[steps.second])[:, None]
    return replace(steps, pose=steps.pose / np.hstack([factor, factor, np.ones_like(factor)]))


def test_the_floor_tells_where_lengths_are_wrong(drive):
    poses, panoramas, steps = drive
    wrong = np.linspace(0.8, 1.2, 40)
    way = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    floor = Floor.seen([panoramas[:25], panoramas[25:]], VIEW)
    found, longer = floor_scale(floor, shortened(steps, wrong), way, HEIGHT)
    assert found.given
    np.testing.assert_allclose(found.factors[10:-10], wrong[10:-10], rtol=0.06)  # blurred over metres
    np.testing.assert_allclose(found.factors, wrong, rtol=0.12)  # at either end, only what lies on one side counts
    assert len(longer) == len(steps)
    np.testing.assert_allclose(longer.pose, steps.pose, atol=0.03)  # a tenth of a step
    length = np.hypot(*longer.pose[:, :2].T)
    along = longer.pose[:, :2] / length[:, None]
    certain = np.einsum("ei,eij,ej->e", along, longer.information[:, :2, :2], along)
    assert (certain > 1 / (0.1 * length) ** 2).all()  # a clear pattern


def test_the_robot_itself_does_not_stand_still_on_the_floor(drive):
    _, panoramas, steps = drive
    bodied = panoramas.copy()
    bodied[..., -16:, :] = np.random.default_rng(1).integers(0, 255, (16, 256))
    found, _ = scaled(bodied, steps)
    np.testing.assert_allclose(found.factors, 1, atol=0.06)


def test_walls_beside_the_lane_do_not_count(drive):
    _, panoramas, steps = drive
    walled, sides = panoramas.copy(), [*range(40, 88), *range(168, 216)]  # within 34 degrees of either side
    walled[..., sides] = np.random.default_rng(1).integers(0, 255, (64, len(sides)))
    found, _ = scaled(walled, steps)
    np.testing.assert_allclose(found.factors, 1, atol=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("pitch", [-3, 2])
def test_a_pitched_camera_tells_the_same_lengths(drive, pitch):
    poses, _, steps = drive
    pitched = np.stack([panorama(pose, pitch=np.radians(pitch)) for pose in poses])
    found, _ = scaled(pitched, steps)
    floor = Floor.seen([pitched], VIEW)
    assert np.degrees(floor.pitch) == pytest.approx(pitch, abs=0.5)  # of small panoramas
    np.testing.assert_allclose(found.factors, 1, atol=0.05)
    notes: list[str] = []
    assert _told_by_floor(floor, True, steps, steps.pose[:39], HEIGHT, notes, False) is not None
    assert f"the camera looks about {abs(pitch)} degrees {'down' if pitch > 0 else 'up'} ahead" in notes[0]
    pitched[..., :64] = pitched[..., 192:] = 40  # edges ahead alone show a pitch less well
    found, _ = scaled(pitched, steps)
    np.testing.assert_allclose(found.factors, 1, atol=0.15)  # 9 and 28 % off if taken to be level


def test_what_fills_unseen_pixels_tells_no_pitch(drive):
    hidden = np.stack([panorama(pose, pitch=np.radians(3)) for pose in drive[0][:8]])
    sees = np.ones((64, 256), dtype=bool)
    sees[:, :64] = sees[:, 192:] = False  # behind
    hidden[..., ~sees] = np.tile(STREAKS, (64, 1))[~sees]
    assert np.degrees(Floor.seen([hidden], VIEW, sees).pitch) == pytest.approx(3, abs=0.5)
    assert np.degrees(Floor.seen([hidden], VIEW).pitch) < 2.5


@pytest.mark.parametrize("wrong", [0.5, 2.5])
def test_a_height_that_cannot_be_true_is_not_used(drive, wrong):
    _, panoramas, steps = drive
    assert scaled(panoramas, steps, wrong * HEIGHT) is None


def test_single_steps_are_right_where_comparisons_differ_from_pair_to_pair(drive):
    _, panoramas, steps = drive
    off = np.exp(np.random.default_rng(2).normal(0, 0.12, len(steps)))[:, None]
    wrong = replace(steps, pose=steps.pose * np.hstack([off, off, np.ones_like(off)]))
    _, longer = scaled(panoramas, wrong)
    before, after = (np.log(np.hypot(*one.pose[:, :2].T) / np.hypot(*steps.pose[:, :2].T)) for one in (wrong, longer))
    assert np.abs(after).mean() < np.abs(before).mean() / 2


def test_steps_too_long_for_the_floor_are_left_out(drive):
    _, panoramas, steps = drive
    far = Edges(np.zeros(1, int), np.array([30]), np.array([[6.0, 2.0, 0.5]]), np.eye(3)[None])
    _, longer = scaled(panoramas, Edges.concatenate([steps, far]))
    assert len(longer) == len(steps)


def test_larger_panoramas_say_the_same(drive):
    _, panoramas, steps = drive
    large = panoramas.repeat(2, axis=2).repeat(2, axis=3)
    floor = Floor.seen([large], replace(VIEW, height=128, width=512))
    found, _ = floor_scale(floor, steps, np.arange(40) * 0.27, HEIGHT)
    np.testing.assert_allclose(found.factors, 1, atol=0.05)


def test_an_unknown_height_is_the_one_that_fits(drive):
    _, panoramas, steps = drive
    found, _ = scaled(panoramas, shortened(steps, np.full(40, 0.9)), None)
    assert not found.given
    assert found.height == pytest.approx(HEIGHT / 0.9, rel=0.06)
    np.testing.assert_allclose(found.factors, found.height / (HEIGHT / 0.9) * np.ones(40), rtol=0.15)


def test_a_floor_without_a_pattern_tells_nothing(drive):
    poses, _, steps = drive
    noise = np.random.default_rng(0).normal(0, 2, (40, 3, 64, 256))
    plain = np.clip(np.stack([panorama(pose, 0.0) for pose in poses]) + noise, 0, 255).astype(np.uint8)
    assert scaled(plain, steps) is None


def test_lengthened_displacements_are_as_certain_in_proportion(drive, plain):
    steps, (floor, found) = drive[2], plain
    found = replace(found, factors=np.full(40, 2.0))
    longer = found.lengthened(steps)
    np.testing.assert_allclose(longer.pose, steps.pose * [2, 2, 1])
    np.testing.assert_allclose(longer.information[0], np.diag([0.25, 0.25, 1]))
    unlike = np.zeros(len(steps))
    compared, odds = lengthening(lambda *_: (steps, unlike), found, floor)(steps.first, steps.second)
    np.testing.assert_allclose(compared.pose, longer.pose)
    np.testing.assert_allclose(compared.information, longer.information)
    assert odds is unlike


def test_the_floor_tells_how_far_apart_images_are_that_were_taken_nearby(drive, plain):
    poses, (floor, found) = drive[0], plain
    first, second = np.arange(36), np.arange(4, 40)
    true = relative(poses, first, second)
    off = np.exp(np.random.default_rng(2).normal(0, 0.12, 36))[:, None]
    wrong = Edges(first, second, true * np.hstack([off, off, np.ones_like(off)]), np.tile(np.eye(3), (36, 1, 1)))
    found = replace(found, factors=np.ones(40))
    longer, _ = lengthening(lambda *_: (wrong, np.full(36, 9.0)), found, floor)(first, second)
    before, after = (np.log(np.hypot(*one.pose[:, :2].T) / np.hypot(*true[:, :2].T)) for one in (wrong, longer))
    assert np.abs(after).mean() < np.abs(before).mean() / 2
    assert np.median(np.linalg.det(longer.information)) > 100  # which was 1


def grey_frames(folder) -> FrameTable:
    """Write 12 grey pictures of 32 x 32 px, and return their frames."""
    for number in range(12):
        cv2.imwrite(str(folder / f"{number}.png"), np.full((32, 32, 3), number, np.uint8))
    return FrameTable(path=[str(folder / f"{number}.png") for number in range(12)])


@pytest.mark.parametrize(
    "options",
    [
        {"elevations": (30.0, -10.0)},
        {"unwrap": PolarRing(inner=4, outer=15)},
        {"unwrap": FisheyeCamera(fov=200, elevation=90)},
        {"unwrap": EquirectangularCamera(highest=20, lowest=-20)},
    ],
)
def test_a_height_needs_a_floor_at_known_elevations(tmp_path, options):
    frames = grey_frames(tmp_path)
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=(64, 256), **options)
    with pytest.raises(ConfigError, match=r"survey\.height needs panoramas that show the floor at known elevations"):
        survey("pretrained", images, frames, settings=SurveySettings(height=1.0), progress=False)
    assert not shows_floor(images, None)
    for good in ({"elevations": (30, -30)}, {"unwrap": FisheyeCamera(fov=200, elevation=-90)}):
        assert shows_floor(PanoramaLibrary(frames, tmp_path / "cache", image_size=(64, 256), **good), 1.0)


def test_a_camera_whose_pictures_have_an_unknown_size_is_not_known_to_see_the_floor(tmp_path):
    frames = grey_frames(tmp_path)
    upward = FisheyeCamera(fov=200, elevation=90)
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=(64, 256), unwrap=upward)
    Path(frames.path[0]).unlink()
    assert not shows_floor(images, None)


def test_no_height_gives_metres_below_a_mirror_that_is_presumed_in_a_ring(tmp_path):
    frames, mirror = grey_frames(tmp_path), likely_mirror(PolarRing(centre=(15.5, 15.5), inner=3, outer=15))
    presumed, known = (
        PanoramaLibrary(frames, tmp_path / "cache", image_size=(64, 256), unwrap=camera)
        for camera in (mirror, replace(mirror, presumed=False))
    )
    assert shows_floor(known, 1.0)
    assert shows_floor(presumed, None)
    with pytest.raises(ConfigError, match=r"survey\.height needs .* a ring of two radii does not say what it sees"):
        shows_floor(presumed, 1.0)


def test_elevations_of_panoramas_are_assumed_unless_siamloc_simulated_them(tmp_path):
    siamloc.simulate.simulate(out=tmp_path, building="mini", camera="panorama", runs=["cloudy1"], frames=2)
    simulated = siamloc.data.read("cold", root=tmp_path / "mini")
    (tmp_path / "copied").mkdir()
    (tmp_path / "copied" / "1.jpeg").hardlink_to(simulated.path[0])
    copied = FrameTable(path=[tmp_path / "copied" / "1.jpeg"])
    for frames, camera, known in (
        (simulated, None, True),
        (copied, None, False),
        (copied, EquirectangularCamera(highest=30, lowest=-45), True),
    ):
        images = PanoramaLibrary(frames, tmp_path / "cache", image_size=(64, 256), unwrap=camera)
        assert elevations_known(images) == known
        assert shows_floor(images, 1.0), "a height that the user gives is used"


@pytest.mark.parametrize("known", [True, False])
def test_a_height_is_asked_for_only_where_it_gives_metres(drive, known):
    _, panoramas, steps = drive
    notes: list[str] = []
    floor, _ = _told_by_floor(Floor.seen([panoramas], VIEW), known, steps, np.full((39, 3), 0.27), None, notes, False)
    assert [note.partition(" is right if the camera is ")[0] for note in notes] == ["the scale"] * known
    assert floor.height == pytest.approx(HEIGHT, rel=0.06)


@pytest.mark.parametrize(("shiny", "height"), [(slice(12, 28), HEIGHT), (slice(8, 30), None), (slice(20), None)])
def test_what_moves_along_with_the_robot_for_a_while_tells_nothing(drive, shiny, height):
    _, panoramas, steps = drive
    streaked = panoramas.copy()
    streaked[shiny, :, 32:] = STREAKS
    found, longer = scaled(streaked, steps, height)
    assert found.height == pytest.approx(HEIGHT, rel=0.06)
    np.testing.assert_allclose(found.factors, HEIGHT / found.height, atol=0.06)
    np.testing.assert_allclose(longer.pose[:, :2], steps.pose[:, :2] * found.factors[0], atol=0.03)


def test_a_floor_that_moves_along_all_the_time_is_not_used(drive):
    _, panoramas, steps = drive
    streaked = panoramas.copy()
    streaked[:, :, 32:] = STREAKS
    streaked[::2, :, 32:] += 5  # or it would be taken for the robot itself
    assert scaled(streaked, steps) is None
