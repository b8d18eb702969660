"""Every recipe runs, at its smallest, on drawn rooms; and no published number gets into what is measured."""

from __future__ import annotations

import csv
import io
import json
import math

import cv2
import pytest

from siamloc.cli import main
from siamloc.errors import ConfigError, DataError, StorageError
from siamloc.reproduce import recipe, recipes, reproduce, write_report
from siamloc.reproduce import running as running_module
from siamloc.reproduce.claims import claim
from siamloc.reproduce.published import published
from siamloc.reproduce.recipe_book import experiment
from tests.drawn import draw_panorama, draw_sequence

RUNS = {"cloudy1": 0, "cloudy2": 1, "cloudy3": 2, "night1": 5, "night2": 3, "sunny1": 6, "sunny2": 4}
FRAMES = 36  # in each of three rooms


@pytest.fixture(scope="session")
def root(tmp_path_factory):
    """A data set in COLD's layout, with the runs that recipes name."""
    folder = tmp_path_factory.mktemp("drawn") / "mini"
    for run, seed in RUNS.items():
        place = folder / "part_a" / f"seq2_{run}"
        for name in ("omni_cam", "localization"):
            (place / name).mkdir(parents=True)
        lines = []
        for time, pose in enumerate(draw_sequence(seed, FRAMES)):
            x, y, theta = pose["x"], pose["y"], pose["theta"]
            name = f"t{1000 + time}.000000_x{x:.6f}_y{y:.6f}_a{theta:.6f}.jpeg"
            lighting = run.rstrip("0123456789")
            picture = draw_panorama(pose["local_x"], y, theta, pose["room"], lighting, size=(128, 512))
            cv2.imwrite(str(place / "omni_cam" / name), picture)
            room = {"kitchen": "KT-A", "office": "1PO-A", "corridor": "CR-A"}[pose["room"]]
            lines.append(f"{name} {room}\n")
        (place / "localization" / "places.lst").write_text("".join(lines))
    return folder


@pytest.fixture(scope="session")
def out(tmp_path_factory):
    return tmp_path_factory.mktemp("reproduced")


def test_every_recipe_runs_and_is_written(root, out):
    results = []
    for one in recipes():
        found = reproduce(one.id, data="mini", root=root, scale="smoke", out=out, progress=False)
        assert found.records, one.id
        assert f"### {one.title}" in found.table()
        rows = list(csv.DictReader(io.StringIO(found.as_csv())))
        assert sum(row["ours"] != "" for row in rows) >= len(found.records)
        assert {row["data"] for row in rows} == {"mini"}
        assert all((verdict.ours in (True, False, None)) for verdict in found.verdicts)
        results.append(found)
    page = write_report(results, out / "report.md", {"table_9_9": "no such data"})
    text = page.read_text()
    assert "table_9_9 | not measured: no such data" in text
    assert text.count("![") == sum(bool(one.figure) for one in recipes())
    for one in recipes():
        assert (out / f"{one.id}.csv").is_file()
        assert (out / f"{one.id}.png").is_file() == bool(one.figure)


