import math

import numpy as np
import pytest

from siamloc import data
from siamloc.data.expansion import outputs, turned_headings, write_lists
from siamloc.data.frames import FrameTable
from siamloc.errors import DataError
from tests.drawn import write_manifest

TURNS = np.array([[0.0, 0.5], [0.0, -3.0], [0.0, 3.0]])


def cold_frames(folder="/cold/freiburg/part_a/seq2_cloudy3", rooms=("CR-A", "CR-A", "KT-A"), times=(10.5, 10.75, 11.0)):
    poses = [(0.0, -1.5, 0.25), (1.0, 2.0, -1.0), (1.0, 2.0, 3.0)]
    names = [f"t{t:.6f}_x{x:.6f}_y{y:.6f}_a{a:.6f}.jpeg" for t, (x, y, a) in zip(times, poses, strict=True)]
    return FrameTable(
        path=[f"{folder}/omni_cam/{name}" for name in names],
        x=[p[0] for p in poses],
        y=[p[1] for p in poses],
        theta=[p[2] for p in poses],
        room=list(rooms),
        sequence=["freiburg_a_seq2_cloudy3"] * 3,
        time=list(times),
    )


def touch(paths):
    for row in paths:
        for path in row:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()


@pytest.mark.parametrize("root", ["/cold", "/cold/freiburg", "/cold/freiburg/part_a/seq2_cloudy3"])
def test_an_expanded_cold_data_set_reads_as_the_frames_with_turned_headings(tmp_path, root):
    frames = cold_frames()
    files = outputs("cold", frames, root, tmp_path, TURNS)
    touch(files)
    (listed,) = write_lists("cold", frames, files, tmp_path, TURNS)
    assert listed.name == "places.lst"
    found = data.read("cold", root=tmp_path, on_error="raise")
    assert set(found.sequence.tolist()) == {"freiburg_a_seq2_cloudy3"}
    assert found.room.tolist() == ["CR-A"] * 4 + ["KT-A"] * 2
    np.testing.assert_allclose(found.xy, np.repeat(frames.xy, 2, axis=0))
    expected = [0.25, 0.75, -1.0, -4.0 + 2 * math.pi, 3.0, 6.0 - 2 * math.pi]
    np.testing.assert_allclose(found.theta, expected, atol=1e-6)
    assert found.path.tolist() == [str(path) for row in files for path in row]


def test_a_folder_whose_name_would_rename_the_sequence_is_refused(tmp_path):
    frames = cold_frames("/drives/seq2_cloudy3").with_columns(sequence=["seq2_cloudy3"] * 3)
    with pytest.raises(DataError, match="seq2_cloudy3 would be read as one of another building: choose a folder"):
        outputs("cold", frames, "/drives/seq2_cloudy3", tmp_path / "freiburg_part_b" / "cold-freiburg_part_b", TURNS)


def test_sequences_without_rooms_get_no_list(tmp_path):
    frames = cold_frames(rooms=("", "", ""))
    files = outputs("cold", frames, "/cold", tmp_path, TURNS)
    touch(files)
    assert write_lists("cold", frames, files, tmp_path, TURNS) == []
    assert len(data.read("cold", root=tmp_path)) == 6


def test_frames_that_would_share_a_name_are_an_error(tmp_path):
    frames = cold_frames(times=(10.5, 11.0, 11.0)).take([1, 2]).with_columns(theta=[3.0, 3.0])
    with pytest.raises(DataError, match=r"would both be expanded to .*give them different names or times"):
        outputs("cold", frames, "/cold", tmp_path, np.zeros((2, 2)))


def test_an_expanded_manifest_reads_as_the_frames(tmp_path):
    table = write_manifest(tmp_path / "in", {"day": "cloudy", "dark": "night"}, frames_per_room=2)
    frames = data.read("manifest", manifest=table)
    turns = np.zeros((len(frames), 3))
    turns[:, 2] = 1.0
    files = outputs("manifest", frames, table.parent, tmp_path / "out", turns)
    touch(files)
    (manifest,) = write_lists("manifest", frames, files, tmp_path / "out", turns)
    found = data.read("manifest", manifest=manifest, on_error="raise")
    for column in ("x", "y", "room", "sequence", "lighting", "time"):
        assert np.array_equal(getattr(found, column), np.repeat(getattr(frames, column), 3)), column
    np.testing.assert_allclose(np.cos(found.theta), np.cos(np.repeat(frames.theta, 3) + turns.ravel()))
    assert np.array_equal(found.theta.reshape(-1, 3)[:, 0], frames.theta)


def test_images_beside_the_manifests_folder_are_gathered_in_it(tmp_path):
    frames = FrameTable(path=["/elsewhere/a.tif", "/data/x/../b.png"], sequence=["one", ""])
    files = outputs("manifest", frames, "/data/x", tmp_path, np.zeros((2, 1)))
    assert [row[0].relative_to(tmp_path).as_posix() for row in files] == [
        "images/one/a_v000.png",
        "images/frames/b_v000.png",
    ]
    write_lists("manifest", frames, files, tmp_path, np.zeros((2, 1)))
    assert "nan" not in (tmp_path / "manifest.csv").read_text()


def test_an_expanded_image_folder_reads_as_the_frames(tmp_path):
    root = tmp_path / "in"
    for name in ("train_cloudy/KT-A/t1.000000_x0.500000_y0.250000_a1.000000.jpeg", "test_night/PA-A/view.png"):
        (root / name).parent.mkdir(parents=True)
        (root / name).touch()
    frames = data.read("folder", root=root)
    turns = np.tile([0.0, 0.5], (2, 1))
    files = outputs("folder", frames, root, tmp_path / "out", turns)
    touch(files)
    assert write_lists("folder", frames, files, tmp_path / "out", turns) == []
    found = data.read("folder", root=tmp_path / "out")
    for column in ("room", "sequence", "lighting"):
        assert sorted(getattr(found, column).tolist()) == sorted(np.repeat(getattr(frames, column), 2).tolist())
    known = np.isfinite(found.theta)
    np.testing.assert_allclose(found.theta[known], [1.0, 1.5])


def test_a_heading_that_was_not_turned_stays_as_it_was_written():
    frames = cold_frames().with_columns(theta=[4.0, math.nan, 3.0])
    turned = turned_headings(frames, TURNS)
    assert turned[0, 0] == 4.0
    assert np.isnan(turned[1]).all()
    assert (np.abs(turned[2]) <= math.pi).all()
