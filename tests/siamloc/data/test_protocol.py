import math
from itertools import pairwise

import numpy as np
import pytest

from siamloc.data.frames import FrameTable
from siamloc.data.protocol import Protocol, Role
from siamloc.errors import ConfigError, DataError


@pytest.fixture
def table():
    names = ["cloudy1", "cloudy2", "night1"]
    labels = {"sequence": np.repeat(names, 10), "lighting": np.repeat(["cloudy", "cloudy", "night"], 10)}
    paths, rooms = [f"{name}/{i}" for name in names for i in range(10)], list("AAAAABBBBB") * 3
    return FrameTable(path=paths, x=np.tile(np.arange(10.0), 3), y=np.zeros(30), room=rooms, **labels)


def protocol(kind="cross_run", **roles):
    return Protocol.of({"kind": kind, **{role: {"sequences": names} for role, names in roles.items()}})


def test_roles_select_by_sequence_pattern_room_lighting_and_step(table):
    chosen = Role(sequences=["*1"], rooms=["B"], lightings=["night"], every=2).select(table)
    assert chosen.path.tolist() == ["night1/5", "night1/7", "night1/9"]
    assert Role(sequences=["cloudy1"], spacing=4.0).select(table).x.tolist() == [0, 4, 8]
    assert len(Role().select(table)) == 30


def test_the_map_is_made_of_the_training_sequences_unless_told(table):
    given = Protocol.of({"train": {"sequences": "cloudy1"}, "map": {"every": 5}})
    assert given.frames("map", table).path.tolist() == ["cloudy1/0", "cloudy1/5"]
    assert Protocol().excluded(table, table) is None


@pytest.mark.parametrize(
    ("roles", "asked"),
    [
        ({"train": ["cloudy1"], "query": ["cloudy*"]}, "query"),
        ({"train": ["*1"], "validation": ["night1"]}, "validation"),
        ({"validation": ["night1"], "query": ["night1"]}, "validation"),
        ({"kind": "same_run", "validation": ["night1"], "query": ["night1"]}, "query"),
    ],
)
def test_what_must_stay_apart_is_kept_apart(table, roles, asked):
    with pytest.raises(ConfigError, match="not be honest"):
        protocol(**roles).frames(asked, table)


@pytest.mark.parametrize(
    ("config", "says"),
    [
        ({"kind": "crossrun"}, "protocol.kind must be cross_run or same_run, got 'crossrun'"),
        ({"trian": {}}, "did you mean 'train'"),
        ({"train": {"sequence": ["a"]}}, "did you mean 'sequences'"),
        ({"train": {"sequences": ["a"], "every": 2, "spacing": 1.0}}, "not both"),
    ],
)
def test_mistaken_protocols_are_one_sentence(config, says):
    with pytest.raises(ConfigError, match=says):
        Protocol.of(config)


def test_an_unfilled_role_says_what_there_is(table):
    with pytest.raises(ConfigError, match=r"protocol.query.sequences is not set.*cloudy1 10, cloudy2 10, night1 10"):
        protocol(train=["cloudy1"]).frames("query", table)
    with pytest.raises(ConfigError, match="did you mean 'night1'"):
        protocol(query=["nigth1"]).frames("query", table)
    with pytest.raises(ConfigError, match=r"^protocol\.query: no frame has room 'C'; valid: A, B"):
        Protocol.of({"query": {"sequences": ["night1"], "rooms": ["C"]}}).frames("query", table)


def naive_exclusion(queries, known, settings, drives):
    """Compare every query with every map frame, and walk the drive between the two."""
    excluded = np.zeros((len(queries), len(known)), dtype=bool)
    for row, query in enumerate(queries):
        for column, frame in enumerate(known):
            if settings.get("leave_one_out") and query["path"] == frame["path"]:
                excluded[row, column] = True
            if query["sequence"] != frame["sequence"]:
                continue
            if abs(query["time"] - frame["time"]) < settings.get("apart_seconds", 0):
                excluded[row, column] = True
            drive = [one for one in drives if one["sequence"] == query["sequence"]]
            paths = [one["path"] for one in drive]
            ends = sorted([paths.index(query["path"]), paths.index(frame["path"])])
            between = [(one["x"], one["y"]) for one in drive[ends[0] : ends[1] + 1]]
            way = sum(math.dist(a, b) for a, b in pairwise(between))
            if way < settings.get("apart_metres", 0):
                excluded[row, column] = True
    return excluded


@pytest.mark.parametrize(
    "settings",
    [
        {"leave_one_out": True},
        {"apart_seconds": 2.5},
        {"apart_metres": 3.0},
        {"leave_one_out": True, "apart_seconds": 1e-9, "apart_metres": 4.5},
    ],
)
def test_what_is_excluded_agrees_with_walking_the_drive(settings):
    """Two drives, taken in turns, that come back to where they were: near by is not the same as a short way."""
    rng = np.random.default_rng(3)
    n = 60
    frames = FrameTable(
        path=[f"{i}.jpg" for i in range(n)],
        sequence=np.where(rng.random(n) < 0.5, "monday", "tuesday"),
        x=np.cos(np.arange(n) / 3) * 3,
        y=np.sin(np.arange(n) / 3) * 3,
        time=np.cumsum(rng.uniform(0.1, 1.5, n)),
    )
    queries, known = frames.take(rng.permutation(n)[:25]), frames.take(np.sort(rng.permutation(n)[:30]))
    expected = naive_exclusion(queries, known, settings, frames)
    np.testing.assert_array_equal(Protocol(**settings).excluded(queries, known, frames), expected)
    assert 0 < expected.sum() < expected.size
    in_map = naive_exclusion(known, frames, settings, frames)
    np.testing.assert_array_equal(Protocol(**settings).excluded(known, frames), in_map)
    np.testing.assert_array_equal(Protocol(**settings).excluded(frames, known), in_map.T)


