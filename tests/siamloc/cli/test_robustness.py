"""`siamloc evaluate task=robustness`, on the drawn flat."""

from __future__ import annotations

import numpy as np
import pytest

from siamloc.evaluation.disturbed_tables import curves
from siamloc.results import read_results, read_rows
from tests.siamloc.cli.commands import done


@pytest.fixture(scope="module")
def given(words):
    return [
        *["evaluate", "task=robustness", "descriptor=hog", *words, "protocol.query.sequences=[second]"],
        *["task.baselines=[thumbnail]", "task.robustness.every=3", "task.robustness.turn=[0,90]"],
        "task.robustness.bar_colour=mean",
    ]


@pytest.fixture(scope="module")
def folder(given, tmp_path_factory):
    run = tmp_path_factory.mktemp("run")
    done(*given, f"run={run}", "task.robustness.effects=[bulb]", "task.robustness.strengths=[0,1]")
    return run / "evaluation" / "robustness-hog"


def test_the_files_hold_every_method_disturbance_and_level(folder):
    results, table = read_results(folder), read_rows(folder, "robustness")
    found = results["measures"]["robustness"]
    assert results["denominators"] == {"queries": 8, "queries_of_the_role": 24, "map_frames": 24}
    assert results["config"]["task"]["bar_colour"] == "mean"
    assert list(found["methods"]) == ["hog", "thumbnail"]
    levels = {one["name"]: len(one["levels"]) for one in found["disturbances"]}
    assert levels == {"noise": 6, "occlusion": 5, "turn": 2, "bulb": 2}
    assert len(table["mean"]) == 2 * sum(levels.values())
    assert [set(table[key]) for key in ("queries", "map_frames", "radius")] == [{8}, {24}, {0.5}]
    assert (folder / "robustness.png").read_bytes().startswith(b"\x89PNG")
    again = curves(read_rows(folder, "answers"), 0.5, 24)
    assert all(np.array_equal(again[name], table[name], equal_nan=table[name].dtype.kind == "f") for name in table)
    entries = [one for curve in found["methods"].values() for level in curve.values() for one in level]
    assert [one["mean"] for one in entries] == again["mean"].tolist()
