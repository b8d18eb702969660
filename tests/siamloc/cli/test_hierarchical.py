"""Hierarchical localization, and the estimates other than the single-frame one, through the command line."""

import json

import numpy as np
import pytest

from foundation.files import plain
from siamloc.evaluation import hierarchy
from siamloc.maps import CoarseLayer, ErrorModel
from siamloc.results import read_results, read_rows
from tests.siamloc.cli.commands import QUICK, done, measures, refused

HIERARCHICAL = ["task=hierarchical", "task.plots=false"]
ABSOLUTE = ["task=absolute", *QUICK]


@pytest.fixture
def evaluate(words, tmp_path):
    """Return a function that evaluates a descriptor in a run of the test."""

    def evaluated(descriptor, *more, run=tmp_path):
        done("evaluate", *words, f"run={run}", f"descriptor={descriptor}", *more)

    return evaluated


@pytest.mark.parametrize("build", ["rooms", "sample build.nodes=5", "spectral build.nodes=4", "som build.grid=[2,2]"])
def test_the_files_alone_give_the_measures(evaluate, tmp_path, build, capsys):
    evaluate("hog", *HIERARCHICAL, *f"build={build}".split(), "task.candidates=1")
    shown = capsys.readouterr().out
    folder = tmp_path / "evaluation" / f"hierarchical-hog-{build.split()[0]}"
    written = read_results(folder)
    measured, known = written["measures"]["hierarchical"], read_rows(folder, "map")
    again = hierarchy.node_measures(read_rows(folder), measured)
    assert json.dumps(plain(again)) == json.dumps(measured)
    assert set(measured["lighting"]) == {"cloudy", "night"}
    table = read_rows(folder, "nodes")
    np.testing.assert_array_equal(np.bincount(known["node"], minlength=len(table["node"])), table["frames"])
    assert written["denominators"]["queries"] == 48
    assert measured["overall"]["comparisons"]["frames_share"] < 0.6
    assert f"{100 * measured['overall']['comparisons']['share']:.1f} %" in shown


@pytest.mark.parametrize(
    ("fine", "coarse", "by"),
    [
        ("thumbnail", "hog", "representatives"),
        ("thumbnail", "hog", "vote"),
        ("briefgist descriptor.rows=8", "hog", "representatives"),
        ("hog", "radon_poc", "vote"),
    ],
)
def test_layers_of_two_descriptors(evaluate, tmp_path, fine, coarse, by):
    options = [f"task.coarse.descriptor={coarse}", f"task.coarse.by={by}", "task.coarse.neighbours=3"]
    evaluate(*fine.split(), *HIERARCHICAL, *options, "build=rooms", "task.candidates=2")
    vote = "-vote" if by == "vote" else ""
    folder = tmp_path / "evaluation" / f"hierarchical-{fine.split()[0]}-{coarse}-rooms{vote}"
    columns = read_rows(folder)
    assert read_results(folder)["coarse_descriptor"]["name"] == coarse
    np.testing.assert_array_equal(columns["comparisons"] - columns["frames_compared"], 24 if by == "vote" else 3)
    assert columns["coarse_correct"].mean() > 0.5
    layer = CoarseLayer.load(tmp_path / "layers" / f"{coarse}-rooms" / "layer.npz")
    assert layer.names.tolist() == ["corridor", "kitchen", "office"]


def test_rooms_by_a_network_and_frames_by_another_descriptor(evaluate, trained, words, tmp_path, capsys):
    given = [*HIERARCHICAL, "build=rooms", f"task.coarse.descriptor={trained}"]
    evaluate("hog", *given)
    results = read_results(tmp_path / "evaluation/hierarchical-hog-network-run-rooms")
    assert results["coarse_descriptor"]["branch"] == "simple1"
    assert results["measures"]["hierarchical"]["overall"]["coarse"]["accuracy"] == 1
    other = ["evaluate", *words, f"run={tmp_path}", "descriptor=hog", *given, "data.image_size=[64,128]"]
    assert "say data.image_size=[32,128]" in refused(capsys, *other)


def test_a_layer_is_built_once_and_anew_for_another_map(evaluate, capsys):
    given = [*HIERARCHICAL, "build=spectral", "build.nodes=4", "overwrite=true"]
    built = []
    for more in ([], [], ["seed=1"], ["seed=1", "descriptor.bins=16"], ["seed=1", "protocol.map.sequences=[third]"]):
        validation = "protocol.validation.sequences=null"
        evaluate("hog", *given, validation, *more)
        built.append("layer: " in capsys.readouterr().out)
    assert built == [True, False, True, True, True]


def test_a_saved_map_is_used_and_one_of_another_descriptor_refused(evaluate, words, tmp_path, capsys):
    given = [*words, f"run={tmp_path}"]
    done("map", *given, "descriptor=hog")
    capsys.readouterr()
    evaluate("hog", *HIERARCHICAL, "build=rooms")
    assert "describing the map" not in capsys.readouterr().err
    evaluate("thumbnail", *HIERARCHICAL, "build=rooms", "task.coarse.descriptor=hog")
    assert "describing the map, hog" not in capsys.readouterr().err
    error = refused(capsys, "evaluate", *given, "descriptor=hog", *ABSOLUTE, "descriptor.bins=16")
    assert "described differently from" in error
    assert "bins" in error


def test_estimates_beside_the_single_frame_one(evaluate, tmp_path, capsys):
    evaluate("hog", *ABSOLUTE, run=tmp_path / "plain")
    options = ["task.filter=true", "task.refine=interpolate", "task.error_model=true", "task.lost_above=0.5"]
    evaluate("hog", *ABSOLUTE, *options, run=tmp_path / "more")
    shown = capsys.readouterr().out
    for words in ("hog + filter", "hog + interpolation", "lost above 0.5 m"):
        assert words in shown
    before, folder = (tmp_path / name / "evaluation/hog" for name in ("plain", "more"))
    results, columns = read_results(folder), read_rows(folder)
    measured = results["measures"]
    assert measured["absolute"] == measures(before)["absolute"]
    for name, column in read_rows(before).items():
        np.testing.assert_array_equal(columns[name], column, err_msg=name)

    assert {"absolute_filtered", "absolute_tracked", "absolute_interpolated", "calibration"} < set(measured)
    about = results["estimates"]
    assert ErrorModel.load(folder / about["error_model"]["file"]).queries == about["error_model"]["queries"] == 24
    assert about["error_model"]["sequences"] == ["third"]
    assert (about["filter"]["tuned"], about["filter"]["kidnapping"]) == (None, 1e-3)


def test_rooms_that_the_map_lacks_are_named(evaluate, capsys):
    for task in ([*HIERARCHICAL, "build=rooms"], ["task=room_retrieval", *QUICK]):
        evaluate("hog", *task, "protocol.map.rooms=[kitchen,office]")
        shown = capsys.readouterr().out
        assert "16 of 48 queries are in rooms that the map lacks (corridor)" in shown
        assert "protocol.map" in shown
