"""Bundles of analytic descriptors, with a coarse layer, with pictures, and with lower precision."""

from __future__ import annotations

import re
import shutil
from dataclasses import asdict, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import analytic
import siamloc
from analytic.descriptors.thumbnail import Thumbnail
from foundation.files import file_hash
from siamloc import evaluation, maps, runtime
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.maps import HierarchicalSearch, LayerSearch, VisualMap
from siamloc.maps.packing import packed, unpacked
from siamloc.models import as_descriptor, build
from siamloc.runtime.precision import LOSS, Measured, smallest
from tests.siamloc.runtime.conftest import altered

PARTS = {
    "gist": {"blocks": 8, "orientations": 8},
    "fs": {"turns": 64, "orientation_columns": 12},
    "wisurf": {"windows": 64},
    "briefgist": {"rows": 8},
    "radon_fourier": {"size": 64},
    "radon_poc": {"size": 64},
}


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    """Images of two drives, read at 32 x 64 pixels."""
    frames = siamloc.data.example().frames
    return siamloc.data.PanoramaLibrary(frames, tmp_path_factory.mktemp("images"), image_size=(32, 64))


@pytest.fixture(scope="module")
def monday(images):
    return images.frames.select(sequence="monday")


@pytest.fixture(scope="module")
def tuesday(images):
    return images.frames.select(sequence="tuesday")


def described(name):
    return analytic.descriptor(name, **PARTS.get(name, {}))


@pytest.fixture(scope="module")
def network():
    return as_descriptor(build("simple1", "fc500_500_5", (32, 64)))


@pytest.fixture(scope="module")
def known(images, monday, network):
    return maps.build(network, images, monday, progress=False)


@pytest.fixture(scope="module")
def made(network, known, tmp_path_factory):
    """A bundle with a coarse layer."""
    layer = maps.group(known, "sample", nodes=2)
    folder = tmp_path_factory.mktemp("made") / "bundle"
    return runtime.export(network, known, folder, layer=layer, figures={"mean": 0.2})


@pytest.fixture
def bundle(made, tmp_path):
    """A copy of the bundle, to be changed."""
    return Path(shutil.copytree(made.path, tmp_path / "copy"))


@pytest.mark.parametrize("name", analytic.DESCRIPTORS)
def test_every_analytic_descriptor_locates_as_its_map_does(images, monday, tuesday, tmp_path, name):
    known = maps.build(described(name), images, monday, progress=False)
    bundle = runtime.export(described(name), known, tmp_path / "bundle")
    localizer = runtime.Localizer(bundle.path)
    queries = maps.describe(known, images, tuesday)
    seen = analytic.Description.concatenate(list(queries))
    expected = maps.match(known, seen, 3)
    theta = maps.headings(known, seen, expected)[:, 0]
    for row, path in enumerate(tuesday.path.tolist()):
        location = localizer.locate(path)
        assert [candidate.row for candidate in location.candidates] == expected.indices[row].tolist()
        np.testing.assert_allclose(location.candidates[0].distance, expected.distances[row, 0], rtol=1e-3, atol=1e-4)
        np.testing.assert_allclose(location.theta, theta[row], atol=1e-6)
    assert ("heading" in bundle.summary()) == described(name).oriented
    assert "model.onnx" not in bundle.files


def test_a_descriptor_of_ones_own_is_not_exported(images, monday, tmp_path):
    class Own(Thumbnail):
        name = "own"

    with pytest.raises(ConfigError, match=r"can be exported, not own: write it as a torch\.nn\.Module"):
        runtime.export(Own(), maps.build(Own(), images, monday, progress=False), tmp_path / "bundle")


def test_parameters_that_did_not_make_the_map_are_refused_before_they_take_memory(images, monday, tmp_path):
    known = maps.build(described("hog"), images, monday, progress=False)
    bundle = runtime.export(described("hog"), known, tmp_path / "bundle").path
    for hostile, says in (
        ({"bins": 10**9}, "hog.bins must be a whole number from 1 to 16,384"),
        ({"bins": "many"}, "in a way unknown to this"),
    ):
        identity = {**known.identity, **hostile}
        replace(known, identity=identity).save(bundle / "map.npz")
        altered(bundle, "map.npz", identity={k: v for k, v in identity.items() if k != "images"})
        with pytest.raises(FormatError, match=says):
            runtime.Localizer(bundle)


