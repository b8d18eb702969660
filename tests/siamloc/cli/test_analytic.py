"""Maps and layers of analytic descriptors, without any training."""

import numpy as np
import pytest

from siamloc.cli import main
from siamloc.maps import CoarseLayer, VisualMap
from siamloc.results import read_results, read_rows
from siamloc.runs import Run
from tests.siamloc.cli.commands import QUICK, done, measures

SMALLER = {
    "wisurf": ["descriptor.windows=32"],
    "briefgist": ["descriptor.rows=8"],
    "gist": ["descriptor.orientations=16"],
}
NAMES = ["hog", "fs", "gist", "wisurf", "briefgist", "radon_fourier", "radon_poc", "hsv", "hog_mapping", "gist_mapping"]


@pytest.mark.parametrize("name", NAMES)
def test_any_descriptor_is_evaluated_like_a_network(words, tmp_path, name):
    given = [*words, f"run={tmp_path}", f"descriptor={name}", *SMALLER.get(name, []), "task.plots=false"]
    done("evaluate", *given, "task.baselines=[thumbnail]")
    folder = tmp_path / "evaluation" / name
    results = read_results(folder)
    absolute = results["measures"]["absolute"]
    assert absolute["overall"]["queries"] == absolute["overall"]["heading_error"]["count"] == 48
    assert set(absolute["lighting"]) == {"cloudy", "night"}
    assert absolute["lighting"]["cloudy"]["error"]["mean"] < 3
    assert 0 <= absolute["lighting"]["cloudy"]["heading_error"]["median"] < 40
    assert "room_retrieval" in results["measures"]
    assert "thumbnail" in results["baselines"]
    assert {"est_theta", "heading_error"} <= set(read_rows(folder))
    if name in ("hog", "briefgist"):
        before = (folder / "queries.csv").read_text()
        done("map", *given[:-1])
        done("evaluate", *given, "task.baselines=[thumbnail]")
        assert (folder / "queries.csv").read_text() == before, "a saved map gives the same results"
        assert VisualMap.load(folder / "map.npz").orientation is not None


def test_a_picture_that_fails_costs_neither_the_record_nor_the_output(words, tmp_path, monkeypatch, capsys):
    def fail(*_):
        raise ValueError("cannot be drawn")

    run = Run(tmp_path)
    run.start({}, [])
    monkeypatch.setattr("siamloc.report.draw.suitable.error_curve", fail)
    with pytest.raises(ValueError, match="cannot be drawn"):
        main(["evaluate", *map(str, words), f"run={tmp_path}", "descriptor=hog", "task.baselines=[]"])
    folder = tmp_path / "evaluation/hog"
    assert f"results: {folder / 'results.json'}" in capsys.readouterr().out
    written = {f"evaluation/hog/{name}" for name in ("results.json", "queries.csv", "floor_plan.png")}
    assert written <= set(run.load_record()["written"])


def test_ordinary_cameras_have_no_heading(words, tmp_path):
    done("evaluate", *words, f"run={tmp_path}", "descriptor=hog", "data.circular=false", *QUICK)
    assert "heading_error" not in measures(tmp_path / "evaluation/hog")["absolute"]["overall"]


BUILDS = {
    "sample": ["build.nodes=4"],
    "spectral": ["build.nodes=4"],
    "som": ["build.grid=[2,2]"],
    "rooms": [],
    "incremental": ["build.first_node=10", "build.new_node=10"],
}


def layered(words, run, build, *more):
    return [*words, f"run={run}", "descriptor=hog", f"build={build}", *more]


@pytest.mark.parametrize("build", BUILDS)
def test_a_layer_is_built_and_measured(words, tmp_path, build, capsys):
    given = layered(words, tmp_path, build, *BUILDS[build])
    done("map", *given)
    folder = tmp_path / "layers" / f"hog-{build}"
    layer = CoarseLayer.load(folder / "layer.npz")
    before = (folder / "layer.npz").read_bytes()
    capsys.readouterr()
    done("evaluate", *given, "task=mapping", "task.closure_gap=5", "task.plots=false")
    assert "layer: " not in capsys.readouterr().out  # the saved one was measured
    assert (folder / "layer.npz").read_bytes() == before
    target = tmp_path / "evaluation" / f"mapping-hog-{build}"
    mapping = measures(target)["mapping"]
    assert (mapping["nodes"], mapping["frames"]) == (len(layer), 24)
    if build == "rooms":
        assert mapping["purity"]["overall"] == 1
    if build == "incremental":
        assert {"mapper.npz", "events.jsonl", "graph.json"} <= {p.name for p in folder.iterdir()}
        assert sum(mapping["reasons"].values()) == 24
    np.testing.assert_array_equal(read_rows(target, "frames")["node"], layer.labels)


def test_a_build_that_is_interrupted_leaves_no_layer_beside_what_explains_another(words, tmp_path, monkeypatch):
    first, second = (layered(words, tmp_path, "incremental", *BUILDS["incremental"], f"build.y={y}") for y in (1.5, 2))
    done("map", *first)

    def broken(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("analytic.mapper.graph.NodeGraph.to_json", broken)
        assert main(["map", *second]) != 0
    folder = tmp_path / "layers/hog-incremental"
    assert (folder / "placing.json").is_file()
    assert not (folder / "layer.npz").exists()
    done("evaluate", *first, "task=mapping", "task.plots=false")
    assert CoarseLayer.load(folder / "layer.npz").made["y"] == 1.5


def test_a_map_of_one_node_says_what_gives_more(words, tmp_path, capsys):
    done("map", *layered(words, tmp_path, "incremental"))
    out = capsys.readouterr().out
    assert ", 1 nodes over 24 frames" in out
    assert "build=incremental_sparse" in out
