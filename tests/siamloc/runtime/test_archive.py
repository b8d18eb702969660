"""Bundles as one archive, and what an attacker may have put into one."""

from __future__ import annotations

import hashlib
import json
import shutil
import stat
import sys
import zipfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest

from foundation.files import file_hash, read_json, write_json
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, FormatError, SiamlocError
from siamloc.maps import VisualMap
from siamloc.models import as_descriptor, build
from siamloc.runtime import Bundle, Localizer, export
from tests.drawn import draw_panorama, draw_sequence

SIZE = (32, 128)
IMAGES = {"height": 32, "width": 128, "camera": None}


def drive(seed):
    poses = draw_sequence(seed, 6)
    pictures = np.stack([draw_panorama(p["local_x"], p["y"], p["theta"], p["room"], "cloudy") for p in poses])
    columns = {key: np.array([pose[key] for pose in poses]) for key in ("x", "y", "theta", "room")}
    return pictures[..., ::-1], FrameTable(np.array([f"{seed}/{i}.png" for i in range(len(poses))]), **columns)


@pytest.fixture(scope="module")
def world():
    network = as_descriptor(build("simple1", "fc500_500_5", SIZE))
    pictures, frames = drive(0)
    seen = network.describe(pictures.transpose(0, 3, 1, 2))
    return network, VisualMap(seen.position, frames, {**network.identity, "images": IMAGES}, describes=network)


@pytest.fixture(scope="module")
def folder(world, tmp_path_factory):
    return export(*world, tmp_path_factory.mktemp("robot") / "bundle").path


@pytest.fixture(scope="module")
def archive(world, tmp_path_factory):
    return export(*world, tmp_path_factory.mktemp("archive") / "bundle.zip").path


def answers(bundle, images=None, **options):
    localizer = Localizer(bundle, **options)
    return [replace(localizer.locate(image), ms=0.0) for image in (drive(1)[0] if images is None else images)]


def same(one, other):
    return all(
        (a.x, a.y, a.room, a.candidates) == (b.x, b.y, b.room, b.candidates) for a, b in zip(one, other, strict=True)
    )


def told(location):
    """Return all that an answer says, to the last digit; NaN equals NaN."""
    return repr(replace(location, ms=0.0))


def zipped(path, files):
    with zipfile.ZipFile(path, "w") as made:
        for name, content in files:
            made.writestr(name, content)
    return path


def files_of(archive):
    with zipfile.ZipFile(archive) as held:
        return [(name, held.read(name)) for name in held.namelist()]


def test_an_archive_answers_as_the_folder_does_and_writes_nothing(folder, archive, tmp_path, monkeypatch):
    copied = shutil.copy(archive, tmp_path / "a.zip")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    assert same(answers(copied), answers(folder))
    assert [path.name for path in tmp_path.iterdir()] == ["a.zip"]
    assert repr(Bundle.open(copied)) == f"Bundle({str(copied)!r}: model.onnx, map.npz)"


def test_equal_bundles_are_equal_archives(world, archive, tmp_path):
    assert file_hash(export(*world, tmp_path / "again.zip").path) == file_hash(archive)


def test_the_folder_put_into_an_archive_by_hand_is_one_too(folder, tmp_path):
    made = shutil.make_archive(str(tmp_path / "by_hand"), "zip", folder.parent, folder.name)
    assert same(answers(made), answers(folder))


@pytest.mark.slow
@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("precision", ["float32", "float16"])
def test_an_image_has_one_answer_alone_again_in_a_batch_and_from_four_threads(world, tmp_path, precision, threads):
    images = list(drive(1)[0])
    localizer = Localizer(export(*world, tmp_path / "bundle", precision=precision).path, threads=threads)
    alone = [told(localizer.locate(image)) for image in images]
    assert [told(localizer.locate(image)) for image in images] == alone
    for size in (2, 5, len(images)):
        assert [told(location) for location in localizer.locate_batch(images[:size])] == alone[:size]
    with ThreadPoolExecutor(4) as pool:
        assert [told(location) for location in pool.map(localizer.locate, images * 4)] == alone * 4


def test_an_archive_is_replaced_and_nothing_else(world, archive, tmp_path):
    path = tmp_path / "robot.zip"
    shutil.copy(archive, path)
    export(*world, path)
    zipped(path, [("thesis.txt", "precious")])
    with pytest.raises(ConfigError, match="is not a bundle: name another file"):
        export(*world, path)
    assert files_of(path) == [("thesis.txt", b"precious")]
    (tmp_path / "folder.zip").mkdir()
    with pytest.raises(ConfigError, match=r"folder\.zip is a folder"):
        export(*world, tmp_path / "folder.zip")
    assert sorted(item.name for item in tmp_path.iterdir()) == ["folder.zip", "robot.zip"]


