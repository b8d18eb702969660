import numpy as np
import pytest

from analytic.description import spectrum
from analytic.descriptors.base import Description
from analytic.mapper.frames import BLOCK, Gallery, spread, thin
from tests.analytic.mapper.world import World, corridor_drive, rows

WORLD = World()
FRAMES = rows(WORLD.at(corridor_drive(BLOCK + 20)))


def test_blocks_answer_as_one_description_would():
    gallery = Gallery.of(range(len(FRAMES)), FRAMES)
    assert [len(block) for block in gallery.blocks] == [BLOCK, 20]
    query = WORLD.at([[1, 1, 1]])
    whole = WORLD.align(query, Description.concatenate(FRAMES)).distance[0]
    parts = np.concatenate([WORLD.align(query, block).distance[0] for block in gallery.blocks])
    np.testing.assert_allclose(parts, whole, rtol=1e-4, atol=1e-4)
    for row in (0, BLOCK - 1, BLOCK, BLOCK + 19):
        assert np.array_equal(gallery.row(row).position, FRAMES[row].position)


def test_a_longer_gallery_leaves_the_shorter_as_it_was_even_if_it_is_given_up():
    short = Gallery.of(range(5), FRAMES[:5])
    before = WORLD.align(FRAMES[9], short.blocks[0]).distance
    longer = short.add(5, FRAMES[5])
    WORLD.align(FRAMES[9], longer.blocks[0])
    again = short.add(5, FRAMES[6])
    assert np.array_equal(WORLD.align(FRAMES[9], short.blocks[0]).distance, before)
    expected = Gallery.of(range(6), [*FRAMES[:5], FRAMES[6]])
    for query in FRAMES[:9]:
        found = WORLD.align(query, again.blocks[0]).distance
        assert np.array_equal(found, WORLD.align(query, expected.blocks[0]).distance)


def test_frames_can_be_left_out():
    gallery = Gallery.of(range(10), FRAMES[:10])
    assert gallery.without([3, 99]).frames.tolist() == [0, 1, 2, 4, 5, 6, 7, 8, 9]
    assert gallery.without([99]) is gallery


def test_a_bounded_gallery_keeps_frames_apart():
    points = [Description(np.array([[x]], dtype=np.float32)) for x in [0, 1, 1.5, 1.6, 10, 1.7, 20, 0.2]]
    gallery = Gallery.of([], [])
    for frame, point in enumerate(points):
        gallery = spread(gallery, frame, point, 4)
    assert gallery.frames.tolist() == [0, 1, 4, 6]
    whole = Gallery.of(range(8), points)
    assert thin(whole, None) is whole
    thinned = thin(whole, 4)
    assert len(thinned) == 4
    assert {4, 6} < set(thinned.frames.tolist())


@pytest.mark.parametrize("limit", [None, 20, 500])
def test_blocks_have_no_more_room_than_they_may_need(limit):
    gallery = Gallery.of([], [], limit)
    for frame, description in enumerate(FRAMES):
        gallery = gallery.add(frame, description)
        assert all(gallery.row(row).position[0, 0] == FRAMES[row].position[0, 0] for row in (0, frame // 2, frame))
        if frame % 16 == 7:
            assert np.array_equal(gallery.blocks[-1].spectrum, spectrum(gallery.blocks[-1].orientation))
    size = 20 if limit == 20 else BLOCK
    assert [len(block) for block in gallery.blocks[:-1]] == [size] * ((len(FRAMES) - 1) // size)
    rooms = [len(block.position.base) for block in gallery.blocks]
    assert rooms == ([20] * 7 + [16] if limit == 20 else [BLOCK, 32])


def test_kept_rows_keep_their_spectra(monkeypatch):
    gallery = Gallery.of(range(40), FRAMES[:40])
    expected = gallery.blocks[0].spectrum.copy()
    rows_kept = [7, 3, *range(12, 40)]
    monkeypatch.setattr("analytic.mapper.frames.spectrum", None)
    kept = gallery.keep(rows_kept)
    assert kept.frames.tolist() == rows_kept
    assert np.array_equal(kept.blocks[0].spectrum, expected[:, rows_kept])
    monkeypatch.undo()
    longer = kept.add(40, FRAMES[40])
    whole = Gallery.of(range(31), [FRAMES[row] for row in [*rows_kept, 40]])
    assert np.array_equal(longer.blocks[0].spectrum, whole.blocks[0].spectrum)
