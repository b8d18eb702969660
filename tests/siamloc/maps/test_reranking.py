"""The nearest map frames are put in order again by a comparison."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analytic import Description
from analytic.descriptors.thumbnail import Thumbnail
from siamloc.data import FrameTable
from siamloc.maps import CoarseLayer, HierarchicalSearch, NodeRanking, Retrieval, VisualMap, frame_distances, match
from siamloc.models.registry import COLOURS

FRAMES = 12


class Compares(Thumbnail):
    """A descriptor that compares: the number of the map frame is in its orientation part."""

    compares = True

    def __init__(self, odds, apart=None):
        super().__init__()
        self.odds = np.asarray(odds, dtype=float)
        self.apart = np.full(len(self.odds), 1.0) if apart is None else np.asarray(apart, dtype=float)

    def compare(self, queries, known):
        np.testing.assert_allclose((known**2).mean(axis=(1, 2)), 1, rtol=1e-3)
        rows = np.rint(known[:, 0, 0] / known[:, 1, 0]).astype(int) - 2
        pose = np.outer(self.apart[rows], [0.6, -0.8, 0.0])
        return pose, np.tile(100.0 * np.eye(3), (len(rows), 1, 1)), self.odds[rows]


def map_of(odds, apart=None, **changes) -> VisualMap:
    """Frames in a row; frame i has the descriptor i / 20."""
    frames = FrameTable(path=[f"{n}.png" for n in range(FRAMES)], x=np.arange(FRAMES), y=np.zeros(FRAMES))
    parts = np.ones((FRAMES, 8, 2), dtype=np.float16)
    parts[:, 0, 0] = 2 + np.arange(FRAMES)
    made = VisualMap(np.arange(FRAMES)[:, None] / 20, frames, orientation=parts, heading={"name": "network"})
    return replace(made, describes=Compares(odds, apart), **changes)


QUERY = Description(np.zeros((2, 1)), np.ones((2, 8, 2), dtype=np.float32))


def test_distances_grow_with_the_doubts_of_the_comparison():
    odds = [-20.0, 4.0, 0.0, -1.5, 10.0, 2.0, -3.0, 4.0, 50.0, 50.0, 50.0, 50.0]
    found = match(map_of(odds), QUERY, FRAMES)
    distances = np.arange(FRAMES) / 20
    distances[:8] += (4 - np.clip(odds[:8], -2, 4)) / 30
    distances[8:] += 0.2  # not compared
    distances += np.where(np.isin(np.arange(FRAMES), [1, 4, 7]), 2, 4)  # certain answers tell 1 m
    expected = sorted(range(FRAMES), key=lambda row: distances[row])
    assert found.indices.tolist() == [expected, expected]
    np.testing.assert_allclose(found.distances[0], distances[expected], atol=1e-6)
    assert expected[:3] == [1, 4, 7]
    fewer = match(map_of(odds), QUERY, 2)
    assert fewer.indices.tolist() == [expected[:2], expected[:2]]


def test_frames_of_a_map_in_another_unit_keep_the_order_of_their_descriptors():
    known = map_of([-20.0, 4.0, *[0.0] * 10])
    assert match(known, QUERY, 3).indices[0, 0] == 1
    found = match(replace(known, frames=replace(known.frames, unit="mm")), QUERY, 3)
    assert found.indices.tolist() == [[0, 1, 2], [0, 1, 2]]
    np.testing.assert_allclose(found.distances[0], [0.0, 0.05, 0.1], atol=1e-6)


@pytest.mark.parametrize("certain", [True, False])
def test_the_frame_next_to_the_pose_is_preferred_if_a_comparison_is_certain(certain):
    odds = np.full(FRAMES, 3.9)
    odds[1] = 9.0 if certain else 3.9
    plain = map_of(odds, np.full(FRAMES, 3.0))
    facing = np.full(FRAMES, np.arctan2(0.8, 0.6))  # all answers then lie ahead along x
    known = replace(plain, frames=plain.frames.with_columns(theta=facing, x=np.arange(FRAMES) * 0.01 + 4))
    known = replace(known, frames=known.frames.with_columns(x=np.where(np.arange(FRAMES) == 6, 7.0, known.frames.x)))
    found = match(known, QUERY, FRAMES)
    pose = 7.01  # of the best three frames, from 4.00, 4.01 and 4.02
    near = np.minimum(np.abs(known.frames.x - pose), 2) if certain else np.full(FRAMES, 2.0)
    near[8:] = 2.0
    distances = np.arange(FRAMES) / 20 + (4 - np.minimum(odds, 4)) / 30 + 2 * near
    distances[8:] = np.arange(8, FRAMES) / 20 + 0.2 + 4
    assert found.indices[0, 0] == (6 if certain else 1 if odds[1] > 4 else 0)
    np.testing.assert_allclose(found.distances[0], np.sort(distances), atol=0.01)
    assert found.strangeness == pytest.approx(np.full(2, (np.arange(8) / 20 - odds[:8] / 10).min()), abs=1e-6)
    assert found.most_alike.tolist() == [0, 0]  # whatever the pose
    assert match(known, QUERY, 1).most_alike.tolist() == [0, 0]
    assert Retrieval.concatenate([found.take([1]), found.take([0])]).most_alike.tolist() == [0, 0]


def test_frames_that_are_nearest_without_colours_are_compared_too():
    odds, apart = np.full(FRAMES, -20.0), np.full(FRAMES, 3.0)
    odds[1], apart[1] = 9.0, 0.1
    colours = np.zeros((FRAMES, COLOURS))
    colours[:4, 0] = 1.0  # the first four frames have other colours than the query and all others
    plain = map_of(odds, apart)
    known = replace(plain, descriptors=np.concatenate([plain.descriptors, colours], axis=1), identity={"colours": True})
    query = replace(QUERY, position=np.zeros((2, 1 + COLOURS)))
    assert known.search(query.position, 8).indices[0].tolist() == list(range(4, FRAMES))
    found = match(known, query, FRAMES)
    shape = np.arange(FRAMES) / 20
    whole = (shape + np.hypot(shape, colours[:, 0])) / 2 + 0.2 + 4
    whole[1] -= 0.2 + 2 * (2 - 0.1)
    assert found.indices[0].tolist() == np.argsort(whole, kind="stable").tolist()
    np.testing.assert_allclose(found.distances[0], np.sort(whole), atol=1e-6)
    assert match(known, query, 3).indices.tolist() == found.indices[:, :3].tolist()
    assert match(known, query, 2 * FRAMES).indices.tolist() == found.indices.tolist()
    assert match(known, query, 5, within=np.array([1, 6])).indices.tolist() == [[1, 6], [1, 6]]
    assert sorted(match(known.take([0, 1, 2]), query, 5).indices[0].tolist()) == [0, 1, 2]


def coloured(colours):
    """Return a map whose frames have colours, by a network that does not compare."""
    plain = map_of(np.zeros(FRAMES))
    descriptors = np.concatenate([plain.descriptors, colours], axis=1)
    return replace(plain, descriptors=descriptors, identity={"colours": True}, describes=None)


def test_without_a_comparison_colours_count_in_the_light_of_the_map_alone():
    """The query is at frame 1 by what is learned, and at frame 9 by colours, which are those of the map or all far."""
    colours = np.zeros((FRAMES, COLOURS))
    colours[:, 0] = 0.1 * np.arange(FRAMES)
    known = coloured(colours)
    assert known.colour_spacing == pytest.approx(0.1)
    for height, weight in ((0.0, 1.0), (0.3, np.exp(-4 * (3 - 2)))):  # of the query's colours above the map's
        query = np.zeros((1, 1 + COLOURS))
        query[0, :3] = 0.05, 0.9, height
        learned, apart = np.arange(FRAMES) / 20 - 0.05, np.hypot(colours[:, 0] - 0.9, height)
        description = Description(query, np.ones((1, 8, 2), dtype=np.float32))
        whole = np.sqrt(learned**2 + weight * apart**2)
        np.testing.assert_allclose(frame_distances(known, description)[0], whole, atol=1e-6)
        found = match(known, description, 3)
        assert found.indices[0].tolist() == np.argsort(whole)[:3].tolist()
        assert match(known, description, 2 * FRAMES).indices[0].tolist() == np.argsort(whole).tolist()
        rows = np.array([2, 3, 7])
        assert match(known, description, 5, within=rows).indices[0].tolist() == rows[np.argsort(whole[rows])].tolist()
        excluded = np.arange(FRAMES)[None] == found.indices[0, 0]
        assert match(known, description, 1, excluded=excluded).indices.tolist() == [[found.indices[0, 1]]]
        np.testing.assert_allclose(found.distances[0], np.sort(whole)[:3], atol=1e-6)


def test_colours_of_frames_that_may_not_be_found_are_not_in_the_light_of_the_map():
    """The query has the colours of frame 0, which are far from all others: without that frame, shapes alone count."""
    colours = np.zeros((FRAMES, COLOURS))
    colours[:, 0] = 0.1 * np.arange(FRAMES)
    colours[0, 1] = 1.0
    known = coloured(colours)
    query = Description(np.concatenate([[0.42], colours[0]])[None])
    excluded = np.arange(FRAMES)[None] == 0
    shape = np.where(excluded[0], np.inf, np.abs(np.arange(FRAMES) / 20 - 0.42))
    assert match(known, query).indices.tolist() == [[0]]
    found = match(known, query, FRAMES - 1, excluded=excluded)
    assert found.indices[0].tolist() == np.argsort(shape)[:-1].tolist()
    np.testing.assert_allclose(frame_distances(known, query, excluded=excluded)[0], shape, atol=1e-6)


def test_only_the_frames_that_may_be_found_are_compared():
    odds = np.zeros(FRAMES)
    odds[[0, 3, 6]] = 9.0
    known = map_of(odds)
    assert match(known, QUERY, 1, within=np.array([4, 6, 11])).indices.tolist() == [[6], [6]]
    excluded = np.zeros((2, FRAMES), dtype=bool)
    excluded[0, :3] = excluded[1, 4:] = True
    excluded[1, 0] = True
    assert match(known, QUERY, 1, excluded=excluded).indices.tolist() == [[3], [3]]


@pytest.mark.parametrize("case", ["nothing compares", "another distance", "no parts asked", "no parts held"])
def test_without_a_comparison_the_descriptors_decide(case):
    known, query = map_of(np.where(np.arange(FRAMES) == 7, 10.0, -10.0)), QUERY
    assert match(known, query, 1).indices.tolist() == [[7], [7]]
    if case == "nothing compares":
        known = replace(known, describes=None)
    elif case == "another distance":
        known = known.with_distance("manhattan")
    elif case == "no parts asked":
        query = Description(QUERY.position)
    else:
        known = replace(known, orientation=None, heading=None)
    found = match(known, query, 3)
    assert found.indices.tolist() == [[0, 1, 2]] * 2
    np.testing.assert_allclose(found.distances[0], [0, 0.05, 0.1], atol=1e-6)


def test_no_queries_give_no_frames():
    assert match(map_of(np.zeros(FRAMES)), QUERY.take(slice(0, 0)), 3).indices.shape == (0, 3)


def test_a_search_in_nodes_keeps_the_least_strangeness_of_any_part():
    known = map_of([1.0] * 6 + [5.0] * 6)
    search = HierarchicalSearch(known, CoarseLayer.of_labels(known, [0] * 6 + [1] * 5 + [-1]), along=1)
    ranking = NodeRanking(np.array([[0, -1], [0, 1]]), np.array([1, 2]))
    found = search.search(QUERY, ranking, 2).found
    np.testing.assert_allclose(found.strangeness, [-0.1, 6 / 20 - 0.5], atol=1e-6)
    assert found.take([1]).strangeness.shape == (1,)
