from __future__ import annotations

import logging
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import siamloc.data
from siamloc.data.names import name_sequence
from siamloc.errors import DataError, SiamlocError
from tests.oracles.cold_lists import read_list

COLD_PLACES = Path(__file__).parents[3] / "../shared/data/cold_places"
BUILDINGS = ["freiburg_a", "freiburg_b", "ljubljana", "saarbruecken_a", "saarbruecken_b"]

IMAGES = [f"t{time}.5_x{time}.25_y-0.5_a1e-05.jpeg" for time in (1, 2, 3)]
LIST = "".join(f"{image} {room}\n" for image, room in zip(IMAGES, ["CR-A", "CR-A", "KT-A"], strict=True))


def make_sequence(folder: Path, text: str | None = LIST, where: str = "localization", camera: str = "omni_cam") -> Path:
    (folder / camera).mkdir(parents=True)
    for image in IMAGES:
        (folder / camera / image).write_bytes(b"image")
    if text is not None:
        (folder / where).mkdir(exist_ok=True)
        (folder / where / "places.lst").write_text(text)
    return folder


@pytest.mark.data
@pytest.mark.skipif(not COLD_PLACES.is_dir(), reason=f"{COLD_PLACES} is missing")
def test_the_real_lists_agree_with_reading_them_by_hand():
    table = siamloc.data.read("cold", root=COLD_PLACES)
    assert len(table) == 21456
    assert len(set(table.sequence.tolist())) == 11
    assert sorted({name.rpartition("_seq")[0] for name in table.sequence.tolist()}) == BUILDINGS
    assert sorted(set(table.building.tolist())) == BUILDINGS
    for path in sorted(COLD_PLACES.glob("*.places.lst")):
        stem = path.name.removesuffix(".places.lst")
        folder = COLD_PLACES / stem / "omni_cam"
        rows = np.flatnonzero([Path(p).parent == folder for p in table.path.tolist()])
        part = table.take(rows)
        expected = read_list(path)
        assert part.path.tolist() == [str(folder / frame[0]) for frame in expected]
        assert part.room.tolist() == [frame[1] for frame in expected]
        got = np.column_stack([part.time, part.x, part.y, part.theta])
        np.testing.assert_array_equal(got, [frame[2:] for frame in expected])
        assert siamloc.data.read("cold", places=path) == part
        assert set(part.lighting.tolist()) == {next(name for name in ("cloudy", "night", "sunny") if name in stem)}


@pytest.mark.parametrize("folder", ["freiburg/part_a/seq2_cloudy3", "cold-freiburg_part_a_seq2_cloudy3"])
@pytest.mark.parametrize("where", ["localization", "."])
@pytest.mark.parametrize("levels_up", [0, 1, 2, 3])
def test_a_sequence_is_found_from_any_folder_above_it(tmp_path, folder, where, levels_up):
    sequence = make_sequence(tmp_path / "data" / "COLD" / folder, where=where)
    root = [sequence, *sequence.parents][levels_up]
    table = siamloc.data.read("cold", root=str(root))
    assert table.path.tolist() == [str(sequence / "omni_cam" / image) for image in IMAGES]
    assert set(table.sequence.tolist()) == {"freiburg_a_seq2_cloudy3"}
    assert set(table.building.tolist()) == {"freiburg_a"}
    assert set(table.lighting.tolist()) == {"cloudy"}
    assert table.room.tolist() == ["CR-A", "CR-A", "KT-A"]
    np.testing.assert_array_equal(table.xy, [(1.25, -0.5), (2.25, -0.5), (3.25, -0.5)])
    np.testing.assert_array_equal([table.theta, table.time], [[1e-5] * 3, [1.5, 2.5, 3.5]])


@pytest.mark.parametrize(
    ("folder", "rooms", "sequence", "building"),
    [
        ("/d/freiburg/part_b/seq3_cloudy1", ["CR-B"], "freiburg_b_seq3_cloudy1", "freiburg_b"),
        ("/d/COLD-Freiburg/part_A/seq2_Sunny2", [], "freiburg_a_seq2_sunny2", "freiburg_a"),
        ("/d/cold-freiburg_part_a/seq2_night1", [], "freiburg_a_seq2_night1", "freiburg_a"),
        ("/d/cold_saarbruecken_part_b_seq4_night2", [], "saarbruecken_b_seq4_night2", "saarbruecken_b"),
        ("/d/freiburg_seq2_cloudy3", ["KT-A", "CR-A"], "freiburg_a_seq2_cloudy3", "freiburg_a"),
        ("/d/freiburg_seq2_cloudy3", ["KT-A", "CR-B"], "freiburg_seq2_cloudy3", "freiburg"),
        ("/d/freiburg_seq2_cloudy3", ["KT-A", "CR"], "freiburg_seq2_cloudy3", "freiburg"),
        ("/d/freiburg/part_b/seq2_cloudy3", ["KT-A"], "freiburg_b_seq2_cloudy3", "freiburg_b"),
        ("/d/ljubljana/seq1_cloudy1", ["CR"], "ljubljana_seq1_cloudy1", "ljubljana"),
        ("/d/x/seq1_cloudy1", ["CR"], "seq1_cloudy1", ""),
        ("/d/lab/part_a/seq1_cloudy1", ["CR"], "lab_a_seq1_cloudy1", "lab_a"),
        ("/d/lab/part_a/seq1_cloudy1_month12", ["CR"], "lab_a_seq1_cloudy1_month12", "lab_a"),
        ("/d/lab-2_part_c_seq1_night", [], "lab-2_c_seq1_night", "lab-2_c"),
        ("/d/freiburg/my_sunny_drive", ["CR-A"], "label", ""),
    ],
)
def test_names_of_sequences(folder, rooms, sequence, building):
    name = name_sequence(Path(folder), "label", rooms)
    assert (name.sequence, name.building) == (sequence, building)
    assert name.lighting
    assert name.lighting in folder.lower()


