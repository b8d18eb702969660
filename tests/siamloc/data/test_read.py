from __future__ import annotations

import subprocess
import sys

import pytest

import siamloc.data
from siamloc.errors import ConfigError, SiamlocError


def test_unknown_kind_names_the_nearest():
    with pytest.raises(ConfigError, match="'colt'; did you mean 'cold'"):
        siamloc.data.read("colt", root=".")


@pytest.mark.parametrize("kind", ["cold", "manifest", "folder"])
def test_unknown_keyword_names_the_valid_ones(kind):
    with pytest.raises(ConfigError, match=r"'on_eror'; did you mean 'on_error'\? valid: .*on_error"):
        siamloc.data.read(kind, on_eror="skip")


def test_lacking_keyword_is_named():
    with pytest.raises(ConfigError, match="need root="):
        siamloc.data.read("folder")


@pytest.mark.parametrize("kind", ["cold", "manifest"])
def test_nothing_given_is_an_error(kind):
    with pytest.raises(ConfigError, match="give either"):
        siamloc.data.read(kind)


@pytest.mark.parametrize("kind", ["cold", "manifest", "folder"])
def test_unknown_policy_names_the_nearest(kind, tmp_path):
    where = {"path": tmp_path / "a.csv"} if kind == "manifest" else {"root": tmp_path}
    with pytest.raises(ConfigError, match="'rais' is not a policy; did you mean 'raise'"):
        siamloc.data.read(kind, on_error="rais", **where)


@pytest.mark.parametrize("kind", ["cold", "manifest", "folder"])
def test_missing_place_is_a_data_error(kind, tmp_path):
    where = {"path": tmp_path / "none"} if kind == "manifest" else {"root": tmp_path / "none"}
    with pytest.raises(SiamlocError, match="none"):
        siamloc.data.read(kind, **where)


def test_importing_the_package_loads_no_heavy_library():
    code = (
        "import sys, siamloc.data; "
        "print(sorted({'torch', 'torchvision', 'lightning', 'pandas', 'matplotlib'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "[]"
