import numpy as np
import pytest

import analytic
from siamloc.data.frames import FrameTable
from siamloc.maps import CoarseLayer, HierarchicalSearch, NodeRanking, VisualMap, frame_distances, match
from siamloc.maps import aligned as module
from tests.siamloc.maps.conftest import map_of

IMAGES = np.random.default_rng(5).integers(0, 256, (9, 32, 64), dtype=np.uint8)
NOISY = np.clip(IMAGES[:4] + np.random.default_rng(6).normal(0, 40, (4, 32, 64)), 0, 255).astype(np.uint8)
DESCRIPTORS = [
    analytic.descriptor("wisurf", rows=2, windows=32),
    analytic.descriptor("wisurf", rows=2, windows=32, circular=False),
    analytic.descriptor("briefgist", rows=8, columns=16),
    analytic.descriptor("radon_poc", step=9.0, size=32),
]
EVERY = pytest.mark.parametrize("by", DESCRIPTORS, ids=lambda by: by.name if by.circular else f"ordinary {by.name}")


def asked(by: analytic.Descriptor) -> analytic.Description:
    """Describe the first four images once more: noisy, and turned if the columns wrap around."""
    return by.describe(np.roll(NOISY, 8, axis=2) if by.circular else NOISY)


@EVERY
@pytest.mark.parametrize("distance", ["manhattan", "euclidean", "cosine", "correlation"])
def test_only_the_frames_of_the_candidates_are_searched(by, distance, monkeypatch):
    known = map_of(by, IMAGES).with_distance(distance)
    monkeypatch.setattr(module, "_VALUES", 2 * known.width)
    layer = CoarseLayer.of_labels(known, [0, 1, 0, 0, 1, 1, -1, 1, 0])
    queries = asked(by)
    ranking = NodeRanking(np.array([[0], [1], [1], [0]]), np.full(4, 2))
    found = HierarchicalSearch(known, layer, by="vote").search(queries, ranking, 3).found
    searched = (layer.labels == ranking.nodes) | (layer.labels == -1)
    apart = np.where(searched, frame_distances(known, queries), np.inf)
    expected = np.argsort(apart, axis=1, kind="stable")[:, :3]
    assert np.array_equal(found.indices, expected)
    # A sum over a few frames at a time may differ in its last bits from that over all.
    np.testing.assert_allclose(found.distances, np.take_along_axis(apart, expected, axis=1), rtol=1e-4)


def test_orientation_parts_that_only_overlap_the_descriptors_stay_themselves(tmp_path):
    values = np.random.default_rng(1).random((9, 3, 4), dtype=np.float32)
    values.flags.writeable = False
    frames = FrameTable(path=[f"{i}.png" for i in range(9)])
    for orientation in (values.transpose(0, 2, 1), values[:, :2]):
        known = VisualMap(values.reshape(9, 12), frames, orientation=orientation)
        assert np.array_equal(known.take([1, 4]).orientation, orientation[[1, 4]])
        known.save(tmp_path / "map.npz")
        assert np.array_equal(VisualMap.load(tmp_path / "map.npz").orientation, orientation)


class Counts(analytic.Descriptor):
    """Compares position parts by whole numbers, which it keeps, and has no orientation part."""

    name = "counts"
    aligned = True

    def __init__(self):
        self.kept = {}

    @property
    def identity(self):
        return {"name": self.name}

    def describe(self, batch):
        return analytic.Description(np.asarray(batch).mean(axis=(1, 2))[:, None].round(), None, self.identity)

    def pairwise(self, queries, references, distance=None):
        apart = np.abs(queries.position - references.position.T).astype(np.int64)
        return self.kept.setdefault(apart.tobytes(), apart)


def test_a_descriptor_of_ones_own_may_compare_in_its_way():
    by, n = Counts(), 6
    images = np.arange(0, 60, 10)[:, None, None] * np.ones((n, 4, 8))
    frames = FrameTable(path=[f"{i}.png" for i in range(n)])
    known = VisualMap(by.describe(images).position, frames, by.identity, describes=by)
    queries = by.describe(images + 2)
    assert match(known, queries, excluded=np.eye(n, dtype=bool)).indices[:3, 0].tolist() == [1, 2, 3]
    assert match(known, queries).indices[:, 0].tolist() == list(range(n))
    layer = CoarseLayer.of_labels(known, [0, 0, 0, 1, 1, 1])
    ranking = NodeRanking(np.ones((n, 1), dtype=np.int64), np.full(n, 2))
    found = HierarchicalSearch(known, layer, by="vote").search(queries, ranking).found
    assert found.indices[:, 0].tolist() == [3, 3, 3, 3, 4, 5]
