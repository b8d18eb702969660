"""A drive is located in a map by all of it at once, with a comparison that knows the truth up to noise."""

from dataclasses import replace

import numpy as np
import pytest

from siamloc.data import FrameTable
from siamloc.errors import ConfigError, DataError
from siamloc.maps import Reason, VisualMap, locate
from siamloc.maps.evidence import judged
from siamloc.maps.maintenance import updated
from tests.siamloc.maps.test_surveying import TrueComparison, drifting, eights, numbered, places_of


class Moved(TrueComparison):
    """Sees the frames from a number on displaced by a metre, as a moved cupboard does, when compared with others."""

    def __init__(self, poses, first, last):
        super().__init__(poses, 1.0, 0.01)
        self.moved = first, last

    def compare(self, queries, known):
        pose, information, odds = super().compare(queries, known)
        rows = np.rint(queries[:, 0, 0] / queries[:, 1, 0]).astype(int) - 2
        others = np.rint(known[:, 0, 0] / known[:, 1, 0]).astype(int) - 2
        first, last = self.moved
        old = others < len(self.poses) // 2
        pose[(rows >= first) & (rows < last) & old, 0] += 1.0
        return pose, information, odds


def maps(by, poses, **columns):
    """Return a map of the first half of some poses, and the second half as a drive without poses."""
    half = len(poses) // 2
    rows = np.arange(len(poses))
    x, y, theta = poses.T
    known = FrameTable(path=[f"{row}.png" for row in rows[:half]], sequence=["monday"] * half, x=x[:half], y=y[:half],
                       theta=theta[:half])  # fmt: skip
    drive = FrameTable(path=[f"{row}.png" for row in rows[half:]], sequence=["monday"] * half, **columns)
    return tuple(
        VisualMap(
            places_of(poses)[part], frames, orientation=numbered(part), heading={"name": "network"},
        ).with_descriptor(by)
        for part, frames in ((rows[:half], known), (rows[half:], drive))
    )  # fmt: skip


@pytest.fixture
def poses():
    return np.concatenate([eights(2), np.add(eights(2), [0.1, -0.1, 0.05])])


