import numpy as np
import pytest

from siamloc.data import Mounting, azimuth_column, column_azimuth
from siamloc.errors import ConfigError

WIDTH = 72


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("yaw", [0, 5, 90, -90, 180, 355])
def test_what_is_ahead_comes_to_the_middle(yaw, mirrored):
    ahead = round(float(azimuth_column(-np.radians(yaw + 2.5), WIDTH)))  # 2.5 degrees: half a column
    panorama = np.zeros((3, 4, WIDTH), np.uint8)
    panorama[..., ahead] = 255
    stored = panorama[..., ::-1] if mirrored else panorama
    straight = Mounting(yaw, mirrored).straight(stored)
    assert straight[0, 0].argmax() == WIDTH // 2
    assert straight.shape == panorama.shape
    assert straight.flags.c_contiguous


def test_left_is_left_of_the_middle_again():
    azimuth = column_azimuth(WIDTH)
    assert np.array_equal(Mounting(mirrored=True).straight(-azimuth), azimuth)
    assert np.array_equal(Mounting().straight(azimuth), azimuth)


def test_the_camera_s_offset_turns_with_the_robot():
    found = Mounting(ahead=0.3, left=0.1).offset(np.array([0, np.pi / 2]))
    assert np.allclose(found, [[0.3, 0.1], [-0.1, 0.3]])


def test_wrong_values_are_refused():
    with pytest.raises(ConfigError, match=r"mounting\.yaw must be a number, got 'left'"):
        Mounting.of({"yaw": "left"})
