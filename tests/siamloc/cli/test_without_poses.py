"""Frames without a pose or a room: queries are located, not scored, and every command says so."""

from __future__ import annotations

import shlex

import numpy as np
import pytest

from siamloc.maps import ErrorModel
from siamloc.results import read_results, read_rows
from tests.drawn import altered
from tests.siamloc.cli.commands import QUICK, done, measures, refused
from tests.siamloc.report.pages import notes, read_page, rows_of

HIERARCHICAL = ["task=hierarchical", "build=rooms"]
SECOND = "protocol.query.sequences=[second]"
POSE = ("x", "y", "theta")


@pytest.fixture
def without(flat, tmp_path):
    """Return a function that writes a manifest in which some frames lack some fields."""

    def written(*fields, which=lambda row: row["sequence"] == "second"):
        name = f"{tmp_path.name}-{'-'.join(fields)}.csv"
        return altered(flat, name, lambda row: dict.fromkeys(fields, "") if which(row) else {})

    return written


@pytest.fixture
def given(words, tmp_path):
    return ["evaluate", *words, SECOND, f"run={tmp_path}", "descriptor=hog"]


def page_of(run):
    done("report", f"run={run}")
    return read_page(run / "report.html")


@pytest.mark.parametrize(
    ("more", "name"),
    [
        (["task.baselines=[thumbnail]"], "hog"),
        (["task.filter=true", "task.refine=interpolate", "task.error_model=true", "task.baselines=[]"], "hog"),
        (HIERARCHICAL, "hierarchical-hog-rooms"),
    ],
    ids=["with a baseline", "with further estimates", "hierarchical"],
)
def test_neither_poses_nor_rooms(without, given, tmp_path, capsys, more, name):
    done(*given, *more, f"data.manifest={without(*POSE, 'room')}")
    shown = capsys.readouterr().out
    assert "queries have no position" in shown
    assert "located.csv" in shown
    assert "queries.csv" not in shown
    folder = tmp_path / "evaluation" / name
    assert len(read_rows(folder, "located")["path"]) == 24
    assert measures(folder) == {}
    page = page_of(tmp_path)
    assert notes(page) == (
        "No query has a true position to compare with: 24 queries were located (see located.csv), and none is scored."
    )
    assert [section.attributes["class"] for section in page.all("section")] == ["configuration"]


@pytest.mark.parametrize(
    ("more", "name"), [(["task=absolute", *QUICK], "hog"), (HIERARCHICAL, "hierarchical-hog-rooms")]
)
def test_some_queries_without_poses(without, given, tmp_path, capsys, more, name):
    some = f"data.manifest={without('x', which=lambda row: row['sequence'] == 'second' and int(row['time']) < 5)}"
    done(*given, *more, some)
    shown = capsys.readouterr().out
    assert "5 of 24 queries have no position" in shown
    assert "located.csv" in shown
    folder = tmp_path / "evaluation" / name
    located = read_rows(folder, "located")
    assert len(located["path"]) == 5
    assert np.isfinite([located["est_x"], located["est_theta"]]).all()
    assert "error" not in located
    assert len(read_rows(folder)["error"]) == 19
    assert "The true position of 5 queries is unknown: located.csv holds the estimates." in notes(page_of(tmp_path))
    assert "5 of 24 queries have no position" in refused(capsys, *given, *more, some, "data.on_error=raise")
    bare = without("y", which=lambda row: row["sequence"] == "first")
    error = refused(capsys, *given, *more, f"data.manifest={bare}", "overwrite=true")
    assert "no map frame has a position" in error or "24 of 24 map frames have no position" in error


@pytest.mark.parametrize(("fields", "said"), [((), True), (("theta",), False)])
def test_a_map_says_how_it_finds_headings_only_where_a_frame_has_one(without, words, tmp_path, capsys, fields, said):
    table = without(*fields, which=lambda row: True)
    done("map", *words, f"run={tmp_path}", "descriptor=thumbnail", "heading=hog", f"data.manifest={table}")
    assert ("headings: by hog" in capsys.readouterr().out) == said


