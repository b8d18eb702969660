"""Which frames of a drive show something new, with a comparison that knows the true poses."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from analytic import Description
from analytic.descriptors.thumbnail import Thumbnail
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.data.moves import relative
from siamloc.errors import ConfigError
from siamloc.maps import key_frames


class TrueComparison(Thumbnail):
    """Compares frames by their true poses; the colour of a panorama is the number of its frame.

    As the shipped network does, it denies that pictures of nearly the same pose show one place.
    """

    compares = tells_heading = True

    def __init__(self, poses):
        super().__init__()
        self.poses = np.array(poses)

    def describe(self, batch):
        parts = np.ones((len(batch), 8, 2), dtype=np.float16)
        parts[:, 0, 0] = 2 + batch[:, 0, 0, 0]
        return Description(np.ones((len(batch), 3)), parts)

    def compare(self, queries, known):
        second, first = (np.rint(one[:, 0, 0] / one[:, 1, 0]).astype(int) - 2 for one in (queries, known))
        pose = relative(self.poses, first, second)
        near = abs(np.hypot(pose[:, 0], pose[:, 1]) - 0.8) < 0.75
        return pose, np.tile(np.eye(3), (len(pose), 1, 1)), np.where(near, 5.0, -5.0)


@pytest.fixture
def chosen(tmp_path):
    """Return a function that chooses the key frames of a drive with these positions along a line."""

    def run(along, sequence=None, **columns):
        paths = [str(tmp_path / f"{number}.png") for number in range(len(along))]
        for number, path in enumerate(paths):
            cv2.imwrite(path, np.full((8, 32, 3), number, np.uint8))
        frames = FrameTable(path=paths, sequence=sequence or ["walk"] * len(paths), **columns)
        images = PanoramaLibrary(frames, tmp_path / "cache", image_size=(8, 32))
        poses = np.column_stack([along, np.zeros((len(along), 2))])
        found = key_frames(TrueComparison(poses), images, frames, spacing=0.3, progress=False)
        return [paths.index(path) for path in found.path.tolist()], found

    return run


def test_a_frame_is_kept_once_the_robot_has_moved_far_enough(chosen):
    assert chosen(np.arange(10) * 0.1001)[0] == [0, 3, 6, 9]


def test_a_robot_that_stands_still_gives_no_more_frames_however_long(chosen):
    along = np.concatenate([np.zeros(40), [0.35], np.full(40, 0.4)])
    assert chosen(along)[0] == [0, 40]


def test_another_place_is_kept(chosen):
    assert chosen([0, 0.1, 9.0, 9.1])[0] == [0, 2]


def test_odometry_counts_where_there_is_any(chosen):
    wheels = np.array([0.0, 0.2, 0.4, np.nan, 0.6, 0.8])
    kept, found = chosen(np.zeros(6), odom_x=wheels, odom_y=np.zeros(6), odom_theta=np.zeros(6))
    assert kept == [0, 2, 5]
    np.testing.assert_array_equal(found.odom_x, wheels[kept])
    assert not found.has_position.any()


def test_each_drive_begins_with_a_key_frame(chosen):
    assert chosen(np.zeros(4), ["a", "b", "a", "b"])[0] == [0, 1]


def test_a_descriptor_that_does_not_compare_is_refused(chosen, tmp_path):
    _, found = chosen([0.0, 1.0])
    images = PanoramaLibrary(found, tmp_path / "cache", image_size=(8, 32))
    with pytest.raises(ConfigError, match="needs a network that compares panoramas"):
        key_frames("hog", images, found)