def wheels(poses):
    """Odometry of the second half, as columns."""
    return dict(zip(("odom_x", "odom_y", "odom_theta"), drifting(poses[len(poses) // 2 :]).T, strict=True))


def test_a_drive_is_located_by_all_of_it(poses):
    by = TrueComparison(poses, 1.0, 0.02)
    known, drive = maps(by, poses, **wheels(poses))
    found = locate(known, drive, progress=False)
    off = np.hypot(*(found.xy - poses[60:, :2]).T)
    assert off.mean() < 0.02  # the noise of a single comparison
    assert np.abs(found.theta - np.angle(np.exp(1j * poses[60:, 2]))).max() < 0.1
    assert found.identities() == drive.frames.identities()
    assert set(found.building) == {""}
    at_home = replace(known, frames=known.frames.with_columns(building=["home"] * 60))
    assert set(locate(at_home, drive, progress=False).building) == {"home"}
    assert 0.3 < off.mean() / np.median(found.deviation) < 2


def test_located_frames_are_in_the_building_that_they_look_like(poses, monkeypatch):
    known, drive = maps(TrueComparison(poses, 1.0, 0.02), poses, **wheels(poses))
    known = replace(known, frames=known.frames.with_columns(building=["up", "down"] * 30))
    monkeypatch.setattr(
        "siamloc.maps.locating.buildings_of",
        lambda known, drive: np.where(drive.frames.x > 0, *known.frames.building[:2]),
    )
    found = locate(known, drive, progress=False)
    np.testing.assert_array_equal(found.building, np.where(found.x > 0, "up", "down"))
    assert len(set(found.building)) == 2
    elsewhere = replace(drive, frames=drive.frames.with_columns(building=["barn"] * 60))
    with pytest.raises(DataError, match="the drive states the building barn, and the map has down, up: name one that"):
        locate(known, elsewhere, progress=False)


def test_the_frames_of_a_map_need_no_order(poses):
    known, drive = maps(TrueComparison(poses, 1.0, 0.02), poses)
    some = known.take(np.random.default_rng(0).permutation(60)[:30])
    days = np.where(np.arange(30) < 29, "monday", "sunday")
    found = locate(replace(some, frames=some.frames.with_columns(sequence=days)), drive, progress=False)
    assert np.hypot(*(found.xy - poses[60:, :2]).T).mean() < 0.05


def test_what_was_moved_is_outvoted(poses):
    by = Moved(poses, 80, 90)
    known, drive = maps(by, poses, **wheels(poses))
    found = locate(known, drive, progress=False)
    assert np.hypot(*(found.xy - poses[60:, :2]).T).max() < 0.15  # a metre, if these frames were asked alone


def test_what_cannot_be_located_is_a_sentence(poses):
    by = TrueComparison(poses, 1.0, 0.02)
    known, drive = maps(by, poses)
    with pytest.raises(DataError, match="a map frame has no pose"):
        locate(replace(known, frames=known.frames.with_columns(theta=np.full(60, np.nan))), drive, progress=False)
    with pytest.raises(DataError, match=r"in a map in metres, and this map is in 'frames'$"):
        locate(replace(known, frames=replace(known.frames, unit="frames")), drive, progress=False)
    with pytest.raises(DataError, match="monday has 5 frames: a survey needs 10"):
        locate(known, drive.take(np.arange(5)), progress=False)
    with pytest.raises(ConfigError, match=r"compares images, .* with cosine distances: build the map with pretrained"):
        locate(known.with_distance("cosine"), drive, progress=False)
    with pytest.raises(ConfigError, match="by a network that compares images"):
        locate(replace(known, heading=None, orientation=None), drive, progress=False)


def test_frames_that_the_map_takes_for_elsewhere_join_it_and_those_that_misled_are_contradicted(poses):
    by = Moved(poses, 80, 90)
    known, drive = maps(by, poses)
    x, y, theta = poses[60:].T
    drive = replace(drive, frames=drive.frames.with_columns(x=x, y=y, theta=theta, sequence=["tuesday"] * 60))
    found = judged(known, drive, radius=1.0)
    assert np.flatnonzero(found.misplaced).tolist() == list(range(20, 30))
    some = replace(known, frames=known.frames.with_columns(theta=np.where(np.arange(60) % 20, poses[:60, 2], np.nan)))
    assert np.flatnonzero(judged(some, drive, radius=1.0).misplaced).tolist() == list(range(20, 30))
    assert 0 < (~found.recognized & found.passed).sum() < 30
    after = updated(known, drive)
    assert set(np.flatnonzero(after.added)) <= set(range(20, 30))
    assert after.added.any()
    assert (after.map_reason == Reason.CONTRADICTED).any()


def test_axes_that_differ_by_less_than_the_radius_are_refused_where_images_are_compared(poses):
    known, drive = maps(TrueComparison(poses, 1.0, 0.05), poses)

    def updated_with(shift, turn):
        cos, sin = np.cos(turn), np.sin(turn)
        x, y, theta = (poses[60:] @ [[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]] + [shift, 0, turn]).T
        frames = drive.frames.with_columns(x=x, y=y, theta=theta, sequence=["tuesday"] * 60)
        return updated(known, replace(drive, frames=frames))

    updated_with(0.0, 0.0)
    updated_with(0.1, np.radians(1))
    for shift, turn, says in (
        (0.5, 0.0, r"by 0\.[45]\d m and \d degrees"),
        (0.0, np.radians(10), "and (9|10|11) degrees"),
    ):
        with pytest.raises(
            DataError, match=f"other axes than the map's: one motion .*{says} brings .* x, y and theta out"
        ):
            updated_with(shift, turn)


def test_positions_that_bend_away_from_where_images_are_compared_are_refused(poses):
    known, drive = maps(TrueComparison(poses, 1.0, 0.05), poses)
    x, y, theta = poses[60:].T
    turned = 0.04 * np.arange(60)
    at = 1.5 * np.exp(1j * turned) * (x + 1j * y)
    frames = drive.frames.with_columns(x=at.real, y=at.imag, theta=theta + turned, sequence=["tuesday"] * 60)
    headings = np.where(np.arange(60) % 3, known.frames.theta, np.nan)
    for seen in (known, replace(known, frames=known.frames.with_columns(theta=headings))):
        with pytest.raises(DataError, match=r"its images show it: \d of \d+ frames are within 0\.25 m .* as odom_x"):
            updated(seen, replace(drive, frames=frames))
    unsure = frames.with_columns(deviation=np.abs(at - (x + 1j * y)))
    assert updated(known, replace(drive, frames=unsure)).known, "positions that are as uncertain as they are wrong"
    elsewhere = frames.with_columns(building=["annex"] * 60)
    assert updated(known, replace(drive, frames=elsewhere)).added.any()


class Covered(TrueComparison):
    """Finds that the frames from a number on show nothing of any other frame."""

    def __init__(self, poses, first):
        super().__init__(poses, 1.0, 0.01)
        self.first = first

    def compare(self, queries, known):
        pose, information, odds = super().compare(queries, known)
        rows = np.rint(queries[:, 0, 0] / queries[:, 1, 0]).astype(int) - 2
        return pose, information, np.where(rows >= self.first, -12.0, odds)


def test_a_drive_that_mostly_shows_nothing_of_the_map_is_refused(poses):
    x, y, theta = poses[60:].T
    for first, strange in ((85, True), (95, False)):
        known, drive = maps(Covered(poses, first), poses, x=x, y=y, theta=theta)
        if strange:
            with pytest.raises(DataError, match="35 of 60 pictures taken in known places show nothing that is on the"):
                updated(known, drive)
            frames = drive.frames.with_columns(building=["annex"] * 60)
            assert updated(known, replace(drive, frames=frames)).added.any(), "a new place shows nothing of the map"
        else:
            assert updated(known, drive).known


def test_comparisons_in_metres_say_nothing_about_a_map_in_pixels(poses):
    known, drive = maps(Moved(poses, 80, 90), poses)
    x, y, theta = poses[60:].T
    frames = replace(drive.frames.with_columns(x=x, y=y, theta=theta), unit="px")
    known = replace(known, frames=replace(known.frames, unit="px"))
    found = judged(known, replace(drive, frames=frames), radius=1.0)
    assert not found.misplaced.any()


def test_frames_that_are_in_the_map_already_are_located_like_others(poses):
    known, drive = maps(TrueComparison(poses, 1.0, 0.02), poses)
    known = known.merge(drive.take(np.arange(4)))
    x, y, theta = np.concatenate([poses[:60], poses[60:64]]).T
    known = replace(known, frames=known.frames.with_columns(x=x, y=y, theta=theta))
    found = locate(known, drive, progress=False)
    assert found.identities() == drive.frames.identities()
    assert np.hypot(*(found.xy - poses[60:, :2]).T).max() < 0.15
