"""Batches of places: what is near what, which lightings meet, and that the draw follows from its numbers alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from siamloc.data import read
from siamloc.data.frames import FrameTable
from siamloc.data.places import PlaceSampler, PlaceSettings
from siamloc.errors import ConfigError, DataError


def building(drives=("cloudy", "night", "sunny"), length=40, apart=0.5):
    """Drives along one corridor, a frame every half metre."""
    rows = [
        {"path": f"{drive}/{number}", "x": apart * number, "y": 0.1 * at, "lighting": drive, "sequence": drive}
        for at, drive in enumerate(drives)
        for number in range(length)
    ]
    return FrameTable.from_rows(rows)


def grouped(frames, rows, images):
    return frames.xy[rows].reshape(-1, images, 2), frames.lighting[rows].reshape(-1, images)


def test_images_of_a_place_lie_near_its_first_and_under_every_lighting():
    frames = building()
    sampler = PlaceSampler(frames, PlaceSettings(places=8, images=3, radius=0.3))
    for number in range(5):
        rows = sampler.batch(0, number)
        assert len(rows) == 24
        xy, lighting = grouped(frames, rows, 3)
        assert np.linalg.norm(xy - xy[:, :1], axis=2).max() <= 0.3
        assert all(len(set(place)) == 3 for place in lighting.tolist())


def test_images_that_no_place_has_are_the_same_ones_again_and_said():
    frames = building(drives=("cloudy",))
    sampler = PlaceSampler(frames, PlaceSettings(places=4, images=4, radius=0.1))
    rows = sampler.batch(0, 0).reshape(4, 4)
    assert (rows == rows[:, :1]).all()
    (note,) = sampler.notes()
    total = len(frames)
    assert note.startswith(f"{total} of {total} frames have no other one within pairs.radius=0.1 m: their places have")
    assert note.endswith("a larger pairs.radius finds some (half of the frames have one within 0.5 m)")
    (note,) = PlaceSampler(frames, PlaceSettings(places=4, images=1, near=0.5, reach=0.1)).notes()
    assert "within pairs.reach=0.1 m: places near them are the same place again" in note
    (note,) = PlaceSampler(frames, PlaceSettings(by="sequence", places=4, radius=0.5)).notes()
    assert "within pairs.radius=0.5 frames" in note
    assert not PlaceSampler(frames, PlaceSettings(places=4, images=1, radius=0.1)).notes()


def test_a_folder_of_rooms_is_said_to_have_no_order_of_a_drive(tmp_path):
    for room in ("a", "b"):
        (tmp_path / "day" / room).mkdir(parents=True)
        for number in range(4):
            (tmp_path / "day" / room / f"{number}.jpg").touch()
    frames, settings = read("folder", root=tmp_path), PlaceSettings(by="sequence", places=4, radius=1)
    (note,) = PlaceSampler(frames, settings).notes()
    assert note.startswith("pairs.by=sequence takes the order of the frames as that of the drive")
    assert note.endswith("give a manifest in the order of the drive")
    for ordered in (frames.select(room="a"), frames.with_columns(time=np.arange(8)), replace(frames, source={})):
        assert not PlaceSampler(ordered, settings).notes()


def test_frames_that_stand_alone_are_counted():
    near = building(drives=("cloudy",), length=6, apart=0.2)
    frames = near.with_columns(x=[0.0, 0.2, 0.4, 5.0, 10.0, 20.0])
    sampler = PlaceSampler(frames, PlaceSettings(places=2, images=2, radius=0.3, near=0.5, reach=5.0))
    radius, reach = sampler.notes()
    assert radius.startswith("3 of 6 frames have no other one within pairs.radius=0.3 m: their places have the")
    assert reach.startswith("1 of 6 frames have no other one within pairs.reach=5 m: ")
    assert reach.endswith("a larger pairs.reach finds some"), "half of the frames have one nearer than that"
    alone = FrameTable(path=list("abcd"), x=[0, 1, 2, 3], y=[0] * 4, building=list("abcd"))
    assert PlaceSampler(alone, PlaceSettings(places=2, images=2)).notes()[0].endswith("alone makes different")
    elsewhere = frames.with_columns(building=["a", "b", "b", "b", "b", "b"])
    assert PlaceSampler(elsewhere, PlaceSettings(places=2, images=2)).notes()[0].startswith("4 of 6 frames")


def test_near_places_lie_within_reach_of_another_place():
    frames = building(drives=("cloudy",), length=2000)
    sampler = PlaceSampler(frames, PlaceSettings(places=20, images=1, near=0.5, reach=1.0))
    xy = frames.xy[sampler.batch(3, 1)]
    apart = np.linalg.norm(xy[:, None] - xy[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    assert (apart.min(axis=1) <= 1.0).sum() >= 10
    far = frames.xy[PlaceSampler(frames, PlaceSettings(places=20, images=1, near=0.0)).batch(3, 1)]
    assert len(np.unique(far, axis=0)) == 20


def test_frames_of_two_buildings_at_one_position_are_two_places():
    frames = building(drives=("a", "b"), length=10, apart=5.0)
    frames = frames.with_columns(building=frames.sequence, lighting=[""] * 20, sequence=[""] * 20)
    rows = PlaceSampler(frames, PlaceSettings(places=6, images=4, radius=5.0)).batch(0, 0).reshape(6, 4)
    assert (frames.building[rows] == frames.building[rows[:, :1]]).all()


def test_a_batch_follows_from_seed_epoch_and_number():
    frames, settings = building(), PlaceSettings(places=5, images=2)
    assert len(PlaceSampler(frames, settings)) == 12, "every frame once on average"
    assert len(PlaceSampler(frames, PlaceSettings(epoch_batches=7))) == 7
    first = PlaceSampler(frames, settings, seed=4)
    rows = first.batch(2, 3)
    first.batch(0, 0)
    assert np.array_equal(PlaceSampler(frames, settings, seed=4).batch(2, 3), rows)
    others = [first.batch(2, 4), first.batch(1, 3), PlaceSampler(frames, settings, seed=5).batch(2, 3)]
    assert not any(np.array_equal(other, rows) for other in others)


def test_two_processes_share_one_batch_of_twice_the_places():
    frames = building()
    two = PlaceSampler(frames, PlaceSettings(places=4, images=2, near=0.5), seed=1)
    one = PlaceSampler(frames, PlaceSettings(places=8, images=2, near=0.5), seed=1)
    shares = [two.batch(1, 2, rank, 2) for rank in (0, 1)]
    assert np.array_equal(np.concatenate(shares), one.batch(1, 2))


def test_without_positions_places_are_stretches_of_a_sequence():
    paths = [f"{drive}{number}" for number in range(30) for drive in ("monday", "tuesday")]  # interleaved
    frames = FrameTable(path=paths, sequence=[path.rstrip("0123456789") for path in paths])
    sampler = PlaceSampler(frames, PlaceSettings(by="sequence", places=6, images=3, radius=2, near=0.5, reach=4))
    for number in range(5):
        rows = sampler.batch(0, number).reshape(6, 3)
        assert (frames.sequence[rows] == frames.sequence[rows[:, :1]]).all()
        step = rows // 2  # each drive has every second row
        assert np.abs(step - step[:, :1]).max() <= 2


def test_what_cannot_be_drawn_is_refused():
    frames = building()
    with pytest.raises(ConfigError, match="a batch of one place has nothing to tell apart"):
        PlaceSampler(frames, PlaceSettings(places=1))
    with pytest.raises(ConfigError, match=r"cannot be drawn from 120 frames: set pairs\.places lower"):
        PlaceSampler(frames, PlaceSettings(places=121))
    shared = "a batch of 200 places, 100 for each process, cannot be drawn from 120 frames"
    for call in (lambda one: one.batch(0, 0, 0, 2), lambda one: one.check_processes(2)):
        with pytest.raises(ConfigError, match=shared):
            call(PlaceSampler(frames, PlaceSettings(places=100)))
    nowhere = FrameTable(path=["a", "b"], x=[0.0, np.nan], y=[0.0, np.nan])
    with pytest.raises(DataError, match="1 of 2 frames have no position, by which places are drawn"):
        PlaceSampler(nowhere)


def test_images_of_a_place_come_from_different_positions_before_the_same_one_under_another_light():
    x = np.repeat([0.0, 0.1, 0.2, 9.0], 4)
    frames = FrameTable(
        path=[f"{n}.png" for n in range(16)], x=x, y=np.zeros(16), lighting=["one", "two", "three", "four"] * 4
    )
    sampler = PlaceSampler(frames, PlaceSettings(places=2, images=4, radius=0.3), seed=3)
    for number in range(30):
        for rows in sampler.batch(0, number).reshape(2, 4):
            positions = frames.x[rows].tolist()
            if 9.0 in positions:  # one position alone: its four lights
                assert set(positions) == {9.0}
            else:  # three positions, then one of them again
                assert len(set(positions[:3])) == 3
                assert positions[3] in positions[:3]
                assert len(set(frames.lighting[rows[:3]].tolist())) == 3
            assert len(set(rows.tolist())) == 4
    # Of a position under two lights, either image is taken, and the other one comes after the third position.
    sampler = PlaceSampler(frames.take([0, 4, 5, 8]), PlaceSettings(places=2, images=3, radius=0.3), seed=1)
    assert all(len(set(x)) == 3 for n in range(50) for x in frames.x[[0, 4, 5, 8]][sampler.batch(0, n)].reshape(2, 3))
