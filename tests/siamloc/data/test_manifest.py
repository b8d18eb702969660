from __future__ import annotations

import csv
import io
import logging
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import siamloc.data
from siamloc.data.frames import FrameTable
from siamloc.data.manifest import COLUMNS
from siamloc.errors import DataError, SiamlocError


@pytest.fixture
def folder(tmp_path):
    for name in ("a.jpg", "b.jpg", "c, d.jpg"):
        (tmp_path / name).write_bytes(b"image")
    return tmp_path


def read(folder: Path, text: str | bytes, **options: str) -> FrameTable:
    path = folder / "frames.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return siamloc.data.read("manifest", manifest=path, **options)


def test_all_columns(folder):
    table = read(
        folder,
        "image,x,y,theta,room,sequence,lighting,time,building,odom_x,odom_y,odom_theta\n"
        "a.jpg,1,-2.5,1e-3,CR-A,drive,cloudy,10,lab,7,8,-40\nb.jpg,2,0,0,KT-A,drive,cloudy,11,lab,,,\n",
    )
    numbers = {"x": [1, 2], "y": [-2.5, 0], "theta": [1e-3, 0], "time": [10, 11]}
    numbers |= {"odom_x": [7, np.nan], "odom_y": [8, np.nan], "odom_theta": [-40, np.nan]}
    labels = {"sequence": ["drive"] * 2, "lighting": ["cloudy"] * 2, "building": ["lab"] * 2}
    paths = [str(folder / "a.jpg"), str(folder / "b.jpg")]
    expected = FrameTable(path=paths, room=["CR-A", "KT-A"], **numbers, **labels)
    assert table == expected
    assert read(folder, "image\na.jpg\n") == FrameTable(path=[str(folder / "a.jpg")])


def test_spreadsheet_habits(folder):
    """Byte-order mark, CRLF, quotes, blanks, other columns, blank lines, absolute names, an image in two sequences."""
    table = read(
        folder, b'\xef\xbb\xbfnote, Room ,X,"image"\r\nhello,"office ""1""",1.5,"c, d.jpg"\r\n,,,a.jpg\r\n\r\n , ,,\r\n'
    )
    assert table.path.tolist() == [str(folder / "c, d.jpg"), str(folder / "a.jpg")]
    assert table.room.tolist() == ['office "1"', ""]
    assert table.x[0] == 1.5
    assert math.isnan(table.x[1])
    table = read(folder, f"image,sequence\n{folder / 'a.jpg'},one\na.jpg,two\n")
    assert table.path.tolist() == [str(folder / "a.jpg")] * 2


def test_columns_that_are_not_used_are_reported(folder, caplog):
    with caplog.at_level(logging.WARNING, "siamloc"):
        read(folder, "image,romm,note,,x\na.jpg,kitchen,nice,,1\n")
        assert "frames.csv: unused columns: romm, note; valid: image, x, y, theta, room, sequence, " in caplog.text
        assert len(read(folder, f"image,{','.join(f'c{number}' for number in range(100_000))}\na.jpg\n")) == 1
    assert len(caplog.text) < 1000


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"frames\.csv is empty"),
        ("image,x\n\n,\n", "has a header but no rows"),
        ("imgae,x\na.jpg,1\n", "no column 'image', only imgae, x: name the columns"),
        ("image;x\na.jpg;1\n", "no column 'image', only image;x: .* separated by commas; valid: image, x, y"),
        ("image,x,X\na.jpg,1,2\n", "has 2 columns named 'x'"),
        ("image,x\na.jpg,1\nb.jpg,one\n", r"csv, line 3, column 'x': 'one' is not a number up to 1e\+07; leave the"),
        ("image,time\na.jpg,2026-05-12T10:15\n", "is not a number of seconds; convert dates to seconds"),
        ("image,time\na.jpg,1_0\n", r"frames\.csv, line 2, column 'time': '1_0' is not a number of seconds"),
        (
            "image,theta\na.jpg,'0,5'\n".replace("'", '"'),
            r"column 'theta': '0,5' is not a number of rad; write it with a decimal point, or",
        ),
        ("image,y\na.jpg,-1e999\n", r"frames\.csv, line 2, column 'y': '-1e999' is not a number up to"),
        ("image,x\n,1\n", r"frames\.csv, line 2, column 'image': empty"),
        ("image,x,y\na.jpg,1\n", r"frames\.csv, line 2: 2 cells, so there is none for column 'y'"),
        ("image,x\na.jpg,1,2\n", r"frames\.csv, line 2: 3 cells under 2 columns; quote"),
        ("image\na.jpg\nb.jpg\n./a.jpg\n", "line 4: image './a.jpg' is already in line 2 with the same sequence"),
        ("image,sequence\na.jpg,B\u00fcro\na.jpg,Bu\u0308ro\n", "image 'a.jpg' is already in line 2 with the same"),
        ('image\n"a.jpg\n', r"frames\.csv, line \d: not a CSV row"),
        ("image\na\0.jpg\n", r"frames\.csv, line 2: (the row has a NUL|not a CSV row)"),
        (b"image\n\xff.jpg\n", r"is not a CSV table in UTF-8 \(.*\): save it as UTF-8"),
    ],
)
def test_each_fault_is_named(folder, text, message):
    with pytest.raises(DataError, match=message):
        read(folder, text)


