import math
from pathlib import Path

import numpy as np
import pytest

from foundation import files
from foundation.files import write_picture
from siamloc import data
from siamloc.data.expansion import outputs, turned_headings, write_lists
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError
from tests.drawn import write_manifest

TURNS = np.array([[0.0, 0.5], [0.0, -3.0], [0.0, 3.0]])


def cold_frames(folder="/cold/freiburg/part_a/seq2_cloudy3", rooms=("CR-A", "CR-A", "KT-A"), times=(10.5, 10.75, 11.0)):
    poses = [(0.0, -1.5, 0.25), (1.0, 2.0, -1.0), (1.0, 2.0, 3.0)]
    names = [f"t{t:.6f}_x{x:.6f}_y{y:.6f}_a{a:.6f}.jpeg" for t, (x, y, a) in zip(times, poses, strict=True)]
    paths, (x, y, theta) = [f"{folder}/omni_cam/{name}" for name in names], zip(*poses, strict=True)
    sequence = ["freiburg_a_seq2_cloudy3"] * 3
    return FrameTable(path=paths, x=x, y=y, theta=theta, room=list(rooms), sequence=sequence, time=list(times))


def expanded(kind, frames, root, folder, turns=TURNS):
    """Make the files of an expanded data set, empty ones, and return them."""
    theta = turned_headings(frames.theta, turns)
    files = outputs(kind, frames, Path(root), folder, theta)
    for path in (path for row in files for path in row):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    write_lists(kind, frames, files, folder, turns)
    return files


@pytest.mark.parametrize("root", ["/cold", "/cold/freiburg", "/cold/freiburg/part_a/seq2_cloudy3"])
def test_an_expanded_cold_data_set_reads_as_the_frames_with_turned_headings(tmp_path, root):
    frames = cold_frames().with_columns(odom_x=[1.0, math.nan, 3.0], odom_y=[0.0] * 3, odom_theta=[2.0, 0.0, -1.0])
    files = expanded("cold", frames, root, tmp_path)
    kept = turned_headings(np.array([4.0, math.nan, 3.0]), TURNS)
    assert kept[0, 0] == 4.0, "a heading that is not turned stays as it was written"
    assert np.isnan(kept[1]).all()
    found = data.read("cold", root=tmp_path, on_error="raise")
    assert set(found.sequence.tolist()) == {"freiburg_a_seq2_cloudy3"}
    assert found.room.tolist() == ["CR-A"] * 4 + ["KT-A"] * 2
    np.testing.assert_allclose(found.xy, np.repeat(frames.xy, 2, axis=0))
    angles = [0.25, 0.75, -1.0, -4.0 + 2 * math.pi, 3.0, 6.0 - 2 * math.pi]
    np.testing.assert_allclose(found.theta, angles, atol=1e-6)
    assert found.path.tolist() == [str(path) for row in files for path in row]
    assert np.array_equal(found.odom_x, np.repeat(frames.odom_x, 2), equal_nan=True)
    np.testing.assert_allclose(found.odom_theta, [2.0, 2.5, 0.0, -3.0, -1.0, 2.0], atol=1e-6)


def test_a_folder_whose_name_would_rename_the_sequence_is_refused(tmp_path):
    frames = cold_frames("/drives/seq2_cloudy3").with_columns(sequence=["seq2_cloudy3"] * 3)
    with pytest.raises(DataError, match="seq2_cloudy3 would be read as one of another building: choose a folder"):
        expanded("cold", frames, "/drives/seq2_cloudy3", tmp_path / "freiburg_part_b" / "cold-freiburg_part_b")
    expanded("cold", cold_frames(rooms=("", "", "")), "/cold", tmp_path)
    assert not list(tmp_path.rglob("places.lst")), "without rooms there is no list of them"
    assert len(data.read("cold", root=tmp_path)) == 6


def test_a_sequence_whose_folder_writes_its_accents_as_characters_of_their_own_is_expanded(tmp_path):
    frames = cold_frames("/drives/Bu\u0308ro").with_columns(sequence=["Bu\u0308ro"] * 3)
    files = expanded("cold", frames, "/drives", tmp_path)
    assert {path.parents[1].name for row in files for path in row} == {"Bu\u0308ro"}


def test_frames_that_would_share_a_name_are_an_error(tmp_path):
    frames = cold_frames(times=(10.5, 11.0, 11.0)).take([1, 2]).with_columns(theta=[3.0, 3.0])
    with pytest.raises(DataError, match=r"would both be expanded to .*give them different names or times"):
        expanded("cold", frames, "/cold", tmp_path, np.zeros((2, 2)))


