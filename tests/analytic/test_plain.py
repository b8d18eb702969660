"""Descriptors give the same results without torch as with it."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import analytic
from analytic.descriptors.radon_transform import radon_transform
from analytic.filters import homomorphic
from tests.drawn import draw_panorama, draw_sequence

NAMES = tuple(analytic.DESCRIPTORS)
PANORAMAS = np.stack(
    [
        draw_panorama(pose["local_x"], pose["y"], pose["theta"], pose["room"], "cloudy", size=(32, 128))[..., ::-1]
        for pose in draw_sequence(0, 4)
    ]
).transpose(0, 3, 1, 2)
SMALL = {
    "gist": {"blocks": 8, "orientations": 8},
    "fs": {"turns": 128, "orientation_columns": 16},
    "wisurf": {"windows": 128},
    "briefgist": {"rows": 16},
}
# Sums in another order differ in the last digits of float32. Where a bin or a sign is decided by them, one pixel
# counts elsewhere: that happens after the logarithm and exponential of the filter, which round in both forms.
CLOSE, FILTERED = 1e-5, 2e-3


def both(name, **options):
    options = {**SMALL.get(name, {}), **options}
    return analytic.descriptor(name, **options), analytic.descriptor(name, device="numpy", **options)


def apart(one, other):
    """The largest distance of two parts, relative to the length of the first."""
    one, other = (np.asarray(part).reshape(len(part), -1) for part in (one, other))
    return float((np.linalg.norm(one - other, axis=1) / np.linalg.norm(one, axis=1)).max())


@pytest.mark.parametrize("homomorphic", [False, True])
@pytest.mark.parametrize("circular", [True, False])
@pytest.mark.parametrize("name", NAMES)
def test_both_forms_describe_alike(name, circular, homomorphic):
    usual, plain = both(name, circular=circular, homomorphic=homomorphic)
    expected, found = usual.describe(PANORAMAS), plain.describe(PANORAMAS)
    assert found.identity == expected.identity
    assert found.position.dtype == expected.position.dtype
    assert (found.orientation.dtype, found.orientation.shape) == (
        expected.orientation.dtype,
        expected.orientation.shape,
    )
    assert apart(expected.position, found.position) <= (FILTERED if homomorphic else CLOSE)
    # Without the wrap the phases of a mirrored row are signs, which rounding decides where a coefficient is nothing.
    if circular or name != "radon_fourier":
        assert apart(expected.orientation, found.orientation) <= (FILTERED if homomorphic else CLOSE)
    np.testing.assert_array_equal(
        usual.pairwise(found, expected).argmin(axis=1), usual.pairwise(expected, expected).argmin(axis=1)
    )
    if circular:
        turned = np.roll(PANORAMAS, 64, axis=3)
        np.testing.assert_array_equal(
            plain.relative_heading(plain.describe(turned), found),
            usual.relative_heading(usual.describe(turned), expected),
        )


@pytest.mark.parametrize("images", ["one", "grey", "floating", "float64"])
@pytest.mark.parametrize("name", NAMES)
def test_both_take_the_same_images(name, images):
    given = {
        "one": PANORAMAS[0],
        "grey": PANORAMAS[:, 1],
        "floating": PANORAMAS.astype(np.float32) / 255,
        "float64": PANORAMAS[::-1] / 255,
    }[images]
    usual, plain = both(name)
    assert apart(usual.describe(given).position, plain.describe(given).position) <= FILTERED


@pytest.mark.parametrize(
    ("name", "options", "size"),
    [
        ("hog", {"rows": 4, "bins": 9, "orientation_bins": 7, "window": 5, "step": 1, "whitened": False}, (20, 50)),
        ("hog", {"rows": 1, "window": 1}, (2, 4)),
        ("fs", {"rows": 3, "columns": 5, "orientation_rows": 4, "orientation_columns": 7, "turns": 36}, (12, 36)),
        ("fs", {"heading": "phase_product", "orientation_columns": 8, "turns": 64}, (16, 64)),
        ("gist", {"blocks": 5, "orientations": 3, "orientation_levels": 2, "normalized": False}, (15, 38)),
        ("gist", {"blocks": 2, "orientations": 4, "orientation_filters": 5, "window": 3, "step": 1}, (10, 31)),
        ("wisurf", {"rows": 1, "windows": 20}, (20, 60)),
        ("briefgist", {"rows": 5, "columns": 7}, (15, 49)),
        ("radon_fourier", {"step": 4.5, "size": 32, "lines": 4, "orientation_lines": 8}, (16, 80)),
        ("radon_fourier", {"source": "omnidirectional", "size": 64}, (48, 48)),
        ("radon_poc", {"step": 9, "size": 24}, (11, 40)),
        ("radon_poc", {"source": "omnidirectional", "size": 32}, (33, 33)),
        ("hsv", {"rows": 2, "hues": 7, "saturations": 3, "values": 5, "window": 9, "step": 3}, (10, 33)),
    ],
)
def test_other_parameters_and_sizes(name, options, size):
    images = np.random.default_rng(0).integers(0, 256, (3, 3, *size), dtype=np.uint8)
    usual, plain = (analytic.descriptor(name, device=device, **options) for device in ("cpu", "numpy"))
    expected, found = usual.describe(images), plain.describe(images)
    assert apart(expected.position, found.position) <= CLOSE
    assert apart(expected.orientation, found.orientation) <= CLOSE


@pytest.mark.parametrize("name", NAMES)
def test_a_black_image_is_described(name):
    black = np.zeros((1, *PANORAMAS.shape[1:]), dtype=np.uint8)
    usual, plain = both(name)
    for one, other in zip(vars(usual.describe(black)).values(), vars(plain.describe(black)).values(), strict=True):
        if isinstance(one, np.ndarray):
            np.testing.assert_allclose(other, one, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("images", "says"),
    [
        (np.full((16, 64), 1.5), "values in \\[0, 1\\], got values between 1.5 and 1.5"),
        (np.full((16, 64), np.nan), "got values not finite"),
        (np.zeros((16, 64), dtype=np.int64), "must be uint8 or floating point"),
        (np.zeros((16, 1), dtype=np.uint8), "at least 2 columns"),
        (np.zeros((5, 64), dtype=np.uint8), "do not divide the image's height"),
        (np.zeros((16, 64, 3), dtype=np.uint8), "channels first"),
    ],
)
def test_both_refuse_alike(images, says):
    for descriptor in both("hog"):
        with pytest.raises(analytic.AnalyticError, match=says):
            descriptor.describe(images)


def test_the_transform_and_the_filter_without_torch():
    grey = PANORAMAS[:, 0]
    np.testing.assert_allclose(
        radon_transform(grey, size=32, device="numpy"), radon_transform(grey, size=32), rtol=1e-5, atol=1e-5
    )
    assert homomorphic(grey).shape == grey.shape


def test_a_descriptor_of_ones_own_says_that_it_needs_torch():
    class Own(type(analytic.descriptor("hog"))):
        name = "own"
        _describe_plainly = analytic.ImageDescriptor._describe_plainly

    with pytest.raises(analytic.AnalyticError, match="own computes with torch alone"):
        Own(device="numpy").describe(PANORAMAS)


def test_a_robot_without_torch_describes_compares_and_finds_headings():
    code = """
