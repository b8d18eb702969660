"""`siamloc evaluate task=buildings`, on two drawn flats that stand in for two buildings."""

from __future__ import annotations

import csv
import json

import cv2
import numpy as np
import pytest

import analytic
from foundation.files import plain
from siamloc.cli import main
from siamloc.evaluation.building_choice import building_measures
from siamloc.maps import CoarseLayer
from siamloc.results import read_results, read_rows
from tests.drawn import altered, write_manifest, write_rows

BUILDINGS = {"north": ("kitchen", "office"), "south": ("corridor",)}
LIGHTINGS = {"first": "cloudy", "second": "cloudy", "dark": "night"}


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """Write one manifest of both buildings; sequences are called north_first and so on."""
    folder = tmp_path_factory.mktemp("buildings")
    rows = []
    for building, rooms in BUILDINGS.items():
        sequences = {f"{building}_{name}": lighting for name, lighting in LIGHTINGS.items()}
        with write_manifest(folder / building, sequences, 8, rooms).open(newline="") as file:
            rows += [
                {**row, "image": f"{building}/{row['image']}", "building": building} for row in csv.DictReader(file)
            ]
    return write_rows(folder / "both.csv", rows)


def data(table, descriptor="hog"):
    cache = f"data.cache={table.parent / 'cache'}"
    return [f"data.manifest={table}", "data.image_size=[32,128]", cache, f"descriptor={descriptor}"]


def words(table, run, *more, descriptor="hog"):
    queries = "protocol.query.sequences=['*second','*dark']"
    return ["evaluate", "task=buildings", *data(table, descriptor), queries, f"run={run}", *more]


def make_maps(table, folder, *more, descriptor="hog"):
    for building in BUILDINGS:
        role = f"protocol.map.sequences=[{building}_first]"
        assert main(["map", *data(table, descriptor), role, f"run={folder / building}", *more]) == 0
    return f"task.maps=[{folder / 'north'},{folder / 'south'}]"


@pytest.fixture(scope="module")
def maps(table, tmp_path_factory):
    return make_maps(table, tmp_path_factory.mktemp("maps"))


def test_the_files_alone_give_the_measures(table, maps, tmp_path, capsys):
    assert main(words(table, tmp_path, maps)) == 0
    shown = capsys.readouterr().out
    folder = tmp_path / "evaluation" / "buildings-hog"
    results, columns = read_results(folder), read_rows(folder)
    found = results["measures"]["buildings"]
    again = plain(building_measures(columns, found["confusion"]["labels"]))
    assert json.dumps({key: found[key] for key in again}) == json.dumps(again)
    assert found["confusion"]["labels"] == ["north", "south"]
    assert set(found["lighting"]) == {"cloudy", "night"}
    assert results["denominators"] == {"queries": 48, "queries_of_the_role": 48, "maps": 2}
    assert {name: one["frames"] for name, one in found["maps"].items()} == {"north": 16, "south": 8}
    assert found["lighting"]["cloudy"]["accuracy"] == 1
    assert np.sum(found["confusion"]["counts"], axis=1).tolist() == [32, 16]
    nearer = columns["distance_north"] <= columns["distance_south"]
    np.testing.assert_array_equal(columns["predicted_building"], np.where(nearer, "north", "south"))
    np.testing.assert_array_equal(
        [path.split("/")[-3] for path in columns["match_name"]], columns["predicted_building"]
    )
    assert (columns["next_distance"] >= columns["descriptor_distance"]).all()
    overall = found["overall"]
    assert f"{100 * overall['accuracy']:.1f} % ({overall['correct']}/48)" in shown
    assert (folder / "confusion.png").read_bytes().startswith(b"\x89PNG")


def test_a_map_of_several_buildings_is_split(table, maps, tmp_path):
    whole = "protocol.map.sequences=['*first']"
    assert main(words(table, tmp_path / "saved", maps)) == 0
    assert main(words(table, tmp_path / "split", whole)) == 0
    assert main(["map", *data(table), whole, f"run={tmp_path / 'known'}"]) == 0
    assert main(words(table, tmp_path / "known", whole)) == 0
    folders = [tmp_path / name / "evaluation" / "buildings-hog" for name in ("saved", "split", "known")]
    tables = [(folder / "queries.csv").read_bytes() for folder in folders]
    assert tables[0] == tables[1] == tables[2]


@pytest.mark.parametrize(
    ("build", "nodes"),
    [
        (["build=spectral", "build.nodes=3"], [3, 3]),
        (["build=rooms"], [2, 1]),
        (["build=sample", "build.nodes=4"], [4, 4]),
    ],
)
def test_the_nearest_node_of_compact_maps_decides(table, maps, tmp_path, build, nodes):
    assert main(words(table, tmp_path, maps, *build, "distance=cosine", "task.plots=false")) == 0
    name = build[0].partition("=")[2]
    folder = tmp_path / "evaluation" / f"buildings-hog-cosine-{name}"
    found, columns = read_results(folder)["measures"]["buildings"], read_rows(folder)
    assert found["distance"] == "cosine"
    assert [one["representatives"] for one in found["maps"].values()] == nodes
    images = np.stack([cv2.imread(path)[..., ::-1].transpose(2, 0, 1) for path in columns["path"].tolist()])
    queries = analytic.descriptor("hog").describe(images).position
    layers = [CoarseLayer.load(tmp_path / f"layers/hog-cosine-{building}-{name}/layer.npz") for building in BUILDINGS]
    apart = [analytic.distance("cosine")(queries, layer.representatives) for layer in layers]
    for building, distance in zip(BUILDINGS, apart, strict=True):
        np.testing.assert_allclose(columns[f"distance_{building}"], distance.min(axis=1), atol=1e-5)
    nearest = np.argmin([distance.min(axis=1) for distance in apart], axis=0)
    assert columns["predicted_building"].tolist() == [list(BUILDINGS)[number] for number in nearest]
    named = [layers[b].names[apart[b][row].argmin()] for row, b in enumerate(nearest)]
    assert columns["match_name"].tolist() == named
    assert not (folder / "confusion.png").exists()


