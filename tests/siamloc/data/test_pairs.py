from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from siamloc.data.frames import FrameTable
from siamloc.data.pairs import PairSampler, PairSettings
from siamloc.errors import ConfigError, DataError


def sampler_of(frames, label="auto", seed=0, **options):
    return PairSampler(frames, PairSettings(label=label, **options), seed=seed)


def table(rooms, building=None):
    x, y = np.random.default_rng(0).uniform(0, 1, (2, len(rooms)))
    paths = [f"{i}.png" for i in range(len(rooms))]
    return FrameTable(path=paths, x=10 * x, y=3 * y, room=rooms, building=building)


def as_lists(pairs):
    return [column.tolist() for column in vars(pairs).values()]


room_lists = st.lists(st.sampled_from(["A", "B", "C", ""]), min_size=2, max_size=30).filter(
    lambda rooms: 1 < len(set(rooms)) < len(rooms)
)


@given(rooms=room_lists, share=st.floats(0, 1), pairs=st.integers(1, 60), seed=st.integers(0, 2**32 - 1))
def test_pairs_are_two_different_frames_with_the_right_label(rooms, share, pairs, seed):
    frames = table(rooms)
    sampler = sampler_of(frames, "room", same_room_share=share, epoch_pairs=pairs, seed=seed)
    drawn = sampler.epoch(3)
    assert len(drawn) == pairs
    assert (drawn.first != drawn.second).all()
    assert (drawn.same == (frames.room[drawn.first] == frames.room[drawn.second])).all()
    assert (drawn.label == ~drawn.same).all()
    assert drawn.same.sum() == round(share * pairs)


@given(rooms=room_lists, epoch=st.integers(0, 5), world_size=st.integers(1, 5))
def test_ranks_share_an_epoch_without_overlap(rooms, epoch, world_size):
    sampler = sampler_of(table(rooms), epoch_pairs=23)
    whole = sampler.epoch(epoch)
    for rank in range(world_size):
        part = sampler.epoch(epoch, rank, world_size)
        assert as_lists(part) == as_lists(whole.take(slice(rank, None, world_size)))


def test_an_epoch_depends_on_seed_and_number_only():
    frames = table(["A"] * 10 + ["B"] * 10)
    sampler = sampler_of(frames, seed=0)
    sampler.epoch(7)
    assert as_lists(sampler.epoch(1)) == as_lists(sampler_of(frames, seed=0).epoch(1))
    assert as_lists(sampler.epoch(1)) != as_lists(sampler.epoch(2))
    assert as_lists(sampler.epoch(1)) != as_lists(sampler_of(frames, seed=1).epoch(1))


def labels_of(pairs):
    """Return the labels by the two frames of the pair."""
    return {frozenset(p): y for *p, y in zip(pairs.first.tolist(), pairs.second.tolist(), pairs.label, strict=True)}


def test_distance_labels_follow_the_thesis_example():
    x, rooms = [0.0, 0.33, 12.82, 0.0, 5.0, 7.48], ["CR", "CR", "CR", "KT", "LO", "LO"]
    frames = FrameTable(path=list("abcdef"), x=x, y=np.zeros(6), room=rooms)
    labels = labels_of(sampler_of(frames, "distance", same_room_share=0.5, epoch_pairs=400, scale=18.99).epoch(0))
    assert labels[frozenset((0, 1))] == pytest.approx(0.017, abs=5e-4)
    assert labels[frozenset((0, 2))] == pytest.approx(0.675, abs=5e-4)
    assert labels[frozenset((4, 5))] == pytest.approx(0.131, abs=5e-4)
    assert labels[frozenset((0, 3))] == 1
    assert labels[frozenset((3, 4))] == 1


def test_labels_of_uncertain_positions_fade():
    frames = FrameTable(path=["a", "b", "c"], x=[0, 1, 4], y=[0, 0, 0], deviation=[0.5, np.nan, 0.1])
    pairs = PairSampler(frames, PairSettings(label="distance", epoch_pairs=200), seed=0).epoch(0)
    for one, other, apart, variance in ((0, 1, 1.0, 0.25), (0, 2, 4.0, 0.26), (1, 2, 3.0, 0.01)):
        rows = (np.minimum(pairs.first, pairs.second) == one) & (np.maximum(pairs.first, pairs.second) == other)
        assert rows.any()
        np.testing.assert_allclose(pairs.label[rows], min(np.sqrt(apart**2 + 2 * variance) / 4, 1), rtol=1e-6)
    with pytest.raises(DataError, match="'deviation' holds standard deviations, from 0 up, got -1"):
        FrameTable(path=["a"], deviation=[-1])


def test_scale_is_the_largest_same_room_distance_of_all_pairs():
    frames = table(["A"] * 30 + ["B"] * 20 + ["C"])
    slow = max(
        float(np.hypot(*(frames.xy[i] - frames.xy[j])))
        for i, j in combinations(range(len(frames)), 2)
        if frames.room[i] == frames.room[j]
    )
    sampler = sampler_of(frames, "distance")
    assert sampler.scale == pytest.approx(slow)
    assert sampler.epoch(0).label.max() <= 1