def test_expected_errors_do_not_depend_on_whether_the_pose_is_known(flat, without, given, tmp_path, capsys):
    half = without("y", which=lambda row: row["sequence"] == "second" and int(row["time"]) % 2)
    more = ["task=absolute", "task.error_model=true", *QUICK]
    told = {}
    for name, table in (("all", flat), ("none", without(*POSE)), ("half", half)):
        done(*given, *more, f"data.manifest={table}", f"run={tmp_path / name}")
        folder = tmp_path / name / "evaluation/hog"
        tables = [read_rows(folder, of) for of in ("queries", "located") if of in read_results(folder)["tables"]]
        columns = [np.concatenate([table[key] for table in tables]).tolist() for key in ("path", "error_m", "lost")]
        told[name] = sorted(zip(*columns, strict=True))
        if name == "none":
            said = "24 of 24 queries have no position: give x and y in a manifest"
            assert ErrorModel.load(folder / "error_model.json").lost_above == 1.0
            assert f"absolute left out: {said}" in capsys.readouterr().out
    assert len(told["all"]) == 24
    assert told["none"] == told["half"] == told["all"]


def test_rooms_without_poses_are_scored_and_the_rest_is_located(without, given, tmp_path, capsys):
    done(*given, "task.baselines=[thumbnail]", f"data.manifest={without(*POSE)}")
    shown = capsys.readouterr().out
    assert "24 queries, in located.csv" in shown
    assert "rooms.csv" in shown
    assert set(measures(tmp_path / "evaluation/hog")) == {"room_retrieval"}
    assert (tmp_path / "evaluation/hog/confusion.png").exists()
    page = page_of(tmp_path)
    assert "none is scored" not in notes(page), "their rooms are"
    assert "24 queries were located" in notes(page)
    names = [section.attributes["class"] for section in page.all("section")]
    assert names == ["summary", "rooms", "configuration"]
    cells = [cell.text for cell in page.all("table", class_="rooms")[0].all("td")]
    assert "–" not in cells[:2], "no empty columns"


def test_a_lighting_without_poses_keeps_its_rooms_and_rooms_left_empty_are_counted(without, given, tmp_path, capsys):
    table = without(*POSE, which=lambda row: row["sequence"] == "dark")
    table = altered(table, f"two-{table.name}", lambda row: {"room": ""} if row["image"] == "second/0003.png" else {})
    done(*given, "protocol.query.sequences=[dark,second]", *QUICK, f"data.manifest={table}")
    said = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith("hog ")]
    assert [line[1] for line in said[:4]] == ["cloudy", "cloudy", "night", "all"], "poses, then rooms"
    rows = rows_of(page_of(tmp_path).all("table", class_="rooms")[0])
    assert [row[-1] for row in rows] == ["23", "24", "47"]
    results = read_results(tmp_path / "evaluation/hog")
    assert results["skipped"]["room_retrieval, queries"] == "1 of 48 queries have no room label"
    shares = results["measures"]["room_retrieval"]
    wanted = [shares["lighting"]["cloudy"], shares["lighting"]["night"], shares["overall"]]
    assert [row[2] for row in rows] == [f"{100 * share['accuracy']:.1f} %" for share in wanted]


def test_rooms_that_the_map_lacks_are_not_called_left_out(given, tmp_path):
    done(*given, *HIERARCHICAL, "protocol.map.rooms=[corridor]", "task.plots=false")
    texts = [part.text for part in page_of(tmp_path).all("p")]
    (note,) = [text for text in texts if "that the map lacks" in text]
    assert note.startswith("16 of 24 queries are in rooms that the map lacks")


def test_a_map_says_how_many_of_its_frames_have_no_position(without, words, tmp_path, capsys):
    some = without("x", which=lambda row: row["sequence"] == "first" and int(row["time"]) < 5)
    done("map", *words, f"run={tmp_path}", "descriptor=hog", f"data.manifest={some}")
    assert "24 frames, 5 of which have no position" in capsys.readouterr().out


def test_a_map_without_positions_names_a_command_that_works(without, words, tmp_path, capsys):
    bare = without(*POSE, which=lambda row: True)
    done("map", *words, SECOND, f"run={tmp_path}", "descriptor=hog", f"data.manifest={bare}", "build=rooms")
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("next: ")]
    command, *given = shlex.split(line.removeprefix("next: siamloc "))
    assert (command, "task=mapping" in given) == ("evaluate", True)
    done(command, *given)
    assert "nodes of a map" in capsys.readouterr().out