def test_what_was_measured_is_not_measured_again(root, out, monkeypatch):
    reproduce("figure_3_11", data="mini", root=root, scale="smoke", out=out, progress=False)

    def refuse(job, data):
        raise AssertionError(f"{job.experiment} is measured again")

    monkeypatch.setattr("siamloc.reproduce.experiments.measured", refuse)
    again = reproduce("figure_3_11", data="mini", root=root, scale="smoke", out=out, progress=False)
    assert len(again.records) > 20
    file = next((out / "measured" / "hits_hog").iterdir())
    held = file.read_text()
    file.write_text(held[: len(held) // 2])  # as on a disk that became full
    with pytest.raises(AssertionError, match="hits_hog is measured again"):
        reproduce("figure_3_11", data="mini", root=root, scale="smoke", out=out, progress=False)
    file.write_text(held)


@pytest.mark.parametrize(
    "change",
    [
        {"records": []},
        {"records": "abc"},
        {"records": [{"measure": "hit_rate", "value": math.nan, "settings": {}}]},
        {"records": [{"measure": "zzz", "value": 1.0, "settings": {}}]},
        {"records": [{"measure": "hit_rate", "value": 1.0, "settings": {"k5": [1]}}]},
        {"records": [{"measure": "hit_rate", "value": 1.0, "settings": {}}]},  # which is whole, but not what was kept
        {"job": {"kind": "retrieval"}},
        {"seconds": -1},
    ],
)
def test_kept_numbers_that_were_altered_are_measured_again(root, out, monkeypatch, change):
    measured = {"data": "mini", "root": root, "scale": "smoke", "out": out, "progress": False}
    reproduce("figure_3_11", **measured)
    file = next((out / "measured" / "hits_hog").iterdir())
    held = file.read_text()
    file.write_text(json.dumps({**json.loads(held), **change}))

    def refuse(job, data):
        raise AssertionError(f"{job.experiment} is measured again")

    monkeypatch.setattr("siamloc.reproduce.experiments.measured", refuse)
    with pytest.raises(AssertionError, match="hits_hog is measured again"):
        reproduce("figure_3_11", **measured)
    file.write_text(held)


def test_a_folder_that_cannot_be_made_is_refused_before_the_work(root, tmp_path, monkeypatch):
    (tmp_path / "taken").write_text("a file")
    monkeypatch.setattr("siamloc.reproduce.experiments.measured", None)
    with pytest.raises(StorageError, match="a file stands where a folder is needed"):
        reproduce("figure_3_11", data="mini", root=root, scale="smoke", out=tmp_path / "taken", progress=False)


def test_one_recipe_is_named(capsys):
    assert main(["reproduce", "figure_3_11", "figure_3_12"]) == 2
    assert "siamloc reproduce takes one id, got figure_3_11 figure_3_12" in capsys.readouterr().err


def test_no_published_number_is_ever_ours(root, out, monkeypatch):
    before = reproduce("section_3_5_1", data="mini", root=root, scale="smoke", out=out, progress=False)

    def poisoned(entry):
        found = published(entry)
        rows = tuple({key: 9731 if key == "hit_rate" else value for key, value in row.items()} for row in found.rows)
        return type(found)(**{**vars(found), "rows": rows})

    monkeypatch.setattr(running_module, "published", poisoned)
    after = reproduce("section_3_5_1", data="mini", root=root, scale="smoke", out=out / "poisoned", progress=False)
    timed = {"seconds"}
    ours = [
        [(one.measure, one.value) for one in found.records if one.measure not in timed] for found in (before, after)
    ]
    assert ours[0] == ours[1]
    assert {row.published.value for row in after.rows} == {97.31}
    assert [row.ours.value for row in after.rows] == [row.ours.value for row in before.rows]
    assert "97.31" not in "".join(path.read_text() for path in (out / "poisoned" / "measured").rglob("*.json"))


def test_recipes_name_what_there_is():
    for one in recipes():
        for name in one.experiments:
            assert experiment(name).jobs("smoke")
            assert len(experiment(name).jobs("smoke")) <= len(experiment(name).jobs("full"))
        for name in one.claims:
            assert claim(name).check
        for name in one.entries:
            assert published(name).rows
        assert one.jobs("short")
    ids = [one.id for one in recipes()]
    assert len(set(ids)) == len(ids)
    assert recipe("table_4_2").join == ("descriptor", "data")


def test_what_stands_beside_ours_is_left_out_of_claims(root, out):
    found = reproduce("section_3_5_1", data="mini", root=root, scale="smoke", out=out, progress=False)
    assert {one.settings["descriptor"] for one in found.beside} == {"pretrained"}
    assert "pretrained" not in {one.settings["descriptor"] for one in found.records}


@pytest.mark.parametrize(
    ("options", "kind", "says"),
    [
        ({"id": "table_5_77"}, ConfigError, "there is no recipe 'table_5_77'; did you mean 'table_5_"),
        ({"scale": "long"}, ConfigError, "unknown scale 'long'"),
        ({"data": "colt"}, ConfigError, "did you mean 'cold'"),
        ({"data": "cold"}, ConfigError, "say where COLD Freiburg, part A, path 2 lies: root=FOLDER"),
        (
            {"data": "mini", "root": "nowhere"},
            DataError,
            "nowhere, which does not exist: render it with `siamloc demo`",
        ),
    ],
)
def test_what_is_missing_is_said_in_one_sentence(tmp_path, options, kind, says):
    with pytest.raises(kind, match=says):
        reproduce(**{"id": "figure_3_11", "out": tmp_path, "progress": False, **options})


def test_a_drive_that_is_missing_is_named(root, tmp_path):
    fewer = tmp_path / "mini"
    (fewer / "part_a").mkdir(parents=True)
    (fewer / "part_a" / "seq2_cloudy3").symlink_to(root / "part_a" / "seq2_cloudy3")
    with pytest.raises(DataError, match=r"lacks a drive that the recipe needs .*cloudy2"):
        reproduce("figure_3_11", data="mini", root=fewer, scale="smoke", out=tmp_path / "out", progress=False)


def test_the_command_lists_and_measures(root, out, capsys):
    assert main(["reproduce", "--list", "data=mini", "scale=smoke"]) == 0
    listed = capsys.readouterr().out
    assert all(f"\n{one.id} " in f"\n{listed}" for one in recipes())
    words = ["reproduce", "figure_3_16", "data=mini", f"root={root}", "scale=smoke", f"out={out / 'command'}"]
    assert main(words) == 0
    assert f"written: {out / 'command'}/figure_3_16.png" in capsys.readouterr().out
    kept = json.loads(next((out / "command" / "measured" / "hits_radon_poc").iterdir()).read_text())
    assert kept["job"]["data"] == "mini"
    assert main(["reproduce", "figure_3_166", "data=mini"]) == 2
    assert "did you mean 'figure_3_16'" in capsys.readouterr().err
