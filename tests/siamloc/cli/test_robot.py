"""Headings and expected errors of a trained network, from the map through the evaluation to the robot."""

import csv
import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from foundation.files import read_json
from siamloc.cli import main
from siamloc.maps import VisualMap
from siamloc.maps.error_model import ErrorModel
from tests.drawn import write_manifest

QUICK = ["protocol.query.sequences=[cloudy2]", "task.baselines=[]", "task.plots=false"]


def siamloc(*words):
    status = main([str(word) for word in words])
    assert status == 0, f"siamloc {' '.join(map(str, words))} returned {status}"


def table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flat")
    return write_manifest(folder, {"cloudy1": "cloudy", "cloudy2": "cloudy", "night1": "night"}, frames_per_room=8)


@pytest.fixture(scope="module")
def trained(flat, tmp_path_factory):
    run = tmp_path_factory.mktemp("job") / "run"
    siamloc(
        *["train", "data=manifest", f"data.manifest={flat}", f"data.cache={flat.parent / 'cache'}", f"run={run}"],
        *["model/branch=simple1", "model/head=fc500_500_5", "data.image_size=[32,128]", "pairs=room", "epochs=3"],
        *["protocol.train.sequences=[cloudy1]", "protocol.validation.sequences=[night1]", "batch_size=8"],
        "trainer.accelerator=cpu",
    )
    siamloc("map", f"run={run}")
    return run


@pytest.fixture(scope="module")
def finished(flat, trained, tmp_path_factory):
    """Map with headings, evaluate with an error model, export and locate all queries."""
    run = Path(shutil.copytree(trained, tmp_path_factory.mktemp("robot") / "run"))
    siamloc("map", f"run={run}", "heading=hog", "heading.step=4")
    siamloc("evaluate", f"run={run}", *QUICK, "task.error_model=true", "task.lost_above=1.5")
    siamloc("export", f"run={run}")
    siamloc("localize", f"run={run}", f"images=[{flat.parent / 'cloudy2'}]")
    return run


def test_a_network_tells_headings_as_an_analytic_method_does(finished):
    results = json.loads((finished / "evaluation/network/results.json").read_text())
    assert results["heading"]["name"] == "hog"
    assert results["heading"]["step"] == 4
    overall = results["measures"]["absolute"]["overall"]
    assert overall["heading_error"]["count"] == overall["queries"] == 24
    known = VisualMap.load(finished / "map.npz")
    hog = known.heading.descriptor
    for row in table(finished / "evaluation/network/queries.csv"):
        turn = float(row["est_theta"]) - known.frames.theta[int(row["match"])]
        steps = turn / hog.resolution(128)
        assert steps == pytest.approx(round(steps), abs=1e-6)
        off = math.remainder(float(row["est_theta"]) - float(row["theta"]), math.tau)
        assert abs(math.degrees(off)) == pytest.approx(float(row["heading_error"]), abs=1e-6)
        assert -math.pi < float(row["est_theta"]) <= math.pi
    assert overall["heading_error"]["median"] < 20


def test_the_robot_says_what_the_evaluation_says(finished):
    queries = {Path(row["path"]).name: row for row in table(finished / "evaluation/network/queries.csv")}
    rows = table(finished / "locations.csv")
    pairs = [(row, queries[Path(row["image"]).name]) for row in rows]
    assert len(pairs) == 24
    same = [(here, there) for here, there in pairs if here["match"] == there["match_path"]]
    assert len(same) >= 23, "the exported network differs by rounding only"
    for here, there in same:
        assert float(here["theta"]) == pytest.approx(float(there["est_theta"]), abs=1e-9)
        assert float(here["error_m"]) == pytest.approx(float(there["error_m"]), rel=1e-3)
        assert here["lost"] == there["lost"]