def test_missing_images_are_left_out_and_reported_and_a_missing_table_is_an_error(folder, caplog):
    text = "image,x\nnone.jpg,1\na.jpg,2\n"
    with caplog.at_level(logging.WARNING, "siamloc"):
        assert read(folder, text).x.tolist() == [2.0]
    (record,) = caplog.records
    assert re.search("1 of 2 images of .*none.jpg", record.message)
    with pytest.raises(DataError, match="1 of 2 images of"):
        read(folder, text, on_error="raise")
    with pytest.raises(DataError, match=r"none\.csv cannot be read: No such file"):
        siamloc.data.read("manifest", manifest=folder / "none.csv")
    with pytest.raises(DataError, match=r"1 of 1 images .*relative to the table's folder.*nothing remains"):
        read(folder, "image\nnone.jpg\n")
    with pytest.raises(DataError, match=r"relative to the table's folder; write / for \\ in paths\), the first:"):
        read(folder, "image\nday\\none.jpg\n")


def test_a_pattern_reads_all_tables_that_fit_each_from_its_own_folder(tmp_path, monkeypatch):
    monday = "image,x,sequence,time\nb.jpg,1,mon,2\na.jpg,2,mon,1\n"
    tables = {"mon": monday, "tue": "image,room,sequence\na.jpg,hall,tue\n"}
    for name, text in tables.items():
        (tmp_path / f"{name}_frames").mkdir()
        for image in ("a.jpg", "b.jpg"):
            (tmp_path / f"{name}_frames" / image).write_bytes(b"image")
        (tmp_path / f"{name}_frames" / "frames.csv").write_text(text)
    monkeypatch.chdir(tmp_path)
    frames = siamloc.data.read("manifest", manifest="*_frames/frames.csv")
    assert [Path(path).relative_to(tmp_path).as_posix() for path in map(os.path.abspath, frames.path.tolist())] == [
        "mon_frames/a.jpg", "mon_frames/b.jpg", "tue_frames/a.jpg",
    ]  # fmt: skip
    assert frames.sequence.tolist() == ["mon", "mon", "tue"]
    assert frames.room.tolist() == ["", "", "hall"]
    np.testing.assert_equal(frames.x, [2, 1, np.nan])
    monkeypatch.chdir("/")
    assert siamloc.data.read(**frames.source).sequence.tolist() == ["mon", "mon", "tue"], "from wherever it is called"
    (tmp_path / "tue_frames" / "frames.csv").write_text("image,sequence\na.jpg,mon\n")
    with pytest.raises(DataError, match=r"sequence 'mon' is in .*mon_frames/.* and in .*tue_frames/.*name of its own"):
        siamloc.data.read("manifest", manifest=tmp_path / "*_frames" / "frames.csv")
    with pytest.raises(DataError, match=r"no file fits the pattern .*\*\.txt"):
        siamloc.data.read("manifest", manifest=tmp_path / "*.txt")


@pytest.mark.parametrize("name", ["/dev/zero", "/dev/stdin", "folder", "pipe"])
def test_only_a_regular_file_is_a_manifest(tmp_path, name):
    """A pipe would keep the reader waiting, an endless device reading for ever."""
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(DataError, match=rf"the manifest .*{name} is not a regular file: give a CSV table"):
        siamloc.data.read("manifest", manifest=tmp_path / name)


labels = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=8).map(str.strip)
numbers = st.one_of(st.just(math.nan), st.floats(allow_nan=False, allow_infinity=False))
positions = st.one_of(st.just(math.nan), st.floats(-1e7, 1e7))
rows = st.fixed_dictionaries(
    dict.fromkeys(("x", "y", "odom_x", "odom_y", "odom_theta", "roll", "pitch"), positions)
    | dict.fromkeys(("deviation", "theta_deviation"), positions.map(abs))
    | dict.fromkeys(("theta", "time"), numbers)
    | dict.fromkeys(("room", "sequence", "lighting", "building"), labels)
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=30)
@given(st.lists(rows, min_size=1, max_size=5), st.permutations(COLUMNS))
def test_whatever_table_is_written_is_read_back(tmp_path, frames, columns):
    for number, frame in enumerate(frames):
        frame["image"] = f"image {number}.jpg"
        (tmp_path / frame["image"]).touch()
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(columns)
    for frame in frames:
        cells = [frame[name] for name in columns]
        writer.writerow(["" if isinstance(cell, float) and math.isnan(cell) else cell for cell in cells])
    table = read(tmp_path, text.getvalue(), on_error="raise")
    written = FrameTable.from_rows([{"path": str(tmp_path / frame.pop("image")), **frame} for frame in frames])
    rows = [written.path.tolist().index(path) for path in table.path.tolist()]
    expected = {name: column[rows] for name, column in written.columns().items()}
    assert table == FrameTable(**expected)


def test_rows_come_in_order_of_time_inside_a_sequence(folder):
    text = "image,sequence,time\na.jpg,one,3\nb.jpg,two,2\nc.jpg,one,1\nd.jpg,two,\ne.jpg,one,2\nf.jpg,one,1\n"
    for name in "cdef":
        (folder / f"{name}.jpg").write_bytes(b"image")
    table = read(folder, text)
    assert [Path(path).stem for path in table.path.tolist()] == ["c", "b", "f", "d", "e", "a"]
    assert table.sequence.tolist() == ["one", "two", "one", "two", "one", "one"]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=150)
@given(st.one_of(st.binary(max_size=120), st.text(st.sampled_from('ab,"\n\r\0;x1e9.é'), max_size=60).map(str.encode)))
def test_garbage_raises_nothing_but_our_errors(folder, garbage):
    for text in (garbage, b"image,x,y\na.jpg,1,2\n" + garbage, b"image,x\n" + garbage):
        try:
            table = read(folder, text)
        except SiamlocError:
            continue
        assert len(table) >= 1
        assert not np.isinf(table.xy).any()
