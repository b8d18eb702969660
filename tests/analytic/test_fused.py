"""Several descriptors as one: distances add, headings come from one part."""

import numpy as np
import pytest

import analytic
from analytic import AnalyticError, Fused
from tests.drawn import ROOMS, draw_panorama

PARTS = ("hog", "hsv", "thumbnail")


@pytest.fixture(scope="module")
def panoramas():
    drawn = [draw_panorama(0.3 * number, -0.2, 0.4, ROOMS[number % 3], size=(32, 128)) for number in range(6)]
    return np.stack(drawn).transpose(0, 3, 1, 2)


def fused(names=PARTS, **numbers):
    return Fused({name: analytic.descriptor(name) for name in names}, **numbers)


def test_squared_distances_are_the_weighted_sum_of_those_of_the_parts(panoramas):
    weights, typical = {"hog": 1, "hsv": 2, "thumbnail": 1}, {"hog": 0.5, "hsv": 3.0, "thumbnail": 2.0}
    by = fused(weights=weights, typical=typical)
    seen = by.describe(panoramas)
    expected = np.zeros((6, 6))
    for name, part in by.parts.items():
        alone = part.describe(panoramas)
        if name == "hsv":
            squares = part.pairwise(alone, alone, "euclidean") ** 2
        else:
            squares = 2 * part.pairwise(alone, alone)  # 1 - correlation
        expected += weights[name] / 4 * squares * (typical["hog"] / typical[name]) ** 2
    # float32 descriptors of length about 1: squares are right to some 1e-6
    np.testing.assert_allclose(by.pairwise(seen, seen) ** 2, expected, atol=1e-5)


def test_one_image_is_described_as_in_a_batch_and_a_turn_changes_only_the_heading(panoramas):
    by = fused(
        ("thumbnail", "hog", "hsv"), weights={"thumbnail": 0, "hog": 1, "hsv": 1}, typical=dict.fromkeys(PARTS, 1.0)
    )
    known, turned = by.describe(panoramas), by.describe(np.roll(panoramas, 32, axis=3))
    np.testing.assert_array_equal(by.describe(panoramas[2]).position[0], known.position[2])
    np.testing.assert_allclose(turned.position, known.position, atol=1e-5)  # sums in another order, in float32
    np.testing.assert_allclose(by.relative_heading(turned, known), np.pi / 2)
    np.testing.assert_array_equal(known.orientation, by.parts["hog"].describe(panoramas).orientation)


def test_parts_without_headings_give_none(panoramas):
    parts = {"small": analytic.descriptor("thumbnail", rows=4), "large": analytic.descriptor("thumbnail")}
    by = Fused(parts)
    assert not by.tells_heading
    assert not by.compares
    seen = by.describe(panoramas)
    with pytest.raises(AnalyticError, match="no orientation part"):
        by.align(seen, seen)


def test_measured_lengths_split_what_was_joined(panoramas):
    by = fused().measured(panoramas[:1])
    seen = by.describe(panoramas).position
    blocks = by.split(seen)
    assert {name: block.shape[1] for name, block in blocks.items()} == by.widths
    np.testing.assert_array_equal(by.joined(blocks), seen)


@pytest.mark.parametrize(
    ("names", "numbers", "says"),
    [
        (["hog"], {}, "a list of two descriptors or more"),
        ([], {}, "a list of two descriptors or more"),
        (["hog", "briefgist"], {}, "briefgist is compared after turning"),
        (["hog", "hsv"], {"weights": {"hog": 1}}, "weights of a fused descriptor are a number for each of hog, hsv"),
        (["hog", "hsv"], {"weights": {"hog": 1, "hsv": -1}}, "not negative"),
        (["hog", "hsv"], {"weights": {"hog": 0, "hsv": 0}}, "not all 0"),
        (["hog", "hsv"], {"typical": {"hog": 0, "hsv": 1}}, "typical of a fused descriptor"),
        (["hog", "hsv"], {"weights": "hog"}, "weights of a fused descriptor"),
    ],
)
def test_what_cannot_be_fused(names, numbers, says):
    with pytest.raises(AnalyticError, match=says):
        fused(names, **numbers)


@pytest.mark.parametrize(
    ("parts", "says"),
    [
        (["hog", "hsv"], "descriptors by name"),
        ({"hog": "hog", "hsv": "hsv"}, "descriptors by name"),
        ({"both": fused(("hog", "hsv")), "thumbnail": analytic.descriptor("thumbnail")}, "both is fused itself"),
    ],
)
def test_parts_that_are_no_single_descriptors(parts, says):
    with pytest.raises(AnalyticError, match=says):
        Fused(parts)


def test_numbers_of_numpy_are_numbers():
    by = fused(
        ("hog", "hsv"), weights={"hog": np.float32(1), "hsv": np.int64(3)}, typical={"hog": 1, "hsv": np.float32(2)}
    )
    assert by.weights == {"hog": 0.25, "hsv": 0.75}
    assert [type(one) for one in by.identity["typical"].values()] == [int, float]