def test_export_and_localize_say_what_they_tell(finished, flat, capsys):
    siamloc("export", f"run={finished}")
    assert "the robot gets: position, heading (by hog), expected error (lost above 1.5 m)" in capsys.readouterr().out
    siamloc("localize", f"run={finished}", f"images=[{flat.parent / 'cloudy2/0003.png'}]", "top=1")
    line = capsys.readouterr().out.split("\n")[0]
    row = table(finished / "locations.csv")[0]
    assert f"heading {math.degrees(float(row['theta'])):.0f} deg" in line
    assert f"expected error {float(row['error_m']):.2f} m" in line
    assert (", lost" in line) == (row["lost"] == "True")


def test_lost_stands_in_the_line_and_the_table(finished, flat, tmp_path, capsys):
    run = Path(shutil.copytree(finished, tmp_path / "run"))
    siamloc("evaluate", f"run={run}", *QUICK, "task.error_model=true", "task.lost_above=1e-6")
    siamloc("export", f"run={run}")
    capsys.readouterr()
    siamloc("localize", f"run={run}", f"images=[{flat.parent / 'cloudy2'}]")
    lines = [line for line in capsys.readouterr().out.split("\n") if "nearest" in line]
    rows = table(run / "locations.csv")
    assert [", lost; nearest" in line for line in lines] == [row["lost"] == "True" for row in rows]
    assert any(row["lost"] == "True" for row in rows)


def test_a_map_without_positions_names_the_room(trained, flat, tmp_path, capsys):
    run = Path(shutil.copytree(trained, tmp_path / "run"))
    known = VisualMap.load(run / "map.npz")
    unknown = np.full(len(known), np.nan)
    replace(known, frames=known.frames.with_columns(x=unknown, y=unknown)).save(run / "map.npz")
    siamloc("export", f"run={run}")
    siamloc("localize", f"run={run}", f"images=[{flat.parent / 'cloudy2'}]")
    lines = [line for line in capsys.readouterr().out.splitlines() if "; nearest " in line]
    rows = table(run / "locations.csv")
    assert len(lines) == len(rows) == 24
    for line, row in zip(lines, rows, strict=True):
        assert f": position unknown in {row['room']}; nearest" in line
        assert row["x"] == row["y"] == ""


def test_the_map_hands_its_headings_on_and_they_can_be_left_out(finished, tmp_path, capsys):
    run = Path(shutil.copytree(finished, tmp_path / "run"))
    siamloc("evaluate", f"run={run}", *QUICK, "task.names=[absolute]", "task.refine=interpolate")
    told = json.loads((run / "evaluation/network/results.json").read_text())["measures"]
    assert "heading_error" in told["absolute"]["overall"]
    assert "heading_error" in told["absolute_interpolated"]["overall"]
    siamloc("export", f"run={run}")
    assert "position (between 3 map frames), heading" in capsys.readouterr().out
    rows = {row["path"]: row for row in table(run / "evaluation/network/queries.csv")}
    picture = next(iter(rows))
    siamloc("localize", f"run={run}", f"images=['{picture}']")
    (found,) = table(run / "locations.csv")
    for key in ("x", "y"):
        assert float(found[key]) == pytest.approx(float(rows[picture][f"interpolated_est_{key}"]), abs=1e-3)
    assert float(found["theta"]) == pytest.approx(float(rows[picture]["interpolated_est_theta"]), abs=1e-3)
    siamloc("evaluate", f"run={run}", *QUICK, "task.names=[absolute]", "heading=none")
    bare = json.loads((run / "evaluation/network/results.json").read_text())["measures"]
    assert "heading_error" not in bare["absolute"]["overall"]
    assert bare["absolute"]["overall"]["error"] == told["absolute"]["overall"]["error"]


def test_hierarchical_localization_tells_headings_too(finished, tmp_path):
    run = Path(shutil.copytree(finished, tmp_path / "run"))
    quick = [word for word in QUICK if "baselines" not in word]
    words = [f"run={run}", *quick, "task=hierarchical", "build=sample", "build.nodes=3"]
    siamloc("evaluate", *words, "task.candidates=3")
    whole = {row["path"]: row for row in table(run / "evaluation/network/queries.csv")}
    rows = table(run / "evaluation/hierarchical-network-sample/queries.csv")
    assert [row["est_theta"] for row in rows] == [whole[row["path"]]["est_theta"] for row in rows]
    siamloc("evaluate", *words, "heading=none")
    assert "est_theta" not in table(run / "evaluation/hierarchical-network-sample/queries.csv")[0]


