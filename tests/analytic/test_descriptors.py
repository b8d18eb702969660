"""What every analytic descriptor has to do, however it is computed."""

import pickle
import subprocess
import sys
from dataclasses import dataclass
from math import prod

import cv2
import numpy as np
import pytest
import torch

from analytic import DESCRIPTORS, AnalyticError, Description, descriptor, distance
from analytic.descriptors.base import ImageDescriptor
from analytic.disturb import noise, occlude
from tests.analytic.photographs import photographs

RNG = np.random.default_rng(11)
COLOUR = RNG.integers(0, 256, (4, 3, 32, 128), dtype=np.uint8)
for plane in COLOUR.reshape(-1, 32, 128):  # neighbouring pixels of a picture have much in common
    smooth = cv2.GaussianBlur(np.hstack([plane] * 3), (0, 0), 2)[:, 128:256]
    plane[:] = cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX)

SMALL = {  # parameters that fit the pictures, where the defaults do not
    "fs": {"rows": 4, "columns": 6, "orientation_rows": 8, "orientation_columns": 32, "turns": 128},
    "hog": {"rows": 4, "bins": 8, "window": 16, "step": 2, "orientation_bins": 8},
    "gist": {"blocks": 4, "orientations": 4, "window": 8, "step": 2, "orientation_filters": 4},
    "wisurf": {"rows": 2, "windows": 16},
    "briefgist": {"rows": 4, "columns": 16},
    "radon_fourier": {"step": 11.25, "size": 32, "lines": 4, "orientation_lines": 8},
    "radon_poc": {"step": 11.25, "size": 32},
    "hsv": {"rows": 4, "hues": 8, "saturations": 4, "values": 4, "window": 16, "step": 2},
}
PUBLISHED = {
    "gist": {"orientations": 16},
    "wisurf": {"windows": 128},
    "radon_fourier": {"step": 360 / 256},  # whole columns
    "radon_poc": {"step": 360 / 64},
}


def small(name, **params):
    return descriptor(name, **{**SMALL.get(name, {}), **params})


every = pytest.mark.parametrize("name", DESCRIPTORS)
oriented = pytest.mark.parametrize("name", [name for name in DESCRIPTORS if small(name).oriented])


def columns_per_step(made, width):
    steps = made.resolution(width) * width / (2 * np.pi)
    assert steps == pytest.approx(round(steps))
    assert round(steps) >= 1
    return round(steps)


def apart(one, other):
    """Angles between headings, rad."""
    return np.abs(np.angle(np.exp(1j * (one - other))))


def assert_alike(found, expected, tolerance):
    """The vectors agree within a share of their length."""
    parts = [(found.position, expected.position)]
    if expected.orientation is not None:
        parts.append((found.orientation, expected.orientation))
    for part, wanted in parts:
        scale = np.linalg.norm(wanted.reshape(len(wanted), -1), axis=1) + 1e-12
        difference = np.linalg.norm((part - wanted).reshape(len(wanted), -1), axis=1)
        assert (difference <= tolerance * scale).all()


@every
def test_sizes_are_the_promised_ones(name):
    made = small(name)
    found = made.describe(COLOUR)
    position, orientation = made.sizes(32, 128)
    assert found.position.shape == (4, prod(position))
    assert found.position.dtype == np.float32
    assert np.isfinite(found.position).all()
    if made.oriented:
        assert found.orientation.ndim == 3
        assert found.orientation.shape[0] == 4
        assert prod(found.orientation.shape[1:]) == prod(orientation)
        assert np.isfinite(found.orientation).all()
    else:
        assert (found.orientation, orientation, made.resolution(128)) == (None, (0,), np.inf)


