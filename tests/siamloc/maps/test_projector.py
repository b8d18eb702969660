"""Maps as TensorBoard's projector reads them."""

from __future__ import annotations

import numpy as np
import pytest

from siamloc.data import FrameTable
from siamloc.maps import VisualMap, write_projector


@pytest.fixture
def known():
    frames = FrameTable(
        path=["a.png", "b\tb.png", "c.png"],
        x=[0, 1.5, np.nan],
        y=[0, -2, np.nan],
        room=["hall", "", "lab"],
        sequence=["monday"] * 3,
    )
    return VisualMap(np.random.default_rng(0).normal(size=(3, 4)), frames)


def test_descriptors_and_frames_have_a_row_each(known, tmp_path):
    write_projector(known, tmp_path / "new")
    vectors = np.loadtxt(tmp_path / "new" / "map.tsv", delimiter="\t")
    np.testing.assert_allclose(vectors, known.descriptors, rtol=1e-6)
    lines = [line.split("\t") for line in (tmp_path / "new" / "map_frames.tsv").read_text().splitlines()]
    assert lines == [
        ["room", "lighting", "sequence", "x", "y", "path"],
        ["hall", "(unknown)", "monday", "0", "0", "a.png"],
        ["(unknown)", "(unknown)", "monday", "1.5", "-2", "b b.png"],
        ["lab", "(unknown)", "monday", "nan", "nan", "c.png"],
    ]


def test_tensorboard_finds_them(known, tmp_path):
    from google.protobuf import text_format
    from tensorboard.plugins.projector.projector_config_pb2 import ProjectorConfig

    *_, config = write_projector(known, tmp_path)
    (entry,) = text_format.Parse(config.read_text(), ProjectorConfig()).embeddings
    assert config.name == "projector_config.pbtxt"
    assert (tmp_path / entry.tensor_path).is_file()
    assert (tmp_path / entry.metadata_path).is_file()