@pytest.mark.parametrize("heading", ["hog", "fs", "gist", "radon_fourier"])
def test_headings_without_a_saved_map(flat, tmp_path, heading):
    data = [f"data.manifest={flat}", f"data.cache={flat.parent / 'cache'}", "data.image_size=[32,128]"]
    size = {"fs": ["heading.turns=128", "heading.orientation_columns=32"]}.get(heading, [])
    siamloc(
        *["evaluate", f"run={tmp_path / 'run'}", "descriptor=thumbnail", *data, *QUICK, f"heading={heading}", *size],
        "protocol.map.sequences=[cloudy1]",
    )
    results = json.loads((tmp_path / "run/evaluation/thumbnail/results.json").read_text())
    assert results["measures"]["absolute"]["overall"]["heading_error"]["median"] < 30


def test_an_older_map_asks_for_its_headings_in_one_sentence(trained, capsys):
    assert VisualMap.load(trained / "map.npz").heading is None
    assert main(["evaluate", f"run={trained}", *QUICK, "heading=hog"]) == 2
    error = capsys.readouterr().err
    assert "holds nothing to find headings by: make it again with `siamloc map heading=hog`" in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["heading=fs"], "the map gives headings by hog, not by fs: make it again with `siamloc map heading=fs`"),
        (["heading=hog", "heading.step=2"], "gives headings by hog with step=4 instead of 2"),
        (["heading=hug"], "unknown option heading=hug: did you mean 'hog'"),
        (["heading=wisurf"], "unknown option heading=wisurf"),
        (["heading=hog", "data.circular=false"], "needs columns that are a full turn"),
    ],
)
def test_headings_that_do_not_fit_get_one_sentence(finished, words, says, capsys):
    assert main(["evaluate", f"run={finished}", *QUICK, *words]) == 2
    assert says in capsys.readouterr().err


def test_an_analytic_descriptor_keeps_its_own_heading(finished, capsys):
    siamloc("evaluate", f"run={finished}", *QUICK, "descriptor=hog", "heading=fs")
    assert "heading=fs left out: hog gives headings itself" in capsys.readouterr().out


def test_an_export_without_headings_and_errors_says_how_to_add_them(trained, flat, tmp_path, capsys):
    run = Path(shutil.copytree(trained, tmp_path / "run"))
    siamloc("export", f"run={run}")
    said = capsys.readouterr().out
    assert "the robot gets: position\n" in said
    assert f"siamloc map run={run} heading=hog" in said
    assert f"siamloc evaluate run={run} task.error_model=true" in said
    siamloc("localize", f"run={run}", f"images=[{flat.parent / 'cloudy2/0003.png'}]")
    row = table(run / "locations.csv")[0]
    assert (row["theta"], row["error_m"], row["lost"]) == ("", "", "")
    line = capsys.readouterr().out.split("\n")[0]
    assert "heading" not in line
    assert "expected error" not in line


def test_an_error_model_of_another_map_is_left_out(finished, tmp_path, capsys):
    run = Path(shutil.copytree(finished, tmp_path / "run"))
    siamloc("map", f"run={run}", "protocol.map.every=2")
    capsys.readouterr()
    siamloc("export", f"run={run}")
    said = capsys.readouterr().out
    assert "error_model.json left out, it was learned on another map" in said
    assert f"siamloc evaluate run={run} task.error_model=true" in said
    assert "the robot gets: position\n" in said
    assert set(read_json(run / "bundle/bundle.json")["sha256"]) == {"model.onnx", "map.npz"}


def test_headings_leave_the_error_model_valid(finished, tmp_path):
    run = Path(shutil.copytree(finished, tmp_path / "run"))
    siamloc("map", f"run={run}", "heading=hog")
    errors = ErrorModel.load(run / "evaluation/network/error_model.json")
    assert errors.lost_above == 1.5
    assert errors.learned_on(VisualMap.load(run / "map.npz"))
    before, after = (VisualMap.load(folder / "map.npz").heading for folder in (finished, run))
    assert np.prod(after.values.shape) == 2 * np.prod(before.values.shape)


