"""The descriptor file of RTAB-Map, called as RTAB-Map calls it."""

import runpy
from pathlib import Path

import cv2
import numpy as np
import pytest

import siamloc
from siamloc import maps, runtime

FILE = Path(__file__).parents[1] / "examples" / "rtabmap" / "siamloc_descriptor.py"


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    example = siamloc.data.example()
    folder = tmp_path_factory.mktemp("rtabmap")
    images = siamloc.data.PanoramaLibrary(example.frames, folder / "cache", image_size=(32, 64))
    known = maps.build("hog", images, example.frames.select(sequence="monday"), progress=False)
    return runtime.export("hog", known, folder / "robot").path, known


@pytest.fixture
def module(world, monkeypatch):
    monkeypatch.setenv("SIAMLOC_BUNDLE", str(world[0]))
    return runpy.run_path(str(FILE))


def given(pixels):
    """Return pixels as RTAB-Map hands them over: signed bytes, with an axis for the channels."""
    return pixels.reshape(*pixels.shape[:2], -1).view(np.int8)


def test_an_image_is_described_as_in_the_map(world, module):
    known = world[1]
    module["init"](known.width)
    for row, path in enumerate(known.frames.path[:3].tolist()):
        found = module["extract"](given(cv2.imread(path)))
        assert (found.shape, found.dtype, found.flags.c_contiguous) == ((1, known.width), np.float32, True)
        expected = known.description.position[row].astype(np.float64)
        # the map may hold rounded descriptors
        np.testing.assert_allclose(found[0], expected / np.linalg.norm(expected), atol=2e-3)


def test_a_grey_image_has_one_channel(world, module):
    module["init"](world[1].width)
    grey = cv2.imread(str(world[1].frames.path[0]), cv2.IMREAD_GRAYSCALE)
    three = np.repeat(grey[..., None], 3, axis=2)
    np.testing.assert_array_equal(module["extract"](given(grey)), module["extract"](given(three)))


def test_what_is_missing_is_said_in_one_sentence(world, module, monkeypatch):
    with pytest.raises(ValueError, match=r"call it first"):
        module["extract"](np.zeros((32, 64, 3), np.int8))
    with pytest.raises(ValueError, match=rf"describes images by {world[1].width} numbers: set PyDescriptor/Dim"):
        module["init"](128)
    monkeypatch.delenv("SIAMLOC_BUNDLE")
    with pytest.raises(ValueError, match="set SIAMLOC_BUNDLE to its folder"):
        module["init"](world[1].width)