def test_an_expanded_manifest_reads_as_the_frames(tmp_path):
    table = write_manifest(tmp_path / "in", {"day": "cloudy", "dark": "night"}, frames_per_room=2)
    frames = data.read("manifest", manifest=table)
    frames = frames.with_columns(odom_x=frames.x - 1, odom_y=frames.y, odom_theta=frames.theta - 0.5)
    turns = np.tile([0.0, 0.0, 1.0], (len(frames), 1))
    expanded("manifest", frames, table.parent, tmp_path / "out", turns)
    found = data.read("manifest", manifest=tmp_path / "out/manifest.csv", on_error="raise")
    for column in ("x", "y", "room", "sequence", "lighting", "time"):
        assert np.array_equal(getattr(found, column), np.repeat(getattr(frames, column), 3)), column
    np.testing.assert_allclose(np.cos(found.theta), np.cos(np.repeat(frames.theta, 3) + turns.ravel()))
    assert np.array_equal(found.theta.reshape(-1, 3)[:, 0], frames.theta)
    assert np.array_equal(found.odometry[::3], frames.odometry)
    np.testing.assert_allclose(np.exp(1j * found.odom_theta), np.exp(1j * (found.theta - 0.5)))
    expanded("manifest", frames.with_columns(theta=[math.nan] * len(frames)), table.parent, tmp_path / "out", turns)
    unknown = data.read("manifest", manifest=tmp_path / "out/manifest.csv")
    assert np.array_equal(unknown.odom_theta, found.odom_theta), "wheels without true headings"


def test_images_beside_the_manifests_folder_are_gathered_in_it(tmp_path):
    frames = FrameTable(path=["/elsewhere/a.tif", "/data/x/../b.png"], sequence=["one", ""])
    files = expanded("manifest", frames, "/data/x", tmp_path, np.zeros((2, 1)))
    names = [row[0].relative_to(tmp_path).as_posix() for row in files]
    assert names == ["images/one/a_v000.png", "images/frames/b_v000.png"]
    assert "nan" not in (tmp_path / "manifest.csv").read_text()


def test_an_expanded_image_folder_reads_as_the_frames(tmp_path):
    root = tmp_path / "in"
    for name in ("train_cloudy/KT-A/t1.000000_x0.500000_y0.250000_a1.000000.jpeg", "test_night/PA-A/view.png"):
        write_picture(root / name, np.zeros((2, 2, 3), np.uint8))
    frames = data.read("folder", root=root)
    expanded("folder", frames, root, tmp_path / "out", np.tile([0.0, 0.5], (2, 1)))
    found = data.read("folder", root=tmp_path / "out")
    for column in ("room", "sequence", "lighting"):
        assert sorted(getattr(found, column).tolist()) == sorted(np.repeat(getattr(frames, column), 2).tolist())
    known = np.isfinite(found.theta)
    np.testing.assert_allclose(found.theta[known], [1.0, 1.5])


@pytest.fixture
def frames(tmp_path):
    images = data.example(frames=2)
    lines = [f"{one['path']},{one['x']},0,0.5,{one['room']},{one['sequence']}" for one in images.frames]
    manifest = tmp_path / "robot.csv"
    manifest.write_text("image,x,y,theta,room,sequence\n" + "\n".join(lines) + "\n")
    return data.read("manifest", manifest=manifest)


def test_a_single_list_of_cold_is_expanded(tmp_path):
    drive = tmp_path / "in" / "seq1_night2"
    picture, name = drive / "omni_cam" / "t1.0_x0.0_y0.0_a0.5.jpeg", "t1.000000_x0.000000_y0.000000_a0.500000.jpeg"
    write_picture(picture, np.zeros((32, 32, 3), np.uint8))
    (drive / "places.lst").write_text(f"{picture.name} CR-A\n")
    frames = data.read("cold", places=drive / "places.lst")
    done = data.expand(frames, tmp_path / "my out", depth=1, image_size=(16, 64))
    assert done.summary().endswith(
        f"siamloc train data=cold 'data.root={done.folder}' unwrap=none 'data.image_size=[16, 64]' "
        "'protocol.train.sequences=[\"*\"]'"
    )
    assert [path.name for path in done.folder.rglob("*.jpeg")] == [name]
    assert data.read(**done.source).sequence.tolist() == ["seq1_night2"]


def test_the_tables_of_a_pattern_are_expanded_together(tmp_path):
    for name in ("mon", "tue"):
        write_picture(tmp_path / "in" / name / "a.png", np.zeros((16, 64, 3), np.uint8))
        (tmp_path / "in" / name / "frames.csv").write_text(f"image,sequence\na.png,{name}\n")
    frames = data.read("manifest", manifest=tmp_path / "in" / "*" / "frames.csv")
    done = data.expand(frames, tmp_path / "out", depth=1, image_size=(16, 64))
    found = data.read(**done.source)
    assert found.sequence.tolist() == ["mon", "tue"]
    assert sorted(path.parent.name for path in done.folder.rglob("a_v*.png")) == ["mon", "tue"]


def test_what_a_killed_run_left_of_the_list_goes_and_foreign_files_stay(frames, tmp_path, monkeypatch):
    out = tmp_path / "out"
    data.expand(frames, out, depth=2, image_size=(16, 64))
    (out / "manifest.csv").unlink()
    (out / f".manifest.csv.{files._HOST}-999999999-0.tmp.csv").write_text("cut")
    (out / ".notes.tmp").write_text("mine")
    monkeypatch.setattr("foundation.files._cleared", set())  # as in another process
    assert data.expand(frames, out, depth=2, image_size=(16, 64), resume=True).kept == 8
    assert not list(out.glob(".manifest*"))
    assert (out / ".notes.tmp").read_text() == "mine"


def test_frames_that_cannot_be_expanded(frames, tmp_path):
    with pytest.raises(ConfigError, match=r"give frames from siamloc\.data\.read"):
        data.expand(data.example(frames=2).frames, tmp_path / "out")
    with pytest.raises(DataError, match="there are no frames to expand"):
        data.expand(frames.take([]), tmp_path / "out")