def folders(maps):
    return maps.partition("=")[2].strip("[]").split(",")


def test_maps_are_named_by_their_files_too(table, maps, tmp_path):
    files = [f"{path}/evaluation/hog/map.npz" for path in folders(maps)]
    assert main(words(table, tmp_path / "files", f"task.maps=[{','.join(files)}]", "build=rooms")) == 0
    assert main(words(table, tmp_path / "runs", maps, "build=rooms")) == 0
    tables = [tmp_path / name / "evaluation/buildings-hog-rooms/queries.csv" for name in ("files", "runs")]
    assert tables[0].read_bytes() == tables[1].read_bytes()
    assert (tmp_path / "files/layers/hog-north-rooms/layer.npz").is_file()


def test_the_layer_of_a_building_stays_in_the_run_whatever_its_name(table, tmp_path):
    named = altered(table, "named.csv", lambda row: {"building": f"../../{row['building']}/1"})
    more = ("protocol.map.sequences=['*first']", "build=rooms", "task.plots=false")
    assert main(words(named, tmp_path / "run", *more)) == 0
    assert sorted(path.name for path in (tmp_path / "run" / "layers").iterdir()) == [
        "hog-..%2F..%2Fnorth%2F1-rooms",
        "hog-..%2F..%2Fsouth%2F1-rooms",
    ]
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_an_aligned_descriptor_chooses_by_its_own_distance(table, tmp_path, capsys):
    more = ["descriptor.rows=8"]
    maps = make_maps(table, tmp_path, *more, descriptor="briefgist")
    assert main(words(table, tmp_path / "out", maps, *more, descriptor="briefgist")) == 0
    found = read_results(tmp_path / "out/evaluation/buildings-briefgist")["measures"]["buildings"]
    assert found["lighting"]["cloudy"]["accuracy"] > 0.9
    refusal = refused(capsys, words(table, tmp_path, maps, *more, "build=rooms", descriptor="briefgist"))
    assert "compared after turning" in refusal
    assert main(words(table, tmp_path / "out", maps, *more, "distance=cosine", descriptor="briefgist")) == 0
    assert (
        read_results(tmp_path / "out/evaluation/buildings-briefgist-cosine")["measures"]["buildings"]["distance"]
        == "cosine"
    )


def refused(capsys, given):
    capsys.readouterr()
    assert main(given) == 2
    error = capsys.readouterr().err
    assert "Traceback" not in error
    lines = [line for line in error.splitlines() if line.startswith("siamloc: ")]
    assert len(lines) == 1
    return lines[0]


@pytest.mark.slow
def test_mistakes_are_one_line(table, maps, tmp_path, capsys):
    north = folders(maps)[0]
    for given, says in (
        ([f"task.maps=[{north}]"], "task.maps names 1: give two or more"),
        ([f"task.maps={north}"], "must be a list of run folders"),
        ([f"task.maps=[{north},{north}]"], "two of the maps are of building 'north'"),
        ([f"task.maps=[{north},{tmp_path / 'none'}]"], "holds no map by hog: make it with `siamloc map run="),
        ([maps, "descriptor.bins=16"], "bins is 32 in the map, 16 here"),
        (
            [maps, "distance=cosin"],
            "distance must be manhattan or euclidean or correlation or cosine, or null, got 'cosin'",
        ),
        ([maps, "build.name=spectrum"], "did you mean 'spectral'"),
        ([maps, "task.baselines=[gist]"], "unknown configuration key 'task.baselines'"),
        ([maps, "protocol.query.sequences=[north_first]"], "'north_first' is in the map and among the queries"),
        (["protocol.map.sequences=[north_first]"], "all map frames are of building 'north'"),
        (["task=absolute", "task.names=[buildings]"], "choose it with task=buildings"),
        (["task=absolute", "task.names=[absolute,buildings]"], "must be one of absolute, room_retrieval"),
        (["task=absolute", "task.names=[absolut]"], "unknown task 'absolut': did you mean 'absolute'"),
    ):
        assert says in refused(capsys, words(table, tmp_path / "run", *given)), given
    error = refused(capsys, words(table, tmp_path / "run", maps, descriptor="gist"))
    assert "holds no map by gist: it holds one by hog; choose that descriptor" in error


def test_buildings_have_to_be_known(table, maps, tmp_path, capsys):
    some = altered(table, "some.csv", lambda row: {"building": ""} if row["sequence"] == "south_dark" else {})
    assert main(words(some, tmp_path / "some", maps)) == 0
    assert "8 of 48 queries have no building: left out" in capsys.readouterr().out
    assert len(read_rows(tmp_path / "some/evaluation/buildings-hog")["query"]) == 40
    assert "8 of 48 queries have no building" in refused(
        capsys, words(some, tmp_path / "some", maps, "data.on_error=raise")
    )
    none = altered(table, "none.csv", lambda row: {"building": ""})
    error = refused(capsys, words(none, tmp_path / "none", maps))
    assert "48 of 48 queries have no building: give the manifest a column `building`" in error
    error = refused(capsys, words(none, tmp_path / "none", "protocol.map.sequences=['*first']"))
    assert "24 of the 24 map frames have no building" in error
    other = altered(table, "other.csv", lambda row: {"building": "east"} if row["sequence"] == "south_dark" else {})
    error = refused(capsys, words(other, tmp_path / "other", maps))
    assert "8 of 48 queries are in a building that has no map (east; the maps are of north, south)" in error