def test_sequences_of_several_buildings_keep_their_folders_apart(tmp_path):
    make_sequence(tmp_path / "freiburg/part_a/seq2_cloudy1")
    make_sequence(tmp_path / "freiburg/part_b/seq2_cloudy1")
    make_sequence(tmp_path / "one/drive")
    make_sequence(tmp_path / "two/drive")
    table = siamloc.data.read("cold", root=tmp_path)
    names = ["freiburg_a_seq2_cloudy1", "freiburg_b_seq2_cloudy1", "one/drive", "two/drive"]
    assert list(table.rows_by("sequence")) == names
    assert len(table) == 12


def test_odometry_is_read_from_the_table_next_to_the_list(tmp_path):
    folder = make_sequence(tmp_path / "freiburg/part_a/seq2_cloudy1")
    assert np.isnan(siamloc.data.read("cold", root=tmp_path).odometry).all()
    table = folder / "localization/odometry.csv"
    table.write_text(f"image,odom_x,odom_y,odom_theta\n{IMAGES[2]},1,2,3\n{IMAGES[0]},0,0,0\nnone.jpeg,9,9,9\n")
    for where in ({"root": tmp_path}, {"places": folder / "localization/places.lst"}):
        found = siamloc.data.read("cold", **where)
        np.testing.assert_equal(found.odometry, [[0, 0, 0], [np.nan] * 3, [1, 2, 3]])
        np.testing.assert_array_equal(found.x, [1.25, 2.25, 3.25])
    table.write_text(f"image,odom_x,odom_theta\n{IMAGES[2]},1,wide\n")
    with pytest.raises(DataError, match=r"odometry\.csv, line 2, column 'odom_theta': 'wide' is not a number"):
        siamloc.data.read("cold", root=tmp_path)
    table.write_text("image,odom_x\n1.jpeg,1\n")
    with pytest.raises(DataError, match=r"odometry\.csv names no image of places\.lst next to it, but 1\.jpeg: use"):
        siamloc.data.read("cold", root=tmp_path)


def test_the_same_sequence_twice_is_an_error(tmp_path):
    make_sequence(tmp_path / "freiburg/part_a/seq2_cloudy1")
    make_sequence(tmp_path / "cold-freiburg_part_a_seq2_cloudy1")
    with pytest.raises(DataError, match=r"freiburg_a_seq2_cloudy1 appears twice.*remove one"):
        siamloc.data.read("cold", root=tmp_path)
    for label in ("B\u00fcro", "Bu\u0308ro"):
        make_sequence(tmp_path / "other" / label)
    with pytest.raises(DataError, match="B\u00fcro appears twice"):
        siamloc.data.read("cold", root=tmp_path / "other")


def test_links_are_followed_but_none_shows_a_sequence_twice(tmp_path):
    make_sequence(tmp_path / "freiburg/part_a/seq2_cloudy1")
    (tmp_path / "freiburg/again").symlink_to(tmp_path, target_is_directory=True)
    assert len(siamloc.data.read("cold", root=tmp_path)) == 3
    (tmp_path / "root").mkdir()
    (tmp_path / "root/freiburg_a_seq2_cloudy1").symlink_to(tmp_path / "freiburg/part_a/seq2_cloudy1")
    assert len(siamloc.data.read("cold", root=tmp_path / "root")) == 3


def test_without_a_list_the_frames_are_the_images(tmp_path):
    folder = make_sequence(tmp_path / "freiburg/part_a/seq2_night1", None)
    table = siamloc.data.read("cold", root=tmp_path)
    assert table.path.tolist() == [str(folder / "omni_cam" / image) for image in IMAGES]
    assert set(table.room.tolist()) == {""}
    assert set(table.sequence.tolist()) == {"freiburg_a_seq2_night1"}
    np.testing.assert_array_equal(table.x, [1.25, 2.25, 3.25])