@pytest.mark.parametrize("by", ["representatives", "vote"])
@pytest.mark.parametrize("coarse", [None, "hog"])
def test_a_coarse_layer_is_searched_first_as_the_evaluation_does(
    images, monday, tuesday, network, known, tmp_path, by, coarse
):
    ranks = None if coarse is None else maps.build(described(coarse), images, monday, progress=False)
    layer = maps.group(known if ranks is None else ranks, "sample", nodes=3)
    search = LayerSearch(by=by, candidates=1, neighbours=3)
    bundle = runtime.export(network, known, tmp_path / "bundle", layer=layer, coarse_map=ranks, search=search)
    assert f"a coarse layer by {by}" in bundle.summary()
    localizer = runtime.Localizer(bundle.path, top=1)
    prepared = HierarchicalSearch(known, layer.layer, coarse=ranks, settings=search)
    fine, ranked = (
        analytic.Description.concatenate(list(maps.describe(one, images, tuesday))) for one in (known, ranks or known)
    )
    found = prepared.search(fine, prepared.rank(ranked))
    located = [localizer.locate(path) for path in tuesday.path.tolist()]
    assert [one.candidates[0].row for one in located] == found.found.indices[:, 0].tolist()
    whole = runtime.Localizer(bundle.path, top=1, hierarchical=False)
    everywhere = known.search(np.concatenate([p.position for p in maps.describe(known, images, tuesday)]))
    assert [whole.locate(path).candidates[0].row for path in tuesday.path.tolist()] == everywhere.indices[:, 0].tolist()


def test_where_nodes_hold_too_few_frames_the_whole_map_is_searched(tuesday, network, known, tmp_path):
    layer = maps.group(known, "sample", nodes=len(known))
    bundle = runtime.export(network, known, tmp_path / "b", layer=layer, search=LayerSearch(candidates=1))
    both = [runtime.Localizer(bundle.path, top=3, hierarchical=h).locate(tuesday.path[0]) for h in (None, False)]
    assert both[0].candidates == both[1].candidates


def test_layers_that_do_not_belong_are_refused(images, tuesday, network, known, bundle, tmp_path):
    layer, other = (
        maps.group(one, "sample", nodes=2) for one in (known, maps.build(network, images, tuesday, progress=False))
    )
    for on, over, says in ((known, other, "was not built over"), (None, layer, "a coarse layer needs the map")):
        with pytest.raises((ConfigError, siamloc.errors.DataError), match=says):
            runtime.export(network, on, tmp_path / "b", layer=over, preprocessing=images.preprocessing)
    plain = runtime.export(network, known, tmp_path / "b")
    with pytest.raises(ConfigError, match="holds no coarse layer: run `siamloc map build=spectral`"):
        runtime.Localizer(plain.path, hierarchical=True)
    with pytest.raises(FormatError, match=r"cannot search its coarse layer \(search\.by must be"):
        runtime.Localizer(altered(bundle, search={"by": "guess"}))


def test_pictures_of_the_map_come_along_and_damaged_ones_are_refused(images, monday, network, known, made, tmp_path):
    assert (made.thumbnail(0), made.about["figures"]) == (None, {"mean": 0.2})
    bundle = runtime.export(network, known, tmp_path / "b", images=images, thumbnails=True)
    for row, panorama in enumerate(next(images.batches(monday))):
        picture = cv2.imdecode(np.frombuffer(bundle.thumbnail(row), np.uint8), cv2.IMREAD_COLOR)
        assert picture.shape == (32, 64, 3)
        assert np.abs(picture[..., ::-1].astype(float) - panorama.transpose(1, 2, 0)).mean() < 12
    with pytest.raises(IndexError):
        bundle.thumbnail(len(monday))
    for jpeg, end in ((np.zeros(3, np.uint8), 9), (np.zeros(3), 3)):
        np.savez(bundle.path / "thumbnails.npz", jpeg=jpeg, ends=np.array([end]))
        with pytest.raises(FormatError, match="holds no pictures, or not all of them"):
            runtime.Bundle.open(altered(bundle.path, "thumbnails.npz")).thumbnail(0)


