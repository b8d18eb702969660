from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

import siamloc.data
from siamloc.data import DataSettings
from siamloc.errors import ConfigError, SiamlocError


def test_unknown_kind_names_the_nearest():
    with pytest.raises(ConfigError, match="'colt'; did you mean 'cold'"):
        siamloc.data.read("colt", root=".")


@pytest.mark.parametrize("kind", ["cold", "manifest", "folder"])
def test_unknown_keyword_names_the_valid_ones(kind):
    with pytest.raises(ConfigError, match=r"'on_eror'; did you mean 'on_error'\? valid: .*on_error"):
        siamloc.data.read(kind, on_eror="skip")


@pytest.mark.parametrize(("kind", "keyword"), [("folder", "root"), ("manifest", "manifest")])
def test_a_missing_keyword_is_named(kind, keyword):
    with pytest.raises(ConfigError, match=f"need {keyword}="):
        siamloc.data.read(kind)


def test_cold_needs_a_folder_or_a_list():
    with pytest.raises(ConfigError, match="give either"):
        siamloc.data.read("cold")


@pytest.mark.parametrize("kind", ["cold", "manifest", "folder"])
def test_unknown_policy_names_the_nearest(kind, tmp_path):
    where = {"manifest": tmp_path / "a.csv"} if kind == "manifest" else {"root": tmp_path}
    with pytest.raises(ConfigError, match="'rais' is not a policy; did you mean 'raise'"):
        siamloc.data.read(kind, on_error="rais", **where)


@pytest.mark.parametrize("kind", ["cold", "manifest", "folder"])
def test_missing_place_is_a_data_error(kind, tmp_path):
    where = {"manifest": tmp_path / "none"} if kind == "manifest" else {"root": tmp_path / "none"}
    with pytest.raises(SiamlocError, match="none"):
        siamloc.data.read(kind, **where)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="only Linux shows its processes as files")
def test_a_view_of_the_running_system_is_no_data_set(tmp_path):
    (tmp_path / "link").symlink_to("/proc/self")
    with pytest.raises(ConfigError, match=r"data.root=.*link lies in a view of the running system"):
        siamloc.data.read("folder", root=tmp_path / "link")


@pytest.mark.parametrize("kind", ["manifest", "folder", "cold"])
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
    assert [Path(path).name for path in again.path.tolist()] == [Path(path).name for path in frames.path.tolist()]
    assert again.source == frames.source
    settings = DataSettings.of({**frames.source, "unit": "px", "image_size": [4, 8], "circular": False})
    assert settings.read() == again
    assert DataSettings.of(settings.plain()) == settings


def test_data_settings_name_what_is_wrong():
    with pytest.raises(ConfigError, match=r"data\.kind must be cold or folder or manifest, got 'colt'"):
        DataSettings(kind="colt")
    with pytest.raises(ConfigError, match=r"unknown key data\.mainfest: did you mean 'manifest'"):
        DataSettings.of({"kind": "manifest", "mainfest": "a.csv"})
    with pytest.raises(ConfigError, match="are not described by 'root'"):
        DataSettings(kind="manifest", manifest="a.csv", root="b").read()


def test_importing_the_package_loads_no_heavy_library():
    code = (
        "import sys, siamloc.data; "
        "print(sorted({'torch', 'torchvision', 'lightning', 'pandas', 'matplotlib'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"


def test_what_is_missing_is_named_once():
    with pytest.raises(ConfigError, match=r"need manifest=\.\.\.; valid: manifest, on_error$"):
        siamloc.data.read("manifest")