@oriented
def test_a_turn_changes_the_heading_alone(name):
    made = small(name)
    step = columns_per_step(made, 128)
    here = made.describe(COLOUR)
    for turn in (1, 3, 128 // step // 2, 128 // step - 1):
        there = made.describe(np.roll(COLOUR, turn * step, axis=-1))
        if made.aligned:
            before, after = made.pairwise(here, here), made.pairwise(there, here)
            np.testing.assert_allclose(after, before, atol=1e-3 * before.max())
        else:
            moved = made.describe(np.roll(COLOUR, turn, axis=-1))  # also by columns between two steps
            assert_alike(there, Description(here.position, there.orientation), 1e-4)
            assert_alike(moved, Description(here.position, moved.orientation), 1e-4)
        expected = 2 * np.pi * turn * step / 128
        assert apart(made.relative_heading(there, here), expected).max() < 1e-6
        found = made.localize(there, here)
        assert found.index.tolist() == [0, 1, 2, 3]
        assert apart(found.heading, expected).max() < 1e-6


@oriented
@pytest.mark.data
def test_the_heading_survives_bars_and_noise_on_photographs(name):
    pictures = photographs(range(0, 111, 6), (512, 128))
    made = descriptor(name, **PUBLISHED.get(name, {}))
    step = columns_per_step(made, 512)
    here = made.describe(pictures)
    good = []
    for seed in range(3):
        generator = np.random.default_rng(seed)
        turns = generator.integers(0, 512 // step, len(pictures)) * step
        turned = np.stack([np.roll(picture, turn, axis=-1) for picture, turn in zip(pictures, turns, strict=True)])
        there = made.describe(noise(occlude(turned, 0.1, generator, bars=4), 0.005, generator))
        error = apart(made.relative_heading(there, here), 2 * np.pi * turns / 512)
        good.extend(error <= made.resolution(512) * 1.001)
    assert np.mean(good) >= 0.95


@every
def test_a_batch_is_its_images_in_any_order(name):
    made = small(name)
    whole = made.describe(COLOUR)
    singles = Description.concatenate([made.describe(image) for image in COLOUR])
    assert_alike(singles, whole, 1e-5)
    assert_alike(made.describe(COLOUR[[2, 0]]), whole.take([2, 0]), 1e-5)
    many = made.describe(np.concatenate([COLOUR] * 10))
    assert_alike(many.take(slice(36, 40)), whole, 1e-5)


@every
def test_colour_grey_bytes_and_tensors_agree_and_stay_as_they_were(name):
    made, share = small(name), COLOUR.astype(np.float32) / 255
    kept = COLOUR.copy(), share.copy()
    whole = made.describe(COLOUR)
    luma = np.einsum("bchw,c->bhw", share.astype(np.float64), [0.299, 0.587, 0.114])
    greys = () if made.colour else (luma, luma.astype(np.float32))
    for same in (share, share.astype(np.float64), *greys, torch.from_numpy(COLOUR)):
        assert_alike(made.describe(same), whole, 1e-3)
    assert all(map(np.array_equal, (COLOUR, share), kept))
    grey = np.rint(luma * 255).astype(np.uint8)
    assert_alike(made.describe(grey), made.describe(np.repeat(grey[:, None], 3, axis=1)), 1e-3)
    assert_alike(made.describe(grey[0]), made.describe(grey).take([0]), 1e-5)
    planes = np.stack([grey[0]] * 3)
    assert (len(made.describe(planes)), len(made.describe(planes[:, None]))) == (1, 3), "one colour image, or three"


@every
@pytest.mark.parametrize("value", [0, 128, 255, 0.3])
def test_a_constant_picture_has_finite_values(name, value):
    made = small(name)
    image = np.full((32, 128), value, dtype=np.float32 if value == 0.3 else np.uint8)
    flat, picture = made.describe(image), made.describe(COLOUR)
    assert np.isfinite(flat.position).all()
    if name in ("hog", "gist", "wisurf", "briefgist") or (value == 0 and name != "hsv"):
        np.testing.assert_allclose(flat.position, 0, atol=1e-6)  # sums of grey values in float32 have seven digits
    assert flat.orientation is None or np.isfinite(flat.orientation).all()
    for queries, references in ((flat, flat), (flat, picture), (picture, flat)):
        assert np.isfinite(made.pairwise(queries, references)).all()
        if made.oriented:
            alignment = made.align(queries, references)
            assert np.isfinite(alignment.heading).all()
            assert np.isfinite(alignment.distance).all()


@every
def test_the_identity_is_the_name_and_the_parameters_and_makes_the_descriptor_again_as_pickling_does(name):
    made = small(name)
    assert made.identity.items() >= {"name": name, **SMALL.get(name, {})}.items()
    assert made.describe(COLOUR).identity == made.identity
    parameters = {key: value for key, value in made.identity.items() if key != "name"}
    again = pickle.loads(pickle.dumps(made))
    assert {made, again, descriptor(name, **parameters)} == {made}
    assert np.array_equal(again.describe(COLOUR).position, made.describe(COLOUR).position)


@every
def test_descriptions_of_other_parameters_are_not_compared(name):
    made = small(name)
    for other in (small(name, homomorphic=True), small(name, circular=False)):
        for compare in (made.pairwise, made.align, made.relative_heading, made.localize):
            with pytest.raises(AnalyticError, match="made with other parameters"):
                compare(made.describe(COLOUR), other.describe(COLOUR))


@every
def test_an_ordinary_camera_has_no_heading(name):
    made = small(name, circular=False)
    found = made.describe(COLOUR)
    assert np.isfinite(found.position).all()
    assert (np.diag(made.pairwise(found, found)) <= made.pairwise(found, found).min(axis=1) + 1e-6).all()
    with pytest.raises(AnalyticError, match="no relative heading"):
        made.relative_heading(found, found)
    match = made.localize(found, found)
    assert (match.index == made.pairwise(found, found).argmin(axis=1)).all()
    assert np.isnan(match.heading).all()


@pytest.mark.parametrize(
    ("images", "says"),
    [
        (np.full((32, 128), np.nan), "not finite"),
        (np.full((32, 128), np.inf, dtype=np.float32), "not finite"),
        (np.full((32, 128), 1.5), r"values in \[0, 1\], got values between 1.5 and 1.5"),
        (np.zeros((32, 128), dtype=np.int32), "got int32"),
        (np.zeros((32, 1)), "at least 2 columns, got 32 x 1"),
        (np.zeros((2, 5, 32, 128)), r"got \(2, 5, 32, 128\)"),
        (np.zeros((32, 128, 3)), r"channels first, \(3, H, W\), got \(32, 128, 3\)"),
        ([np.zeros((32, 128)), np.zeros((32, 64))], "the same size"),
    ],
    ids=["nan", "infinite", "range", "type", "column", "shape", "channels last", "mixed"],
)
def test_what_is_no_picture_is_refused_in_one_sentence(images, says):
    with pytest.raises(AnalyticError, match=says):
        small("hog").describe(images)


@every
def test_a_parameter_of_another_type_is_refused_before_any_work(name):
    numbers = {key: value for key, value in small(name).identity.items() if type(value) is int}
    for key, value in numbers.items():
        for wrong in (value + 0.0, str(value), None, True, 0, 10**9):
            with pytest.raises(AnalyticError, match=f"{name}.{key} must be .*, got"):
                small(name, **{key: wrong})
        same = small(name, **{key: np.int64(value)})
        assert type(same.identity[key]) is int
        assert same == small(name)
    with pytest.raises(AnalyticError, match=f"{name}.circular must be true or false, got 'no'"):
        small(name, circular="no")
    small(name).describe(COLOUR[0])


@every
def test_no_descriptions_compare_to_nothing(name):
    made = small(name)
    here = made.describe(COLOUR)
    none = here.take(slice(0, 0))
    for queries, references in ((none, here), (here, none), (none, none)):
        shape = (len(queries), len(references))
        assert made.pairwise(queries, references).shape == shape
        if made.oriented:
            assert made.align(queries, references).heading.shape == shape
    assert len(made.localize(none, here).index) == 0
    with pytest.raises(AnalyticError, match="no reference"):
        made.localize(here, none)


def test_a_descriptor_of_ones_own_needs_no_orientation_part():
    @dataclass(frozen=True, kw_only=True)
    class RowMeans(ImageDescriptor):
        name = "row_means"
        oriented = False

        def sizes(self, height, width):
            return (height,), (0,)

        def _check_size(self, height, width):
            pass

        def _describe(self, image):
            return image.mean(axis=1), None

    made = RowMeans()
    found = made.localize(made.describe(np.roll(COLOUR, 5, axis=-1)), made.describe(COLOUR))
    assert found.index.tolist() == [0, 1, 2, 3]
    assert np.isnan(found.heading).all()
    assert not made.tells_heading
    with pytest.raises(AnalyticError, match="no orientation part"):
        made.relative_heading(made.describe(COLOUR), made.describe(COLOUR))


def test_a_descriptor_of_ones_own_with_an_orientation_part_of_some_images_only():
    @dataclass(frozen=True, kw_only=True)
    class Mixed(ImageDescriptor):
        name = "mixed"

        def sizes(self, height, width):
            return (height,), (width, height)

        def _check_size(self, height, width):
            pass

        def _describe(self, image):
            return image.mean(axis=1), image.T if image.mean() > 0.5 else None

    for levels in ((0, 255), (255, 0)):
        with pytest.raises(AnalyticError, match="1 of 2 descriptions have no orientation part: give one for every"):
            Mixed().describe(np.stack([np.full((1, 4, 8), level, np.uint8) for level in levels]))


@pytest.mark.parametrize("name", ["hog", "gist", "wisurf", "thumbnail"])
def test_neither_contrast_nor_an_offset_matters(name):
    made = small(name)
    apart = made.pairwise(made.describe(0.2 + COLOUR / 510), made.describe(COLOUR))
    assert np.diag(apart).max() < 1e-3 * apart.max()


@pytest.mark.parametrize(
    ("name", "params", "says"),
    [
        ("fs", {"turns": 62}, "turns=62 resolves at most 31 frequencies, got orientation_columns=32"),
        ("fs", {"heading": "phase"}, "fs.heading must be correlation or phase_product, got 'phase'"),
        ("fs", {"orientation_rows": 64}, "orientation_rows=64 .* height of 32 pixels: use orientation_rows=32"),
        ("fs", {"columns": 65}, "columns=65 is above the 64 frequencies of 128 columns: use at most columns=64"),
        ("fs", {"turns": 96}, "turns=96 .* 128 columns: use turns=128"),
        ("hog", {"rows": 5}, "hog's rows=5 does not divide the height of 32 pixels: use rows=4 or 8"),
        ("hog", {"step": 5}, "step=5 .* width of 128 pixels: use step=4 or 8"),
        ("hog", {"window": 129}, "window=129 .* 128 columns: use at most 128"),
        ("gist", {"orientation_levels": 3}, "gist.orientation_levels must be 1 or 2, got 3"),
        ("gist", {"orientation_filters": 1}, "normalized=False"),
        ("gist", {"blocks": 5}, "gist's blocks=5 .* use blocks=4 or 8"),
        ("wisurf", {"windows": 1}, "wisurf.windows must be a whole number from 2 to 16,384, got 1"),
        ("wisurf", {"rows": 3}, "an image of 32 pixel rows: use rows=2 or 4, or resize it to .* 12 rows"),
        ("wisurf", {"windows": 10}, "width of 128 pixels: use windows=8 or 16"),
        ("briefgist", {"rows": 5}, "briefgist's rows=5 .* use rows=4 or 8"),
        ("briefgist", {"columns": 7}, "columns=7 .* use columns=4 or 8"),
        ("radon_fourier", {"step": 7}, "radon_fourier.step must be degrees that divide 360, at most 120, .* got 7"),
        ("radon_poc", {"step": float("nan")}, "radon_poc.step must be .*, got nan"),
        ("radon_poc", {"step": 180}, "radon_poc.step must be .*, got 180"),
        ("radon_poc", {"size": 33}, "radon_poc.size must be an even number from 2 to 16,384, got 33"),
        ("radon_fourier", {"lines": 5}, "lines=5 must divide the 16 lines of size=32: use lines=4 or 8"),
        ("radon_poc", {"source": "disc"}, "radon_poc.source must be panorama or omnidirectional, got 'disc'"),
        ("radon_poc", {"source": "omnidirectional"}, "32 x 128 pixels: crop them, or use source='panorama'"),
        ("hsv", {"hues": 4096, "saturations": 4096, "values": 4096}, "numbers, more than 16,777,216: ask for fewer"),
        ("hsv", {"rows": 5}, "hsv's rows=5 .* use rows=4 or 8"),
        ("thumbnail", {"rows": 64}, "32 x 128 pixels are fewer than the thumbnail's 64 x 32: ask for a smaller"),
    ],
)
def test_parameters_that_do_not_fit_are_refused_in_one_sentence(name, params, says):
    with pytest.raises(AnalyticError, match=says):
        small(name, **params).describe(COLOUR)


def test_images_that_no_window_fits():
    with pytest.raises(AnalyticError, match="windows of 32 x 32 are wider than 24 columns: use more rows"):
        descriptor("wisurf", rows=1, windows=12).describe(COLOUR[..., :24])
    with pytest.raises(AnalyticError, match="an image of 30 pixel rows: resize it to a multiple of 16 rows"):
        small("wisurf", rows=4).describe(COLOUR[..., :30, :])
    assert small("fs", circular=False, turns=100).describe(COLOUR).position.shape == (4, 24)  # no turn to fit


@pytest.mark.parametrize("name", ["fs", "hog", "gist", "wisurf", "briefgist", "hsv"])
def test_a_picture_smaller_than_the_cells_is_refused_in_one_sentence(name):
    with pytest.raises(AnalyticError, match=r"\b1\b"):  # its height
        descriptor(name).describe(np.zeros((1, 512)))


def test_a_robot_without_torch_and_scipy_describes_compares_and_finds_headings():
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
    known = one.describe(images)
    assert one.pairwise(known, known).argmin(axis=1).tolist() == [0, 1], name
    if one.tells_heading:
        found = one.localize(one.describe(np.roll(images, 32, axis=3)), known)
        assert found.index.tolist() == [0, 1], name
        assert np.allclose(found.heading, np.pi / 2, atol=0.05), name
from analytic.distances import minkowski
near = minkowski([[0, 0], [1, 1]], [[3, 4]], p=1).tolist(), minkowski([[0, 0]], [[3, 4], [0, 0]]).tolist()
assert near == ([[7.0], [5.0]], [[5.0, 0.0]])
"""
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: descriptor("hogg"), "unknown descriptor 'hogg': did you mean 'hog'"),
        (lambda: descriptor("sift"), "valid: fs, hog, gist, wisurf, briefgist, radon_fourier, radon_poc, hsv"),
        (lambda: descriptor(["hog"]), "unknown descriptor"),
        (lambda: distance({"cosine": 1}), "unknown distance"),
        (lambda: descriptor("hog", windows=3), "unknown key hog.windows: did you mean 'window'"),
        (lambda: descriptor("fs", k1=3), "unknown key fs.k1: valid: "),
    ],
)
def test_unknown_names_are_one_sentence(call, says):
    with pytest.raises(AnalyticError, match=says):
        call()
