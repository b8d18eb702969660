"""`python -m benchmarks.gpu` in tiny sizes: every part gives its figures."""

from __future__ import annotations

import math

import pytest
import torch

from benchmarks import gpu, views
from siamloc.files import read_json
from siamloc.pretraining import rendering
from tests.siamloc.pretraining.test_pretraining import drawn

MEASURED = [part for part in gpu.PARTS if part != "tests"]


@pytest.fixture
def measured(tmp_path, monkeypatch):
    """Measure everything on a device, and return the record."""
    monkeypatch.setattr(rendering, "draw_views", drawn)
    monkeypatch.setattr(views, "draw_views", drawn)

    def call(device):
        gpu.main(["--smoke", "--device", device, "--out", str(tmp_path)])
        return read_json(tmp_path / "gpu.json")

    return call


def check(record):
    """Every part has its figures: none ended in an error, and all targets that were measured are met."""
    assert [name for name in record if name in gpu.PARTS] == MEASURED
    figures = list(leaves({name: record[name] for name in MEASURED}))
    assert [one for one in figures if isinstance(one, str)] == []
    assert all(math.isfinite(one) for one in figures if one is not None)
    assert [row["met"] for row in record["targets"]] == [True, True]  # resume and export


def leaves(value):
    return [leaf for one in value.values() for leaf in leaves(one)] if isinstance(value, dict) else [value]


@pytest.mark.slow
def test_every_part_gives_figures(measured):
    check(measured("cpu"))


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu_only_what_needs_none_is_measured(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(gpu.PARTS, "core", lambda bench: {"per_second": {"gathered": 1.0}})
    gpu.main(["--parts", "networks", "core", "--out", str(tmp_path)])
    assert "torch finds no GPU here: only the part core is measured" in capsys.readouterr().out
    record = read_json(tmp_path / "gpu.json")
    assert (record["core"], record["gpu"], record["targets"]) == ({"per_second": {"gathered": 1.0}}, None, [])
    assert "networks" not in record
