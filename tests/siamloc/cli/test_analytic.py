import json
import re

import numpy as np
import pytest

from siamloc.cli import main
from siamloc.maps import CoarseLayer, VisualMap
from tests.drawn import write_manifest

SMALLER = {
    "wisurf": ["descriptor.windows=32"],
    "briefgist": ["descriptor.rows=8"],
    "gist": ["descriptor.orientations=16"],
}
NAMES = ["hog", "fs", "gist", "wisurf", "briefgist", "radon_fourier", "radon_poc", "hsv", "hog_mapping", "gist_mapping"]


@pytest.fixture(scope="module")
def manifest(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drawn")
    return write_manifest(folder, {"first": "cloudy", "second": "cloudy", "dark": "night"}, frames_per_room=10)


def words(manifest, run, name, *more):
    common = [f"data.manifest={manifest}", "data.image_size=[32,128]", f"data.cache={manifest.parent / 'store'}"]
    roles = ["protocol.map.sequences=[first]", "protocol.query.sequences=[second,dark]"]
    return [*common, *roles, f"run={run}", f"descriptor={name}", *SMALLER.get(name, []), *more]


@pytest.mark.parametrize("name", NAMES)
def test_any_descriptor_is_evaluated_like_a_network(manifest, tmp_path, name):
    given = words(manifest, tmp_path, name, "task.baselines=[thumbnail]", "task.plots=false")
    assert main(["evaluate", *given]) == 0
    folder = tmp_path / "evaluation" / name
    results = json.loads((folder / "results.json").read_text())
    absolute = results["measures"]["absolute"]
    assert absolute["overall"]["queries"] == 60
    assert set(absolute["lighting"]) == {"cloudy", "night"}
    assert absolute["lighting"]["cloudy"]["error"]["mean"] < 3
    assert absolute["overall"]["heading_error"]["count"] == 60
    assert 0 <= absolute["lighting"]["cloudy"]["heading_error"]["median"] < 40
    assert "room_retrieval" in results["measures"]
    assert "thumbnail" in results["baselines"]
    header = (folder / "queries.csv").read_text().split("\n", 1)[0].split(",")
    assert {"est_theta", "heading_error"} <= set(header)


def test_a_saved_map_gives_the_same_results(manifest, tmp_path):
    plain = ["task.baselines=[]", "task.plots=false"]
    for name in ("hog", "briefgist"):
        assert main(["evaluate", *words(manifest, tmp_path / "a", name, *plain)]) == 0
        assert main(["map", *words(manifest, tmp_path / "b", name)]) == 0
        assert main(["evaluate", *words(manifest, tmp_path / "b", name, *plain)]) == 0
        queries = [(tmp_path / run / "evaluation" / name / "queries.csv").read_text() for run in "ab"]
        assert queries[0] == queries[1]
        assert VisualMap.load(tmp_path / "b" / "evaluation" / name / "map.npz").orientation is not None


def test_ordinary_cameras_have_no_heading(manifest, tmp_path):
    given = words(manifest, tmp_path, "hog", "data.circular=false", "task.baselines=[]", "task.plots=false")
    assert main(["evaluate", *given]) == 0
    results = json.loads((tmp_path / "evaluation" / "hog" / "results.json").read_text())
    assert "heading_error" not in results["measures"]["absolute"]["overall"]


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (["descriptor.rows=5"], "does not divide the image's height of 32 pixels"),
        (["descriptor.bens=5"], "did you mean 'descriptor.bins'"),
        (["descriptor.window=200"], "wider than the image of 128 columns"),
        (["task.baselines=[hug]"], "did you mean 'hog'"),
    ],
)
def test_parameters_that_do_not_fit_get_one_sentence(manifest, tmp_path, capsys, more, sentence):
    assert main(["evaluate", *words(manifest, tmp_path, "hog", *more)]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.strip().split("\n")[-1].startswith("siamloc: ")


BUILDS = {
    "sample": ["build.nodes=4"],
    "spectral": ["build.nodes=4"],
    "som": ["build.grid=[2,2]"],
    "rooms": [],
    "incremental": ["build.first_node=10", "build.new_node=10"],
}


@pytest.mark.parametrize("build", BUILDS)
def test_a_layer_is_built_and_measured(manifest, tmp_path, build, capsys):
    given = words(manifest, tmp_path, "hog", f"build={build}", *BUILDS[build])
    assert main(["map", *given]) == 0
    folder = tmp_path / "layers" / f"hog-{build}"
    layer = CoarseLayer.load(folder / "layer.npz")
    assert len(layer.labels) == 30
    before = (folder / "layer.npz").read_bytes()
    capsys.readouterr()
    assert main(["evaluate", *given, "task=mapping", "task.closure_gap=5", "task.plots=false"]) == 0
    assert "layer: " not in capsys.readouterr().out  # the saved one was measured
    assert (folder / "layer.npz").read_bytes() == before
    target = tmp_path / "evaluation" / f"mapping-hog-{build}"
    results = json.loads((target / "results.json").read_text())
    mapping = results["measures"]["mapping"]
    assert mapping["nodes"] == len(layer)
    assert mapping["frames"] == 30
    if build == "rooms":
        assert mapping["purity"]["overall"] == 1
    if build == "incremental":
        assert {"mapper.npz", "events.jsonl", "graph.json"} <= {p.name for p in folder.iterdir()}
        assert sum(mapping["reasons"].values()) == 30
    rows = (target / "frames.csv").read_text().strip().split("\n")
    assert len(rows) == 31
    nodes = np.array([int(row.split(",")[rows[0].split(",").index("node")]) for row in rows[1:]])
    assert np.array_equal(nodes, layer.labels)


def test_other_settings_build_the_layer_anew(manifest, tmp_path, capsys):
    for nodes in (3, 5):
        given = words(manifest, tmp_path, "hog", "build=sample", f"build.nodes={nodes}", "task.plots=false")
        assert main(["evaluate", *given, "task=mapping"]) == 0
        assert re.search(rf"^nodes +{nodes}$", capsys.readouterr().out, re.MULTILINE)


def test_a_build_that_is_interrupted_leaves_no_layer_beside_what_explains_another(manifest, tmp_path, monkeypatch):
    first, second = (
        words(
            manifest, tmp_path, "hog", "build=incremental", "build.first_node=10", "build.new_node=10", f"build.y={y}"
        )
        for y in (1.5, 2)
    )
    assert main(["map", *first]) == 0

    def broken(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("analytic.mapper.graph.NodeGraph.to_json", broken)
        assert main(["map", *second]) != 0
    folder = tmp_path / "layers" / "hog-incremental"
    assert (folder / "placing.json").is_file()
    assert not (folder / "layer.npz").exists()
    assert main(["evaluate", *first, "task=mapping", "task.plots=false"]) == 0
    assert CoarseLayer.load(folder / "layer.npz").made["y"] == 1.5


def test_a_map_of_one_node_says_what_gives_more(manifest, tmp_path, capsys):
    given = words(manifest, tmp_path, "hog", "build=incremental")
    assert main(["map", *given]) == 0
    out = capsys.readouterr().out
    assert ", 1 nodes over 30 frames" in out
    assert "build=incremental_sparse" in out


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (["task=mapping"], "choose one with build=rooms|sample|spectral|som|incremental"),
        (["task=mapping", "build=spectral", "build.nodes=31"], "31"),
        (["task=mapping", "build=som", "build.grid=8"], "build.grid must be a list of 2"),
        (["task=mapping", "build=incremental", "build.y=-1"], "y must be a positive number"),
        (["task=mapping", "build=incremental", "build.gama=1"], "did you mean 'build.gamma'"),
        (["task=mapping", "build=spectrum"], "did you mean 'spectral'"),
    ],
)
def test_layers_that_cannot_be_built_get_one_sentence(manifest, tmp_path, capsys, more, sentence):
    assert main(["evaluate", *words(manifest, tmp_path, "hog", *more)]) == 2
    error = capsys.readouterr().err.strip().split("\n")[-1]
    assert error.startswith("siamloc: ")
    assert sentence in error
