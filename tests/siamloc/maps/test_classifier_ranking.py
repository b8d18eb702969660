"""Rooms named by a classifier as the coarse layer of a hierarchical search."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from analytic import Description
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.maps import CoarseLayer, HierarchicalSearch, LayerSearch, VisualMap, group
from siamloc.maps.ranking import rank_by_classifier
from siamloc.models import RoomClassifier

RNG = np.random.default_rng(5)
NAMES = ["cellar", "hall", "office"]  # one more than the map has
ROOMS = RoomClassifier(NAMES, RNG.normal(size=(3, 4)), RNG.normal(size=3))
FRAMES = FrameTable(path=[f"{number}.png" for number in range(6)], room=["office", "hall"] * 3)
DESCRIPTORS = RNG.normal(size=(6, 4))
QUERIES = RNG.normal(size=(20, 4))


def seen(rooms=ROOMS, frames=FRAMES):
    describes = SimpleNamespace(rooms=rooms, aligned=False, identity={"name": "made up"}, name="made up")
    return VisualMap(DESCRIPTORS, frames, describes=describes)


def test_nodes_are_ranked_by_their_probabilities():
    layer = group(seen(), "rooms").layer
    assert layer.names.tolist() == layer.classifier.names.tolist() == ["hall", "office"]
    expected = [sorted((0, 1), key=lambda node: -row[node + 1]) for row in ROOMS.named(QUERIES).probabilities.tolist()]
    ranking = rank_by_classifier(QUERIES, layer.classifier, 5)
    assert ranking.nodes.tolist() == expected
    assert ranking.compared.tolist() == [2] * 20
    search = HierarchicalSearch(seen(), layer, by="classifier", candidates=1)
    asked = Description(QUERIES)
    found = search.search(asked, search.rank(asked))
    assert found.tried.tolist() == [[row[0]] for row in expected]
    assert found.node.tolist() == [row[0] for row in expected]
    everywhere = HierarchicalSearch(seen(), layer, settings=LayerSearch(by="classifier", candidates=2))
    whole = everywhere.search(asked, everywhere.rank(asked)).found.indices
    np.testing.assert_array_equal(whole, seen().search(QUERIES).indices)
    with pytest.raises(DataError, match="descriptors of 4 numbers"):
        rank_by_classifier(QUERIES[:, :3], layer.classifier)


def test_a_layer_built_without_the_network_is_built_again_with_it(tmp_path):
    known = VisualMap(DESCRIPTORS, FRAMES)
    assert group(known, "rooms", folder=tmp_path).layer.classifier is None
    assert group(seen(), "rooms", folder=tmp_path).layer.classifier is not None
    assert group(known, "rooms", folder=tmp_path).layer.classifier is not None


def test_a_damaged_classifier_is_refused(tmp_path):
    path = tmp_path / "layer.npz"
    group(seen(), "rooms").layer.save(path)
    with np.load(path) as held:
        whole = dict(held)
    for change in ({"class_weight": whole["class_weight"][:, :2]}, {"class_bias": None}, {"class_bias": np.zeros(5)}):
        np.savez(path, **{name: array for name, array in (whole | change).items() if array is not None})
        with pytest.raises(FormatError, match="not a whole coarse layer"):
            CoarseLayer.load(path)


@pytest.mark.parametrize(
    ("known", "way"),
    [
        (seen(None), {"way": "rooms"}),
        (seen(), {"way": "sample", "nodes": 2}),
        (seen(ROOMS.of(["hall", "cellar"])), {"way": "rooms"}),
    ],
)
def test_nodes_that_no_classifier_names_are_refused(known, way):
    layer = group(known, **way).layer
    assert layer.classifier is None
    with pytest.raises(ConfigError, match="a classifier ranks nodes that are the rooms of the map"):
        HierarchicalSearch(known, layer, by="classifier")
