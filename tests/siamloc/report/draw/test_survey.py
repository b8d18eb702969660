"""Pictures of a survey show its paths and loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex

from siamloc.maps.surveying import Survey
from siamloc.report.draw.survey import survey_film, survey_picture
from tests.surveyed import a_survey


@pytest.fixture
def found() -> Survey:
    return a_survey()


def test_the_picture_shows_odometry_paths_and_loops(found):
    figure = survey_picture(found)
    by_odometry, surveyed = figure.axes
    assert len(by_odometry.lines) == 2
    path = by_odometry.lines[0].get_xydata()
    np.testing.assert_allclose(path[0], found.frames.xy[0])
    # Odometry is turned to the first frame's heading: here, straight up.
    np.testing.assert_allclose(path[:, 0], path[0, 0], atol=1e-9)
    np.testing.assert_allclose(np.diff(path[:, 1]), 1)
    used, refused = (one for one in surveyed.collections if isinstance(one, LineCollection))
    assert [len(used.get_segments()), len(refused.get_segments())] == [2, 1]
    np.testing.assert_allclose(refused.get_segments()[0], found.frames.xy[[2, 11]])
    np.testing.assert_allclose(surveyed.lines[0].get_xydata(), found.frames.xy[:6])
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["monday", "tuesday", "loop", "loop refused as contradicting"]


def test_the_plan_of_a_torn_survey_says_so(found, monkeypatch):
    monkeypatch.setattr("siamloc.maps.surveying.torn_before", lambda *_: [3])
    surveyed = survey_picture(found).axes[-1]
    title = surveyed.get_title(loc="left") + surveyed.get_title()
    assert title == "surveyed: 2 loops used\ndo not rely on it: torn in 1 place"


def test_loops_look_like_no_drive_and_every_drive_is_named(found):
    loops = a_survey()
    names = [f"_{row}" for row in range(12)]
    loops = replace(loops, frames=loops.frames.with_columns(sequence=names))
    surveyed = survey_picture(loops).axes[-1]
    drives = {(line.get_color(), str(line.get_linestyle())) for line in surveyed.lines if line.get_label() in names}
    assert len(drives) == 12
    used, refused = (one for one in surveyed.collections if isinstance(one, LineCollection))
    for one in (used, refused):
        assert to_hex(one.get_color()[0]) not in {colour for colour, _ in drives}
    assert [text.get_text() for text in surveyed.figure.legends[0].get_texts()][:12] == names


def test_the_film_ends_with_the_whole_path(found, tmp_path):
    from PIL import Image

    path = survey_film(found, tmp_path / "film.gif")
    with Image.open(path) as film:
        assert film.n_frames == 11
        first = np.asarray(film.convert("RGB")).astype(int)
        film.seek(10)
        last = np.asarray(film.convert("RGB")).astype(int)
    assert (np.abs(last - first).sum(axis=2) > 60).sum() > 500