import sys
for name in ("torch", "scipy", "sklearn"):
    sys.modules[name] = None
import numpy as np, analytic
images = np.random.default_rng(0).integers(0, 256, (2, 3, 32, 128), dtype=np.uint8)
small = {"fs": {"turns": 128, "orientation_columns": 16}, "wisurf": {"windows": 128}, "briefgist": {"rows": 16},
         "gist": {"orientations": 8}}
for name in analytic.DESCRIPTORS:
    one = analytic.descriptor(name, **small.get(name, {}))
    known, turned = one.describe(images), one.describe(np.roll(images, 32, axis=3))
    found = one.localize(turned, known)
    assert found.index.tolist() == [0, 1], name
    assert np.allclose(found.heading, np.pi / 2, atol=0.05), name
from analytic.distances import minkowski
near = minkowski([[0, 0], [1, 1]], [[3, 4]], p=1).tolist(), minkowski([[0, 0]], [[3, 4], [0, 0]]).tolist()
assert near == ([[7.0], [5.0]], [[5.0, 0.0]])
"""
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


def test_with_numpy_torch_is_not_loaded():
    code = (
        "import sys, numpy as np, analytic\n"
        "analytic.descriptor('hog', device='numpy').describe(np.zeros((16, 64), np.uint8))\n"
        "assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