@pytest.mark.parametrize("on_a_line", [True, False])
def test_scale_of_a_large_room_uses_the_hull(on_a_line):
    rng = np.random.default_rng(1)
    x = rng.uniform(0, 10, 1500)
    y = 2 * x if on_a_line else rng.uniform(0, 10, 1500)
    frames = FrameTable(path=np.arange(1500).astype(str), x=x, y=y)
    xy = frames.xy
    slow = max(float(np.hypot(*(xy - point).T).max()) for point in xy)
    assert sampler_of(frames, "distance").scale == pytest.approx(slow)


def two_buildings():
    x, building = [0, 10, 5, 0, 2, 1, 50], ["large"] * 3 + ["small"] * 4
    return FrameTable(path=list("abcdefg"), x=x, y=np.zeros(7), room=list("RRSRRRS"), building=building)


def test_each_building_has_its_own_scale():
    frames = two_buildings()
    sampler = sampler_of(frames, "distance", same_room_share=1, epoch_pairs=200)
    assert sampler.scale == {"large": 10, "small": 2}
    assert labels_of(sampler.epoch(0)) == {
        frozenset((0, 1)): 1,
        frozenset((3, 4)): 1,
        frozenset((3, 5)): 0.5,
        frozenset((4, 5)): 0.5,
    }


def test_another_sampler_takes_over_the_scale():
    frames = two_buildings()
    sampler = sampler_of(frames, "distance", epoch_pairs=200)
    again = sampler_of(frames.take([0, 2, 3, 5]), "distance", scale=sampler.scale, same_room_share=0, epoch_pairs=9)
    assert again.scale == {"large": 10, "small": 2}
    small = frames.select(building="small")
    assert sampler_of(small, "distance").scale == 2
    assert sampler_of(small, "distance", scale={"large": 10}).scale == {"large": 10, "small": 2}
    one = sampler_of(frames, "distance", same_room_share=1, scale=4, epoch_pairs=200)
    assert one.scale == 4
    assert set(one.epoch(0).label.tolist()) == {1, 0.5, 0.25}
    assert np.isnan(sampler_of(frames, "room").scale)


def test_frames_without_label_are_one_room_and_buildings_stay_apart():
    unlabelled = sampler_of(table([""] * 5))
    assert (unlabelled.label, unlabelled.same_room_share) == ("distance", 1)
    assert unlabelled.epoch(0).same.all()
    assert not sampler_of(table(["A", "A"]), "room", same_room_share=1).epoch(0).label.any()
    frames = table(["CR", "CR", "CR", "CR"], building=["a", "a", "b", "b"])
    drawn = sampler_of(frames, "room", epoch_pairs=50).epoch(0)
    assert (drawn.same == (frames.building[drawn.first] == frames.building[drawn.second])).all()


def test_every_pair_is_reachable_and_equally_likely():
    frames = table(["A", "A", "A", "B", "B"])
    drawn = sampler_of(frames, "room", same_room_share=0, epoch_pairs=12000, seed=0).epoch(0)
    counts = np.zeros((5, 5))
    np.add.at(counts, (drawn.first, drawn.second), 1)
    different = frames.room[:, None] != frames.room[None, :]
    assert (counts[~different] == 0).all()
    expected = np.where(different, 12000 / 5 / different.sum(axis=1, keepdims=True), 0)
    assert np.abs(counts - expected)[different].max() < 0.12 * expected.max()
    frames = table(["A"] * 90 + ["B"] * 10)
    pairs = sampler_of(frames, "room", same_room_share=1, epoch_pairs=4000).epoch(0)
    assert (frames.room[pairs.first] == "B").mean() == pytest.approx(0.1, abs=0.03)


@pytest.mark.parametrize(
    ("rooms", "options", "error", "says"),
    [
        (["A", "A"], {"label": "rooom"}, ConfigError, r"pairs\.label must be auto or room or distance, got 'rooom'"),
        (["A", "A"], {"scale": 0}, ConfigError, r"pairs\.scale must be a number above 0"),
        (["A"], {}, DataError, "at least two frames, got 1"),
        (["A", "A"], {"same_room_share": 0.5}, ConfigError, "one room, A"),
        (["A", "B"], {"same_room_share": 0.5}, ConfigError, "only one frame"),
        (["A", "A"], {"label": "room"}, ConfigError, "all 2 frames belong to one room, A, so"),
        (["", ""], {"label": "room"}, ConfigError, r"one room, \(no label\), .*: name the rooms"),
        (["A", "A", "B"], {"seed": -1}, ConfigError, "seed must be a whole number from 0 to .*, got -1"),
    ],
)
def test_impossible_requests_are_one_clear_sentence(rooms, options, error, says):
    with pytest.raises(error, match=says):
        sampler_of(table(rooms), **options)


def test_distance_needs_positions_that_differ():
    frames = table(["A", "A", "B", "B"])
    with pytest.raises(DataError, match="1 of 4 frames have no position"):
        sampler_of(frames.with_columns(x=[0, np.nan, 1, 2]), "distance")
    with pytest.raises(DataError, match="at one point"):
        sampler_of(frames.with_columns(x=[1, 1, 1, 1], y=[1, 1, 1, 1]), "distance")
    with pytest.raises(DataError, match="of a room of building small were taken at one point"):
        sampler_of(two_buildings().with_columns(x=[0, 10, 5, 1, 1, 1, 50]), "distance")
