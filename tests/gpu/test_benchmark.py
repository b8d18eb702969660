"""`python -m benchmarks.gpu` in tiny sizes: every part gives its figures."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch

from benchmarks import gpu as benchmark
from benchmarks import views
from foundation.files import read_json
from siamloc.pretraining import view_batches
from siamloc.training import batches
from tests.gpu.pretend import NAME
from tests.gpu.trainer import pretend_trainer
from tests.siamloc.pretraining.test_pretraining import drawn

MEASURED = [part for part in benchmark.PARTS if part != "tests"]


def leaves(value):
    return [leaf for one in value.values() for leaf in leaves(one)] if isinstance(value, dict) else [value]


@pytest.mark.slow
@pytest.mark.usefixtures("gpu")
def test_every_part_gives_figures_on_a_pretended_gpu(tmp_path, monkeypatch):
    """None ends in an error, and all targets that are measured are met."""
    for module in (view_batches, views):
        monkeypatch.setattr(module, "draw_views", drawn)
    monkeypatch.setattr(
        benchmark, "trainer_on", lambda _: pretend_trainer(precision="bf16-mixed") | {"precision": None}
    )
    monkeypatch.setattr(batches, "room_for", lambda device: 1 << 40)
    benchmark.main(["--smoke", "--device", NAME, "--out", str(tmp_path)])
    record = read_json(tmp_path / "gpu.json")
    assert [name for name in record if name in benchmark.PARTS] == MEASURED
    figures = list(leaves({name: record[name] for name in MEASURED}))
    assert [one for one in figures if isinstance(one, str)] == []
    assert all(math.isfinite(one) for one in figures if one is not None)
    assert [row["met"] for row in record["targets"]] == [True, True]  # resume and export


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_only_what_needs_none_is_measured(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(benchmark.PARTS, "core", lambda bench: {"per_second": {"gathered": 1.0}})
    benchmark.main(["--smoke", "--parts", "networks", "core", "--out", str(tmp_path)])
    assert "torch finds no GPU here: only the part core is measured" in capsys.readouterr().out
    record = read_json(tmp_path / "gpu.json")
    assert (record["core"], record["gpu"], record["targets"]) == ({"per_second": {"gathered": 1.0}}, None, [])
    assert "networks" not in record


def test_the_page_on_speed_lists_the_targets():
    page = (Path(__file__).parents[2] / "docs/results/speed.md").read_text(encoding="utf-8")
    listed = [line.removeprefix("- ") for line in page.partition("## On a GPU")[2].splitlines() if line.startswith("-")]
    assert listed == [target.text for target in benchmark.TARGETS]