def test_any_descriptor_gives_the_robot_its_heading(finished, flat, tmp_path, capsys):
    run = Path(shutil.copytree(finished, tmp_path / "run"))
    siamloc("map", f"run={run}", "heading=gist")
    siamloc("evaluate", f"run={run}", *QUICK, "task.names=[absolute]")
    siamloc("export", f"run={run}")
    assert "heading (by gist)" in capsys.readouterr().out
    siamloc("localize", f"run={run}", f"images=[{flat.parent / 'cloudy2'}]")
    queries = {Path(row["path"]).name: row for row in table(run / "evaluation/network/queries.csv")}
    for row in table(run / "locations.csv"):
        expected = queries[Path(row["image"]).name]
        if row["match"] == expected["match_path"]:
            assert math.remainder(float(row["theta"]) - float(expected["est_theta"]), math.tau) == pytest.approx(
                0, abs=1e-3
            )


def test_an_analytic_map_becomes_a_bundle_with_layer_pictures_and_precision(flat, tmp_path, capsys):
    run, data = tmp_path / "run", ["data=manifest", f"data.manifest={flat}", f"data.cache={flat.parent / 'cache'}"]
    roles = ["protocol.map.sequences=[cloudy1]", "protocol.validation.sequences=[night1]"]
    size = ["data.image_size=[32,128]", "descriptor.rows=4"]
    words = [f"run={run}", "descriptor=hog", *size, *roles]
    siamloc("map", *data, *words, "build=sample", "build.nodes=3")
    siamloc("export", *words, "build=sample", "build.nodes=3", "precision=auto", "thumbnails=true", "task=hierarchical")
    said = capsys.readouterr().out
    assert "precision " in said
    assert "heading (by hog), a coarse layer by representatives, pictures of the map" in said
    siamloc("localize", f"run={run}", f"images=[{flat.parent / 'cloudy2'}]", "hierarchical=false")
    assert len(table(run / "locations.csv")) == 24


@pytest.mark.slow
def test_a_network_that_finds_headings_needs_no_heading_key(flat, tmp_path, capsys):
    run = tmp_path / "run"
    siamloc(
        *["train", "data=manifest", f"data.manifest={flat}", f"data.cache={flat.parent / 'cache'}", f"run={run}"],
        *["model/branch=panoresnet", "model/head=fourier", "model.circular=true", "data.image_size=[32,128]"],
        *["pairs=room", "epochs=1", "batch_size=8", "trainer.accelerator=cpu"],
        *["protocol.train.sequences=[cloudy1]", "protocol.validation.sequences=[night1]"],
    )
    siamloc("map", f"run={run}")
    assert "headings: by network, 2048 bytes a frame" in capsys.readouterr().out
    siamloc("evaluate", f"run={run}", *QUICK, "task.names=[absolute]")
    results = json.loads((run / "evaluation/network/results.json").read_text())
    assert results["heading"] == {"name": "network", "version": 1}
    assert results["measures"]["absolute"]["overall"]["heading_error"]["count"] == 24
    siamloc("export", f"run={run}")
    assert "heading (by network)" in capsys.readouterr().out
    siamloc("localize", f"run={run}", f"images=[{flat.parent / 'cloudy2'}]")
    queries = {Path(row["path"]).name: row for row in table(run / "evaluation/network/queries.csv")}
    pairs = [(row, queries[Path(row["image"]).name]) for row in table(run / "locations.csv")]
    same = [(here, there) for here, there in pairs if here["match"] == there["match_path"]]
    assert len(same) >= 23, "the exported network differs by rounding only"
    for here, there in same:
        apart = math.remainder(float(here["theta"]) - float(there["est_theta"]), math.tau)
        assert abs(apart) <= 1.01 * math.tau / 1024
    assert main(["evaluate", f"run={run}", *QUICK, "heading=hog"]) == 2
    assert "the map gives headings by network, not by hog" in capsys.readouterr().err
