"""Hierarchical localization, and the estimates other than the single-frame one, through the command line."""

import json

import numpy as np
import pytest

from foundation.files import plain
from siamloc.cli import main
from siamloc.evaluation import absolute, calibration, hierarchy
from siamloc.maps import CoarseLayer, ErrorModel
from siamloc.results import read_results, read_rows
from tests.drawn import altered, write_manifest

SEQUENCES = {"first": "cloudy", "second": "cloudy", "dark": "night", "third": "cloudy"}
HIERARCHICAL = ["task=hierarchical", "task.plots=false"]
ABSOLUTE = ["task=absolute", "task.baselines=[]", "task.plots=false"]


@pytest.fixture(scope="module")
def manifest(tmp_path_factory):
    return write_manifest(tmp_path_factory.mktemp("drawn"), SEQUENCES, frames_per_room=12)


def words(manifest, run, descriptor, *more):
    common = [f"data.manifest={manifest}", "data.image_size=[32,128]", f"data.cache={manifest.parent / 'store'}"]
    roles = ["protocol.map.sequences=[first]", "protocol.query.sequences=[second,dark]"]
    roles.append("protocol.validation.sequences=[third]")
    return [*common, *roles, f"run={run}", f"descriptor={descriptor}", *more]


def evaluate(manifest, run, descriptor, *more):
    given = words(manifest, run, descriptor, *more)
    assert main(["evaluate", *given]) == 0


def refused(capsys, *given):
    assert main(["evaluate", *given]) == 2
    error = capsys.readouterr().err
    assert error.count("siamloc: ") == 1
    assert error.splitlines()[-1].startswith("siamloc: ")
    return error.splitlines()[-1]