@pytest.mark.parametrize("images", [False, True])
def test_a_bare_list_serves_the_folder_beside_it_and_needs_no_images(tmp_path, caplog, images):
    """A byte-order mark, carriage returns and blank lines do no harm, and frames come in order of time."""
    if images:
        make_sequence(tmp_path / "freiburg_seq2_cloudy1", None)
    lines = LIST.splitlines()
    text = "\ufeff" + "\r\n\r\n".join([lines[2], lines[0], lines[1]]) + "\r\n  \r\n"
    (tmp_path / "freiburg_seq2_cloudy1.places.lst").write_bytes(text.encode())
    table = siamloc.data.read("cold", root=tmp_path, on_error="raise")
    assert table.path.tolist() == [str(tmp_path / "freiburg_seq2_cloudy1/omni_cam" / image) for image in IMAGES]
    assert table.room.tolist() == ["CR-A", "CR-A", "KT-A"]
    assert set(table.building.tolist()) == {"freiburg_a"}
    assert not caplog.records


@pytest.mark.parametrize("where", ["localization", "."])
def test_one_list_is_read_by_its_file(tmp_path, where):
    folder = make_sequence(tmp_path / "freiburg/part_a/seq2_cloudy1", where=where)
    table = siamloc.data.read("cold", places=folder / where / "places.lst")
    assert table == siamloc.data.read("cold", root=folder)


def test_frames_without_a_pose_are_kept(tmp_path):
    folder = make_sequence(tmp_path / "ljubljana/seq1_cloudy1", LIST + "t4.5.jpeg CR-A\n")
    (folder / "omni_cam" / "t4.5.jpeg").write_bytes(b"image")
    for table in (siamloc.data.read("cold", root=tmp_path), siamloc.data.read("cold", root=folder)):
        assert table.has_position.tolist() == [True, True, True, False]
        assert table.time[-1] == 4.5


def test_the_other_camera(tmp_path):
    folder = make_sequence(tmp_path / "seq2_cloudy1")
    make_sequence(folder, None, camera="std_cam")
    table = siamloc.data.read("cold", root=tmp_path, camera="std_cam")
    assert {Path(path).parent.name for path in table.path.tolist()} == {"std_cam"}


@pytest.mark.parametrize(
    ("case", "kept", "says"),
    [
        ("calibration", IMAGES, "1 of 4 images of .* carry no time in their names, the first: calibration.png"),
        ("missing", [IMAGES[0], IMAGES[2]], f"1 of 3 images listed in .* do not exist, the first: .*{IMAGES[1]}"),
        ("camera", IMAGES, "1 of 2 sequences have no folder omni_cam, .* the first: .*seq2_cloudy2"),
    ],
)
def test_what_is_lacking_is_left_out_and_reported(tmp_path, caplog, case, kept, says):
    images = make_sequence(tmp_path / "seq2_cloudy1", None if case == "calibration" else LIST) / "omni_cam"
    if case == "calibration":
        (images / "calibration.png").touch()
    elif case == "missing":
        (images / IMAGES[1]).unlink()
    else:
        make_sequence(tmp_path / "seq2_cloudy2", camera="std_cam")
    with caplog.at_level(logging.WARNING, "siamloc"):
        table = siamloc.data.read("cold", root=tmp_path)
    assert [Path(path).name for path in table.path.tolist()] == kept
    assert len(caplog.records) == 1
    assert re.search(says, caplog.text)
    with pytest.raises(DataError, match=rf"{says}.*\(on_error=skip"):
        siamloc.data.read("cold", root=tmp_path, on_error="raise")


MALFORMED = r"a_seq1_cloudy1\.places\.lst, line 5: expected t<seconds>.* got"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (LIST + "\nt1_x1_y1_a1.jpeg\n", MALFORMED),
        (LIST + "\nimage.jpeg CR-A\n", MALFORMED),
        (LIST + "\nt1_xinf_y1_a1.jpeg CR\n", MALFORMED),
        (LIST + LIST, r"line 4: image .* is in the list already"),
        ("\n", "lists no images"),
    ],
)
def test_a_faulty_line_is_named(tmp_path, text, says):
    (tmp_path / "a_seq1_cloudy1.places.lst").write_text(text)
    with pytest.raises(DataError, match=says):
        siamloc.data.read("cold", root=tmp_path)


def test_where_nothing_can_be_read_the_sentence_says_what_is_there(tmp_path):
    def says(message, **where):
        with pytest.raises(DataError, match=message):
            siamloc.data.read("cold", **(where or {"root": tmp_path}))

    says(r"which holds: nothing\. Expected <building>/part_")
    (tmp_path / "file0.txt").write_text("")
    says(r"no sequence found under .*, which holds: file0\.txt\. Expected")
    says("is not a folder: give root=FOLDER, or one list as places=FILE", root=tmp_path / "file0.txt")
    says(r"places\.lst cannot be read", places=tmp_path / "places.lst")
    (tmp_path / "seq1_cloudy1/omni_cam").mkdir(parents=True)
    says("no images, and there is no list")
    (tmp_path / "seq1_cloudy1/places.lst").write_text(LIST)
    says(r"3 of 3 images .* nothing remains")


@given(st.binary(max_size=200))
def test_a_list_of_garbage_raises_nothing_but_our_errors(tmp_path_factory, garbage):
    path = tmp_path_factory.mktemp("garbage") / "a_seq1_cloudy1.places.lst"
    path.write_bytes(garbage)
    with pytest.raises(SiamlocError, match="places"):
        siamloc.data.read("cold", places=path)
