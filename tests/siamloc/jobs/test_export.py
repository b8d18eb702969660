"""What `siamloc export` gives the robot besides its map."""

import numpy as np
import pytest

from analytic import descriptor
from siamloc.data import FrameTable, Preprocessing
from siamloc.errors import ConfigError, DataError
from siamloc.jobs import Export
from siamloc.maps import Refinement, VisualMap


@pytest.fixture
def known(tmp_path):
    """A map of four frames by thumbnails, saved in a run of its own."""
    thumbnail = descriptor("thumbnail", rows=4)
    described = thumbnail.describe(np.random.default_rng(0).integers(0, 256, (4, 3, 16, 64), dtype=np.uint8))
    images = Preprocessing.checked((16, 64), None).parameters()
    frames = FrameTable(path=[f"{i}.png" for i in range(4)], x=np.arange(4.0), y=np.zeros(4), theta=np.zeros(4))
    data = {"kind": "manifest", "manifest": "robot.csv", "image_size": [16, 64]}
    made = VisualMap(described.position, frames, {**thumbnail.identity, "images": images}, made={"data": data})
    made.save(tmp_path / "evaluation/thumbnail/map.npz")
    return made


def test_poses_are_refined_without_an_evaluation_where_the_task_asks_for_it(known, tmp_path):
    def exported(**task):
        return Export.of({"run": str(tmp_path), "task": task}).run().load("refinement.json")

    saved = tmp_path / "evaluation/thumbnail/refinement.json"
    assert exported() is None
    assert exported(refine="interpolate") == Refinement("interpolate", 3, map_digest=known.digest)
    Refinement("interpolate", 3, radius=2.5, map_digest=known.digest).save(saved)
    assert exported().radius == exported(refine="interpolate").radius == 2.5
    assert exported(refine="interpolate", neighbours=2).neighbours == 2
    with pytest.raises(ConfigError, match="thumbnail does not tell where images were taken relative to others"):
        exported(refine="relative")


@pytest.mark.parametrize(
    ("columns", "gets"),
    [
        ({}, "position"),
        ({"x": [np.nan] * 3 + [1.0]}, "position"),
        ({"x": [np.nan] * 4, "room": ["hall"] * 4}, "room"),
        ({"x": [np.nan] * 4, "theta": [np.nan] * 4}, "the map frames that look most alike"),
    ],
)
def test_the_robot_is_promised_what_the_map_holds(known, tmp_path, columns, gets):
    frames = known.frames.with_columns(**columns)
    VisualMap(known.descriptors, frames, known.identity, made=known.made).save(
        tmp_path / "evaluation/thumbnail/map.npz"
    )
    said = []
    Export.of({"run": str(tmp_path)}).run(said.append)
    assert any(line.endswith(f"the robot gets: {gets}") for line in said)
    assert any("task.error_model=true" in line for line in said) == (gets == "position"), "positions make errors"
    assert any("for a heading as well" in line for line in said) == ("theta" not in columns)


def test_headings_that_cannot_be_right_refine_no_poses(known, tmp_path):
    degrees = VisualMap(
        known.descriptors, known.frames.with_columns(theta=[0, 90, 180, 270]), known.identity, made=known.made
    )
    degrees.save(tmp_path / "evaluation/thumbnail/map.npz")
    with pytest.raises(DataError, match=r"task\.refine=relative depends on the headings of the map"):
        Export.of({"run": str(tmp_path), "task": {"refine": "relative"}}).run()
