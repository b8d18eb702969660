"""The messages of the ROS 2 example, without ROS: classes with the fields of its messages stand in for them."""

import importlib.util
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from siamloc.runtime import Candidate, Location

PATH = Path(__file__).parents[1] / "examples" / "ros2" / "localizer_node.py"
spec = importlib.util.spec_from_file_location("localizer_node", PATH)
node = importlib.util.module_from_spec(spec)
spec.loader.exec_module(node)


def image(encoding, depth, padding=0):
    pixels = np.random.default_rng(0).integers(0, 256, (3, 4, depth), dtype=np.uint8)
    rows = np.concatenate([pixels.reshape(3, -1), np.full((3, padding), 7, np.uint8)], axis=1)
    message = SimpleNamespace(height=3, width=4, step=rows.shape[1], encoding=encoding, data=rows.tobytes())
    return message, pixels


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize(("encoding", "depth"), [("rgb8", 3), ("bgr8", 3), ("rgba8", 4), ("bgra8", 4), ("mono8", 1)])
def test_images_of_every_encoding_are_rgb(encoding, depth, padding):
    message, pixels = image(encoding, depth, padding)
    found = node.pixels(message)
    assert (found.shape, found.dtype, found.flags.c_contiguous) == ((3, 4, 3), np.uint8, True)
    first = pixels[..., :3] if depth > 1 else np.repeat(pixels, 3, axis=2)
    np.testing.assert_array_equal(found, first[..., ::-1] if encoding.startswith("bgr") else first)


def test_other_encodings_are_refused():
    with pytest.raises(ValueError, match="got bayer_rggb8"):
        node.pixels(image("bayer_rggb8", 1)[0])


def message():
    position, orientation = SimpleNamespace(x=0.0, y=0.0, z=0.0), SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    return SimpleNamespace(pose=SimpleNamespace(pose=SimpleNamespace(position=position, orientation=orientation)))


def location(**known):
    nearest = (Candidate("a.png", 1.0, 2.0, "", 0.1),)
    unknown = {"theta": math.nan, "room": "", "error_m": math.nan, "lost": None, "candidates": nearest, "ms": 1.0}
    return Location(**{"x": 1.0, "y": 2.0, **unknown, **known})


def test_a_pose_with_its_covariance():
    filled = node.fill(message(), location(theta=math.pi / 2, covariance=((0.04, 0.01), (0.01, 0.09)))).pose
    assert (filled.pose.position.x, filled.pose.position.y, filled.pose.position.z) == (1.0, 2.0, 0.0)
    turn = filled.pose.orientation
    assert 2 * math.atan2(turn.z, turn.w) == pytest.approx(math.pi / 2)
    spread = np.array(filled.covariance).reshape(6, 6)
    assert spread[:2, :2].tolist() == [[0.04, 0.01], [0.01, 0.09]]
    assert spread[5, 5] < 0.1
    assert (np.diag(spread)[2:5] == node.UNKNOWN).all()
    np.testing.assert_array_equal(spread, spread.T)


def test_what_is_not_known_has_no_weight():
    spread = np.array(node.fill(message(), location()).pose.covariance).reshape(6, 6)
    np.testing.assert_array_equal(spread, np.eye(6) * node.UNKNOWN)
    spread = np.array(node.fill(message(), location(error_m=0.2)).pose.covariance).reshape(6, 6)
    assert spread[0, 0] == spread[1, 1] == pytest.approx(0.02)
