"""`siamloc localize` as a job in Python: what it takes, and what it says at the end."""

from __future__ import annotations

import re
import shutil

import pytest

import siamloc
from siamloc.errors import ConfigError
from siamloc.jobs import Localize


def test_paths_are_taken_in_lists_and_the_median_of_two_errors_is_their_mean(tmp_path):
    images = siamloc.data.example()
    monday = images.frames.select(sequence="monday")
    siamloc.runtime.export("hog", siamloc.maps.build("hog", images, monday), tmp_path / "bundle")
    named = [tmp_path / f"t{time}_x{time}_y0_a0.png" for time in (10, 90)]
    for path in named:
        shutil.copy(monday.path[0], path)
    lines = list[str]()
    Localize.of({"bundle": tmp_path / "bundle", "images": named, "out": tmp_path / "out.csv"}).run(lines.append)
    mean, median, largest = map(float, re.findall(r"(?:mean|median|largest) ([\d.]+) m", lines[-1]))
    assert mean == median < largest


def test_the_key_of_the_field_folder_is_named():
    with pytest.raises(ConfigError, match=r"unknown configuration key 'folder': did you mean 'run'\?"):
        Localize.of({"folder": "runs/robot"})
