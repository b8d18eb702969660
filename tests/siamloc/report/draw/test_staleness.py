"""The picture of a map's staleness shows where it was contradicted, and what joined and left it."""

from dataclasses import replace

import numpy as np

from siamloc.data import FrameTable
from siamloc.maps import History, Reason, Update, VisualMap
from siamloc.report.draw.staleness import staleness, staleness_picture

FRAMES = FrameTable(path=[f"{i}.png" for i in range(6)], x=[0.2, 0.4, 1.2, 1.4, 5.2, 5.4], y=[0.5] * 6)
KNOWN = VisualMap(
    np.eye(6), FRAMES, history=History([1, 1, 1, 0, 0, 0], [0, 0, 0, 1, 0, 0], [0.5, 0.7, 1.0, 1.5, np.nan, np.nan])
)


def dots(figure):
    return {one.get_label(): one.get_offsets().tolist() for one in figure.axes[0].collections[1:]}


def test_squares_show_the_mean_change_of_the_frames_that_were_passed():
    assert staleness(KNOWN)[:4].tolist() == [0.5, 0.7, 1.0, 2.0], "a contradicted frame counts at least 2"
    figure = staleness_picture(KNOWN)
    tiles = figure.axes[0].collections[0]
    np.testing.assert_allclose(tiles.get_array(), [0.6, 1.5])
    np.testing.assert_allclose([path.vertices[0] for path in tiles.get_paths()], [[0, 0], [1, 0]])
    assert dots(figure)["contradicted"] == [[1.4, 0.5]]
    assert len(dots(figure)["map frame"]) == 6


def test_an_update_shows_what_joined_and_left():
    drive = FrameTable(path=["a.png", "b.png"], x=[1.0, 1.1], y=[0.4, 0.4])
    left, joined = [Reason.KEPT] * 3 + [Reason.FORGOTTEN] + [Reason.KEPT] * 2, [Reason.ADDED, Reason.EXPLAINED]
    reasons = (np.array(one, dtype=object) for one in (left, joined))
    map_reason, reason = reasons
    found = Update(KNOWN, None, KNOWN, map_reason, drive, reason, np.ones(2, bool), np.ones(2, bool), 5)
    shown = dots(staleness_picture(found))
    assert shown["left the map"] == [[1.4, 0.5]]
    assert shown["joined the map"] == [[1.0, 0.4]]


def test_updates_by_several_drives_show_what_joined_and_left_by_each():
    def found(before, left, x):
        map_reason = np.where(np.arange(len(before)) == left, Reason.FORGOTTEN, Reason.KEPT).astype(object)
        drive, reason = FrameTable(path=[f"{x}.png"], x=[x], y=[0.4]), np.array([Reason.ADDED], dtype=object)
        return Update(before, None, before, map_reason, drive, reason, np.ones(1, bool), np.ones(1, bool), 5)

    figure = staleness_picture(found(KNOWN, 3, 1.0), found(KNOWN.take(np.arange(5)), 0, 2.0))
    shown = dots(figure)
    assert len(shown["map frame"]) == 3, "a frame is drawn by its last state"
    assert shown["left the map"] == [[1.4, 0.5], [0.2, 0.5]]
    assert shown["joined the map"] == [[1.0, 0.4], [2.0, 0.4]]
    assert figure.axes[0].get_title(loc="left") + figure.axes[0].get_title() == "6 map frames became 5"


def test_a_frame_that_joined_and_left_again_is_a_cross_and_rings_lie_above_all_marks():
    def found(before, left, drive):
        map_reason = np.where(np.arange(len(before)) == left, Reason.FORGOTTEN, Reason.KEPT).astype(object)
        reason = np.full(len(drive), Reason.ADDED, dtype=object)
        return Update(before, None, before, map_reason, drive, reason, np.ones(1, bool), np.ones(1, bool), 5)

    come = FrameTable(path=["a.png"], x=[1.0], y=[0.4])
    after = replace(KNOWN, frames=KNOWN.frames.with_columns(path=["a.png", *KNOWN.frames.path[1:]]))
    figure = staleness_picture(found(KNOWN, 3, come), found(after, 0, come.take([])))
    shown = dots(figure)
    assert "joined the map" not in shown
    assert len(shown["left the map"]) == 2
    *others, ring = figure.axes[0].collections
    assert ring.get_label() == "contradicted"
    assert not len(ring.get_facecolor()), "what a ring marks is seen"
    assert ring.get_zorder() > max(one.get_zorder() for one in others)


def test_each_building_has_a_plan_of_its_own():
    frames = KNOWN.frames.with_columns(building=["A", "B"] * 3)
    figure = staleness_picture(replace(KNOWN, frames=frames))
    means = [axes.collections[0].get_array().tolist() for axes in figure.axes[:2]]
    assert means == [[0.5, 1.0], [0.7, 2.0]], "not those of both buildings"
    titles = [axes.get_title(loc="left") + axes.get_title() for axes in figure.axes[:2]]
    assert titles == ["A: 3 map frames", "B: 3 map frames"]
    assert len(figure.legends[0].get_texts()) == 2


def test_a_building_that_the_map_lacked_has_a_plan_of_the_frames_that_joined():
    drive = FrameTable(path=["a.png", "b.png"], x=[1.0, 2.0], y=[0.4, 0.4], building=["new", "new"])
    reason, kept = np.full(2, Reason.NEW_PLACE, dtype=object), np.full(6, Reason.KEPT, dtype=object)
    found = Update(KNOWN, None, KNOWN, kept, drive, reason, np.zeros(2, bool), np.zeros(2, bool), 5)
    figure = staleness_picture(found)
    assert len(figure.axes) == 3, "two plans and the scale"
    (joined,) = (one for one in figure.axes[1].collections if one.get_label() == "joined the map")
    assert joined.get_offsets().tolist() == [[1.0, 0.4], [2.0, 0.4]]
    assert figure.rendered("svg")


def test_a_map_that_no_drive_passed_has_no_squares():
    figure = staleness_picture(replace(KNOWN, history=None))
    assert not len(figure.axes[0].collections[0].get_paths())
    assert figure.rendered("svg")
