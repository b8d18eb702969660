"""What a type checker says of calls whose keywords are the fields of settings."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from siamloc.evaluation import compact_maps, disturbed, hierarchy, layers, localize
from siamloc.training.settings import Training, TrainingFields

ROOT = Path(__file__).parents[2]
CALLS = """
from siamloc.data import example
from siamloc.models import TripletLoss, build
from siamloc.evaluation import localization
from siamloc.maps import build as mapped
from siamloc.training import Training, fit

images = example()
network = build("simple1", "flat")
fit(network, images, images.frames, run="r", epochs=3, optimizer={"name": "adam"}, pairs={"places": 3})
fit(network, images, images.frames, run="r", settings=Training(epochs=3))
TripletLoss(near=0.3, miner="semihard")
fit(None, images, images.frames, run="r", epochs=3)  # wrong: arg-type
fit(network, images, images.frames, run="r", epoch=3)  # wrong: call-arg
fit(network, images, images.frames, run="r", epochs="3")  # wrong: arg-type
fit(network, images, images.frames, run="r", monitor="eror")  # wrong: arg-type
known = mapped("hog", images, images.frames)
localization(known, images, images.frames, refine="relative", radii=(0.5,), seed=1)
localization(known, images, images.frames, refine="relativ")  # wrong: arg-type
TripletLoss(nearer=0.3)  # wrong: call-arg
TripletLoss(near="0.3")  # wrong: arg-type
"""


@pytest.mark.slow
def test_a_type_checker_knows_the_fields_and_refuses_wrong_ones(tmp_path, monkeypatch):
    from mypy import api

    monkeypatch.chdir(ROOT)
    path = tmp_path / "calls.py"
    path.write_text(CALLS)
    found, _, _ = api.run([str(path), "--config-file", "pyproject.toml"])
    expected = [(number, line.split("wrong: ")[1]) for number, line in enumerate(CALLS.split("\n"), 1) if "#" in line]
    wrong = re.findall(r"calls\.py:(\d+): error: .*\[([a-z-]+)\]", found)
    assert [(int(number), code) for number, code in wrong] == expected, found


FIELDS = [
    (TrainingFields, Training),
    (localize.LocalizationFields, localize.Localization),
    (disturbed.RobustnessFields, disturbed.Robustness),
    (hierarchy.HierarchicalFields, hierarchy.Hierarchical),
    (layers.MapMeasuresFields, layers.MapMeasures),
    (compact_maps.CompactFields, compact_maps.Compact),
]


@pytest.mark.parametrize(("fields", "kind"), FIELDS)
def test_the_keywords_that_a_type_checker_knows_are_the_fields(fields, kind):
    assert list(fields.__annotations__) == list(kind.__dataclass_fields__)
