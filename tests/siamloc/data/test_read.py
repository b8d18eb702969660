from __future__ import annotations

import json
from pathlib import Path

import pytest

import siamloc.data
from siamloc.data import DataSettings
from siamloc.errors import ConfigError

KINDS = {"cold": "root", "manifest": "manifest", "folder": "root"}


@pytest.mark.parametrize(
    ("kind", "where", "says"),
    [
        ("colt", {"root": "."}, "'colt'; did you mean 'cold'"),
        ("folder", {}, "need root="),
        ("manifest", {}, r"need manifest=\.\.\.; valid: manifest, on_error$"),
        ("cold", {}, "give either root=FOLDER or places=FILE"),
        ("cold", {"root": ".", "places": "places.lst"}, "give either root=FOLDER or places=FILE"),
        ("cold", {"root": ".", "camera": "omnicam"}, "no camera 'omnicam'; did you mean 'omni_cam'"),
        *((kind, {"on_eror": "skip"}, r"'on_eror'; did you mean 'on_error'\? valid: .*on_error") for kind in KINDS),
        *((kind, {KINDS[kind]: ".", "on_error": "rais"}, "on_error must be skip or raise, got") for kind in KINDS),
    ],
)
def test_what_no_reader_understands_is_one_sentence(kind, where, says):
    with pytest.raises(ConfigError, match=says):
        siamloc.data.read(kind, **where)


def test_a_reader_that_returns_no_frames_is_named(monkeypatch):
    monkeypatch.setitem(siamloc.data.READERS, "mine", lambda: [])
    with pytest.raises(ConfigError, match="the reader of data of kind 'mine' must return a FrameTable, got list"):
        siamloc.data.read("mine")


def test_a_reader_without_annotations_gets_no_unknown_policy(monkeypatch):
    monkeypatch.setitem(siamloc.data.READERS, "mine", lambda on_error: siamloc.data.FrameTable(path=["a.png"]))
    with pytest.raises(ConfigError, match="on_error must be skip or raise, got 'sip'"):
        siamloc.data.read("mine", on_error="sip")


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="only Linux shows its processes as files")
def test_a_view_of_the_running_system_is_no_data_set(tmp_path):
    (tmp_path / "link").symlink_to("/proc/self")
    with pytest.raises(ConfigError, match=r"data.root=.*link lies in a view of the running system"):
        siamloc.data.read("folder", root=tmp_path / "link")


@pytest.mark.parametrize("kind", KINDS)
def test_the_source_reads_the_same_frames_from_anywhere(kind, tmp_path, monkeypatch):
    name = "t1_x2_y3_a0.jpeg"
    for folder in ("train/kitchen", "seq2_cloudy1/omni_cam"):
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / name).write_bytes(b"image")
    (tmp_path / "robot.csv").write_text(f"image,x\ntrain/kitchen/{name},1\n")
    where = {"manifest": "robot.csv"} if kind == "manifest" else {"root": Path()}
    monkeypatch.chdir(tmp_path)
    frames = siamloc.data.read(kind, unit="px", on_error="skip", **where)
    assert frames.unit == "px"
    assert json.loads(json.dumps(frames.source)) == frames.source
    monkeypatch.chdir("/")
    again = siamloc.data.read(**frames.source)
    assert again == frames
    assert again.source == frames.source
    settings = DataSettings.of({**frames.source, "unit": "px", "image_size": [4, 8], "circular": False})
    assert settings.read() == again
    assert DataSettings.of(settings.plain()) == settings


def test_data_settings_name_what_is_wrong():
    with pytest.raises(ConfigError, match=r"data\.kind must be cold or manifest or folder or .*, got 'colt'"):
        DataSettings.of({"kind": "colt"})
    with pytest.raises(ConfigError, match=r"unknown key data\.mainfest: did you mean 'manifest'"):
        DataSettings.of({"kind": "manifest", "mainfest": "a.csv"})
    with pytest.raises(ConfigError, match=r"unknown key data\.root: .*valid: .*manifest"):
        DataSettings.of({"kind": "manifest", "manifest": "a.csv", "root": "b"})
    with pytest.raises(ConfigError, match=r"data\.gap must be a number above 0, got -1"):
        DataSettings.of({"kind": "trajectory", "images": "a", "gap": -1})
    with pytest.raises(ConfigError, match=r"data\.root must be a path, got 3"):
        DataSettings.of({"kind": "cold", "root": 3})
