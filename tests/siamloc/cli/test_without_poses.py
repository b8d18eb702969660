"""Queries without any pose: they are located, not scored, and every command says so."""

from __future__ import annotations

import csv

import pytest

from siamloc.cli import main
from siamloc.tasks.results import read_results, read_rows
from tests.drawn import write_manifest
from tests.siamloc.report.pages import notes, read_page


def without(manifest, name, *fields):
    """Write a manifest beside another in which the queries lack some fields."""
    with manifest.open(newline="") as file:
        rows = list(csv.DictReader(file))
    path = manifest.parent / name
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows({**row, **(dict.fromkeys(fields, "") if row["sequence"] == "second" else {})} for row in rows)
    return path


@pytest.fixture(scope="module")
def manifest(tmp_path_factory):
    sequences = {"first": "cloudy", "second": "night", "third": "cloudy"}
    return write_manifest(tmp_path_factory.mktemp("drawn"), sequences, frames_per_room=6)


def words(command, manifest, run, *more):
    return [
        *[command, f"data.manifest={manifest}", "data.image_size=[32,128]", f"data.cache={manifest.parent / 'store'}"],
        *["protocol.map.sequences=[first]", "protocol.query.sequences=[second]", f"run={run}", "descriptor=hog", *more],
    ]


def page_of(run):
    assert main(["report", f"run={run}"]) == 0
    return read_page(run / "report.html")


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ([], "hog"),
        (["task.filter=true", "task.interpolate=3", "task.error_model=true", "task.baselines=[]"], "hog"),
        (["task=hierarchical", "build=rooms"], "hierarchical-hog-rooms"),
    ],
    ids=["with a baseline", "with further estimates", "hierarchical"],
)
def test_neither_poses_nor_rooms(manifest, tmp_path, capsys, given, name):
    bare = without(manifest, f"bare-{len(given)}.csv", "x", "y", "theta", "room")
    more = ["task.baselines=[thumbnail]"] if not given else ["protocol.validation.sequences=[third]"]
    assert main(words("evaluate", bare, tmp_path, *given, *more)) == 0
    shown = capsys.readouterr().out
    assert "queries have no position" in shown
    assert "located.csv" in shown
    assert "queries.csv" not in shown
    folder = tmp_path / "evaluation" / name
    queries = len(read_rows(folder, "located")["path"])
    assert queries == 18
    assert read_results(folder)["measures"] == {}
    page = page_of(tmp_path)
    assert notes(page) == (
        f"No query has a true position to compare with: {queries} queries were located, in located.csv, and none is "
        "scored."
    )
    assert [section.attributes["class"] for section in page.all("section")] == ["configuration"]


def test_rooms_without_poses_are_scored_and_the_rest_is_located(manifest, tmp_path, capsys):
    rooms = without(manifest, "rooms.csv", "x", "y", "theta")
    assert main(words("evaluate", rooms, tmp_path, "task.baselines=[thumbnail]")) == 0
    shown = capsys.readouterr().out
    assert "18 queries, in located.csv" in shown
    assert "rooms.csv" in shown
    measures = read_results(tmp_path / "evaluation" / "hog")["measures"]
    assert set(measures) == {"room_retrieval"}
    assert (tmp_path / "evaluation" / "hog" / "confusion.png").exists()
    page = page_of(tmp_path)
    assert "none is scored" not in notes(page), "their rooms are"
    assert "18 queries were located" in notes(page)
    names = [section.attributes["class"] for section in page.all("section")]
    assert names == ["summary", "rooms", "configuration"]
    cells = [cell.text for cell in page.one("table", class_="by-lighting").all("td")]
    assert "–" not in cells[:2], "no empty columns"


def test_robustness_needs_poses_and_says_so(manifest, tmp_path, capsys):
    bare = without(manifest, "robust.csv", "x")
    assert main(words("evaluate", bare, tmp_path, "task=robustness", "task.baselines=[]")) == 2
    error = capsys.readouterr().err
    assert "all 18 frames of the queries have no position" in error
    assert "Traceback" not in error
