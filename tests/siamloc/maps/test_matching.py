from dataclasses import replace

import numpy as np
import pytest

import analytic
from siamloc.data import FrameTable
from siamloc.errors import ConfigError, DataError
from siamloc.maps import VisualMap, frame_distances, headings, match
from tests.siamloc.maps.conftest import map_of, placed

RNG = np.random.default_rng(5)
IMAGES = RNG.integers(0, 256, (9, 16, 64), dtype=np.uint8)
HOG = analytic.descriptor("hog", rows=4, window=16)
BRIEF = analytic.descriptor("briefgist", rows=4, columns=16)
THUMBNAIL = analytic.descriptor("thumbnail", rows=2, columns=4)


@pytest.mark.parametrize("descriptor", [HOG, BRIEF], ids=lambda d: d.name)
def test_a_turned_frame_has_the_heading_of_its_map_frame_and_the_turn(descriptor):
    theta = RNG.uniform(-np.pi, np.pi, len(IMAGES))
    known = map_of(descriptor, IMAGES, theta)
    queries = descriptor.describe(np.roll(IMAGES, 12, axis=2))  # 12 of 64 columns: to the left
    found = match(known, queries, 1)
    assert found.indices[:, 0].tolist() == list(range(9))
    told = headings(known, queries, found)[:, 0]
    np.testing.assert_allclose(np.exp(1j * told), np.exp(1j * (theta + 2 * np.pi * 12 / 64)), atol=1e-6)
    assert (np.abs(told) <= np.pi).all()


def test_no_headings_where_there_is_nothing_to_find_them_by():
    flat, ordinary = THUMBNAIL, analytic.descriptor("hog", rows=4, window=16, circular=False)
    unknown = map_of(HOG, IMAGES)  # the map frames have no heading
    for known in (unknown, map_of(flat, IMAGES, np.zeros(9)), map_of(ordinary, IMAGES, np.zeros(9))):
        queries = known.describe(IMAGES)
        told = headings(known, queries, match(known, queries, 3), 2)
        assert told.shape == (9, 2)
        assert np.isnan(told).all()


def test_descriptions_by_another_descriptor_are_refused_whatever_their_size():
    known = replace(map_of(HOG, IMAGES), identity={**HOG.identity, "images": {"size": [16, 64]}})
    other = replace(HOG, homomorphic=True).describe(IMAGES)
    more = FrameTable(path=[f"{i}.png" for i in range(100, 109)])
    for call in (match, frame_distances, lambda known, queries: known.add(more, queries)):
        with pytest.raises(ConfigError, match="differently from the queries: homomorphic is False in the map"):
            call(known, other)
        call(known, HOG.describe(IMAGES))


@pytest.mark.parametrize("descriptor", [HOG, BRIEF, THUMBNAIL], ids=lambda d: d.name)
def test_the_nearest_frames_are_those_of_all_distances_but_the_excluded(descriptor):
    known = map_of(descriptor, IMAGES)
    queries = known.describe(np.roll(IMAGES, 8, axis=2))
    apart = descriptor.pairwise(queries, known.description)
    np.testing.assert_allclose(frame_distances(known, queries), apart, atol=1e-5)
    excluded = np.eye(9, dtype=bool) | (np.arange(9) == 4)
    for left_out, k in ((None, 100), (excluded, 5)):
        found = match(known, queries, k, excluded=left_out)
        left = apart if left_out is None else np.where(left_out, np.inf, apart)
        np.testing.assert_array_equal(found.indices, np.argsort(left, axis=1, kind="stable")[:, :k])
        np.testing.assert_allclose(found.distances, np.sort(left, axis=1)[:, :k], atol=1e-5)
    with pytest.raises(DataError, match="8 of 9 queries have fewer than 8 map frames that they may find"):
        match(known, queries, 8, excluded=excluded)
    with pytest.raises(DataError, match=r"true or false of shape \(9, 9\), got bool \(9, 8\)"):
        match(known, queries, 1, excluded=excluded[:, 1:])


def test_what_turns_as_a_whole_is_kept_once(tmp_path):
    wisurf = analytic.descriptor("wisurf", rows=2, windows=16)
    known = map_of(wisurf, IMAGES)
    known.save(tmp_path / "map.npz")
    loaded = VisualMap.load(tmp_path / "map.npz")
    assert (tmp_path / "map.npz").stat().st_size < 1.2 * known.descriptors.nbytes + 20_000
    assert np.array_equal(loaded.orientation, wisurf.describe(IMAGES).orientation)


@pytest.mark.parametrize("orientation", [np.zeros((2, 3, 4)), np.zeros((9, 3)), np.full((9, 2, 2), np.nan)])
def test_orientation_parts_that_do_not_fit_are_an_error(orientation):
    with pytest.raises(ValueError, match="a map's orientation parts"):
        VisualMap(np.zeros((9, 4)), placed(np.zeros((9, 2))), orientation=orientation)
