"""`siamloc evaluate task=robustness`, on the drawn flat."""

from __future__ import annotations

import numpy as np

from siamloc.evaluation.disturbed_tables import curves
from siamloc.results import read_results, read_rows
from tests.siamloc.cli.commands import done


def test_the_files_hold_every_method_disturbance_and_level(words, tmp_path):
    levels = [f"task.robustness.{level}" for level in ("turn=[0,90]", "effects=[bulb]", "strengths=[0,1]", "every=3")]
    levels.append("task.robustness.bar_colour=mean")
    given = [*words, "protocol.query.sequences=[second]", "task.baselines=[thumbnail]", *levels]
    done("evaluate", "task=robustness", "descriptor=hog", *given, f"run={tmp_path}")
    folder = tmp_path / "evaluation/robustness-hog"
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
