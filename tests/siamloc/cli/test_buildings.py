"""`siamloc evaluate task=buildings`, on two parts of the drawn flat that stand in for two buildings."""

from __future__ import annotations

import numpy as np
import pytest

from siamloc.results import read_results, read_rows
from tests.drawn import altered
from tests.siamloc.cli.commands import done, measures, refused

BUILDINGS = ("north", "south")
WHOLE = "protocol.map.sequences=['*first']"


@pytest.fixture(scope="module")
def table(town):
    """Write a manifest whose drives stay in one building each; they are called north_first and so on."""
    return altered(town, "both.csv", lambda row: {"sequence": f"{row['building']}_{row['sequence']}"})


def data(table, descriptor="hog"):
    cache = f"data.cache={table.parent / 'cache'}"
    return [f"data.manifest={table}", "data.image_size=[32,128]", cache, f"descriptor={descriptor}"]


@pytest.fixture(scope="module")
def maps(table, tmp_path_factory):
    folder = tmp_path_factory.mktemp("maps")
    for building in BUILDINGS:
        done("map", *data(table), f"protocol.map.sequences=[{building}_first]", f"run={folder / building}")
    return [folder / building for building in BUILDINGS]


def words(table, run, *more, descriptor="hog"):
    queries = "protocol.query.sequences=['*second','*dark']"
    return ["evaluate", "task=buildings", *data(table, descriptor), queries, f"run={run}", *more]


def named(folders):
    return f"task.maps=[{','.join(map(str, folders))}]"


def test_the_table_says_what_the_measures_say(table, maps, tmp_path, capsys):
    done(*words(table, tmp_path, named(maps)))
    shown = capsys.readouterr().out
    folder = tmp_path / "evaluation/buildings-hog"
    results, columns = read_results(folder), read_rows(folder)
    found = results["measures"]["buildings"]
    assert found["confusion"]["labels"] == list(BUILDINGS)
    assert set(found["lighting"]) == {"cloudy", "night"}
    assert results["denominators"] == {"queries": 48, "queries_of_the_role": 48, "maps": 2}
    assert {name: one["frames"] for name, one in found["maps"].items()} == {"north": 16, "south": 8}
    assert found["lighting"]["cloudy"]["accuracy"] == 1
    assert np.sum(found["confusion"]["counts"], axis=1).tolist() == [32, 16]
    nearer = columns["distance_north"] <= columns["distance_south"]
    np.testing.assert_array_equal(columns["predicted_building"], np.where(nearer, *BUILDINGS))
    assert (columns["next_distance"] >= columns["descriptor_distance"]).all()
    overall = found["overall"]
    assert f"{100 * overall['accuracy']:.1f} % ({overall['correct']}/48)" in shown
    assert (folder / "confusion.png").read_bytes().startswith(b"\x89PNG")


def test_maps_are_named_by_runs_or_files_or_one_map_is_split(table, maps, tmp_path):
    done("map", *data(table), WHOLE, f"run={tmp_path / 'known'}")
    files = [f"{path}/evaluation/hog/map.npz" for path in maps]
    tables = []
    for name, choice in (("runs", named(maps)), ("files", named(files)), ("split", WHOLE), ("known", WHOLE)):
        done(*words(table, tmp_path / name, choice, "build=rooms", "task.plots=false"))
        tables.append((tmp_path / name / "evaluation/buildings-hog-rooms/queries.csv").read_bytes())
    assert tables == tables[:1] * 4
    assert (tmp_path / "files/layers/hog-north-rooms/layer.npz").is_file()


def test_the_nearest_node_of_compact_maps_decides(table, maps, tmp_path):
    done(*words(table, tmp_path, named(maps), "build=sample", "build.nodes=4", "distance=cosine", "task.plots=false"))
    folder = tmp_path / "evaluation/buildings-hog-cosine-sample"
    found, columns = measures(folder)["buildings"], read_rows(folder)
    assert found["distance"] == "cosine"
    assert [one["representatives"] for one in found["maps"].values()] == [4, 4]
    assert (tmp_path / "layers/hog-cosine-north-sample/layer.npz").is_file()
    nearer = columns["distance_north"] <= columns["distance_south"]
    np.testing.assert_array_equal(columns["predicted_building"], np.where(nearer, *BUILDINGS))
    assert set(columns["match_name"]) <= {str(node) for node in range(4)}
    assert not (folder / "confusion.png").exists()


