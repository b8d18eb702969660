"""Maps of a map server: which squares are occupied, where they lie, and what is refused."""

import math

import cv2
import numpy as np
import pytest

from siamloc.data import OccupancyMap, read_occupancy
from siamloc.errors import DataError

KEYS = {
    **{"image": "map.pgm", "resolution": "0.5", "origin": "[-1.0, 2.0, 0.0]", "negate": "0"},
    **{"occupied_thresh": "0.65", "free_thresh": "0.196"},
}
VALUES = (0, 80, 205, 254)  # 1, 0.686, 0.196 (as unknown squares are saved) and 0.004 dark


@pytest.fixture
def written(tmp_path):
    def write(values=VALUES, **keys):
        cv2.imwrite(str(tmp_path / "map.pgm"), np.uint8([values]))
        given = {key: value for key, value in {**KEYS, **keys}.items() if value is not None}
        (tmp_path / "map.yaml").write_text("\n".join(f"{key}: {value}" for key, value in given.items()))
        return tmp_path / "map.yaml"

    return write


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({}, [1, 1, np.nan, 0]),
        ({"mode": "trinary", "negate": "1"}, [0, np.nan, 1, 1]),
        ({"resolution": "5e-1", "negate": "true"}, [0, np.nan, 1, 1]),
        ({"mode": "scale", "occupied_thresh": "0.9", "free_thresh": "0.1"}, [1, 0.733, 0.12, 0]),
    ],
)
def test_squares_are_occupied_free_or_unknown(written, keys, expected):
    found = read_occupancy(written(**keys))
    np.testing.assert_allclose(found.occupancy, [expected], atol=0.001)
    assert (found.size, found.origin) == ((2.0, 0.5), (-1.0, 2.0, 0.0))


def test_raw_values_are_percentages(written):
    found = read_occupancy(written((0, 50, 100, 255), mode="raw"))
    np.testing.assert_allclose(found.occupancy, [[0, 0.5, 1, np.nan]])


def test_the_picture_shows_what_is_occupied_and_nothing_of_what_is_unknown(written):
    found = read_occupancy(written())
    cover = found.picture()[0, :, 3].tolist()
    assert cover[0] == cover[1] > cover[3] > cover[2] == 0
    decoded = cv2.imdecode(np.frombuffer(found.png(), np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(decoded, cv2.cvtColor(found.picture(), cv2.COLOR_RGBA2BGRA))
    assert found.placed() == {"x": -1.0, "y": 2.0, "heading": 0.0, "width": 2.0, "height": 0.5}


def test_positions_on_the_map_are_taken_and_others_refused():
    turned = OccupancyMap(np.zeros((2, 8), np.float32), 0.5, (1.0, 1.0, math.pi / 2))  # x 0 to 1, y 1 to 5
    turned.check(np.array([[0.5, 4.5], [9.0, 9.0], [np.nan, np.nan]]))
    for wrong in ([[1.5, 1.5]], [[0.5, 5.5]], [[4.0, 1.5]]):
        with pytest.raises(DataError, match=r"no position lies on the occupancy map: x is .* is it of this building"):
            turned.check(np.array(wrong))
    with pytest.raises(DataError, match="the positions are in frames: leave plan out"):
        turned.check(np.array([[0.5, 4.5]]), "frames")


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"image": None, "negate": None}, "image, negate missing"),
        ({"image": "none.pgm"}, "none.pgm, the picture of .*, cannot be read: the file does not exist"),
        ({"resolution": "0"}, "resolution is above 0"),
        ({"resolution": "coarse"}, "resolution is a number, got 'coarse'"),
        ({"origin": "[0, 0]"}, "origin is x, y and heading, three numbers"),
        ({"origin": "[0, 0, x]"}, "origin is a number, got 'x'"),
        ({"mode": "binary"}, "mode one of trinary, scale, raw, got 0.5 and 'binary'"),
        ({"origin": "[0"}, "is not YAML"),
    ],
)
def test_a_wrong_file_is_refused_in_one_sentence(written, keys, reason):
    with pytest.raises(DataError, match=reason):
        read_occupancy(written(**keys))


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(DataError, match=r"^the map \S*map\.yaml cannot be read: No such file"):
        read_occupancy(tmp_path / "map.yaml")


def test_a_plan_shows_what_the_map_knows_around_the_frames():
    occupancy = np.full((100, 100), np.nan, np.float32)  # 10 x 10 m from (-5, -5)
    occupancy[20:60, 10:100] = 0.0  # y from -1 to 3, x from -4 to 5
    known = OccupancyMap(occupancy, 0.1, (-5.0, -5.0, 0.0))
    xy = np.array([[-2.0, 0.0], [0.0, 1.0], [np.nan, np.nan]])
    np.testing.assert_allclose(known.around(xy), [[-4, -1], [3, 3]], atol=1e-6)
    empty = OccupancyMap(np.full((2, 2), np.nan, np.float32), 0.1, (0.0, 0.0, 0.0))
    np.testing.assert_array_equal(empty.around(xy), [[-2, 0], [0, 1]])
