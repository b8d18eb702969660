from pathlib import Path

import numpy as np
import pytest

import analytic
from siamloc.data.frames import FrameTable
from siamloc.maps import CoarseLayer, HierarchicalSearch, NodeRanking, VisualMap, frame_distances, headings, match
from siamloc.maps import aligned as module
from siamloc.maps.packing import Packed, packed, shares_values

IMAGES = np.random.default_rng(5).integers(0, 256, (9, 32, 64), dtype=np.uint8)
NOISY = np.clip(IMAGES[:4] + np.random.default_rng(6).normal(0, 40, (4, 32, 64)), 0, 255).astype(np.uint8)
DESCRIPTORS = [
    analytic.descriptor("wisurf", rows=2, windows=32),
    analytic.descriptor("wisurf", rows=2, windows=32, circular=False),
    analytic.descriptor("briefgist", rows=8, columns=16),
    analytic.descriptor("radon_poc", step=9.0, size=32),
]
EVERY = pytest.mark.parametrize("by", DESCRIPTORS, ids=lambda by: by.name if by.circular else f"ordinary {by.name}")
SHORT = pytest.mark.parametrize("precision", ["float16", "int8"])


def map_of(by: analytic.Descriptor) -> VisualMap:
    seen, n = by.describe(IMAGES), len(IMAGES)
    frames = FrameTable(path=[f"{i}.png" for i in range(n)], x=np.arange(n), y=np.zeros(n), theta=np.linspace(-3, 3, n))
    return VisualMap(
        seen.position, frames, by.identity, by.default_distance, orientation=seen.orientation, describes=by
    )


def asked(by: analytic.Descriptor) -> analytic.Description:
    """Describe the first four images once more: noisy, and turned if the columns wrap around."""
    return by.describe(np.roll(NOISY, 8, axis=2) if by.circular else NOISY)


def saved(by: analytic.Descriptor, precision: str, folder: Path) -> tuple[VisualMap, VisualMap]:
    """Return a map of lower precision as it is read in the laboratory, and on a robot."""
    map_of(by).save(folder / "map.npz", precision)
    with (folder / "map.npz").open("rb") as file:
        return VisualMap.load(folder / "map.npz"), VisualMap.read(file, "map.npz")


@EVERY
@SHORT
@pytest.mark.parametrize("distance", ["manhattan", "euclidean", "cosine", "correlation"])
def test_a_packed_map_finds_what_its_values_find(by, precision, distance, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_UNPACKED", 2 * map_of(by).width)  # several blocks
    whole, short = (known.with_distance(distance) for known in saved(by, precision, tmp_path))
    assert isinstance(short.descriptors, Packed)
    assert isinstance(short.orientation, Packed)
    queries = asked(by)
    expected, found = match(whole, queries), match(short, queries)
    assert found.indices[:, 0].tolist() == expected.indices[:, 0].tolist() == [0, 1, 2, 3]
    # The turn of the nearest frame stays: only a distance from a rounded correlation is off. The correlation of noise
    # with noise has many turns that are nearly as good as the best.
    np.testing.assert_allclose(found.distances, expected.distances, rtol=5e-3)
    np.testing.assert_allclose(frame_distances(short, queries), frame_distances(whole, queries), rtol=2e-2)
    assert np.array_equal(headings(short, queries, found), headings(whole, queries, found), equal_nan=True)
    alone = [match(short, queries.take([row])) for row in range(4)]
    assert np.array_equal(np.concatenate([one.indices for one in alone]), found.indices)
    barred = np.eye(4, len(IMAGES), dtype=bool)
    others = match(short, queries, 2, excluded=barred).indices
    assert not np.take_along_axis(barred, others, axis=1).any()
    assert match(short, queries.take(slice(0, 0))).indices.shape == (0, 1)
    assert match(short.take([3]), queries, 2).indices.tolist() == [[0]] * 4


@SHORT
def test_whole_numbers_are_compared_exactly(precision, tmp_path):
    by = DESCRIPTORS[2]
    whole, short = saved(by, precision, tmp_path)
    queries = asked(by)
    assert np.array_equal(frame_distances(short, queries), frame_distances(whole, queries))
    assert np.array_equal(frame_distances(short, queries), frame_distances(map_of(by), queries))


@EVERY
@SHORT
def test_some_frames_of_a_packed_map_stay_packed(by, precision, tmp_path):
    whole, short = saved(by, precision, tmp_path)
    part, expected = short.take([1, 4, 5]), whole.take([1, 4, 5])
    assert isinstance(part.orientation, Packed)
    assert shares_values(part.orientation, part.descriptors) == shares_values(short.orientation, short.descriptors)
    assert not part.descriptors.values.flags.writeable
    assert np.array_equal(part.orientation[:], expected.orientation)
    assert np.array_equal(part.descriptors[:], expected.descriptors)
    assert match(part, asked(by).take([1])).indices.tolist() == [[0]]
    short.save(tmp_path / "again.npz", precision)
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "map.npz").read_bytes()
    assert short.digest == whole.digest


