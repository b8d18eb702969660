"""Headings and expected errors of a trained network, from the map through the evaluation to the robot."""

import csv
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from foundation.files import read_json
from siamloc.maps import VisualMap
from siamloc.maps.error_model import ErrorModel
from siamloc.results import read_results
from tests.drawn import altered
from tests.siamloc.cli.commands import QUICK, done, measures, refused

MEASURED = ["protocol.query.sequences=[second]", *QUICK]
ABSOLUTE = [*MEASURED, "task.names=[absolute]", "overwrite=true"]


def table(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def answers(run):
    """Pair the row of each located query with its row in the results; nearly all have the same map frame."""
    queries = {Path(row["path"]).name: row for row in table(run / "evaluation/network/queries.csv")}
    pairs = [(row, queries[Path(row["image"]).name]) for row in table(run / "locations.csv")]
    assert len(pairs) == len(queries) == 24
    # The bundle names map frames from the folder that they share.
    same = [(here, there) for here, there in pairs if Path(there["match_path"]).name == Path(here["match"]).name]
    assert len(same) >= 23, "the exported network differs by rounding only"
    return same


def apart(one, other):
    return abs(math.remainder(float(one) - float(other), math.tau))


@pytest.fixture
def bare(trained, tmp_path):
    """A copy of the run whose map has no headings, to be changed."""
    return Path(shutil.copytree(trained, tmp_path / "run"))


def test_the_robot_says_what_the_evaluation_says(finished, flat, tmp_path, capsys):
    for here, there in answers(finished):
        assert float(here["distance"]) == pytest.approx(float(there["descriptor_distance"]), abs=1e-3)
        assert float(here["theta"]) == pytest.approx(float(there["est_theta"]), abs=1e-9)
        assert float(here["error_m"]) == pytest.approx(float(there["error_m"]), rel=1e-3)
        assert here["lost"] == there["lost"]
    row = table(finished / "locations.csv")[3]
    image = f"images=[{flat.parent / 'second/0003.png'}]"
    done("localize", f"run={finished}", image, "top=1", f"out={tmp_path / 'one.csv'}")
    line = capsys.readouterr().out.split("\n")[0]
    assert f"heading {round(math.degrees(float(row['theta'])))} deg" in line
    assert f"expected error {float(row['error_m']):.2f} m" in line
    assert (", lost" in line) == (row["lost"] == "True")


def test_lost_stands_in_the_line_and_the_table(run, flat, tmp_path, capsys):
    done("evaluate", f"run={run}", *MEASURED, "task.error_model=true", "task.lost_above=1e-6")
    done("export", f"run={run}")
    assert "the robot gets: position, heading (by hog), expected error (lost above 1e-06 m)" in capsys.readouterr().out
    done("localize", f"run={run}", f"images=[{flat.parent / 'second'}]")
    out = capsys.readouterr().out
    lines = [line for line in out.split("\n") if "nearest" in line]
    lost = [row["lost"] == "True" for row in table(run / "locations.csv")]
    assert [", lost; nearest" in line for line in lines] == lost
    assert f"{len(lost) - sum(lost)} of {len(lost)} images located, {sum(lost)} lost: " in out
    assert any(lost)
    shutil.copy(flat.parent / "second/0003.png", named := tmp_path / "t3.0_x0_y0_a0.png")
    done("localize", f"run={run}", f"images=['{named}']")
    told = capsys.readouterr().out
    assert " m from the pose in its name" in told
    assert "from the poses in their names" not in told, "a lost robot claims none"
    (run / "evaluation/network/results.json").write_text("[1]")
    assert "results.json is not a siamloc result file" in refused(capsys, "export", f"run={run}")


def test_a_robot_is_followed_by_the_odometry_of_a_manifest(run, flat):
    still = altered(flat, "still.csv", lambda row: dict.fromkeys(("odom_x", "odom_y", "odom_theta"), "0"))
    images, jumps = [f"run={run}", f"images=[{flat.parent / 'second'}]", "track=true"], []
    for words in ([], [f"odometry={still}"]):
        done("localize", *images, *words)
        x = [float(row["x"]) for row in table(run / "locations.csv")]
        jumps.append(np.count_nonzero(np.diff(x)))
    assert jumps[1] < jumps[0], "the wheels say that the robot stands still"


def test_a_map_without_positions_names_the_room(bare, flat, capsys):
    known = VisualMap.load(bare / "map.npz")
    unknown = np.full(len(known), np.nan)
    replace(known, frames=known.frames.with_columns(x=unknown, y=unknown)).save(bare / "map.npz")
    done("export", f"run={bare}")
    done("localize", f"run={bare}", f"images=[{flat.parent / 'second'}]")
    lines = [line for line in capsys.readouterr().out.splitlines() if "; nearest " in line]
    rows = table(bare / "locations.csv")
    assert len(lines) == len(rows) == 24
    for line, row in zip(lines, rows, strict=True):
        assert f": position unknown in {row['room']}; nearest" in line
        assert row["x"] == row["y"] == ""


def test_the_map_hands_its_headings_on_and_they_can_be_left_out(run, capsys):
    done("evaluate", f"run={run}", *ABSOLUTE, "task.refine=interpolate")
    told = measures(run / "evaluation/network")
    assert "heading_error" in told["absolute"]["overall"]
    assert "heading_error" in told["absolute_interpolated"]["overall"]
    done("export", f"run={run}")
    assert "position (between 3 map frames), heading" in capsys.readouterr().out
    row = table(run / "evaluation/network/queries.csv")[0]
    done("localize", f"run={run}", f"images=['{row['path']}']")
    (found,) = table(run / "locations.csv")
    for key in ("x", "y", "theta"):
        assert float(found[key]) == pytest.approx(float(row[f"interpolated_est_{key}"]), abs=1e-3)
    done("evaluate", f"run={run}", *ABSOLUTE, "heading=none")
    bare = measures(run / "evaluation/network")
    assert "heading_error" not in bare["absolute"]["overall"]
    assert bare["absolute"]["overall"]["error"] == told["absolute"]["overall"]["error"]


def test_hierarchical_localization_tells_headings_too(run):
    words = [f"run={run}", MEASURED[0], "task=hierarchical", "task.plots=false", "build=sample", "build.nodes=3"]
    done("evaluate", *words, "task.candidates=3")
    whole = {row["path"]: row for row in table(run / "evaluation/network/queries.csv")}
    rows = table(run / "evaluation/hierarchical-network-sample/queries.csv")
    assert [row["est_theta"] for row in rows] == [whole[row["path"]]["est_theta"] for row in rows]
    done("evaluate", *words, "heading=none")
    assert "est_theta" not in table(run / "evaluation/hierarchical-network-sample/queries.csv")[0]


@pytest.mark.parametrize("heading", ["hog", "fs", "gist", "radon_fourier"])
def test_headings_without_a_saved_map(words, tmp_path, heading, capsys):
    size = {"fs": ["heading.turns=128", "heading.orientation_columns=32"]}.get(heading, [])
    given = ["evaluate", f"run={tmp_path}", *words, *ABSOLUTE, f"heading={heading}", *size]
    done(*given, "descriptor=thumbnail")
    assert measures(tmp_path / "evaluation/thumbnail")["absolute"]["overall"]["heading_error"]["median"] < 30
    if heading == "hog":
        done(*given, "descriptor=fs", "descriptor.turns=128", "descriptor.orientation_columns=32")
        assert "heading=hog left out: fs gives headings itself" in capsys.readouterr().out


def test_an_export_without_headings_and_errors_says_how_to_add_them(bare, flat, capsys):
    done("export", f"run={bare}")
    said = capsys.readouterr().out
    assert "the robot gets: position\n" in said
    assert f"siamloc map run={bare} heading=hog" in said
    assert f"siamloc evaluate run={bare} 'protocol.query.sequences=[\"second\"]' task.error_model=true" in said
    done("localize", f"run={bare}", f"images=[{flat.parent / 'second/0003.png'}]")
    row = table(bare / "locations.csv")[0]
    assert (row["theta"], row["error_m"], row["lost"]) == ("", "", "")
    line = capsys.readouterr().out.split("\n")[0]
    assert "heading" not in line
    assert "expected error" not in line


def test_an_error_model_is_left_out_for_another_map_and_kept_for_other_headings(run, capsys):
    before = VisualMap.load(run / "map.npz").orientation
    done("map", f"run={run}", "heading=hog")
    errors, known = ErrorModel.load(run / "evaluation/network/error_model.json"), VisualMap.load(run / "map.npz")
    assert errors.lost_above == 1.5
    assert errors.learned_on(known)
    assert known.orientation.size == 2 * before.size
    done("map", f"run={run}", "protocol.map.every=2")
    capsys.readouterr()
    done("export", f"run={run}")
    said = capsys.readouterr().out
    assert "error_model.json left out, it was learned on another map" in said
    assert f"siamloc evaluate run={run} 'protocol.query.sequences=[\"second\"]' task.error_model=true" in said
    assert "the robot gets: position\n" in said
    assert set(read_json(run / "bundle/bundle.json")["sha256"]) == {"model.onnx", "map.npz"}


def test_an_analytic_map_becomes_a_bundle_with_layer_pictures_and_precision(words, flat, tmp_path, capsys):
    given = [*words, f"run={tmp_path}", "descriptor=hog", "descriptor.rows=4", "build=sample", "build.nodes=3"]
    done("map", *given)
    done("export", *given, "precision=auto", "thumbnails=true", "task=hierarchical")
    said = capsys.readouterr().out
    assert "precision " in said
    assert "heading (by hog), a coarse layer by representatives, pictures of the map" in said
    done("localize", f"run={tmp_path}", f"images=[{flat.parent / 'second'}]", "hierarchical=false")
    assert len(table(tmp_path / "locations.csv")) == 24


@pytest.mark.slow
def test_poses_by_an_ordinary_camera_are_refined_from_the_training_to_the_robot(data, tmp_path, capsys):
    run = tmp_path / "run"
    done(
        *["train", "experiment=modern", *data, f"run={run}", "data.circular=false", "model.circular=false"],
        *["model.relative=true", "protocol.train.sequences=[first]", "protocol.validation.sequences=[third]"],
        *["epochs=1", "pairs.places=4", "pairs.images=2", "pairs.epoch_batches=2", "trainer.accelerator=cpu"],
    )
    done("map", f"run={run}")
    assert "comparison: by network" in capsys.readouterr().out
    done("evaluate", f"run={run}", *ABSOLUTE, "task.refine=relative")
    told = measures(run / "evaluation/network")
    assert "heading_error" not in told["absolute"]["overall"]
    assert told["absolute_refined"]["overall"]["heading_error"]["count"] == 24
    done("export", f"run={run}")
    assert "the robot gets: position (by comparison with 3 map frames)\n" in capsys.readouterr().out
    row = table(run / "evaluation/network/queries.csv")[0]
    done("localize", f"run={run}", f"images=['{row['path']}']")
    (found,) = table(run / "locations.csv")
    for key in ("x", "y", "theta"):
        assert float(found[key]) == pytest.approx(float(row[f"refined_est_{key}"]), abs=1e-3)


@pytest.mark.slow
def test_a_network_that_finds_headings_needs_no_heading_key(data, flat, tmp_path, capsys):
    run = tmp_path / "run"
    done(
        *["train", *data, f"run={run}", "model/branch=panoresnet", "model/head=fourier", "model.circular=true"],
        *["pairs=room", "epochs=1", "batch_size=8", "trainer.accelerator=cpu"],
        *["protocol.train.sequences=[first]", "protocol.validation.sequences=[dark]"],
    )
    done("map", f"run={run}")
    assert "headings: by network, 2048 bytes a frame" in capsys.readouterr().out
    done("evaluate", f"run={run}", *ABSOLUTE)
    results = read_results(run / "evaluation/network")
    assert results["heading"] == {"name": "network", "version": 1}
    assert results["measures"]["absolute"]["overall"]["heading_error"]["count"] == 24
    done("export", f"run={run}")
    assert "heading (by network)" in capsys.readouterr().out
    done("localize", f"run={run}", f"images=[{flat.parent / 'second'}]")
    assert all(apart(here["theta"], there["est_theta"]) <= 1.01 * math.tau / 1024 for here, there in answers(run))
    says = "name is 'network' in the map, 'hog' here"
    assert says in refused(capsys, "evaluate", f"run={run}", *ABSOLUTE, "heading=hog")