@pytest.mark.slow
@pytest.mark.parametrize(("precision", "size", "change"), [("float16", 1.001, 1e-5), ("int8", 0.45, 0.4)])
@pytest.mark.parametrize(
    ("branch", "head", "circular"), [("vgg11", "fc500_500_5", False), ("panoresnet", "fourier", True)]
)
def test_fewer_digits_are_shorter_and_locate_alike(
    images, monday, tuesday, tmp_path, precision, size, change, branch, head, circular
):
    net = as_descriptor(build(branch, head, (32, 64), circular=circular))
    known = maps.build(net, images, monday, progress=False)
    whole = runtime.export(net, known, tmp_path / "whole")
    short = runtime.export(net, known, tmp_path / "short", precision=precision, images=images)
    assert short.about["precision"] == precision
    assert short.bytes < size * whole.bytes
    panoramas = next(images.batches(tuesday))
    localizer = runtime.Localizer(short.path)
    expected, found = (one.describe(panoramas).position for one in (runtime.Localizer(whole.path), localizer))
    apart = np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1)
    assert apart.max() < change
    loaded = VisualMap.load(tmp_path / "short" / "map.npz")
    for panorama in panoramas[:5]:
        nearest = maps.match(loaded, localizer.describe(panorama[None]), 3)
        candidates = localizer.locate_panorama(panorama).candidates
        assert [one.row for one in candidates] == nearest.indices[0].tolist()
        assert [one.distance for one in candidates] == nearest.distances[0].tolist()


def test_int8_gives_the_same_file_again(images, network, known, tmp_path):
    for name in ("one", "two"):
        runtime.export(network, known, tmp_path / name, precision="int8", images=images)
    assert file_hash(tmp_path / "one" / "model.onnx") == file_hash(tmp_path / "two" / "model.onnx")


def test_auto_compares_errors_in_one_unit(images, tuesday, network, known, tmp_path):
    given = {"images": images, "validation": replace(tuesday, x=1000 * tuesday.x, y=1000 * tuesday.y, unit="mm")}
    with pytest.raises(DataError, match="positions count in m and mm cannot be joined or compared"):
        runtime.export(network, known, tmp_path / "b", precision="auto", **given)
    assert not (tmp_path / "b").exists()


def test_auto_takes_the_smallest_that_loses_little(images, tuesday, network, known, tmp_path):
    bundle = runtime.export(network, known, tmp_path / "b", precision="auto", images=images, validation=tuesday)
    rows = [Measured(**row) for row in bundle.about["precisions"]]
    assert [row.precision for row in rows] == ["float32", "float16", "int8"]
    assert bundle.about["precision"] == smallest(rows).precision
    assert next(row.bytes for row in rows if row.precision == bundle.about["precision"]) <= bundle.bytes
    table = runtime.precision_table(bundle)
    assert "[MB]" in table
    assert table.count("*") == 1
    located = map(runtime.Localizer(bundle.path).locate, tuesday.path)
    error = np.hypot(*(np.array([[one.x, one.y] for one in located]) - tuesday.xy).T)
    chosen = next(row for row in rows if row.precision == bundle.about["precision"])
    assert chosen.error == pytest.approx(error.mean())


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("parity", {"max_abs_difference": "a", "max_relative_difference": 1.0}),
        ("heading", {"name": "hog"}),
        ("refinement", {"method": "magic", "neighbours": 3}),
        ("search", {"by": 3}),
        ("errors", {"lost_above": "far"}),
        ("precision", "int4"),
        ("precisions", 3),
        ("unit", 5),
        ("sha256", ["model.onnx"]),
        ("preprocessing", None),
        ("preprocessing", {"height": 32}),
        ("preprocessing", {"height": 32, "width": 128, "camera": {"kind": "Fisheye"}}),
        ("identity", "vgg16"),
    ],
)
def test_altered_descriptions_are_refused(bundle, key, value):
    with pytest.raises(FormatError, match=rf"altered in {key}.*: export again"):
        runtime.Bundle.open(altered(bundle, **{key: value}))
    if key in ("heading", "errors", "precisions", "refinement", "unit"):
        assert runtime.Bundle.open(altered(bundle, **{key: None})).summary()


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"version": 1}, "has format version 1, this siamloc reads version 4: export again"),
        ({"version": "4"}, "has format version '4', this siamloc reads version 4: export again"),
        ({"sha256": {}}, "lists no model.onnx"),
    ],
)
def test_other_versions_and_missing_files_are_refused(bundle, changed, says):
    with pytest.raises(FormatError, match=says):
        runtime.Localizer(altered(bundle, **changed))


def test_altered_precisions_are_refused(bundle):
    row = asdict(Measured("int8", 1, 1.0, 0.0, 0.1, 3))
    for rows in ([{"precision": "int8"}], [["a"]], [{**row, "ms": "fast"}]):
        with pytest.raises(FormatError, match="is altered in its precisions"):
            runtime.precision_table(runtime.Bundle.open(altered(bundle, precisions=rows)))


