"""Tables of evaluations: what was swept, what was measured, and which comes first."""

from __future__ import annotations

import csv
import math
from dataclasses import replace

import pytest

import siamloc
from siamloc.errors import ConfigError, FormatError
from siamloc.evaluation import compare
from siamloc.jobs import Compare
from siamloc.runs import Run


@pytest.fixture(scope="module")
def measured():
    """Evaluate a descriptor once, and save it under other names as often as needed."""
    images = siamloc.data.example()
    monday, tuesday = (images.frames.select(sequence=day) for day in ("monday", "tuesday"))
    known = siamloc.maps.build("hog", images, monday, progress=False)
    return siamloc.evaluation.localization(known, images, tuesday, radii=(0.5,), ks=(1, 5))


def write(measured, folder, error, swept=None, **about):
    """Write the results with another mean error."""
    absolute = measured.parts["absolute"]
    overall = {**absolute["overall"], "error": {**absolute["overall"]["error"], "mean": error}}
    parts = {**measured.parts, "absolute": {**absolute, "overall": overall}}
    swept = {} if swept is None else {"swept": swept}
    replace(measured, parts=parts, about={**measured.about, **swept, **about}).save(folder, pictures=False)
    return folder


def test_rows_hold_what_was_swept_and_the_measures_and_the_best_comes_first(measured, tmp_path):
    write(measured, tmp_path / "a" / "8", 0.9, {"descriptor.bins": 8, "distance": "cosine"})
    write(measured, tmp_path / "b", 0.5, {"descriptor.bins": 16, "distance": "cosine"})
    found = compare(tmp_path)
    assert (found.by, found.differing, found.highest) == ("error", ("descriptor.bins",), False)
    assert found.columns == (
        *("descriptor.bins", "error", "error.night", "hit_rate", "recall@1_0.5", "room", "queries", "folder"),
    )
    assert [(row["descriptor.bins"], row["error"], row["folder"]) for row in found.rows] == [
        (16, 0.5, (tmp_path / "b").as_posix()),
        (8, 0.9, (tmp_path / "a" / "8").as_posix()),
    ]
    overall = measured.parts["absolute"]["overall"]
    assert (found.unit, compare(tmp_path, by="hit_rate").unit) == ("m", "")
    assert compare(tmp_path, by="absolute.overall.error.count").unit == "", "a number of queries"
    assert found.best["hit_rate"] == overall["hit_rate"][0]["rate"]
    assert found.best["recall@1_0.5"] == overall["recall"][0]["recall"]
    assert found.best["room"] == measured.parts["room_retrieval"]["overall"]["accuracy"]
    assert found.best["queries"] == 12
    assert found.verdict() == f"best: descriptor.bins=16, error 0.5, in {(tmp_path / 'b').as_posix()}"
    assert repr(found) == found.table()
    write(measured, tmp_path / "c", 0.5, {"descriptor.bins": 32, "distance": "cosine"})
    assert compare(tmp_path).verdict() == f"{found.verdict()}, and 1 more with the same error"


def test_other_measures_can_count_and_the_highest_recall_is_the_best(measured, tmp_path):
    write(measured, tmp_path / "a", 0.9)
    assert compare(tmp_path, by="recall@1").by == "recall@1_0.5"
    for by, highest in (("recall@5_0.5", True), ("cost.bytes", False), ("absolute.overall.error.p95", False)):
        found = compare(tmp_path, by=by)
        assert (found.by, found.highest) == (by, highest)
        assert math.isfinite(found.best[by])


def test_what_differs_is_found_where_nothing_says_what_was_swept(measured, tmp_path):
    write(measured, tmp_path / "a", 0.9)
    other = {**measured.about["descriptor"], "bins": 4}
    write(measured, tmp_path / "b", 0.5, descriptor=other, distance="cosine")
    assert compare([tmp_path / "a", tmp_path / "b"]).differing == ("distance", "descriptor.bins")
    write(measured, tmp_path / "b", 0.5, descriptor={"name": "fs", "rows": 3})
    assert compare(tmp_path).differing == ("descriptor",), "each descriptor has parameters of its own"
    write(measured, tmp_path / "c", 0.7, descriptor={"name": "fs", "rows": 5})
    assert compare(tmp_path).differing == ("descriptor", "descriptor.rows"), "two values for one descriptor"


def test_runs_show_what_they_were_trained_with(measured, tmp_path):
    for seed in (0, 1):
        run = siamloc.training.Run(tmp_path / f"seed-{seed}")
        run.start({"model": {"branch": "vgg11", "seed": seed}, "training": {"seed": seed}}, [])
        write(measured, run.evaluation("network"), 1.0 + seed)
    found = compare(tmp_path)
    assert found.differing == ("seed",)
    assert [row["seed"] for row in found.rows] == [0, 1]
    assert compare([Run(tmp_path / "seed-0"), tmp_path / "seed-1"]) == found