@EVERY
@pytest.mark.parametrize("precision", ["float32", "float16", "int8"])
def test_only_the_frames_of_the_candidates_are_searched(by, precision, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "_VALUES", 2 * map_of(by).width)
    monkeypatch.setattr(module, "_UNPACKED", 2 * map_of(by).width)
    whole, short = saved(by, precision, tmp_path)
    layer = CoarseLayer.of_labels(whole, [0, 1, 0, 0, 1, 1, -1, 1, 0])
    queries = asked(by)
    ranking = NodeRanking(np.array([[0], [1], [1], [0]]), np.full(4, 2))
    found = HierarchicalSearch(short, layer, by="vote").search(queries, ranking, 3).found
    searched = (layer.labels == ranking.nodes) | (layer.labels == -1)
    apart = np.where(searched, frame_distances(short, queries), np.inf)
    expected = np.argsort(apart, axis=1, kind="stable")[:, :3]
    assert np.array_equal(found.indices, expected)
    # A sum over a few frames at a time may differ in its last bits from that over all.
    np.testing.assert_allclose(found.distances, np.take_along_axis(apart, expected, axis=1), rtol=1e-4)


def test_a_packed_map_holds_its_values_once_and_its_spectra_in_one_byte_a_number(tmp_path):
    by = DESCRIPTORS[0]
    _, short = saved(by, "float16", tmp_path)
    assert shares_values(short.orientation, short.descriptors)
    match(short, by.describe(IMAGES[:1]))
    assert sum(part.nbytes for part in short.aligned_index._rounded_spectra) < 0.65 * short.orientation.nbytes
    assert "spectrum" not in vars(short.description)


def test_orientation_parts_that_only_overlap_the_descriptors_stay_themselves(tmp_path):
    values = np.random.default_rng(1).random((9, 3, 4), dtype=np.float32)
    values.flags.writeable = False
    frames = FrameTable(path=[f"{i}.png" for i in range(9)])
    for orientation in (values.transpose(0, 2, 1), values[:, :2]):
        known = VisualMap(values.reshape(9, 12), frames, orientation=orientation)
        assert np.array_equal(known.take([1, 4]).orientation, orientation[[1, 4]])
        known.save(tmp_path / "map.npz")
        assert np.array_equal(VisualMap.load(tmp_path / "map.npz").orientation, orientation)
    short = Packed(np.ones((9, 12), dtype=np.int8), np.ones(9, dtype=np.float32))
    doubled = Packed(short.values.reshape(9, 3, 4), 2 * short.scale)
    assert shares_values(short, short.reshape(9, 3, 4))
    assert not shares_values(short, doubled)


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
        apart = np.abs(queries.position - references.position[:].T).astype(np.int64)
        return self.kept.setdefault(apart.tobytes(), apart)


@pytest.mark.parametrize("precision", ["float32", "float16"])
def test_a_descriptor_of_ones_own_may_compare_in_its_way(precision, tmp_path):
    by, n = Counts(), 6
    images = np.arange(0, 60, 10)[:, None, None] * np.ones((n, 4, 8))
    frames = FrameTable(path=[f"{i}.png" for i in range(n)])
    VisualMap(by.describe(images).position, frames, by.identity, describes=by).save(tmp_path / "map.npz", precision)
    with (tmp_path / "map.npz").open("rb") as file:
        known = VisualMap.read(file, "map.npz").with_descriptor(by)
    queries = by.describe(images + 2)
    assert match(known, queries, excluded=np.eye(n, dtype=bool)).indices[:3, 0].tolist() == [1, 2, 3]
    assert match(known, queries).indices[:, 0].tolist() == list(range(n))
    layer = CoarseLayer.of_labels(known, [0, 0, 0, 1, 1, 1])
    ranking = NodeRanking(np.ones((n, 1), dtype=np.int64), np.full(n, 2))
    found = HierarchicalSearch(known, layer, by="vote").search(queries, ranking).found
    assert found.indices[:, 0].tolist() == [3, 3, 3, 3, 4, 5]


def test_maps_with_values_that_are_not_finite_are_still_noticed():
    frames, held = FrameTable(path=["a.png", "b.png", "c.png"]), packed("a", np.ones((3, 4)), "float16")
    right = Packed(held["a"], held["a_scale"])
    held["a"] = held["a"].copy()
    held["a"][1, 2] = np.inf
    wrong = Packed(held["a"], held["a_scale"])
    with pytest.raises(ValueError, match="descriptors hold values that are not finite"):
        VisualMap(wrong, frames)
    with pytest.raises(ValueError, match="orientation parts hold values that are not finite"):
        VisualMap(right, frames, orientation=wrong.reshape(3, 2, 2))
