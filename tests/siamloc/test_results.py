from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from siamloc import __version__
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.results import read_results, read_rows, versions, write_results

RESULTS = {
    "config": {"seed": 0, "margin": np.float64(2)},
    "measures": {"absolute": {"error": float("nan")}},
    "denominators": {"n": 2},
}
ROWS = {
    "path": np.array(['a "b", c\nd.jpeg', ""]),
    "room": np.array(["007", "1PO-A"]),
    "x": np.array([0.1 + 0.2, np.nan]),
    "rank": np.array([3, 0]),
    "correct": np.array([True, False]),
}


def test_round_trip(tmp_path: Path) -> None:
    path = write_results(tmp_path / "run" / "1", RESULTS, {"queries": ROWS, "map": {"x": np.array([1e-300, -0.0])}})
    assert path == tmp_path / "run" / "1" / "results.json"
    assert sorted(p.name for p in path.parent.iterdir()) == ["map.csv", "queries.csv", "results.json"]
    results = read_results(path.parent)
    assert results["schema"] == {"name": "siamloc-results", "version": 1}
    assert results["config"] == {"seed": 0, "margin": 2.0}
    assert results["measures"] == {"absolute": {"error": None}}
    assert results["versions"]["siamloc"] == __version__
    assert results["created"].endswith("+00:00")
    rows = read_rows(path.parent)
    assert list(rows) == list(ROWS)
    for name, column in ROWS.items():
        assert rows[name].dtype.kind == column.dtype.kind
        np.testing.assert_array_equal(rows[name], column)
    assert str(read_rows(path.parent, "map")["x"].tolist()) == "[1e-300, -0.0]"


@given(values=st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=1))
def test_every_float_comes_back_to_the_last_bit(tmp_path_factory: pytest.TempPathFactory, values: list[float]) -> None:
    folder = tmp_path_factory.mktemp("floats")
    write_results(folder, RESULTS, {"queries": {"x": np.array(values)}})
    np.testing.assert_array_equal(read_rows(folder)["x"], values)


def test_tables_without_rows(tmp_path: Path) -> None:
    write_results(tmp_path, RESULTS, {"queries": {name: column[:0] for name, column in ROWS.items()}})
    assert {name: column.tolist() for name, column in read_rows(tmp_path).items()} == {name: [] for name in ROWS}


def test_float32_columns_become_float64(tmp_path: Path) -> None:
    write_results(tmp_path, RESULTS, {"queries": {"x": np.array([0.1], dtype=np.float32)}})
    assert read_rows(tmp_path)["x"][0] == float(np.float32(0.1))


def test_versions_name_torch_only_if_it_is_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "torch", raising=False)
    assert set(versions()) == {"python", "siamloc", "numpy", "opencv"}
    monkeypatch.setitem(sys.modules, "torch", sys)
    assert versions()["torch"][0].isdigit()


def test_a_failed_write_leaves_the_old_results(tmp_path: Path) -> None:
    write_results(tmp_path, RESULTS, {"queries": ROWS})
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(DataError):
        write_results(tmp_path, RESULTS, {"queries": {**ROWS, "short": np.array([1])}})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"a": np.ones(2), "b": np.ones(1)}, r"column 'b' of 'queries' has shape \(1,\), expected \(2,\)"),
        ({"a": np.array([None])}, "holds object"),
        ({}, "'queries' has no columns"),
    ],
)
def test_what_cannot_be_written(tmp_path: Path, columns: dict, message: str) -> None:
    with pytest.raises(DataError, match=message):
        write_results(tmp_path, RESULTS, {"queries": columns})
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match=r"results\.json does not exist"):
        read_results(tmp_path)
    path = write_results(tmp_path, RESULTS, {"queries": ROWS})
    whole = path.read_text()
    for text, message in (
        (whole[:50], "incomplete or invalid JSON"),
        ("[1]", "not a siamloc result file"),
        *((json.dumps({**json.loads(whole), "measures": other}), "altered in measures") for other in ([], 3, {"a": 1})),
        (json.dumps({key: value for key, value in json.loads(whole).items() if key != "config"}), "altered in config"),
        *((json.dumps({**json.loads(whole), "pictures": other}), "in pictures") for other in (3, [1], ["../a.png"])),
        (json.dumps({"schema": {"name": "other", "version": 1}}), "not a siamloc result file"),
        (whole.replace('"version": 1', '"version": 2'), "format version 2, .* reads version 1: update siamloc"),
    ):
        path.write_text(text)
        with pytest.raises(FormatError, match=message):
            read_results(tmp_path)
    path.write_text(whole)
    with pytest.raises(ConfigError, match="no table 'pairs'; valid: queries"):
        read_rows(tmp_path, "pairs")
    table = tmp_path / "queries.csv"
    rows = table.read_text()
    for text in (
        rows[: len(rows) // 2],
        "",
        rows.replace("path,", "file,"),
        rows.replace("True", "yes"),
        rows + "x\n",
        rows.replace("007,", "007,1,"),
    ):
        table.write_text(text)
        with pytest.raises(FormatError, match=r"queries\.csv is not what results\.json describes"):
            read_rows(tmp_path)
    table.unlink()
    with pytest.raises(FormatError, match="does not exist, though"):
        read_rows(tmp_path)