def test_runs_that_were_measured_by_different_protocols_say_so(measured, tmp_path):
    for seed, kind in enumerate(("cross_run", "same_run")):
        run = siamloc.training.Run(tmp_path / f"seed-{seed}")
        run.start({"training": {"seed": seed}, "protocol": {"kind": ["cross_run", "leave_one_out"][seed]}}, [])
        settings = {**measured.settings, "protocol": {**measured.settings["protocol"], "kind": kind}}
        other = replace(measured, settings=settings, about={**measured.about, "protocol": kind})
        write(other, run.evaluation("network"), 1.0 - seed)
    found = compare(tmp_path)
    assert found.differing == ("seed", "protocol.kind")
    assert [row["protocol.kind"] for row in found.rows] == ["same_run", "cross_run"], "not those of the trainings"
    assert found.verdict().splitlines()[1:] == [
        "These evaluations follow different protocols: their errors must not be compared with each other."
    ]


def test_evaluations_of_other_frames_say_so(measured, tmp_path):
    write(measured, tmp_path / "a", 0.9)
    assert compare(tmp_path).notes == ()
    write(replace(measured, denominators={**measured.denominators, "queries": 9}), tmp_path / "b", 0.5)
    a, b = ((tmp_path / name).as_posix() for name in "ab")
    assert compare(tmp_path).notes == (
        f"Take care when comparing {a} with {b}: they differ in their queries (12 and 9).",
    )


def test_evaluations_without_the_measure_come_last(measured, tmp_path):
    rooms = {name: part for name, part in measured.parts.items() if name == "room_retrieval"}
    replace(measured, parts=rooms, about={**measured.about, "swept": {"seed": 1}}).save(tmp_path / "a", pictures=False)
    write(measured, tmp_path / "b", 0.5, {"seed": 2})
    found = compare(tmp_path)
    assert [row["seed"] for row in found.rows] == [2, 1]
    assert math.isnan(found.rows[1]["error"])
    with found.save(tmp_path / "table.csv").open(newline="") as file:
        assert [(row["seed"], row["error"]) for row in csv.DictReader(file)] == [("2", "0.5"), ("1", "")]
    assert len(found.plot().axes[0].lines[0].get_xdata()) == 1


def test_runs_in_which_nothing_was_measured_are_named(measured, tmp_path):
    for name in "ab":
        Run(tmp_path / name).start({}, [])
    write(measured, tmp_path / "a" / "evaluation" / "hog", 0.5)
    left_out = f"runs that hold no evaluation: {(tmp_path / 'b').as_posix()}"
    assert compare(iter([tmp_path, tmp_path / "b"])).verdict().splitlines()[1:] == [left_out]


def test_settings_of_a_task_without_the_measure_make_no_columns(measured, tmp_path):
    write(measured, tmp_path / "a", 0.9)
    other = replace(measured, parts={"compact": {"queries": 3}}, settings={"task": {"radius": 0.5}})
    other.save(tmp_path / "compact", pictures=False)
    found = compare(tmp_path)
    assert found.differing == ("task",)
    assert [row["task"] for row in found.rows] == ["localization", "compact"]
    further = replace(measured, settings={"task": {**measured.settings.get("task", {}), "candidates": 3}})
    further.save(tmp_path / "other", pictures=False)
    assert "task.candidates" not in compare(tmp_path).differing, "the settings of one task alone"
    assert found.verdict() == f"best: task=localization, error 0.9, in {(tmp_path / 'a').as_posix()}"


def test_mistakes_are_named(measured, tmp_path):
    for folders, says in (
        (tmp_path / "no", "no folder"),
        (tmp_path, "holds no evaluation"),
        ([], "nothing to compare"),
    ):
        with pytest.raises(ConfigError, match=says):
            compare(folders)
    write(measured, tmp_path / "a", 0.9)
    for by, says in (
        ("eror", "did you mean 'error'"),
        ("absolute.overall.eror.p95", r"did you mean 'absolute\.overall\.error\.p95'"),
    ):
        with pytest.raises(ConfigError, match=says):
            compare(tmp_path, by=by)
    kept = tmp_path / "paper.tex"
    kept.write_text("written by hand")
    with pytest.raises(ConfigError, match=r"ending in \.csv, not .*paper\.tex"):
        compare(tmp_path).save(kept)
    assert kept.read_text() == "written by hand"
    replace(measured, parts={"absolute": {"overall": {}}}).save(tmp_path / "b", pictures=False)
    with pytest.raises(FormatError, match="not whole"):
        compare(tmp_path)
    replace(measured, parts={"compact": {"queries": 3}}).save(tmp_path / "c", pictures=False)
    with pytest.raises(ConfigError, match=r"by=compact\.queries"):
        compare(tmp_path / "c")


def test_only_measures_that_were_measured_are_proposed(measured, tmp_path):
    run = Run(tmp_path / "run")
    run.start({}, [])
    run.metrics.write_text("epoch,train/loss\n0,1.0\n")
    parts = {"room_retrieval": {"overall": {"accuracy": 0.5}}}
    replace(measured, parts=parts).save(run.evaluation("network"), pictures=False)
    with pytest.raises(ConfigError, match=r"no evaluation has the measure 'recall@1': valid: .*room"):
        compare(run.folder, by="recall@1")
    said = list[str]()
    Compare(runs=str(run.folder), by="train/loss").run(said.append)
    assert f"to compare the evaluations of these runs: siamloc compare runs={run.folder} by=room" in said
