import numpy as np

from analytic import descriptor


def test_a_bit_tells_whether_a_window_is_brighter_than_the_one_before():
    picture = np.zeros((4, 6), dtype=np.uint8)
    picture[:2] = [[10, 30, 20, 20, 50, 10], [10, 30, 40, 0, 10, 50]]  # means 20, 20, 30
    picture[2:] = [[90, 90, 80, 80, 70, 70], [90, 90, 80, 80, 70, 70]]
    made = descriptor("briefgist", rows=2, columns=3)
    found = made.describe(picture)
    assert found.position.tolist() == [[0, 0, 1, 1, 0, 0]]
    assert found.orientation[0].tolist() == [[0, 1], [0, 0], [1, 0]]
    assert found.position.dtype == found.orientation.dtype == np.float32
    ordinary = descriptor("briefgist", rows=2, columns=3, circular=False).describe(picture)
    assert ordinary.position.tolist() == [[0, 0, 1, 0, 0, 0]]
