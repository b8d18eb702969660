import json

import numpy as np
import pytest

import analytic
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.maps import Built, CoarseLayer, VisualMap, group
from siamloc.maps.coarse import UNASSIGNED
from siamloc.maps.grouping import IncrementalSparse

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
    assert not layer.labels.flags.writeable


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
    with pytest.raises(FormatError, match="does not exist: build the layer with"):
        CoarseLayer.load(tmp_path / "none.npz")
    KNOWN.save(tmp_path / "map.npz")
    with pytest.raises(FormatError, match="not a coarse layer"):
        CoarseLayer.load(tmp_path / "map.npz")


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"header": np.array(json.dumps({"format": "coarse layer"}))}, "has format version None"),
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
        ([0] * 11, "got 11 labels for 12 frames"),
        ([-1] * 12, "no frame is in a cluster"),
        ([0] * 11 + [2], "needs frames in each node, 0 ... 1"),
    ],
)
def test_labels_that_make_no_layer(labels, sentence):
    with pytest.raises((ConfigError, DataError), match=sentence):
        CoarseLayer.of_labels(KNOWN, labels)


@pytest.fixture(scope="module")
def driven():
    """A map of a drive through three places."""
    steps = np.repeat(np.arange(3), 30) * 64 // 3
    base = RNG.integers(0, 256, (16, 64 * 3), dtype=np.uint8)
    images = np.stack([np.roll(base, -step, axis=1)[:, :64] for step in steps])
    images = np.clip(images.astype(int) + RNG.integers(-9, 9, images.shape), 0, 255).astype(np.uint8)
    found = HOG.describe(images)
    frames = FrameTable(path=[f"{i}.png" for i in range(90)], x=np.arange(90), y=np.zeros(90), theta=np.zeros(90))
    return VisualMap(found.position, frames, orientation=found.orientation, describes=HOG)


def test_an_incremental_layer_is_the_mappers(driven):
    built = group(driven, "incremental", progress=False)
    assert built.mapper is not None
    assert np.array_equal(built.layer.labels >= 0, built.mapper.labels() >= 0)
    assert len(built.layer) == len(built.mapper.nodes)
    assert built.mapper.poses[5] == [5.0, 0.0, 0.0]
    assert built.summary().startswith(f"{len(built.layer)} nodes over 90 frames")
    with pytest.raises(DataError, match="made no node of 12 frames"):
        group(driven.take(np.arange(12)), "incremental", progress=False)
    sparse = driven.take(slice(0, 90, 3))
    assert len(group(sparse, "incremental", progress=False).layer) == 1
    assert len(group(sparse, "incremental_sparse", progress=False).layer) == 3


def test_the_thresholds_for_sparse_frames_are_those_of_the_incremental_mapper(driven, tmp_path):
    layer = {"folder": tmp_path / "layer", "progress": False}
    built = group(driven.take(slice(0, 12)), "incremental", **layer, **IncrementalSparse().plain())
    again = group(driven.take(slice(0, 12)), "incremental_sparse", **layer)
    assert again.mapper is None, "it was read"
    assert again.layer.made["name"] == "incremental"
    assert len(built.layer) == 1
    assert "incremental_sparse" not in again.summary(), "no advice to take what was taken"


def test_a_layer_that_was_built_before_is_read_and_another_is_built(driven, tmp_path, caplog):
    built = group(driven, "incremental", folder=tmp_path / "layer", progress=False)
    names = ["events.jsonl", "graph.json", "layer.npz", "mapper.npz", "placing.json"]
    assert sorted(path.name for path in (tmp_path / "layer").iterdir()) == names
    again = group(driven, "incremental", folder=tmp_path / "layer", progress=False)
    assert again.mapper is None  # it was read
    assert again.reasons == built.reasons
    assert np.array_equal(again.layer.labels, built.layer.labels)
    assert np.array_equal(again.seconds, built.seconds)
    assert not caplog.messages
    other = group(driven, "incremental", folder=tmp_path / "layer", progress=False, omega=1.0)
    assert other.layer.made["omega"] == 1.0
    assert f"the nodes in {tmp_path / 'layer'} were made with omega=1.85: they are made again" in caplog.messages


def test_a_layer_whose_explanation_is_cut_short_is_built_again(tmp_path):
    group(KNOWN, "sample", nodes=2, folder=tmp_path)
    (tmp_path / "placing.json").write_text("{}")
    with pytest.raises(FormatError, match=r"placing\.json is not whole: build the layer again"):
        Built.load(tmp_path)
    assert len(group(KNOWN, "sample", nodes=2, folder=tmp_path).layer) == 2
    assert Built.load(tmp_path).layer.made["nodes"] == 2


def test_ways_that_cannot_be_taken():
    known = VisualMap(DESCRIPTORS, KNOWN.frames, describes=analytic.descriptor("briefgist"))
    small = r"build\.first_node=5 is less than build\.smallest_node=10"
    for on, way, parameters, says in (
        (KNOWN, "spectra", {}, "unknown build 'spectra': did you mean 'spectral'"),
        (KNOWN, "sample", {"node": 3}, r"unknown key build\.node: did you mean 'nodes'"),
        (KNOWN, "spectral", {"nodes": 0}, r"build\.nodes must be a whole number from 1 to 10 million, got 0"),
        (KNOWN, "incremental", {"first_node": 5}, small),
        (known, "som", {"grid": [2, 2]}, "briefgist are compared after turning, so .*: use build=sample or rooms"),
        (known, "incremental", {}, "briefgist are compared after turning, so .*: use build=sample or rooms"),
    ):
        with pytest.raises(ConfigError, match=says):
            group(on, way, **parameters)