def test_the_order_of_two_selections_comes_from_their_times_or_from_the_drive(table):
    queries, known = table.select(sequence="cloudy1").take([1, 3, 5]), table.every(2)
    apart = Protocol(apart_metres=1.5)
    with pytest.raises(DataError, match="needs the order in which the frames were taken: give times, or the whole"):
        apart.excluded(queries, known)
    timed = table.with_columns(time=np.arange(30.0))
    found = apart.excluded(queries, known, table)
    assert found.sum(axis=1).tolist() == [2, 2, 2]
    queries, known = timed.select(sequence="cloudy1").take([5, 1, 3]), timed.every(2)
    np.testing.assert_array_equal(apart.excluded(queries, known), found[[2, 0, 1]])


def test_the_order_of_the_rows_does_not_matter_where_times_are_known(table):
    drive = table.select(sequence="cloudy1").with_columns(time=np.arange(10.0))
    apart, rows = Protocol(apart_metres=1.5), np.array([3, 1, 5, 0, 2, 4, 9, 7, 6, 8])
    whole = apart.excluded(drive, drive)
    assert whole.sum() == 28
    mixed = drive.take(rows)
    np.testing.assert_array_equal(apart.excluded(mixed, mixed), whole[np.ix_(rows, rows)])
    np.testing.assert_array_equal(apart.excluded(mixed, drive.every(2)), whole[rows][:, ::2])
    np.testing.assert_array_equal(apart.excluded(drive.every(2), mixed), whole[::2][:, rows])


def test_exclusion_names_what_it_lacks(table):
    with pytest.raises(DataError, match=r"^10 frames of sequence 'cloudy1' have no time, which protocol\.apart_s"):
        Protocol(apart_seconds=1.0).excluded(table, table)
    with pytest.raises(DataError, match=r"^10 frames"):
        Protocol(apart_seconds=1.0).excluded(table.every(5), table)
    unplaced = table.with_columns(x=np.full(30, np.nan))
    with pytest.raises(DataError, match=r"have no position along a drive.*apart_metres needs.*or leave_one_out"):
        Protocol(apart_metres=1.0).excluded(unplaced, unplaced)
    assert Protocol(leave_one_out=True).excluded(unplaced, unplaced).sum() == 30
    others = table.select(sequence="night1")
    assert not Protocol(apart_seconds=1.0).excluded(others, table.select(sequence="cloudy*")).any()


@pytest.mark.parametrize("settings", [{"leave_one_out": True}, {"apart_seconds": 2}, {"apart_metres": 0.5}])
def test_queries_of_the_maps_own_run_are_honest_when_near_frames_are_out(table, settings):
    roles = {"map": {"sequences": "cloudy1"}, "query": {"sequences": "cloudy1"}}
    assert len(Protocol.of({**roles, **settings}).frames("query", table)) == 10
    with pytest.raises(ConfigError, match=r"protocol\.map.*keep near frames out with protocol\.leave_one_out=true"):
        Protocol.of(roles).frames("query", table)
    with pytest.raises(ConfigError, match=r"protocol\.query and in protocol\.train"):
        Protocol.of({**roles, **settings, "train": {"sequences": "cloudy1"}}).frames("query", table)
    with pytest.raises(ConfigError, match=r"protocol\.apart_metres must be a number above 0"):
        Protocol(apart_metres=0)


def test_a_role_begins_later_or_takes_the_rest():
    frames = FrameTable(
        path=[f"{i}.png" for i in range(14)], sequence=["a"] * 7 + ["b"] * 7, x=np.arange(14), y=[0] * 14
    )

    def numbers(**settings):
        return [int(path.partition(".")[0]) for path in Role(sequences=("*",), **settings).select(frames).path]

    assert numbers(every=3, offset=1) == [1, 4, 8, 11]
    assert numbers(every=3, offset=1, rest=True) == [0, 2, 3, 5, 6, 7, 9, 10, 12, 13]
    assert numbers(spacing=2.5, rest=True) == [1, 2, 4, 5, 8, 9, 11, 12]
    for wrong, says in (
        ({"offset": 1}, "offset=1 goes with an every that is larger, got every=null"),
        ({"every": 3, "offset": 3}, "goes with an every that is larger, got every=3"),
        ({"rest": True}, "rest=true keeps what every or spacing leaves out"),
    ):
        with pytest.raises(ConfigError, match=says):
            numbers(**wrong)
    assert str(Role(sequences=("a",), every=3, rest=True)) == "sequences a, every 3, rest True"
    both = Protocol(kind="same_run", map=Role(("a",), every=3), query=Role(("a",), every=3, rest=True))
    known, queries = both.frames("map", frames), both.frames("query", frames)
    assert sorted([*known.path, *queries.path]) == sorted(frames.path[:7])
