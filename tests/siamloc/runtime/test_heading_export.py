"""Exported heading descriptors: the same orientation parts, the same headings, and one sentence where it cannot be."""

from __future__ import annotations

import json

import numpy as np
import onnx
import onnxruntime
import pytest

import analytic
from siamloc.errors import ConfigError, FormatError, SiamlocError
from siamloc.runtime import export_heading, heading_parity

SIZE = (32, 128)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    path = tmp_path_factory.mktemp("heading") / "new" / "heading.onnx"
    hog = analytic.descriptor("hog", rows=1)
    return hog, path, export_heading(hog, path, SIZE)


def test_the_file_says_what_it_is(exported):
    hog, path, report = exported
    onnx.checker.check_model(str(path), full_check=True)
    metadata = {entry.key: entry.value for entry in onnx.load(path).metadata_props}
    assert (metadata["format"], metadata["format_version"]) == ("siamloc-heading", "1")
    assert json.loads(metadata["identity"]) == hog.identity
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]
    assert report["mean_relative_difference"] <= report["tolerance"]
    assert report["headings"] == 4
    assert heading_parity(hog, path) == report
    json.dumps(report, allow_nan=False)


def test_the_file_computes_the_orientation_part(exported):
    hog, path, _ = exported
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    images = np.random.default_rng(1).integers(0, 256, (5, 3, *SIZE), dtype=np.uint8)
    images[4] = 90  # nothing to see
    expected = hog.describe(images).orientation
    for image, wanted in zip(images, expected, strict=True):
        (got,) = session.run(["orientation"], {"panorama": image[None].astype(np.float32) / np.float32(255)})
        np.testing.assert_allclose(got[0], wanted, rtol=0, atol=1e-4)


@pytest.mark.parametrize("options", [{"step": 4, "window": 9}, {"bins": 16}, {"orientation_bins": 5}])
def test_parameters_stay(tmp_path, options):
    hog = analytic.descriptor("hog", rows=2, **options)
    assert export_heading(hog, tmp_path / "heading.onnx", (16, 64))["headings"] == 4


def test_a_file_of_other_parameters_fails_the_comparison(exported):
    _, path, _ = exported
    with pytest.raises(SiamlocError, match=r"differ from hog's by .* of their mean .*do not use the file"):
        heading_parity(analytic.descriptor("hog", rows=1, window=8), path)
    with pytest.raises(SiamlocError, match=r"shape \(4, 64, 16\) for \(4, 32, 16\)"):
        heading_parity(analytic.descriptor("hog", rows=1, step=4), path)


@pytest.mark.parametrize("name", ["fs", "gist", "radon_fourier", "hog"])
def test_what_onnx_does_not_have_is_refused_in_one_sentence(tmp_path, name):
    options = {
        "fs": {"turns": 128, "orientation_columns": 32},
        "gist": {"orientations": 16},
        "hog": {"homomorphic": True},
    }
    with pytest.raises(ConfigError, match=f"heading={name} with these parameters cannot be exported .*heading=hog"):
        export_heading(analytic.descriptor(name, **options.get(name, {})), tmp_path / "heading.onnx", SIZE)
    assert not list(tmp_path.iterdir())


def test_a_size_that_does_not_fit_is_refused(tmp_path):
    with pytest.raises(analytic.AnalyticError, match="do not divide the image's height of 20 pixels"):
        export_heading(analytic.descriptor("hog", rows=8), tmp_path / "heading.onnx", (20, 128))


def test_other_files_are_refused(tmp_path):
    (tmp_path / "text.onnx").write_text("no graph")
    with pytest.raises(FormatError, match="no ONNX file that onnxruntime can run"):
        heading_parity(analytic.descriptor("hog"), tmp_path / "text.onnx")
