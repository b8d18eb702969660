"""The versions of a report."""

from importlib import metadata

import numpy as np

import siamloc
from siamloc.cli import main
from siamloc.versions import PACKAGES, installed, versions


def test_only_what_is_installed_is_named(monkeypatch):
    def version(distribution):
        if distribution not in ("numpy", "opencv-contrib-python"):
            raise metadata.PackageNotFoundError(distribution)
        return "1.2"

    monkeypatch.setattr(metadata, "version", version)
    assert versions().keys() == {"python", "siamloc", "numpy", "opencv"}
    assert installed("opencv") == {"opencv-contrib-python": "1.2"}
    assert installed("onnxruntime") == {}


def test_the_command_names_its_version_first_and_loads_nothing_for_it(capsys):
    assert main(["--version"]) == 0
    first, *others = capsys.readouterr().out.splitlines()
    assert first == f"siamloc {siamloc.__version__}"
    assert f"numpy {np.__version__}" in others
    assert {line.split()[0] for line in others} <= {"python", *PACKAGES}
