"""Poses of drives whose frames have none, with a comparison that knows the truth up to noise."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest

from analytic import Description
from analytic.descriptors.thumbnail import Thumbnail
from siamloc.data import FrameTable, PanoramaLibrary, concatenate
from siamloc.data.decoding import Preprocessing
from siamloc.data.mounting import Mounting
from siamloc.data.moves import chained, composed, relative, wrapped
from siamloc.errors import ConfigError, DataError
from siamloc.maps import LiveSurvey, SurveySettings, VisualMap, survey
from siamloc.maps.floor import Floor, FloorScale
from siamloc.maps.survey_steps import _slipping


class Panoramas(PanoramaLibrary):
    """Panoramas that are never opened, since they do not show the floor."""

    circular = True
    preprocessing = Preprocessing.checked((64, 256), elevations=(30.0, -5.0))
    cameras: ClassVar = {}


class TrueComparison(Thumbnail):
    """Compares frames by their true poses; the number of a frame is in its orientation part."""

    compares = tells_heading = True

    def __init__(self, poses, scale, noise, seed=0, mirrored=False):
        super().__init__()
        self.poses, self.scale, self.noise, self.mirrored = poses, scale, noise, mirrored
        self.rng = np.random.default_rng(seed)

    def describe(self, batch):
        """A panorama whose first pixel is the number of the frame."""
        rows = batch[:, 0, 0, 0].astype(int)
        return Description(places_of(self.poses)[rows], numbered(rows))

    def compare(self, queries, known):
        second, first = (np.rint(one[:, 0, 0] / one[:, 1, 0]).astype(int) - 2 for one in (queries, known))
        pose = relative(self.poses, first, second)
        apart = np.hypot(pose[:, 0], pose[:, 1])
        pose[:, :2] *= self.scale
        pose += self.rng.normal(size=pose.shape) * [self.noise, self.noise, self.noise / 2]
        if self.mirrored:
            pose *= [1, -1, -1]
        sure = 1 / max(self.noise, 0.01) ** 2
        information = np.tile(np.diag([sure, sure, 4 * sure]), (len(pose), 1, 1))
        return pose, information, np.where(apart < 2.5, 5.0, -5.0)


def numbered(rows) -> np.ndarray:
    """Orientation parts that hold the numbers of frames."""
    parts = np.ones((len(rows), 8, 2), dtype=np.float16)
    parts[:, 0, 0] = 2 + np.array(rows)
    return parts


def places_of(poses) -> np.ndarray:
    """Descriptors that are positions."""
    return np.column_stack([poses[:, :2], np.zeros(len(poses))])


def eights(rounds=3, per_round=30, turned=0.0) -> np.ndarray:
    """A robot that drives figures of eight, 6 m long, and a little differently each time."""
    t = 2 * np.pi * np.arange(rounds * per_round) / per_round
    xy = np.column_stack([3 * np.sin(t), 1.5 * np.sin(2 * t)]) + 0.1 * np.sin(0.37 * np.arange(len(t)))[:, None]
    ahead = np.gradient(xy, axis=0)
    pose = np.column_stack([xy, np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))])
    return composed(np.tile([1.0, 2.0, turned], (len(pose), 1)), pose)


def drifting(poses, scale=1.02, degrees=0.5, seed=0) -> np.ndarray:
    steps = relative(poses, np.arange(len(poses) - 1), np.arange(1, len(poses)))
    way = np.hypot(steps[:, 0], steps[:, 1])
    rng = np.random.default_rng(seed)
    steps[:, :2] *= scale + 0.01 * rng.normal(size=(len(steps), 1))
    steps[:, 2] += np.radians(degrees) * way + np.radians(0.3) * np.sqrt(way) * rng.normal(size=len(steps))
    return chained(np.concatenate([np.zeros((1, 3)), steps]))


@pytest.fixture
def surveyed(monkeypatch):
    """Return a function that surveys drives with these true poses (by name)."""

    def run(drives, *, scale=1.0, noise=0.02, odometry=True, mirrored=False, seed=0, made=None, joined=True, **options):
        time = options.pop("time", None)
        tables = [
            FrameTable(path=[f"{name}/{n}.png" for n in range(len(poses))], sequence=[name] * len(poses), time=time)
            for name, poses in drives.items()
        ]
        table = concatenate(tables)
        true = np.concatenate(list(drives.values()))

        def built(network, images, frames, progress):
            rows = [table.identities().index(key) for key in frames.identities()]
            of = {"orientation": numbered(rows), "heading": {"name": "network"}, "made": made or {}}
            known = VisualMap(places_of(true)[rows], frames, **of)
            return replace(known, describes=network)

        monkeypatch.setattr(sys.modules["siamloc.maps.surveying"], "build", built)
        wheels = None
        if isinstance(odometry, np.ndarray):
            wheels = odometry
        elif odometry:
            wheels = np.concatenate([drifting(poses, seed=n) for n, poses in enumerate(drives.values())])
        images = object.__new__(Panoramas)
        found = survey(
            TrueComparison(true, scale, noise, seed, mirrored),
            images,
            table if joined else tables,
            odometry=wheels,
            progress=False,
            **options,
        )
        return found, true, table

    return run


def anchors_at(poses, rows, drive="monday") -> FrameTable:
    """Frames of a drive with their true poses."""
    x, y, theta = poses[rows].T
    return FrameTable(path=[f"{drive}/{row}.png" for row in rows], sequence=[drive] * len(rows), x=x, y=y, theta=theta)


def off(found, true, scaled=False) -> float:
    """Return the mean distance in m after the best rigid motion."""
    given, wanted = (xy - xy.mean(axis=0) for xy in (found.frames.xy, true[:, :2]))
    cross = given.T @ wanted
    angle = np.arctan2(cross[0, 1] - cross[1, 0], cross[0, 0] + cross[1, 1])
    cosine, sine = np.cos(angle), np.sin(angle)
    moved = given @ np.array([[cosine, sine], [-sine, cosine]])
    if scaled:
        moved *= (moved * wanted).sum() / (moved**2).sum()
    return float(np.hypot(*(moved - wanted).T).mean())


def test_odometry_that_drifts_more_is_believed_less(surveyed):
    drives = {"monday": eights()}
    found, _, _ = surveyed(drives)
    loose, _, _ = surveyed(drives, settings=SurveySettings(drift=5.0))
    assert (loose.graph.wheels.information[:, 2, 2] < found.graph.wheels.information[:, 2, 2] / 50).all()
    assert (loose.frames.theta_deviation[1:] > found.frames.theta_deviation[1:]).all()


def test_loops_undo_the_drift_of_odometry(surveyed):
    poses = eights()
    found, true, _ = surveyed({"monday": poses}, scale=0.9)
    frames = found.frames
    before = off(replace(found, frames=frames.with_columns(x=frames.odom_x, y=frames.odom_y)), true)
    assert before > 0.2
    assert off(found, true) < 0.06  # 2 % of the 3 m from the middle, which only anchors would tell
    assert off(found, true, scaled=True) < 0.03
    expected = np.sqrt(np.pi / 2) * np.median(found.frames.deviation)  # the mean of a Rayleigh distribution
    assert 0.3 < off(found, true, scaled=True) / expected < 1.5
    assert 0.01 < found.scale_deviation < 0.03  # wheels are expected to be off by 3 %
    turns = wrapped(found.frames.theta - true[:, 2])
    assert np.degrees(np.abs(wrapped(turns - turns[0]))).mean() < 2
    assert found.fixed_by == "odometry"
    assert found.solution.scale == pytest.approx(0.9 / 1.02, abs=0.03)
    assert np.degrees(found.solution.gyro_bias[0]) == pytest.approx(0.5, abs=0.15)
    assert found.frames.x[0] == found.frames.y[0] == 0
    assert found.report()["loops"]["accepted"] == found.loops.accepted.sum() > 50
    assert found.notes == ()
    assert found.torn == 0
    assert "along" in found.summary()
    assert found.summary().endswith(" m"), "no doubt"


def test_images_alone_give_the_shape(surveyed):
    poses = eights()
    found, true, _ = surveyed({"monday": poses}, odometry=False, noise=0.03)
    assert off(found, true) < 0.1
    assert found.fixed_by == "pictures"
    assert np.isnan(found.frames.odometry).all()


def test_anchors_fix_position_direction_and_scale(surveyed):
    poses = eights()
    anchors = anchors_at(poses, [3, 40, 77])
    found, true, _ = surveyed({"monday": poses}, scale=0.9, anchors=anchors)
    assert np.hypot(*(found.frames.xy - true[:, :2]).T).mean() < 0.03
    np.testing.assert_allclose(found.frames.xy[[3, 40, 77]], true[[3, 40, 77], :2], atol=1e-12)
    assert found.fixed_by == "anchors"
    assert found.solution.wheel_scale[0] == pytest.approx(1.02, abs=0.01)
    with pytest.raises(DataError, match=r"anchor .*nowhere\.png of drive monday is not among the 90 frames"):
        surveyed({"monday": poses}, anchors=anchors.with_columns(path=["nowhere.png"] * 3))
    with pytest.raises(DataError, match=r"anchor monday/3\.png has no pose"):
        surveyed({"monday": poses}, anchors=anchors.with_columns(theta=[np.nan, 0, 0]))


def test_loops_are_searched_among_given_candidates(surveyed):
    poses = eights()
    given = [(40, 10), (10, 40), (11, 41), (12, 42), (13, 43), (20, 21), (20, 22), (5, 50)]
    found, _, _ = surveyed({"monday": poses}, candidates=given)
    pairs = np.column_stack([found.loops.first, found.loops.second]).tolist()
    assert pairs == [[5, 50], [10, 40], [11, 41], [12, 42], [13, 43]]  # each once, and none along a short way
    assert found.loops.accepted.tolist() == [False, True, True, True, True]
    none, _, _ = surveyed({"monday": poses}, candidates=[])
    assert not len(none.loops)
    assert "loops were not found" in none.notes[-1]
    for wrong in ([1, 2, 3], [(0, 90)], [(-1, 3)], [(0.5, 3)]):
        with pytest.raises(DataError, match="candidates are pairs of rows of the 90 frames"):
            surveyed({"monday": poses}, candidates=wrong)


def test_drives_are_brought_together(surveyed):
    drives = {"monday": eights(2), "tuesday": np.add(eights(2)[::-1], [0.05, 0.1, np.pi]), "night": eights(1)}
    found, true, _ = surveyed(drives)
    assert off(found, true) < 0.08
    assert found.graph.drive.tolist() == [0] * 60 + [1] * 60 + [2] * 30
    assert list(found.report()["odometry"]) == ["monday", "tuesday", "night"]
    apart, _, _ = surveyed(drives, joined=False)
    assert apart.frames == found.frames
    with pytest.raises(DataError, match="no places were found that elsewhere and monday have in common"):
        surveyed({"monday": eights(2), "elsewhere": np.add(eights(2), [50.0, 0, 0])})


def test_drives_that_never_meet_are_placed_by_anchors(surveyed):
    drives = {"monday": eights(2), "elsewhere": np.add(eights(2, turned=1.0), [50.0, 0, 0]), "night": eights(1)}
    anchors = concatenate(
        [anchors_at(drives[name], rows, name) for name, rows in (("monday", [5, 50]), ("elsewhere", [10, 40]))]
    )
    found, every, _ = surveyed(drives, anchors=anchors)
    assert np.hypot(*(found.frames.xy - every[:, :2]).T).mean() < 0.05
    np.testing.assert_allclose(found.frames.xy[[5, 50, 60 + 10, 60 + 40]], anchors.xy, atol=1e-12)
    with pytest.raises(DataError, match=r"elsewhere and monday have in common.*anchors in each"):
        surveyed(drives, anchors=anchors.take([0, 1]))


def test_a_wrong_loop_is_refused(surveyed, monkeypatch):
    poses = eights()
    wrong = TrueComparison.compare

    def compare(self, queries, known):
        pose, information, odds = wrong(self, queries, known)
        second, first = (np.rint(one[:, 0, 0] / one[:, 1, 0]).astype(int) - 2 for one in (queries, known))
        mistaken = (first < 6) & (second > 60) & (second < 66)  # a whole place that looks like another
        pose[mistaken] = relative(self.poses, first[mistaken] + 15, second[mistaken])
        odds[mistaken] = 5.0
        return pose, information, odds

    monkeypatch.setattr(TrueComparison, "compare", compare)
    found, true, _ = surveyed({"monday": poses})
    assert off(found, true) < 0.08
    right = relative(true, found.loops.first, found.loops.second)
    far = np.hypot(*(found.loops.pose - right)[:, :2].T) > 1
    assert far.sum() > 5
    assert (found.loops.weight[far] < 0.1).all()


def test_parts_of_the_odometry_that_cannot_be_true_are_left_out(surveyed):
    poses = eights()
    wheels = drifting(poses)
    wheels[30:, :2] += 40.0  # a reset
    steps = relative(wheels, np.arange(89), np.arange(1, 90))
    steps[50:60] = 0  # frozen
    wheels = chained(np.concatenate([np.zeros((1, 3)), steps]))
    wheels[70:75] = np.nan
    found, true, _ = surveyed({"monday": poses}, odometry=wheels)
    assert off(found, true) < 0.1
    text = "; ".join(found.notes)
    for part in ("jumps at 1 step, before frame 30", "stands still while the images move at 11", "for 5 frames"):
        assert part in text
    assert found.report()["notes"] == list(found.notes)


def test_odometry_of_wheels_that_slip_for_metres_is_left_out_there(surveyed):
    poses = eights()
    steps = relative(drifting(poses), np.arange(89), np.arange(1, 90))
    steps[40:55, :2] *= 0.4
    found, true, _ = surveyed({"monday": poses}, odometry=chained(np.concatenate([np.zeros((1, 3)), steps])))
    assert "moves much less than the images, as wheels do that slip, at " in found.notes[0]
    left_out = np.setdiff1d(np.arange(89), found.graph.wheels.first)
    assert np.isin(np.arange(42, 53), left_out).all()
    assert len(left_out) < 20
    assert off(found, true) < 0.1


def test_wheels_slip_where_they_and_images_are_metres_apart():
    last, judged = np.arange(60) >= 45, np.ones(60, dtype=bool)
    judged[50:55] = False  # dark
    compared = np.full(60, 0.3)
    found = _slipping(np.where(last, 0.3, 1.0) * compared, compared, judged)
    assert not found[:42].any()
    assert found[45:].tolist() == judged[45:].tolist()
    turning = np.where(last, 0.08, 0.3)  # a camera off the centre of a robot that turns on the spot
    assert not _slipping(np.where(last, 0.0, turning), turning, judged).any()


def test_a_front_that_is_not_found_without_odometry_is_noted(surveyed):
    ahead, sideways = eights(), eights()
    sideways[::2, 2] += np.pi / 2  # the robot drives now ahead and now to its right
    assert not surveyed({"monday": ahead}, odometry=False)[0].notes
    assert "the robot's front was not found" in surveyed({"monday": sideways}, odometry=False)[0].notes[0]


def test_frozen_odometry_is_left_out_with_steps_that_images_do_not_see_and_the_step_after(surveyed, monkeypatch):
    poses = eights()
    wheels = drifting(poses)
    steps = relative(wheels, np.arange(89), np.arange(1, 90))
    caught_up = relative(wheels, np.array([50]), np.array([63]))[0]
    steps[50:62], steps[62] = 0, caught_up
    wheels = chained(np.concatenate([np.zeros((1, 3)), steps]))
    compare = TrueComparison.compare

    def unsure(self, queries, known):
        pose, information, odds = compare(self, queries, known)
        rows = np.rint(queries[:, 0, 0] / queries[:, 1, 0]).astype(int) - 2
        return pose, information, np.where(np.isin(rows, [51, 57, 58]), -5.0, odds)

    monkeypatch.setattr(TrueComparison, "compare", unsure)
    found, _, _ = surveyed({"monday": poses}, odometry=wheels)
    assert not np.isin(np.arange(50, 63), found.graph.wheels.first).any()
    assert len(found.graph.wheels) == 89 - 13


def test_odometry_of_every_second_frame_is_said_to_be_of_no_use(surveyed):
    poses = eights()
    wheels = drifting(poses)
    wheels[::2] = np.nan
    found, _, _ = surveyed({"monday": poses}, odometry=wheels)
    assert found.fixed_by == "pictures"
    assert "is unknown for 45 frames: it is not used, since no two frames in a row have it" in found.notes[0]


def test_the_floor_tells_lengths_unless_most_frames_have_odometry(surveyed, monkeypatch):
    told, module = FloorScale(np.full(90, 1.25), 0.95, True), sys.modules["siamloc.maps.surveying"]
    nothing = Floor(np.zeros((90, 8, 260), np.float32), np.linspace(-0.25, -2, 8), 0.0)
    monkeypatch.setattr(Floor, "seen", lambda *_: nothing)
    for name in ("shows_floor", "elevations_known"):
        monkeypatch.setattr(module, name, lambda *_: True)
    monkeypatch.setattr(module, "seen_by_all", lambda _: np.ones((64, 256), bool))
    monkeypatch.setattr(module, "_told_by_floor", lambda _, known, steps, *rest: (told, told.lengthened(steps)))
    poses, height = eights(), SurveySettings(height=0.95)
    wheels = drifting(poses, 1.0)
    wheels[50:53] = np.nan  # as of wheels that slip
    found, _, _ = surveyed({"monday": poses}, odometry=wheels, scale=0.8, settings=height)
    assert found.fixed_by == "odometry"
    assert found.floor is None
    assert found.notes[-1] == "odometry tells the scale: the height of the camera is not used"
    wheels[4:] = np.nan
    found, true, _ = surveyed({"monday": poses}, odometry=wheels, scale=0.8, settings=height)
    assert found.fixed_by == "odometry and height"
    assert len(found.notes) == 1, "of unknown odometry"
    assert found.solution.scale == pytest.approx(1, abs=0.05)
    assert off(found, true) < 0.1


def test_odometry_with_x_and_y_exchanged_is_refused_on_a_way_along_one_axis(surveyed):
    n = np.arange(100)
    turn = np.pi / 2 * (n >= 85) + 0.15 * np.sin(0.4 * n)
    steps = np.column_stack([np.full(100, 0.3), np.zeros(100), np.diff(turn, prepend=turn[0])])
    poses = chained(steps)
    assert surveyed({"monday": poses}, odometry=drifting(poses))[0].fixed_by == "odometry"
    with pytest.raises(DataError, match="moves in other directions than its images show"):
        surveyed({"monday": poses}, odometry=drifting(poses)[:, [1, 0, 2]])


def test_odometry_of_zeros_is_left_out(surveyed):
    poses = eights()
    found, true, _ = surveyed({"monday": poses}, odometry=np.zeros((90, 3)))
    assert off(found, true) < 0.1
    assert found.fixed_by == "pictures"
    assert "stands still while the images move" in found.notes[0]


def test_odometry_of_a_robot_that_rests_most_of_the_time_is_used(surveyed):
    poses = eights(2)
    poses = np.concatenate([poses, np.tile(poses[-1], (180, 1))])
    wheels = drifting(poses) + 1e-4 * np.random.default_rng(1).normal(size=poses.shape)
    found, true, _ = surveyed({"monday": poses}, odometry=wheels)
    assert off(found, true) < 0.1
    assert found.fixed_by == "odometry"


def test_mirrored_panoramas_are_noted(surveyed):
    found, _, _ = surveyed({"monday": eights()}, made={"mounting": Mounting(mirrored=True).plain()})
    assert any("the panoramas are taken to be mirrored" in note for note in found.notes)
    assert not surveyed({"monday": eights()})[0].notes


def test_an_anchor_that_contradicts_the_images_is_noted(surveyed):
    poses = eights()

    def anchors(rows, x=0.0):
        right = anchors_at(poses, rows)
        return right.with_columns(x=right.x + x)

    found, _, _ = surveyed({"monday": poses}, anchors=anchors([5, 40, 80], np.array([0, 3.0, 0])))
    assert "1 of 3 anchors contradict the images around them, the first is monday/40.png" in found.notes[-1]
    assert found.torn == 0
    assert not surveyed({"monday": poses}, anchors=anchors([5, 40, 80]))[0].notes
    wheels = drifting(poses)
    wheels[1:] += [0.9, 0, 0]  # a first step that contradicts the images
    assert not surveyed({"monday": poses}, odometry=wheels, anchors=anchors([0]))[0].notes  # one anchor cannot
    found, _, _ = surveyed({"monday": poses}, anchors=anchors([5, 80], np.array([0, 90.0])))
    assert "the anchors contradict the images: drive monday is torn before its frame" in found.notes[-1]
    doubt = f"; do not rely on it: torn in {found.torn} place"
    assert doubt in found.summary(), "figures of a torn survey are not said without it"
    assert doubt in found.report()["summary"]
    with pytest.raises(DataError, match=r"anchor .*5\.png is given twice"):
        surveyed({"monday": poses}, anchors=anchors([5, 5]))


@pytest.mark.parametrize("wheeled", [True, False])
def test_anchors_in_another_unit_or_mirrored_are_refused(surveyed, wheeled):
    poses, rows = eights(), [3, 10, 20, 33, 50]
    for factor, says in (
        ([1000, 1000, 1], r"drive monday are \d+ times as far apart as the robot drove between them: give their x"),
        ([1, 1, 180 / np.pi], "drive monday have theta in degrees"),
        ([1, -1, -1], "drive monday turn left where its images turn right"),
    ):
        wheels, wrong = drifting(poses) if wheeled else False, anchors_at(poses * factor, rows)
        with pytest.raises(DataError, match=says):
            surveyed({"monday": poses}, odometry=wheels, anchors=wrong)


def test_what_cannot_be_surveyed_is_a_sentence(surveyed):
    poses = eights()
    wheels = drifting(poses)
    for changed, says in (
        (wheels * [100, 100, 1], "moves 102 times as far as its images show: give odom_x and odom_y in metres"),
        (wheels * [1, 1, 180 / np.pi], "odom_theta looks like degrees"),
        (wheels * [1, -1, -1], "turns left where its images turn right"),
        (wheels[:, [1, 0, 2]], "moves in other directions than its images show"),
        (wheels[:50], r"shape \(90, 3\), got \(50, 3\)"),
    ):
        with pytest.raises(DataError, match=says):
            surveyed({"monday": poses}, odometry=changed)
    with pytest.raises(DataError, match="monday has 5 frames: a survey needs 10"):
        surveyed({"monday": poses[:5]})
    with pytest.raises(DataError, match="monday stays within 1 m"):
        surveyed({"monday": np.tile(poses[:1], (30, 1))})
    straight = np.column_stack([0.3 * np.arange(40), np.zeros((40, 2))])
    found, _, _ = surveyed({"monday": straight})
    assert "loops were not found" in found.notes[-1]


@pytest.mark.parametrize(
    ("names", "says"),
    [([], "got none"), (["monday", "monday"], "monday is in two"), (["", ""], r"\(unnamed\) is in two")],
)
def test_tables_of_drives_hold_different_drives(names, says):
    tables = [FrameTable(path=[f"{n}.png"], sequence=[name]) for n, name in enumerate(names)]
    with pytest.raises(DataError, match=says):
        survey("pretrained", object.__new__(Panoramas), tables)


def test_two_anchors_bend_a_long_straight_drive(surveyed):
    rng = np.random.default_rng(5)
    heading = 0.05 * np.cumsum(rng.normal(size=300)) * 0.3
    true = chained(np.column_stack([np.full(300, 0.4), np.zeros(300), np.diff(heading, prepend=0)]))
    wheels = drifting(true, degrees=1.0)
    assert np.hypot(*(wheels - true)[:, :2].T).max() > 15
    found, _, _ = surveyed({"monday": true}, odometry=wheels, anchors=anchors_at(true, [0, 299]))
    assert np.hypot(*(found.frames.xy - true[:, :2]).T).mean() < 1.5


def test_loops_close_a_drive_that_drifted_far(surveyed):
    poses = eights(rounds=4, per_round=60)
    found, true, _ = surveyed({"monday": poses}, odometry=drifting(poses, degrees=4.0))
    assert off(found, true) < 0.1
    assert found.loops.counts()["contradicted"] < found.loops.counts()["accepted"] / 10


def test_drives_that_meet_once_are_noted(surveyed):
    crossing = np.column_stack([np.linspace(-8, 8, 60) + 1, np.full(60, 2.0), np.zeros(60)])
    other = np.column_stack([np.full(60, 1.0), np.linspace(-8, 8, 60) + 2, np.full(60, np.pi / 2)])
    found, _, _ = surveyed({"monday": crossing, "tuesday": other})
    assert any("meets the others at a single place" in note for note in found.notes) == (
        len(np.unique(found.loops.first[found.loops.accepted] // 10)) == 1
    )


def test_units_and_signs_of_dense_frames_are_judged_as_well(surveyed):
    poses = eights(rounds=1, per_round=500)
    wheels = drifting(poses)
    for changed, says in ((wheels * [100, 100, 1], "give odom_x"), (wheels * [1, -1, -1], "turns left where")):
        with pytest.raises(DataError, match=says):
            surveyed({"monday": poses}, odometry=changed, noise=0.003)


def test_shuffled_images_alone_are_refused(surveyed):
    x = np.arange(60) * 0.3
    poses = np.column_stack([x, np.sin(x / 3), np.arctan(np.cos(x / 3) / 3)])
    shuffled = poses[np.random.default_rng(0).permutation(60)]
    with pytest.raises(DataError, match=r"only \d+ of 59 images of drive monday are like .* sorted by time"):
        surveyed({"monday": shuffled}, odometry=False)
    assert surveyed({"monday": shuffled}, odometry=shuffled)[0].fixed_by == "odometry"
    assert surveyed({"monday": poses}, odometry=False)[0].fixed_by == "pictures"


def test_odometry_of_another_drive_or_clock_is_refused(surveyed):
    turns = np.convolve(np.random.default_rng(2).normal(0, 0.4, 130), np.ones(5) / 5, "same")
    poses = chained(np.column_stack([np.full(130, 0.3), np.zeros(130), turns]))
    wheels = drifting(poses)
    wheels[90:] = composed(np.tile([3.0, 1.0, 2.0], (40, 1)), wheels[90:])  # one reset does not matter
    assert surveyed({"monday": poses[:100]}, odometry=wheels[:100])[0].fixed_by == "odometry"
    with pytest.raises(DataError, match="turns otherwise than its images show: give that of this drive, in the clock"):
        surveyed({"monday": poses[:100]}, odometry=wheels[30:])


def test_noise_of_comparisons_on_a_straight_way_is_no_reason_to_refuse_odometry(surveyed):
    poses = np.column_stack([0.1 * np.arange(150), np.zeros(150), np.zeros(150)])
    assert surveyed({"monday": poses}, odometry=poses, noise=0.06)[0].fixed_by == "odometry"


@pytest.mark.parametrize(("late", "says"), [(3, "3 rows after"), (1, "1 row after"), (-2, "2 rows before")])
def test_odometry_of_other_images_is_refused(surveyed, late, says):
    rng = np.random.default_rng(3)
    turns = np.radians(6) * rng.normal(size=90)
    poses = chained(np.column_stack([np.full(90, 0.3), np.zeros(90), turns]))
    wheels = drifting(poses)
    assert surveyed({"monday": poses}, odometry=wheels)[0].fixed_by == "odometry"
    with pytest.raises(DataError, match=rf"turns {says} its images do: give each image the odometry of its own time"):
        surveyed({"monday": poses}, odometry=wheels[np.clip(np.arange(90) - late, 0, 89)])


def test_late_odometry_of_images_with_times_is_named_in_seconds(surveyed):
    time = np.arange(90) * 0.3
    turns = np.radians(10) * np.sin(time) * np.sin(2.3 * time)
    poses = chained(np.column_stack([np.full(90, 0.3), np.zeros(90), turns]))
    wheels = drifting(poses)
    late = np.column_stack([np.interp(time - 0.5, time, np.unwrap(one)) for one in wheels.T])
    says = r"turns 0\.[45]\d s after its images do: add \+0\.[45]\d s to the times of the images \(column time, "
    with pytest.raises(DataError, match=says):
        surveyed({"monday": poses}, odometry=late, time=time)


def test_frames_out_of_order_are_refused_before_any_image_is_described(surveyed, monkeypatch):
    monkeypatch.setattr(sys.modules["siamloc.maps.surveying"], "comparing_descriptor", None)
    table = FrameTable(path=[f"{n}.png" for n in range(12)], time=[*range(6), 3, *range(6, 11)])
    with pytest.raises(DataError, match=r"times of drive .* go back"):
        survey("pretrained", object.__new__(Panoramas), table)


def test_a_survey_needs_a_network_that_compares(monkeypatch, surveyed):
    monkeypatch.setattr(TrueComparison, "compares", False)
    with pytest.raises(ConfigError, match="needs a network that compares panoramas"):
        surveyed({"monday": eights()})


@pytest.mark.parametrize("wheeled", [True, False])
def test_a_survey_goes_on_frame_by_frame(surveyed, wheeled):
    poses, known = eights(rounds=3), 45
    wheels = drifting(poses)
    before, _, _ = surveyed({"monday": poses[:known]}, odometry=wheels[:known] if wheeled else False, scale=0.95)
    network = TrueComparison(poses, 0.95, 0.02)
    held = VisualMap(
        places_of(poses[:known]), before.frames, orientation=numbered(range(known)), heading={"name": "network"}
    )
    live = LiveSurvey(network, before, replace(held, describes=network))
    off_by = []
    for row in range(known, len(poses)):
        pose = live.add(np.full((3, 1, 1), row, np.uint8), f"{row}.png", odometry=wheels[row] if wheeled else None)
        np.testing.assert_array_equal(live.poses[-1], pose)
        first = relative(poses, np.array([0]), np.array([row]))[0]
        shown = relative(live.poses, np.array([0]), np.array([row]))[0]
        off_by.append(np.hypot(*(shown - first)[:2]))
    assert np.mean(off_by) < (0.1 if wheeled else 0.2)  # by odometry alone 0.8
    found = live.survey()
    whole, true, _ = surveyed({"monday": poses}, odometry=wheels if wheeled else False, scale=0.95)
    assert off(found, true, scaled=True) < max(0.03, 1.5 * off(whole, true, scaled=True))
    assert len(found.frames) == len(live) == 90
    assert found.frames.path[-1] == "89.png"
    assert found.loops.accepted.sum() > 0.8 * whole.loops.accepted.sum()
    assert found.fixed_by == ("odometry" if wheeled else "pictures")
    assert list(found.report()["odometry"]) == (["monday"] if wheeled else [])
    with pytest.raises(DataError, match="needs the map of its frames"):
        LiveSurvey(network, whole, held)
    if wheeled:
        with pytest.raises(DataError, match=r"odometry turned by .* since the last frame: give its heading in rad"):
            live.add(np.full((3, 1, 1), 89, np.uint8), "90.png", odometry=wheels[-1] * [1, 1, 180 / np.pi])
    for old in (before.frames.path[3], "89.png"):
        with pytest.raises(DataError, match=r"the drive has the frame .* already"):
            live.add(np.full((3, 1, 1), 89, np.uint8), old)
    for panorama in (np.full((3, 1, 1), 0.5), np.zeros((1, 1, 3), np.uint8)):
        with pytest.raises(DataError, match=r"a panorama is uint8 of shape \(3, H, W\), got"):
            live.add(panorama, "90.png")


def test_a_live_survey_goes_on_with_the_lengths_of_the_floor(surveyed):
    x, known = np.arange(90) * 0.3, 60
    poses = np.column_stack([x, np.sin(x / 3), np.arctan(np.cos(x / 3) / 3)])
    before, _, _ = surveyed({"monday": poses[:known]}, odometry=False, noise=0.01)
    before = replace(before, floor=FloorScale(np.full(known, 1.25), 0.95, True))
    network = TrueComparison(poses, 0.8, 0.01)
    held = VisualMap(
        places_of(poses[:known]), before.frames, orientation=numbered(range(known)), heading={"name": "network"}
    )
    live = LiveSurvey(network, before, replace(held, describes=network))
    for row in range(known, len(poses)):
        live.add(np.full((3, 1, 1), row, np.uint8), f"{row}.png")
    shown, true = (np.hypot(*(one[-1] - one[known - 1])[:2]) for one in (live.poses, poses))
    assert shown == pytest.approx(true, rel=0.05)  # by comparisons alone a fifth too short
    found = live.survey()
    np.testing.assert_allclose(found.floor.factors, np.full(len(poses), 1.25))
    assert found.fixed_by == "height"
