"""The heading part of a map: kept small, written and read, and comparable with an analytic descriptor's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import analytic
from siamloc.errors import DataError
from siamloc.maps import VisualMap
from siamloc.maps.heading import described, halved
from tests.drawn import draw_panorama
from tests.siamloc.maps.conftest import placed

SIZE = (32, 128)
THUMBNAIL = analytic.descriptor("thumbnail")
SMALL = {
    "hog": {},
    "fs": {"turns": 128, "orientation_columns": 32},
    "gist": {"orientations": 16},
    "radon_fourier": {"size": 64},
}


def views(thetas, room: str = "office") -> np.ndarray:
    drawn = [draw_panorama(0.3, -0.2, theta, room, size=SIZE) for theta in thetas]
    return np.stack(drawn)[..., ::-1].transpose(0, 3, 1, 2)


def map_with_headings(thetas, heading) -> VisualMap:
    frames = placed(np.zeros((len(thetas), 2)), theta=np.array(thetas))
    both = described(THUMBNAIL, heading, views(thetas))
    parts = halved(heading, both.orientation)
    return VisualMap(
        both.position, frames, THUMBNAIL.identity, "correlation", orientation=parts, heading=heading.identity
    )


@pytest.mark.parametrize("name", SMALL)
def test_half_precision_gives_the_headings_of_the_descriptor(name: str) -> None:
    heading = analytic.descriptor(name, **SMALL[name])
    thetas = np.linspace(-3, 3, 8)
    seen, known = heading.describe(views(thetas)), map_with_headings(thetas, heading)
    assert known.orientation.nbytes * 2 == seen.orientation.nbytes
    kept = replace(seen, orientation=known.turning(np.arange(8)).orientation)
    assert kept.orientation.dtype == seen.orientation.dtype
    for row in range(8):
        expected = heading.relative_heading(seen, seen.take([row]))
        np.testing.assert_array_equal(known.heading_by.relative_heading(seen, kept.take([row])), expected)


def test_frames_are_scaled_one_by_one_and_to_full_use() -> None:
    hog = analytic.descriptor("hog")
    faint, strong, empty = np.full((8, 2), 1e-20), np.full((8, 2), 7e18), np.zeros((8, 2))
    largest = halved(hog, np.stack([faint, strong, empty]).astype(np.float32)).max(axis=(1, 2))
    assert ((largest[:2] >= 2**13) & (largest[:2] < 2**14)).all()
    assert largest[2] == 0


def test_headings_count_neither_for_the_digest_nor_for_the_describer() -> None:
    known = map_with_headings([0.5, -2.0], analytic.descriptor("hog"))
    bare = replace(known, orientation=None, heading=None)
    assert known.digest == bare.digest
    known.check_descriptor(THUMBNAIL.identity)
    others = [
        replace(bare, descriptors=bare.descriptors + 1),
        replace(bare, frames=replace(bare.frames, x=bare.frames.x + 1)),
        replace(bare, identity={"name": "other"}),
        bare.take(np.array([0])),
    ]
    assert len({bare.digest, *(other.digest for other in others)}) == 5


def test_parts_that_are_no_heading_parts() -> None:
    known, values = map_with_headings([0.0, 1.0], analytic.descriptor("hog")), np.ones((2, 4, 3), dtype=np.float16)
    for bad in (None, values.astype(np.float32), values[0], values[:1], np.ones((2, 4, 3, 3), dtype=np.float16)):
        with pytest.raises(DataError, match=r"must be float16 of shape \(2, K, F\), got"):
            replace(known, orientation=bad)
    with pytest.raises(DataError, match="not finite"):
        replace(known, orientation=values * np.float16("nan"))
    with pytest.raises(DataError, match="the orientation parts of hog hold values that are not finite"):
        halved(analytic.descriptor("hog"), np.full((1, 4, 2), np.inf))
