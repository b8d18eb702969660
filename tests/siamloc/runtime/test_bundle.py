"""Bundles answer alike however they are asked, and what an attacker may have put into one."""

from __future__ import annotations

import os
import shutil
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import onnx
import pytest

from siamloc.errors import FormatError, SiamlocError
from siamloc.runtime import Bundle, Localizer, export
from tests.siamloc.runtime.conftest import altered, drive


def told(location):
    """Return all that an answer says, to the last digit; NaN equals NaN."""
    return repr(replace(location, ms=0.0))


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("precision", ["float32", "float16"])
def test_an_image_has_one_answer_alone_again_in_a_batch_and_from_four_threads(small, tmp_path, precision, threads):
    images = list(drive(1, 6)[0])
    localizer = Localizer(export(*small, tmp_path / "bundle", precision=precision).path, threads=threads)
    alone = [told(localizer.locate(image)) for image in images]
    assert [told(localizer.locate(image)) for image in images] == alone
    for size in (2, 5, len(images)):
        assert [told(location) for location in localizer.locate_batch(images[:size])] == alone[:size]
    with ThreadPoolExecutor(4) as pool:
        assert [told(location) for location in pool.map(localizer.locate, images * 4)] == alone * 4


def test_a_folder_with_links_or_with_names_that_lead_outside_is_refused(bare, tmp_path):
    linked = tmp_path / "linked"
    shutil.copytree(bare, linked)
    (linked / "map.npz").rename(tmp_path / "map.npz")
    (linked / "map.npz").symlink_to(tmp_path / "map.npz")
    with pytest.raises(FormatError, match="is a link"):
        Bundle.open(linked)
    outside = Path(shutil.copytree(bare, tmp_path / "outside"))
    with pytest.raises(FormatError, match=r"lists '\.\./map\.npz', which no bundle has"):
        Bundle.open(altered(outside, "../map.npz"))


def test_a_bundle_may_lie_where_files_take_no_blocks(bare, tmp_path):
    copied = Path(shutil.copytree(bare, tmp_path / "bundle"))
    os.truncate(copied / "map.npz", 80_000_000)  # a hole; network and compressing file systems report no blocks at all
    assert Bundle.open(altered(copied, "map.npz")).bytes > 80_000_000


@pytest.mark.skipif(sys.version_info < (3, 11), reason="needs onnxruntime 1.24")
@pytest.mark.parametrize("where", ["link.bin", "../secret.bin", None])
def test_weights_outside_of_the_bundle_are_not_read(bare, tmp_path, monkeypatch, where):
    copied = Path(shutil.copytree(bare, tmp_path / "bundle"))
    model = onnx.load(copied / "model.onnx")
    tensor = max(model.graph.initializer, key=lambda one: len(one.raw_data))
    (tmp_path / "secret.bin").write_bytes(tensor.raw_data)
    (copied / "link.bin").symlink_to(tmp_path / "secret.bin")
    where = str(tmp_path / "secret.bin") if where is None else where
    entries = {"location": where, "offset": "0", "length": str(len(tensor.raw_data))}
    tensor.ClearField("raw_data")
    tensor.data_location = onnx.TensorProto.EXTERNAL
    for key, value in entries.items():
        tensor.external_data.add(key=key, value=value)
    (copied / "model.onnx").write_bytes(model.SerializeToString())
    altered(copied, "model.onnx")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FormatError, match="not an ONNX file that onnxruntime can run"):
        Localizer(copied)


def test_a_bundle_that_disagrees_with_its_network_is_refused(small, tmp_path, monkeypatch):
    described = Localizer.describe

    def off(self, panoramas):
        found = described(self, panoramas)
        return replace(found, position=found.position + 0.1)

    monkeypatch.setattr(Localizer, "describe", off)
    with pytest.raises(SiamlocError, match="away from the original"):
        export(*small, tmp_path / "bundle")
    assert not list(tmp_path.iterdir())