@pytest.mark.parametrize(
    ("build", "nodes"),
    [
        (["build=rooms"], 3),
        (["build=sample", "build.nodes=5"], 5),
        (["build=spectral", "build.nodes=4"], 4),
        (["build=som", "build.grid=[2,2]"], None),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_the_files_alone_give_the_measures(manifest, tmp_path, build, nodes, capsys):
    evaluate(manifest, tmp_path, "hog", *HIERARCHICAL, *build, "task.candidates=1")
    shown = capsys.readouterr().out
    folder = tmp_path / "evaluation" / f"hierarchical-hog-{build[0].partition('=')[2]}"
    written = read_results(folder)
    measures, known = written["measures"]["hierarchical"], read_rows(folder, "map")
    columns = read_rows(folder)
    again = hierarchy.node_measures(columns, measures["radii"], measures["ks"], len(known["path"]), measures["unit"])
    assert json.dumps(plain(again)) == json.dumps(measures)
    assert set(measures["lighting"]) == {"cloudy", "night"}
    table = read_rows(folder, "nodes")
    assert nodes in (None, len(table["node"]))
    np.testing.assert_array_equal(np.bincount(known["node"], minlength=len(table["node"])), table["frames"])
    assert written["denominators"]["queries"] == 72
    overall = measures["overall"]
    assert overall["comparisons"]["frames_share"] < 0.6
    assert overall["given_right"]["queries"] + overall["given_wrong"]["queries"] == 72
    assert overall["perfect_coarse"]["error"]["mean"] <= overall["absolute"]["error"]["mean"] + 0.5
    assert overall["heading_error"]["median"] < 40
    assert f"{100 * overall['comparisons']['share']:.1f} %" in shown
    assert f"{overall['given_right']['error']['mean']:.3f}" in shown


def test_frames_in_no_node_are_searched_always(manifest, tmp_path):
    evaluate(manifest, tmp_path, "hog", *HIERARCHICAL, "build=incremental_sparse", "task.candidates=1")
    folder = tmp_path / "evaluation" / "hierarchical-hog-incremental_sparse"
    node, size = read_rows(folder, "map")["node"], read_rows(folder, "nodes")["frames"]
    columns = read_rows(folder)
    tried = columns["nodes_tried"].astype(int)
    assert (node == -1).any()
    np.testing.assert_array_equal(columns["frames_compared"], (node == -1).sum() + size[tried])
    assert columns["coarse_correct"][columns["true_node"] == -1].all()


def test_all_nodes_give_what_absolute_localization_gives(manifest, tmp_path):
    evaluate(manifest, tmp_path, "hog", *HIERARCHICAL, "build=sample", "build.nodes=4", "task.candidates=4")
    evaluate(manifest, tmp_path, "hog", *ABSOLUTE)
    both = read_rows(tmp_path / "evaluation" / "hierarchical-hog-sample")
    whole = read_rows(tmp_path / "evaluation" / "hog")
    for name, column in whole.items():
        np.testing.assert_array_equal(both[name], column, err_msg=name)
    np.testing.assert_array_equal(both["error_absolute"], whole["error"])


@pytest.mark.parametrize(
    ("fine", "coarse", "by"),
    [
        (["thumbnail"], "hog", "representatives"),
        (["thumbnail"], "hog", "vote"),
        (["briefgist", "descriptor.rows=8"], "hog", "representatives"),
        (["hog"], "radon_poc", "vote"),
    ],
)
def test_layers_of_two_descriptors(manifest, tmp_path, fine, coarse, by):
    options = [f"task.coarse.descriptor={coarse}", f"task.coarse.by={by}", "task.coarse.neighbours=3"]
    evaluate(manifest, tmp_path, *fine, *HIERARCHICAL, *options, "build=rooms", "task.candidates=2")
    vote = "-vote" if by == "vote" else ""
    folder = tmp_path / "evaluation" / f"hierarchical-{fine[0]}-{coarse}-rooms{vote}"
    columns = read_rows(folder)
    assert read_results(folder)["coarse_descriptor"]["name"] == coarse
    np.testing.assert_array_equal(columns["comparisons"] - columns["frames_compared"], 36 if by == "vote" else 3)
    assert columns["coarse_correct"].mean() > 0.5
    layer = CoarseLayer.load(tmp_path / "layers" / f"{coarse}-rooms" / "layer.npz")
    assert layer.names.tolist() == ["corridor", "kitchen", "office"]
    evaluate(manifest, tmp_path, *fine, *ABSOLUTE)
    whole = read_rows(tmp_path / "evaluation" / fine[0])
    np.testing.assert_array_equal(columns["error_absolute"], whole["error"])
    inside = columns["match"] == whole["match"]
    tried = [
        str(node) in text.split()
        for node, text in zip(layer.labels[whole["match"]], columns["nodes_tried"], strict=True)
    ]
    np.testing.assert_array_equal(inside, tried)


def test_rooms_by_a_network_and_frames_by_another_descriptor(manifest, tmp_path, capsys):
    run = tmp_path / "rooms"
    data = [f"data.manifest={manifest}", "data.image_size=[32,128]", f"data.cache={manifest.parent / 'store'}"]
    model = ["model/branch=simple1", "model/head=fc500_500_5", "pairs=room", "epochs=2", "batch_size=8"]
    train = ["protocol.train.sequences=[first]", "trainer.accelerator=cpu", f"run={run}"]
    assert main(["train", *data, *model, *train]) == 0
    evaluate(manifest, tmp_path / "hog", "hog", *HIERARCHICAL, "build=rooms", f"task.coarse.descriptor={run}")
    results = read_results(tmp_path / "hog" / "evaluation" / "hierarchical-hog-network-rooms-rooms")
    assert results["coarse_descriptor"]["branch"] == "simple1"
    assert results["measures"]["hierarchical"]["overall"]["coarse"]["accuracy"] == 1
    wanted = [*HIERARCHICAL, "build=rooms", f"task.coarse.descriptor={run}", "data.image_size=[64,128]"]
    assert "say data.image_size=[32,128]" in refused(capsys, *words(manifest, tmp_path / "hog", "hog", *wanted))


def test_a_layer_is_built_once_and_anew_for_another_map(manifest, tmp_path, capsys):
    given = [*HIERARCHICAL, "build=spectral", "build.nodes=4", "overwrite=true"]
    built = []
    for more in ([], [], ["seed=1"], ["seed=1", "descriptor.bins=16"], ["seed=1", "protocol.map.sequences=[third]"]):
        evaluate(manifest, tmp_path, "hog", *given, *more)
        built.append("layer: " in capsys.readouterr().out)
    assert built == [True, False, True, True, True]


def test_a_saved_map_is_used_and_one_of_another_descriptor_refused(manifest, tmp_path, capsys):
    assert main(["map", *words(manifest, tmp_path, "hog")]) == 0
    given = [*HIERARCHICAL, "build=rooms"]
    capsys.readouterr()
    evaluate(manifest, tmp_path, "hog", *given)
    assert "describing the map" not in capsys.readouterr().err
    evaluate(manifest, tmp_path, "thumbnail", *given, "task.coarse.descriptor=hog")
    assert "describing the map, hog" not in capsys.readouterr().err
    error = refused(capsys, *words(manifest, tmp_path, "hog", *given, "descriptor.bins=16"))
    assert "described differently from" in error
    assert "bins" in error


def test_estimates_beside_the_single_frame_one(manifest, tmp_path, capsys):
    evaluate(manifest, tmp_path / "plain", "hog", *ABSOLUTE)
    options = ["task.filter=true", "task.refine=interpolate", "task.error_model=true", "task.lost_above=0.5"]
    evaluate(manifest, tmp_path / "more", "hog", *ABSOLUTE, *options)
    shown = capsys.readouterr().out
    assert "hog + filter" in shown
    assert "hog + interpolation" in shown
    assert "lost above 0.5 m" in shown
    before, folder = read_results(tmp_path / "plain/evaluation/hog"), tmp_path / "more/evaluation/hog"
    results, columns = read_results(folder), read_rows(folder)
    measures = results["measures"]
    assert measures["absolute"] == before["measures"]["absolute"]
    for name, column in read_rows(tmp_path / "plain/evaluation/hog").items():
        np.testing.assert_array_equal(columns[name], column, err_msg=name)

    radii, frames = measures["absolute"]["radii"], measures["absolute"]["map_frames"]
    again = {
        "absolute": absolute.pose_measures(columns, radii, measures["absolute"]["ks"], frames, "m"),
        "absolute_filtered": absolute.estimate_measures(columns, "filtered", radii, frames, "m"),
        "absolute_tracked": absolute.estimate_measures(columns, "tracked", radii, frames, "m"),
        "absolute_interpolated": absolute.estimate_measures(columns, "interpolated", radii, frames, "m"),
        "calibration": calibration.calibration_measures({**columns, "error": columns["interpolated_error"]}, 0.5),
    }
    assert json.dumps(plain(again)) == json.dumps(measures)
    known = read_rows(folder, "map")
    np.testing.assert_array_equal(columns["filtered_est_x"], known["x"][columns["filtered_match"]])
    moved = np.hypot(columns["interpolated_est_x"] - columns["x"], columns["interpolated_est_y"] - columns["y"])
    np.testing.assert_allclose(columns["interpolated_error"], moved)
    assert (columns["interpolated_used"] > 1).any()
    above = columns["error_m"] > 0.5
    assert columns["lost"][above].all()
    assert columns["lost"][~above].mean() < 0.1, "few queries of the map's own building are foreign"
    model = ErrorModel.load(folder / results["estimates"]["error_model"]["file"])
    assert model.queries == results["estimates"]["error_model"]["queries"] == 36
    assert results["estimates"]["error_model"]["sequences"] == ["third"]
    assert results["estimates"]["filter"]["tuned"] is None
    assert results["estimates"]["filter"]["kidnapping"] == 1e-3


def test_a_tuned_filter_takes_its_settings_from_validation(manifest, tmp_path):
    given = ["task.filter=true", "task.filter_tune=true", "task.filter_settings.temperature=0.01"]
    evaluate(manifest, tmp_path, "hog", *ABSOLUTE, *given)
    settings = read_results(tmp_path / "evaluation/hog")["estimates"]["filter"]
    assert settings["temperature"] / 0.01 == pytest.approx(round(settings["temperature"] / 0.01))
    assert settings["tuned"]["queries"] == 36


def test_an_aligned_descriptor_has_the_same_estimates(manifest, tmp_path):
    options = ["task.filter=true", "task.refine=interpolate", "task.neighbours=2", "task.error_model=true"]
    evaluate(manifest, tmp_path, "briefgist", "descriptor.rows=8", *ABSOLUTE, *options)
    measures = read_results(tmp_path / "evaluation/briefgist")["measures"]
    further = {"absolute_filtered", "absolute_tracked", "absolute_interpolated"}
    assert {"absolute", *further, "calibration"} == set(measures)
    assert measures["absolute_interpolated"]["overall"]["heading_error"]["count"] == 72


@pytest.mark.parametrize("task", ["hierarchical", "absolute"])
def test_queries_without_poses_are_located_and_not_scored(manifest, tmp_path, capsys, task):
    some = altered(
        manifest,
        f"some-{task}.csv",
        lambda row: {"x": ""} if row["sequence"] == "dark" and int(row["time"]) < 5 else {},
    )
    given = [*HIERARCHICAL, "build=rooms"] if task == "hierarchical" else ABSOLUTE
    name = "hierarchical-hog-rooms" if task == "hierarchical" else "hog"
    evaluate(some, tmp_path / "some", "hog", *given)
    shown = capsys.readouterr().out
    assert "5 of 72 queries have no position" in shown
    assert "located.csv" in shown
    folder = tmp_path / "some" / "evaluation" / name
    located = read_rows(folder, "located")
    assert len(located["path"]) == 5
    assert np.isfinite(located["est_x"]).all()
    assert np.isfinite(located["est_theta"]).all()
    assert "error" not in located
    assert len(read_rows(folder)["error"]) == 67
    assert "5 of 72 queries have no position" in refused(
        capsys, *words(some, tmp_path / "some", "hog", *given, "data.on_error=raise")
    )
    none = altered(manifest, f"none-{task}.csv", lambda row: {"y": ""} if row["sequence"] != "first" else {})
    evaluate(none, tmp_path / "none", "hog", *given)
    folder = tmp_path / "none" / "evaluation" / name
    assert len(read_rows(folder, "located")["path"]) == 72
    assert read_results(folder)["measures"] == {}
    bare = altered(manifest, f"bare-{task}.csv", lambda row: {"x": ""} if row["sequence"] == "first" else {})
    error = refused(capsys, *words(bare, tmp_path / "bare", "hog", *given))
    assert "no map frame has a position" in error or "36 of 36 map frames have no position" in error


def test_rooms_that_the_map_lacks_are_named(manifest, tmp_path, capsys):
    for task in ([*HIERARCHICAL, "build=rooms"], ["task=room_retrieval", "task.baselines=[]", "task.plots=false"]):
        evaluate(manifest, tmp_path, "hog", *task, "protocol.map.rooms=[kitchen,office]")
        shown = capsys.readouterr().out
        assert "24 of 72 queries are in rooms that the map lacks (corridor)" in shown
        assert "protocol.map" in shown


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "says"),
    [
        ([*HIERARCHICAL], "build=rooms|"),
        (["task.names=[hierarchical]", "build=rooms"], "task=hierarchical"),
        ([*HIERARCHICAL, "build=rooms", "task.coarse.by=votes"], "representatives or vote or classifier"),
        ([*HIERARCHICAL, "build=rooms", "task.candidates=0"], "task.candidates must be a whole number from 1"),
        ([*HIERARCHICAL, "build=rooms", "task.coarse.descriptor=hogg"], "did you mean 'hog'"),
        ([*HIERARCHICAL, "build=rooms", "task.coarse.descriptor=radon_poc"], "task.coarse.by=vote"),
        ([*HIERARCHICAL, "build=rooms", "protocol.query.sequences=[]"], "selects none of the 144 frames"),
        ([*HIERARCHICAL, "build=rooms", "protocol.query.lightings=[sunny]"], "no frame has lighting 'sunny'"),
        ([*HIERARCHICAL, "build=rooms", "protocol.query.sequences=[first]"], "would not be honest"),
        ([*ABSOLUTE, "protocol.map.rooms=[]"], "protocol.map selects none"),
        ([*ABSOLUTE, "task.error_model=true", "protocol.validation.sequences=null"], "validation.sequences is not"),
        ([*ABSOLUTE, "task.error_model=true", "protocol.validation.sequences=[first]"], "validate on another sequence"),
        ([*ABSOLUTE, "task.error_model=true", "protocol.validation.every=12"], "at least 10 validation queries, got 3"),
        ([*ABSOLUTE, "task.filter=true", "task.filter_settings.kidnapping=1"], "must be a number between 0 and 1"),
        ([*ABSOLUTE, "task.neighbours=0"], "task.neighbours must be a whole number from 1"),
    ],
)  # fmt: skip
def test_mistakes_are_one_line(manifest, tmp_path, given, says, capsys):
    assert says in refused(capsys, *words(manifest, tmp_path, "hog", *given))