@pytest.mark.parametrize("name", ["../model.onnx", "/etc/passwd", "sub/model.onnx", "run.py", "bundle.json/x"])
def test_names_that_no_bundle_has_are_refused(archive, tmp_path, name):
    path = zipped(tmp_path / "a.zip", [*files_of(archive), (name, b"x")])
    with pytest.raises(FormatError, match="not part of a bundle"):
        Bundle.open(path)
    assert [item.name for item in tmp_path.iterdir()] == ["a.zip"]


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_links_doubles_and_bombs_are_refused(archive, tmp_path):
    files = files_of(archive)
    link = zipfile.ZipInfo("error_model.json")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with pytest.raises(FormatError, match="a link"):
        Bundle.open(zipped(tmp_path / "link.zip", [*files, (link, "/etc/passwd")]))
    with pytest.raises(FormatError, match="appears twice"):
        Bundle.open(zipped(tmp_path / "double.zip", [*files, files[0]]))
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as made:
        for name, content in files:
            made.writestr(name, bytes(200_000_000) if name == "map.npz" else content)
    with pytest.raises(FormatError, match="far too long"):
        Bundle.open(tmp_path / "bomb.zip")


@pytest.mark.parametrize("kept", [0, 1, 100, 0.5, 0.99])
def test_an_archive_cut_short_is_refused(archive, tmp_path, kept):
    content = archive.read_bytes()
    (tmp_path / "a.zip").write_bytes(content[: int(kept * len(content)) if isinstance(kept, float) else kept])
    with pytest.raises(FormatError, match="not a zip archive"):
        Bundle.open(tmp_path / "a.zip")


def test_changed_bytes_of_an_archive_are_noticed(archive, tmp_path):
    content, path = archive.read_bytes(), tmp_path / "a.zip"
    with zipfile.ZipFile(archive) as held:
        inside = [member.header_offset + 100 + int(share * (member.file_size - 100))
                  for member in held.infolist() for share in (0.0, 0.5, 0.99)]  # fmt: skip
    for at in inside:
        changed = bytearray(content)
        changed[at] ^= 0x55
        path.write_bytes(changed)
        with pytest.raises(SiamlocError):
            Localizer(path)


def test_a_folder_with_links_or_with_names_that_lead_outside_is_refused(folder, tmp_path):
    linked = tmp_path / "linked"
    shutil.copytree(folder, linked)
    (linked / "map.npz").rename(tmp_path / "map.npz")
    (linked / "map.npz").symlink_to(tmp_path / "map.npz")
    with pytest.raises(FormatError, match="is a link"):
        Bundle.open(linked)
    outside = Path(shutil.copytree(folder, tmp_path / "outside"))
    about = read_json(outside / "bundle.json")
    about["sha256"]["../map.npz"] = file_hash(tmp_path / "map.npz")
    write_json(outside / "bundle.json", about)
    with pytest.raises(FormatError, match=r"lists '\.\./map\.npz', which no bundle has"):
        Bundle.open(outside)


@pytest.mark.skipif(sys.version_info < (3, 11), reason="needs onnxruntime 1.24")
@pytest.mark.parametrize("where", ["link.bin", "../secret.bin", None])
def test_weights_outside_of_the_bundle_are_not_read(archive, tmp_path, monkeypatch, where):
    files = dict(files_of(archive))
    model = onnx.load_from_string(files["model.onnx"])
    tensor = max(model.graph.initializer, key=lambda one: len(one.raw_data))
    (tmp_path / "secret.bin").write_bytes(tensor.raw_data)
    (tmp_path / "link.bin").symlink_to(tmp_path / "secret.bin")
    (tmp_path / "bundle").mkdir()
    (tmp_path / "bundle" / "link.bin").symlink_to(tmp_path / "secret.bin")
    where = str(tmp_path / "secret.bin") if where is None else where
    entries = {"location": where, "offset": "0", "length": str(len(tensor.raw_data))}
    tensor.ClearField("raw_data")
    tensor.data_location = onnx.TensorProto.EXTERNAL
    for key, value in entries.items():
        tensor.external_data.add(key=key, value=value)
    files["model.onnx"] = model.SerializeToString()
    about = json.loads(files["bundle.json"])
    about["sha256"]["model.onnx"] = hashlib.sha256(files["model.onnx"]).hexdigest()
    files["bundle.json"] = json.dumps(about).encode()
    for name, content in files.items():
        (tmp_path / "bundle" / name).write_bytes(content)
    monkeypatch.chdir(tmp_path)
    for path in (tmp_path / "bundle", zipped(tmp_path / "a.zip", files.items())):
        with pytest.raises(FormatError, match="onnxruntime cannot run"):
            Localizer(path)


def test_a_bundle_that_disagrees_with_its_network_is_refused(world, tmp_path, monkeypatch):
    described = Localizer.describe

    def off(self, panoramas):
        found = described(self, panoramas)
        return replace(found, position=found.position + 0.1)

    monkeypatch.setattr(Localizer, "describe", off)
    with pytest.raises(SiamlocError, match="away from the original"):
        export(*world, tmp_path / "bundle")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"top": 0}, "top must be a whole number from 1"),
        ({"threads": 0}, "threads must be a whole number from 1"),
        ({"providers": ("CUDA",)}, "no provider 'CUDA'.*valid: .*CPUExecutionProvider"),
    ],
)
def test_options_without_a_meaning_are_one_sentence(folder, options, says):
    with pytest.raises(ConfigError, match=says):
        Localizer(folder, **options)


def test_threads_and_providers_do_not_change_the_answer(folder):
    assert same(answers(folder, threads=2, providers=("CPUExecutionProvider",)), answers(folder))
