"""Expanding a data set from Python: it is read back like any other, and resumes where it was killed."""

import pytest

from foundation import files
from siamloc import data
from siamloc.errors import ConfigError


@pytest.fixture
def frames(tmp_path):
    images = data.example(frames=2)
    lines = [f"{one['path']},{one['x']},0,0.5,{one['room']},{one['sequence']}" for one in images.frames]
    manifest = tmp_path / "robot.csv"
    manifest.write_text("image,x,y,theta,room,sequence\n" + "\n".join(lines) + "\n")
    return data.read("manifest", manifest=manifest)


def test_what_was_expanded_is_read_back(frames, tmp_path):
    expanded = data.expand(frames, tmp_path / "out", depth=3, image_size=(16, 64))
    again = data.read(**expanded.source)
    assert (len(again), expanded.written, expanded.kept) == (12, 12, 0)
    assert set(again.room) == set(frames.room)
    assert (
        f"train with: siamloc train data=manifest data.manifest={tmp_path / 'out' / 'manifest.csv'}"
        in expanded.summary()
    )


def test_what_a_killed_run_left_of_the_list_goes_and_foreign_files_stay(frames, tmp_path, monkeypatch):
    out = tmp_path / "out"
    data.expand(frames, out, depth=2, image_size=(16, 64))
    (out / "manifest.csv").unlink()
    (out / f".manifest.csv.{files._HOST}-999999999-0.tmp.csv").write_text("cut")
    (out / ".notes.tmp").write_text("mine")
    monkeypatch.setattr("foundation.files._cleared", set())  # as in another process
    expanded = data.expand(frames, out, depth=2, image_size=(16, 64), resume=True)
    assert expanded.kept == 8
    assert not list(out.glob(".manifest*"))
    assert (out / ".notes.tmp").read_text() == "mine"


def test_frames_that_no_reader_gave_have_no_layout(tmp_path):
    with pytest.raises(ConfigError, match=r"give frames from siamloc\.data\.read"):
        data.expand(data.example(frames=2).frames, tmp_path / "out")
