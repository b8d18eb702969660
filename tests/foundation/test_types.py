"""What a type checker says of calls whose keywords are the fields of settings."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CALLS = """
from siamloc.data import FrameTable, example
from siamloc.models import TripletLoss, build
from siamloc.evaluation import localization
from siamloc.maps import build as mapped
from siamloc.simulate import simulate
from siamloc.training import Training, fit

images = example()
network = build("simple1", "flat")
fit(network, images, images.frames, run="r", epochs=3, optimizer={"name": "adam"}, pairs={"places": 3})
fit(network, images, images.frames, run="r", settings=Training(epochs=3))
TripletLoss(near=0.3, miner="semihard")
fit(None, images, images.frames, run="r", epochs=3)  # wrong: arg-type
known = mapped("hog", images, images.frames)
localization(known, images, images.frames, refine="relative", radii=(0.5,), seed=1)
simulate(building="mini", runs=("cloudy1",), out="data", camera="panorama")
FrameTable(path=["1.jpg", "2.jpg"], x=[0, 1], room=["A", "A"]).x.mean()
FrameTable.from_rows({"path": name} for name in "ab").with_columns(room=["A", "B"])
FrameTable(["1.jpg"], rooms=["A"])  # wrong: call-arg
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