def test_the_layer_of_a_building_stays_in_the_run_whatever_its_name(table, tmp_path):
    outside = altered(table, "outside.csv", lambda row: {"building": f"../../{row['building']}/1"})
    done(*words(outside, tmp_path / "run", WHOLE, "build=rooms", "task.plots=false"))
    layers = sorted(path.name for path in (tmp_path / "run/layers").iterdir())
    assert layers == ["hog-..%2F..%2Fnorth%2F1-rooms", "hog-..%2F..%2Fsouth%2F1-rooms"]
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_an_aligned_descriptor_chooses_by_its_own_distance(table, tmp_path, capsys):
    more = ["descriptor.rows=8", "task.plots=false"]
    given = words(table, tmp_path, *more, WHOLE, descriptor="briefgist")
    done(*given)
    assert measures(tmp_path / "evaluation/buildings-briefgist")["buildings"]["lighting"]["cloudy"]["accuracy"] > 0.9
    assert "compared after turning" in refused(capsys, *given, "build=rooms")
    done(*given, "distance=cosine")
    assert measures(tmp_path / "evaluation/buildings-briefgist-cosine")["buildings"]["distance"] == "cosine"


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (
            "task.maps=[{north}]",
            "task.maps must be a list of two or more run folders or map files, such as [runs/a,runs/b], or null, got",
        ),
        ("task.maps={north}", "task.maps must be a list of two or more run folders"),
        ("task.maps=[{north},{north}]", "two of the maps are of building 'north'"),
        ("task.maps=[{north},/none]", "/none holds no map by hog: make it with `siamloc map run=/none`, with the same"),
        (
            "task.maps=[{north},{south}] descriptor=thumbnail",
            "north holds no map by thumbnail: it holds one by hog; choose that descriptor, or make it with",
        ),
        ("task.maps=[{north},{south}] descriptor.bins=16", "bins is 32 in the map, 16 here"),
        ("task.maps=[{north},{south}] protocol.query.sequences=[north_first]", "is in the map and among the queries"),
        ("protocol.map.sequences=[north_first]", "all map frames are of building 'north'"),
    ],
)
def test_mistakes_are_one_line(table, maps, tmp_path, capsys, line, says):
    given = line.format(north=maps[0], south=maps[1]).split()
    assert says in refused(capsys, *words(table, tmp_path / "run", *given))


def test_buildings_have_to_be_known(table, maps, tmp_path, capsys):
    def last(building):
        return lambda row: {"building": building} if row["sequence"] == "south_dark" else {}

    some, maps = altered(table, "some.csv", last("")), named(maps)
    done(*words(some, tmp_path, maps))
    assert "8 of 48 queries have no building: left out" in capsys.readouterr().out
    assert len(read_rows(tmp_path / "evaluation/buildings-hog")["query"]) == 40
    none = altered(table, "none.csv", lambda row: {"building": ""})
    for given, says in (
        ([some, maps, "data.on_error=raise"], "8 of 48 queries have no building"),
        ([none, maps], "48 of 48 queries have no building: give the manifest a column `building`"),
        ([altered(table, "other.csv", last("east")), maps],
         "8 of 48 queries are in a building that has no map (east; the maps are of north, south)"),
    ):  # fmt: skip
        assert says in refused(capsys, *words(given[0], tmp_path / "run", *given[1:]))


def test_a_map_of_drives_in_different_frames_is_warned_of(town, tmp_path, caplog, monkeypatch):
    monkeypatch.setattr("siamloc.maps.axes._JUDGED", 5)  # the drives are short
    by = {"first": 0.0, "second": 30.0}
    moved = altered(town, "moved.csv", lambda row: {"x": float(row["x"]) + by.get(row["sequence"], 0.0)})
    done("map", *data(moved), "protocol.map.sequences=[first,second]", f"run={tmp_path}")
    assert "drive second of this map and the drives before it seem to be in different frames: the" in caplog.text
