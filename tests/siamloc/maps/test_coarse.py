import json

import numpy as np
import pytest

import analytic
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.maps import CoarseLayer, VisualMap, build_layer
from siamloc.maps.coarse import UNASSIGNED, connections

RNG = np.random.default_rng(2)
ROOMS = ["a"] * 4 + ["b"] * 5 + [""] * 1 + ["a"] * 2
DESCRIPTORS = RNG.normal(size=(12, 3))
KNOWN = VisualMap(
    DESCRIPTORS,
    FrameTable(path=[f"{i}.png" for i in range(12)], x=np.arange(12), y=np.zeros(12), room=ROOMS, sequence=["s"] * 12),
)
HOG = analytic.descriptor("hog", rows=4, window=16)


def test_a_layer_of_labels_has_their_means_and_connections():
    labels = np.array([0, 0, 1, 1, -1, 2, 2, 2, 0, 0, 0, 0])
    layer = CoarseLayer.of_labels(KNOWN, labels)
    assert len(layer) == 3
    for node in range(3):
        np.testing.assert_allclose(layer.representatives[node], DESCRIPTORS[labels == node].mean(axis=0), rtol=1e-5)
        np.testing.assert_allclose(layer.positions[node, 0], np.flatnonzero(labels == node).mean())
    assert layer.edges.tolist() == [[0, 1], [0, 2], [1, 2]]
    assert layer.members(1).tolist() == [2, 3]
    assert not layer.labels.flags.writeable


def test_sequences_are_not_connected_with_each_other():
    assert connections(np.array([0, 0, 1, 1]), np.array(["s", "s", "t", "t"])).tolist() == []
    assert connections(np.array([0, -1, 1, 0]), np.array(["s"] * 4)).tolist() == [[0, 1]]


def test_rooms_are_nodes_and_frames_without_one_are_in_none():
    layer = CoarseLayer.of_rooms(KNOWN)
    assert layer.names.tolist() == ["a", "b"]
    assert layer.labels.tolist() == [0] * 4 + [1] * 5 + [UNASSIGNED] + [0] * 2
    bare = VisualMap(DESCRIPTORS, FrameTable(path=KNOWN.frames.path))
    with pytest.raises(DataError, match="no map frame has a room label"):
        CoarseLayer.of_rooms(bare)


def test_a_layer_is_the_same_after_saving(tmp_path):
    layer = CoarseLayer.of_rooms(KNOWN)
    layer.save(tmp_path / "layer.npz")
    loaded = CoarseLayer.load(tmp_path / "layer.npz")
    for name in ("labels", "representatives", "positions", "names", "edges"):
        assert np.array_equal(getattr(loaded, name), getattr(layer, name)), name
    assert loaded.made == {"name": "rooms"}


def test_files_that_are_no_layer(tmp_path):
    with pytest.raises(FormatError, match="does not exist: build the layer first"):
        CoarseLayer.load(tmp_path / "none.npz")
    path = tmp_path / "layer.npz"
    CoarseLayer.of_rooms(KNOWN).save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(FormatError, match="not a whole one"):
        CoarseLayer.load(path)
    KNOWN.save(path)
    with pytest.raises(FormatError, match="not a coarse layer"):
        CoarseLayer.load(path)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"header": np.array("[]")}, "not a coarse layer"),
        ({"header": np.array(json.dumps({"format": "siamloc-coarse-layer"}))}, "not a coarse layer"),
        ({"representatives": np.zeros(2)}, r"needs representatives \(k, D\)"),
        ({"representatives": np.array(1.0)}, r"needs representatives \(k, D\)"),
        ({"edges": np.array([[0, 2]])}, "the edges of a coarse layer lie between its nodes, 0 to 1"),
    ],
)
def test_altered_layers_are_refused(tmp_path, changed, sentence):
    path = tmp_path / "layer.npz"
    CoarseLayer.of_rooms(KNOWN).save(path)
    np.savez(path, **{**np.load(path), **changed})
    with pytest.raises(FormatError, match=sentence):
        CoarseLayer.load(path)


@pytest.mark.parametrize(
    ("labels", "sentence"),
    [
        ([0] * 11, "12 map frames need as many labels"),
        ([-1] * 12, "no map frame was assigned"),
        ([0] * 11 + [2], "node 1 has no frames"),
    ],
)
def test_labels_that_make_no_layer(labels, sentence):
    with pytest.raises(DataError, match=sentence):
        CoarseLayer.of_labels(KNOWN, labels)


@pytest.mark.parametrize(
    "options",
    [
        {"name": "sample", "nodes": 3},
        {"name": "spectral", "nodes": 3, "sigma": None, "neighbours": None, "assign": "kmeans"},
        {"name": "som", "grid": [2, 2]},
        {"name": "rooms"},
    ],
    ids=lambda options: options["name"],
)
def test_each_way_of_building_gives_a_layer_over_all_frames(options):
    thumbnail = analytic.Thumbnail(1, 3)
    built = build_layer(KNOWN, thumbnail, options)
    assert len(built.layer.labels) == 12
    assert built.layer.made["name"] == options["name"]
    assert built.mapper is None
    assert built.seconds.shape == (1,)


def test_an_incremental_layer_is_the_mappers():
    steps = np.repeat(np.arange(3), 30)[:, None] * 64 // 3
    base = RNG.integers(0, 256, (16, 64 * 3), dtype=np.uint8)
    images = np.stack([np.roll(base, -step, axis=1)[:, :64] for step in steps[:, 0]])
    images = np.clip(images.astype(int) + RNG.integers(-9, 9, images.shape), 0, 255).astype(np.uint8)
    found = HOG.describe(images)
    frames = FrameTable(path=[f"{i}.png" for i in range(90)], x=np.arange(90), y=np.zeros(90), theta=np.zeros(90))
    known = VisualMap(found.position, frames, orientation=found.orientation)
    built = build_layer(known, HOG, {"name": "incremental", "version": 2})
    assert built.mapper is not None
    assert len(built.decisions) == len(built.seconds) == 90
    assert np.array_equal(built.layer.labels >= 0, built.mapper.labels() >= 0)
    assert len(built.layer) == len(built.mapper.nodes)
    assert built.mapper.poses[5] == [5.0, 0.0, 0.0]
    with pytest.raises(DataError, match="made no node of 12 frames"):
        build_layer(known.take(np.arange(12)), HOG, {"name": "incremental"})


def test_ways_that_cannot_be_taken():
    with pytest.raises(ConfigError, match="unknown build 'spectra': did you mean 'spectral'"):
        build_layer(KNOWN, analytic.Thumbnail(), {"name": "spectra"})
    with pytest.raises(ConfigError, match="those of briefgist have to be aligned first"):
        build_layer(KNOWN, analytic.descriptor("briefgist"), {"name": "som", "grid": [2, 2]})