def test_the_smallest_is_chosen_among_those_that_lose_little():
    def row(precision, size, error):
        return Measured(precision, size, 1.0, 0.0, error, 10, 10)

    full = row("float32", 100, 1.0)
    good, bad = row("int8", 25, 1 + LOSS), row("int8", 25, 1.01 + LOSS)
    assert smallest([full, row("float16", 50, 1.0), good]) == good
    assert smallest([full, row("float16", 50, 1.0), bad]).precision == "float16"
    assert smallest([full, row("float16", 50, 2.0), bad]) == full
    with pytest.raises(ConfigError, match="none of the 10 validation images finds a map frame with a position"):
        smallest([replace(full, located=0)])


def test_what_cannot_be_made_is_one_sentence(images, network, known, tmp_path):
    other = siamloc.data.PanoramaLibrary(images.frames, tmp_path / "cache", image_size=(32, 128))
    panoramas = "needs the panoramas of the map's frames: give images="
    for given, options, says in (
        (known, {"precision": "int8"}, f"precision=int8 {panoramas}"),
        (known, {"precision": "int4"}, "precision must be"),
        (known, {"precision": "auto", "images": images}, "give frames with positions as validation="),
        (known, {"thumbnails": True}, f"with pictures of the map {panoramas}"),
        (known, {"thumbnails": True, "images": other}, r"images\.width is 64 in the map, 128 here"),
        (None, {"precision": "float16", "preprocessing": images.preprocessing}, "without a map there are neither"),
    ):
        with pytest.raises(ConfigError, match=says):
            runtime.export(network, given, tmp_path / "b", **options)
    assert not (tmp_path / "b").exists()


@pytest.mark.parametrize("precision", ["float16", "int8"])
def test_rows_keep_their_digits(precision, tmp_path):
    generator = np.random.default_rng(0)
    values = generator.standard_normal((5, 7)) * 10.0 ** np.array([[-20], [-3], [0], [4], [20]])
    values[0] = 0
    held = packed("a", values.astype(np.float32), precision)
    back = unpacked(held["a"], held["a_scale"])
    largest = np.abs(values).max(axis=1, keepdims=True)
    assert (np.abs(back - values) <= largest * (1e-3 if precision == "float16" else 0.5 / 127 + 1e-6)).all()
    spectra = (values[:, :6] + 1j).reshape(5, 2, 3).astype(np.complex64)
    back = unpacked(*packed("a", spectra, "float16").values())
    assert back.dtype == np.complex64
    np.testing.assert_allclose(back, spectra, rtol=0, atol=float(np.abs(spectra).max()) * 1e-3)


def test_several_images_at_once_give_the_same_answers(images, tuesday, network, known, tmp_path):
    errors = evaluation.error_model(known, images, tuesday, lost_above=1.0)
    localizer = runtime.Localizer(runtime.export(network, known, tmp_path / "b", errors=errors).path)
    paths = tuesday.path.tolist()
    alone, together = [localizer.locate(path) for path in paths], localizer.locate_batch(paths)
    for one, other in zip(alone, together, strict=True):
        assert [c.row for c in one.candidates] == [c.row for c in other.candidates]
        assert (one.x, one.y, one.room, one.lost) == (other.x, other.y, other.room, other.lost)
        assert other.error_m == pytest.approx(one.error_m, rel=1e-4)
    assert localizer.locate_batch([]) == []
    panorama = images.preprocessing.panorama(paths[0])
    for same in (panorama, panorama.transpose(1, 2, 0)):  # as from a library, and as from `siamloc.data.unwrap`
        assert repr(replace(localizer.locate_panorama(same), ms=0)) == repr(replace(alone[0], ms=0))


def test_panoramas_of_another_size_are_one_sentence(made):
    localizer = runtime.Localizer(made.path)
    for wrong in (np.zeros((3, 16, 64), np.uint8), np.zeros((3, 32, 64)), np.zeros((16, 64, 3), np.uint8)):
        asked = rf"has shape \(3, 32, 64\) and dtype uint8, got {re.escape(str(wrong.shape))} {wrong.dtype}: resize it"
        with pytest.raises(siamloc.errors.DataError, match=asked):
            localizer.locate_panorama(wrong)
    with pytest.raises(siamloc.errors.DataError, match=r"shape \(B, 3, 32, 64\) and dtype uint8, got \(3, 32, 64\) "):
        localizer.describe(np.zeros((3, 32, 64), np.uint8))
