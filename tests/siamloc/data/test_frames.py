from __future__ import annotations

import copy
import math
import pickle
from datetime import datetime
from unicodedata import normalize

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from siamloc.data.frames import FrameTable, concatenate
from siamloc.data.image_files import image_files
from siamloc.data.protocol import Protocol
from siamloc.errors import ConfigError, DataError


def table(n: int = 6) -> FrameTable:
    return FrameTable(
        path=[f"{i}.jpg" for i in range(n)],
        x=np.arange(n) * 0.5,
        y=np.zeros(n),
        room=["a", "b", ""] * (n // 3),
        sequence=["seq2_cloudy1", "seq2_night1"] * (n // 2),
        building=["one"] * (n // 2) + [""] * (n - n // 2),
    )


def numbers(frames: FrameTable) -> list[int]:
    """The rows of the first table that a selection shows, from its file names."""
    return [int(path.split(".")[0]) for path in frames.path.tolist()]


def test_columns_that_are_left_out_are_filled():
    frames = FrameTable(path=["a", "b"], x=np.zeros(2))
    assert np.isnan([frames.y, frames.theta, frames.time]).all()
    assert [column.tolist() for column in (frames.room, frames.lighting, frames.building)] == [["", ""]] * 3
    assert not frames.has_position.any()
    with pytest.raises(DataError, match=r"column 'x' has shape \(1,\), expected \(2,\) like 'path'"):
        FrameTable(path=["a", "b"], x=[1.0])
    frames = FrameTable(path=["a", "b"], odom_x=[1, 2], odom_theta=[0, 0.5])
    np.testing.assert_equal(frames.odometry, [[1, np.nan, 0], [2, np.nan, 0.5]])
    np.testing.assert_equal(concatenate([frames, frames]).take([3]).odometry, [[2, np.nan, 0.5]])


class NotAvailable:
    """Like the missing value of pandas, it compares as itself, which is neither true nor false."""

    def __ne__(self, other):
        return self

    def __bool__(self):
        raise TypeError("boolean value of NA is ambiguous")


@pytest.mark.parametrize(
    "rooms",
    [
        ["hall", None],
        ["hall", math.nan],
        ["hall", NotAvailable()],
        np.array(["hall", None]),
        np.array(["hall", np.nan], dtype=object),
    ],
)
def test_a_label_that_is_none_or_nan_is_missing(rooms):
    frames = FrameTable(path=["a", "b"], room=rooms)
    assert frames.room.tolist() == ["hall", ""]
    assert frames.with_columns(lighting=[math.nan, np.float32("nan")]).lighting.tolist() == ["", ""]
    assert FrameTable.from_rows([{"path": "a", "room": None}]).room.tolist() == [""]
    assert FrameTable(path=["a", "b"], room=np.array([3.0, np.nan])).room.tolist() == ["3.0", ""]


def test_masked_values_are_missing():
    masked = {name: np.ma.array(values, mask=[0, 1]) for name, values in {"x": [1, 2], "y": [1.5, 2.5]}.items()}
    frames = FrameTable(path=["a", "b"], room=np.ma.array(["hall", "lab"], mask=[0, 1]), **masked)
    np.testing.assert_equal(frames.xy, [[1, 1.5], [np.nan, np.nan]])
    assert frames.room.tolist() == ["hall", ""]
    with pytest.raises(DataError, match="1 of 2 are missing, the first in row 0"):
        FrameTable(path=np.ma.array(["a", "b"], mask=[1, 0]))


@pytest.mark.parametrize(
    "times",
    [
        np.array(["2026-05-12T10:15:00", "2026-05-12T10:15:05"], "datetime64[ns]"),
        [np.timedelta64(0, "s"), np.timedelta64(5, "s")],
        np.array([0.0, np.timedelta64(5, "s")], dtype=object),
        [datetime(2026, 5, 12), datetime(2026, 5, 13)],
    ],
)
def test_dates_and_durations_are_no_numbers(times):
    with pytest.raises(DataError, match=r"dates or durations, so give seconds: t = np\.array"):
        FrameTable(path=["a", "b"], time=times)
    with pytest.raises(DataError, match=r"column 'x' must hold numbers, one for each frame: got dates or durations$"):
        FrameTable(path=["a", "b"], x=times)


def test_a_column_of_another_library_is_a_list_of_image_files_and_a_single_one_is_not():
    class Series:  # as those of pandas, no Sequence
        def __len__(self):
            return 2

        def __array__(self, dtype=None, copy=None):
            return np.array(["a.jpg", "b.jpg"], dtype=dtype)

    assert FrameTable(path=Series()).path.tolist() == ["a.jpg", "b.jpg"]
    for wrong in ("a.jpg", None, np.array("a.jpg"), [["a.jpg"]]):
        with pytest.raises(DataError, match="column 'path' must be a list of image files, got"):
            FrameTable(path=wrong)


@pytest.mark.parametrize("missing", [None, math.nan, NotAvailable()])
def test_a_frame_without_an_image_file_is_refused(missing):
    says = "column 'path' must hold texts, one for each frame: 2 of 3 are missing, the first in row 1"
    with pytest.raises(DataError, match=says):
        FrameTable(path=["a", missing, missing])


def test_equality_counts_nan_as_equal_and_rows_make_the_table_again():
    assert table() == table()
    assert table() not in (table().with_columns(x=np.arange(6)), table(3 * 4), "table")
    assert FrameTable.from_rows(iter(table())) == table()
    row = next(iter(table()))
    assert row["path"] == "0.jpg"
    assert row["building"] == "one"
    assert math.isnan(row["theta"])


@pytest.mark.parametrize(
    ("key", "nearest"), [("image", "path"), ("rom", "room"), ("odometry_x", "odom_x"), ("sequences", "sequence")]
)
def test_a_key_that_names_no_column_is_refused_with_the_nearest_name(key, nearest):
    with pytest.raises(DataError, match=f"frames have no column '{key}'; did you mean '{nearest}'"):
        FrameTable.from_rows([{"path": "1.jpg"}, {"path": "2.jpg", key: "3"}])
    with pytest.raises(DataError, match=f"frames have no column '{key}'; did you mean '{nearest}'"):
        table().with_columns(**{key: range(6)})


def test_select_by_labels_and_patterns():
    frames = table()
    assert numbers(frames.select(room="a")) == [0, 3]
    assert numbers(frames.select(room=["a", "b"], sequence="*_night?")) == [1, 3]
    assert numbers(frames.select(building="")) == [3, 4, 5]
    with pytest.raises(ConfigError, match="no frame has sequence 'seq2_cloudy2'; did you mean 'seq2_cloudy1'"):
        frames.select(sequence="seq2_cloudy2")
    with pytest.raises(ConfigError, match="cannot be selected by 'rooms'; did you mean 'room'"):
        frames.select(rooms="a")
    frames = FrameTable(path=["0.png", "1.png"], sequence=["one", ""])
    with pytest.raises(ConfigError, match=r"^no frame has room 'kitchen'; valid: none$"):
        frames.select(room="kitchen")
    with pytest.raises(ConfigError, match=r"^no frame has sequence 'two'; valid: one$"):
        frames.select(sequence="two")
    assert numbers(frames.select(room="")) == [0, 1]


def test_a_label_that_frames_carry_is_no_pattern():
    frames = FrameTable(path=["0.png", "1.png", "2.png"], sequence=["Tag [1]", "Tag 1", "Abend"])
    assert numbers(frames.select(sequence="Tag [1]")) == [0]
    assert numbers(frames.take([1, 2]).select(sequence="Tag [1]")) == [1]
    assert Protocol.of({"map": {"sequences": ["Tag [1]"]}}).without_role(frames) == ["Tag 1", "Abend"]


def test_a_label_is_the_same_whether_its_accents_are_characters_of_their_own():
    one, two = (normalize(form, "Büro") for form in ("NFC", "NFD"))
    frames = FrameTable(path=[f"{two}/1.jpg", "2.jpg", "3.jpg"], room=[one, two, "Bad"], sequence=[two, one, "b"])
    assert frames.path[0] == f"{two}/1.jpg", "a path names a file"
    assert (frames.room.tolist(), frames.sequence.tolist()) == ([one, one, "Bad"], [one, one, "b"])
    for wanted in (one, two, two[:-1] + "*"):
        assert numbers(frames.select(room=wanted).take([1])) == [2]
    assert Protocol.of({"map": {"sequences": [two]}}).without_role(frames) == ["b"]


@given(st.lists(st.sampled_from("abc"), max_size=30), st.integers(1, 7))
def test_every_k_agrees_with_counting(sequences, k):
    frames = FrameTable(path=[str(i) for i in range(len(sequences))], sequence=np.array(sequences, dtype=np.str_))
    seen: dict[str, int] = {}
    expected = []
    for row, sequence in enumerate(sequences):
        if seen.get(sequence, 0) % k == 0:
            expected.append(row)
        seen[sequence] = seen.get(sequence, 0) + 1
    assert numbers(frames.every(k)) == expected


@given(
    st.lists(st.tuples(st.sampled_from("ab"), st.integers(-3, 3), st.integers(-3, 3)), max_size=30),
    st.sampled_from([0.5, 1.0, 2.0, 100.0]),
)
def test_spacing_agrees_with_walking_along(steps, metres):
    n = len(steps)
    sequences, x, y = zip(*steps, strict=True) if steps else ([], [], [])
    frames = FrameTable(path=np.arange(n).astype(str), sequence=np.array(sequences, dtype=np.str_), x=x, y=y)
    last: dict[str, tuple[int, int]] = {}
    expected = []
    for row, (sequence, x, y) in enumerate(steps):
        if sequence not in last or math.dist(last[sequence], (x, y)) >= metres:
            expected.append(row)
            last[sequence] = (x, y)
    assert numbers(frames.spaced(metres)) == expected


def test_steps_and_spacings_are_positive():
    with pytest.raises(ConfigError, match="k must be a whole number from 1"):
        table().every(0)
    with pytest.raises(ConfigError, match="metres must be a number above 0, got 0"):
        table().spaced(0)
    with pytest.raises(DataError, match="2 of 2 frames have no position"):
        FrameTable(path=["a", "b"]).spaced(1.0)


def test_unit_and_source_are_kept_and_do_not_count_for_equality():
    source = {"kind": "manifest", "manifest": "/robot.csv"}
    frames = table().with_columns(unit="px", source=source)
    assert frames == table()
    parts = [frames.select(room="a"), frames.take([1]), frames.every(2), frames.spaced(1.0)]
    for part in (*parts, frames.with_columns(x=np.zeros(6)), concatenate([frames, frames.take([0])])):
        assert (part.unit, part.source) == ("px", source)
    joined = concatenate([frames.take([5, 1]), FrameTable(path=["a longer name"], room=["a room"], unit="px")])
    assert (joined.path.tolist(), joined.room.tolist()) == (["5.jpg", "1.jpg", "a longer name"], ["", "b", "a room"])
    assert joined.source == {}
    assert len(concatenate([])) == 0
    with pytest.raises(DataError, match="positions count in px and m cannot be joined"):
        concatenate([frames, table()])


def test_frames_are_known_by_sequence_and_absolute_path_and_rooms_by_building(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert FrameTable(path=["a/../b.jpg"], sequence=["one"]).identities() == [("one", str(tmp_path / "b.jpg"))]
    assert table().place.tolist() == ["one/a", "one/b", "one/", "a", "b", ""]


def test_copies_are_read_only_too():
    for copied in (copy.deepcopy(table()), pickle.loads(pickle.dumps(table()))):
        assert copied == table()
        with pytest.raises(ValueError, match="read-only"):
            copied.x[0] = 1


def test_image_files_are_in_the_order_of_their_numbers_and_then_of_their_names(tmp_path):
    names = ["0002.png", "002.png", "02.png", "2.png", "a9.5.png", "a10.png"]
    for name in ["2.png", "a10.png", "002.png", "02.png", "0002.png", "a9.5.png"]:
        (tmp_path / name).touch()
    assert [file.name for file in image_files(tmp_path)] == names
