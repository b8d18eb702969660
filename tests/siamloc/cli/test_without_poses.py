"""Queries without any pose: they are located, not scored, and every command says so."""

from __future__ import annotations

import pytest

from siamloc.cli import main
from siamloc.maps import ErrorModel
from siamloc.results import read_results, read_rows
from tests.drawn import altered, write_manifest
from tests.siamloc.report.pages import notes, read_page, rows_of


def without(manifest, name, *fields):
    """Write a manifest next to another in which the queries lack some fields."""
    return altered(manifest, name, lambda row: dict.fromkeys(fields, "") if row["sequence"] == "second" else {})


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
        (["task.filter=true", "task.refine=interpolate", "task.error_model=true", "task.baselines=[]"], "hog"),
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
        f"No query has a true position to compare with: {queries} queries were located (see located.csv), and none is "
        "scored."
    )
    assert [section.attributes["class"] for section in page.all("section")] == ["configuration"]


def test_expected_errors_do_not_depend_on_whether_the_pose_is_known(manifest, tmp_path, capsys):
    bare = without(manifest, "unposed.csv", "x", "y", "theta")
    half = manifest.parent / "half.csv"
    lines = [with_pose if i % 2 else none for i, (with_pose, none) in enumerate(pairs_of_lines(manifest, bare))]
    half.write_text("".join(lines))
    given = ["task=absolute", "task.error_model=true", "task.baselines=[]", "protocol.validation.sequences=[third]"]
    told = {}
    for name, table in (("all", manifest), ("none", bare), ("half", half)):
        assert main(words("evaluate", table, tmp_path / name, *given)) == 0
        folder = tmp_path / name / "evaluation" / "hog"
        tables = [read_rows(folder, of) for of in ("queries", "located") if of in read_results(folder)["tables"]]
        told[name] = {
            path: (expected, lost)
            for columns in tables
            for path, expected, lost in zip(
                *(columns[key].tolist() for key in ("path", "error_m", "lost")), strict=True
            )
        }
        assert read_results(folder)["estimates"]["error_model"]["sequences"] == ["third"]
    assert len(told["all"]) == 18
    assert told["none"] == told["half"] == told["all"]
    folder = tmp_path / "none" / "evaluation" / "hog"
    assert ErrorModel.load(folder / "error_model.json").lost_above == 1.0
    said = "18 of 18 queries have no position: add x and y to the data"
    skipped = read_results(folder)["skipped"]
    assert skipped.pop("absolute") == said
    assert skipped.pop("foreign").endswith("got 18 and 0"), "the map has no frames that are far from others"
    assert not skipped
    assert f"absolute left out: {said}" in capsys.readouterr().out


def pairs_of_lines(*tables):
    return zip(*(table.read_text().splitlines(keepends=True) for table in tables), strict=True)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (["task=hierarchical", "build=rooms", "task.filter=true"], "unknown configuration key 'task.filter'"),
        (["task=robustness", "task.refine=interpolate"], "unknown configuration key 'task.refine'"),
        (["task=room_retrieval", "task.error_model=true"], "which room_retrieval leaves out: use task=absolute"),
        (["task=absolute", "task.filter_tune=true"], "set task.filter=true"),
    ],
)
def test_what_has_nothing_to_stand_beside_is_not_passed_over(manifest, tmp_path, capsys, given, sentence):
    assert main(words("evaluate", manifest, tmp_path, *given)) == 2
    assert sentence in capsys.readouterr().err


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
    cells = [cell.text for cell in page.all("table", class_="rooms")[0].all("td")]
    assert "–" not in cells[:2], "no empty columns"


def test_a_lighting_without_poses_keeps_its_rooms(manifest, tmp_path, capsys):
    table = without(manifest, "night.csv", "x", "y", "theta")
    given = ["protocol.query.sequences=[second,third]", "task.baselines=[]", "task.plots=false"]
    assert main(words("evaluate", table, tmp_path, *given)) == 0
    said = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith("hog ")]
    *said, _ = said  # the last table says what a query costs
    assert [line[1] for line in said] == ["cloudy", "cloudy", "night", "all"], "poses, then rooms"
    rows = rows_of(page_of(tmp_path).all("table", class_="rooms")[0])
    assert [row[-1] for row in rows] == ["18", "18", "36"]
    shares = read_results(tmp_path / "evaluation" / "hog")["measures"]["room_retrieval"]
    wanted = [shares["lighting"]["cloudy"], shares["lighting"]["night"], shares["overall"]]
    assert [row[2] for row in rows] == [f"{100 * share['accuracy']:.1f} %" for share in wanted]


def test_rooms_that_the_map_lacks_are_not_called_left_out(manifest, tmp_path):
    given = ["task=hierarchical", "build=rooms", "protocol.map.rooms=[corridor]", "task.plots=false"]
    assert main(words("evaluate", manifest, tmp_path, *given)) == 0
    texts = [part.text for part in page_of(tmp_path).all("p")]
    (note,) = [text for text in texts if "that the map lacks" in text]
    assert note.startswith("12 of 18 queries are in rooms that the map lacks")


def test_robustness_without_poses_is_judged_by_rooms(manifest, tmp_path, capsys):
    bare = without(manifest, "robust.csv", "x")
    assert main(words("evaluate", bare, tmp_path, "task=robustness", "task.baselines=[]")) == 0
    assert "[wrong rooms]" in capsys.readouterr().out
    neither = without(bare, "neither.csv", "room")
    assert main(words("evaluate", neither, tmp_path, "task=robustness", "task.baselines=[]")) == 2
    error = capsys.readouterr().err
    assert "18 of 18 map frames have no room label" in error or "have no room label" in error
    assert "Traceback" not in error
