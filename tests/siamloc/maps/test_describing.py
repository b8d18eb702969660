"""From images to a map and back: what `build` keeps, and what hierarchical search finds for frames of a library."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from torch import nn

import analytic
from analytic import Description
from analytic.descriptors.base import description_of
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.errors import ConfigError, DataError
from siamloc.maps import (
    CoarseLayer,
    HierarchicalSearch,
    Refinement,
    VisualMap,
    build,
    describe,
    headings,
    match,
    refine,
)
from siamloc.models import as_descriptor
from siamloc.models import build as build_network
from tests.drawn import ROOMS, draw_panorama

SIZE = (32, 128)
THETAS = (0.0, 1.0, -2.0, 3.0, 0.5, -0.5)


class Small(nn.Module):
    """A custom network."""

    def __init__(self) -> None:
        super().__init__()
        self.layer = nn.Linear(3 * SIZE[0], 4)

    def forward(self, panoramas: torch.Tensor) -> torch.Tensor:
        return self.layer(panoramas.mean(dim=3).flatten(1))


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    for number, theta in enumerate(THETAS):
        drawn = draw_panorama(0.3 * number, -0.2, theta, ROOMS[number // 3], size=SIZE)
        assert cv2.imwrite(str(folder / f"{number}.png"), drawn)
    (folder / "broken.png").write_bytes(b"no image")
    names = [*map(str, range(6)), "broken"]
    frames = FrameTable(
        path=[str(folder / f"{name}.png") for name in names],
        x=0.3 * np.arange(7),
        y=np.zeros(7),
        theta=[*THETAS, 0.0],
        sequence=["monday"] * 7,
        unit="steps",
        source={"kind": "manifest", "manifest": "robot.csv"},
    )
    return frames, PanoramaLibrary(frames, folder / "cache", image_size=SIZE)


def test_a_network_of_ones_own_makes_a_map_with_headings(images, tmp_path):
    frames, library = images
    network = Small()
    known = build(network, library, frames, heading="hog", progress=False)
    assert len(known) == 6  # one image cannot be read
    assert (known.unit, known.made["sequences"], known.made["frames"]) == ("steps", ["monday"], 6)
    assert known.made["data"]["manifest"] == "robot.csv"
    assert known.made["data"]["image_size"] == list(SIZE)
    assert known.identity["images"] == library.preprocessing.parameters()
    known.save(tmp_path / "map.npz")
    loaded = VisualMap.load(tmp_path / "map.npz", known.descriptor)
    assert loaded.unit == "steps"
    seen = Description.concatenate(list(describe(loaded, library, known.frames)))
    found = match(loaded, seen)
    assert found.indices[:, 0].tolist() == list(range(6))
    np.testing.assert_allclose(headings(loaded, seen, found)[:, 0], THETAS, atol=1e-6)
    with pytest.raises(ConfigError, match="described differently from"):
        VisualMap.load(tmp_path / "map.npz", analytic.descriptor("hog"))


def test_panoramas_of_another_size_are_refused(images, tmp_path):
    frames, library = images
    known = build("hog", library, frames, progress=False)
    other = PanoramaLibrary(frames, tmp_path, image_size=(32, 64))
    with pytest.raises(ConfigError, match=r"images\.width is 128 in the map, 64 here"):
        describe(known, other, known.frames)


def test_what_cannot_be_built(images, tmp_path):
    frames, library = images
    with pytest.raises(ConfigError, match="unknown descriptor 'hgo': did you mean 'hog'"):
        build("hgo", library, frames)
    for by, heading in (("briefgist", "hog"), ("thumbnail", "briefgist"), ("hog", "thumbnail")):
        with pytest.raises(ConfigError, match=f"{heading} cannot find the headings of a map by {by}"):
            build(by, library, frames, heading=heading)
    flat = PanoramaLibrary(frames, tmp_path, image_size=SIZE, circular=False)
    with pytest.raises(ConfigError, match="heading=hog needs columns that are a full turn"):
        build("thumbnail", flat, frames, heading="hog")
    with pytest.raises(DataError, match="none of the images of the 1 map frames could be read"):
        build("hog", library, frames.take([6]))
    with pytest.raises(DataError, match="the table is empty"):
        build("hog", library, frames.take([]))


@pytest.mark.parametrize(
    ("returned", "says"),
    [
        (lambda values: values, "must return an analytic.Description, got ndarray"),
        (lambda values: Description(values.tolist()), r"an array \(B, D\) as position, .* got list"),
        (lambda values: Description(values[:1]), r"one row for each of 3 images, got \(1, 3\)"),
        (lambda values: Description(values, values), r"an array \(B, K, F\) as orientation, .* got \(3, 3\)"),
        (
            lambda values: Description(values, None, {"name": "own", "bands": 8}),
            "returns the identity .*'bands': 8.* instead of",
        ),
    ],
)
def test_a_descriptor_of_ones_own_that_returns_something_else_is_named(images, returned, says):
    class Own(analytic.Descriptor):
        name = "own"
        identity = {"name": "own", "bands": 4}  # noqa: RUF012

        def describe(self, batch):
            return returned(batch.mean(axis=(2, 3)))

    frames, library = images
    with pytest.raises(ConfigError, match=says):
        build(Own(), library, frames, progress=False)
    with pytest.raises(ConfigError, match="`describe` of own"):
        build([Own(), "hsv"], library, frames, progress=False)


def test_an_identity_that_is_no_dictionary_is_refused(images):
    class Own(analytic.Descriptor):
        name = "own"
        identity = "own"

        def describe(self, batch):
            return Description(batch.mean(axis=(2, 3)))

    frames, library = images
    with pytest.raises(analytic.AnalyticError, match=r"`identity` of own must be a dictionary, .* got 'own'"):
        build(Own(), library, frames, progress=False)


@pytest.mark.parametrize(
    ("change", "when"),
    [
        (lambda values: values - values.mean(axis=0), "other images are in its batch"),
        (lambda values: values * np.random.default_rng().random(), "it is described again"),
    ],
)
def test_a_descriptor_of_ones_own_that_depends_on_more_than_the_image_is_refused(images, change, when):
    class Own(analytic.Descriptor):
        name = "own"
        identity = {"name": "own"}  # noqa: RUF012

        def describe(self, batch):
            return Description(change(batch.mean(axis=(2, 3))))

    frames, library = images
    for described_by in (Own(), [Own(), "hsv"]):
        with pytest.raises(analytic.AnalyticError, match=f"`describe` of own gives an image another .* when {when}"):
            build(described_by, library, frames, progress=False)


@pytest.mark.parametrize(
    ("shape", "count"), [((16, 32), 1), ((3, 16, 32), 1), ((5, 16, 32), 5), ((1, 16, 32), 1), ((5, 3, 16, 32), 5)]
)
def test_a_batch_without_channels_needs_as_many_rows_as_images(shape, count):
    class Own(analytic.Descriptor):
        name = "own"
        identity = {"name": "own"}  # noqa: RUF012
        returned = np.ones((count, 2))

        def describe(self, batch):
            return Description(self.returned)

    own, batch = Own(), np.zeros(shape, np.uint8)
    assert len(description_of(own, batch)) == count
    for own.returned, got in ((None, "NoneType"), (np.ones((count + 1, 2)), rf"\({count + 1}, 2\)")):
        with pytest.raises(analytic.AnalyticError, match=f"one row for each of {count} images, got {got}"):
            description_of(own, batch)


def test_an_identity_may_hold_arrays():
    class Own(analytic.Descriptor):
        name = "own"

        def __init__(self, *bands):
            self.bands = np.array(bands)

        @property
        def identity(self):
            return {"name": "own", "bands": self.bands}

        def describe(self, batch):
            return Description(np.ones((len(batch), 2)), None, self.identity)

    batch = np.zeros((5, 3, 16, 32), np.uint8)
    made, other = description_of(Own(4, 8), batch), description_of(Own(4, 9), batch)
    assert Own(4, 8).pairwise(made, made).shape == (5, 5)
    message = r"bands=\[4, 9\] instead of \[4, 8\]"
    with pytest.raises(analytic.AnalyticError, match=message):
        Own(4, 8).pairwise(other, other)
    with pytest.raises(analytic.AnalyticError, match=message):
        Description.concatenate([made, other])


def test_ranking_settings_that_make_no_sense(images):
    frames, library = images
    known = build(analytic.descriptor("briefgist", rows=8), library, frames, progress=False)
    layer = CoarseLayer.of_labels(known, [0, 0, 0, 1, 1, 1])
    with pytest.raises(ConfigError, match="compared after turning, so their means are meaningless"):
        HierarchicalSearch(known, layer)
    with pytest.raises(ConfigError, match="by must be representatives or vote or classifier, got 'votes'"):
        HierarchicalSearch(known, layer, by="votes")
    with pytest.raises(ConfigError, match=r"search\.candidates must be a whole number from 1"):
        HierarchicalSearch(known, layer, by="vote", candidates=0)
    with pytest.raises(DataError, match="frames in the same order"):
        HierarchicalSearch(known, layer, coarse=known.take([1, 0, 2, 3, 4, 5]), by="vote")


def test_a_network_that_finds_headings_keeps_them_in_its_map(images, tmp_path):
    frames, library = images
    network = build_network("panoresnet", "fourier", SIZE, circular=True)
    known = build(network, library, frames, progress=False)
    assert known.heading_by_network
    assert known.orientation.dtype == np.float16
    assert known.heading_descriptor is None
    assert repr(known).endswith("headings by network)")
    seen = Description.concatenate(list(describe(known, library, library.readable(frames))))
    found = match(known, seen)
    np.testing.assert_array_equal(found.indices[:, 0], np.arange(6))
    np.testing.assert_allclose(headings(known, seen, found)[:, 0], known.frames.theta, atol=1e-9)

    known.save(tmp_path / "map.npz")
    bare = VisualMap.load(tmp_path / "map.npz")
    np.testing.assert_array_equal(bare.orientation, known.orientation)
    np.testing.assert_array_equal(headings(bare, seen, found), headings(known, seen, found))  # without the network
    with pytest.raises(ConfigError, match="come from the network: describe images with known"):
        bare.heading_by.describe(library.batch([0]))
    assert bare.with_heading(None) is bare
    with pytest.raises(ConfigError, match=r"name is 'network' in the map, 'hog' here: make it again"):
        bare.with_heading(analytic.descriptor("hog"))
    loaded = VisualMap.load(tmp_path / "map.npz", as_descriptor(network))
    np.testing.assert_array_equal(headings(loaded, seen, found), headings(known, seen, found))
    # What gives headings changes neither the map nor how its frames are grouped.
    assert known.digest == build(network, library, frames, heading="hog", progress=False).digest


def test_a_map_of_ordinary_images_keeps_no_orientation_parts_that_nothing_compares(images, tmp_path):
    frames = images[0]
    flat = PanoramaLibrary(frames, tmp_path / "cache", image_size=SIZE, circular=False)
    hog, wisurf = analytic.descriptor("hog", circular=False), analytic.descriptor("wisurf", windows=32, circular=False)
    known = build(hog, flat, frames, progress=False)
    assert known.orientation is None
    assert build(wisurf, flat, frames, progress=False).orientation is not None, "it compares them"
    assert build(analytic.descriptor("hog"), images[1], frames, progress=False).orientation is not None
    seen = Description.concatenate(list(describe(known, flat, known.frames)))
    assert seen.orientation is not None
    replace(known, orientation=seen.orientation).save(tmp_path / "map.npz")  # as maps used to be
    kept = VisualMap.load(tmp_path / "map.npz", hog)
    assert kept.orientation is not None
    for one in (known, kept):
        np.testing.assert_array_equal(match(one, seen).indices[:, 0], np.arange(6))


def test_a_network_that_compares_ordinary_images_keeps_what_it_compares_and_no_heading(images, tmp_path):
    frames = replace(images[0], unit="m")
    flat = PanoramaLibrary(frames, tmp_path / "cache", image_size=SIZE, circular=False)
    network = build_network("panoresnet", "magnitudes", SIZE, relative=True)
    known = build(network, flat, frames, progress=False)
    assert known.heading == {"name": "network", "version": 1, "circular": False}
    assert "headings" not in repr(known)
    known.save(tmp_path / "map.npz")
    loaded = VisualMap.load(tmp_path / "map.npz", as_descriptor(network))
    seen = Description.concatenate(list(describe(loaded, flat, known.frames)))
    found = match(loaded, seen, 3)
    assert np.isnan(headings(loaded, seen, found, 3)).all()
    poses = refine(loaded, seen, found, k=1)
    np.testing.assert_array_equal(poses.xy, refine(known, seen, found, k=1).xy)
    pose, _, _ = known.descriptor.compare(seen.orientation, seen.orientation)
    np.testing.assert_allclose(poses.theta, known.frames.theta + pose[:, 2], atol=0.01)  # the map is in half precision
    assert np.isnan(Refinement("interpolate").poses(loaded, seen, found).theta).all()
    assert build(build_network("panoresnet", "magnitudes", SIZE), flat, frames, progress=False).heading is None


def test_who_builds_a_map_in_another_unit_hears_that_the_network_compares_in_metres(images, caplog):
    frames, library = images
    network = build_network("panoresnet", "magnitudes", SIZE, relative=True)
    build(network, library, frames, progress=False)
    assert "positions are in 'steps': the network compares images in metres" in caplog.text
    caplog.clear()
    build(network, library, replace(frames, unit="m"), progress=False)
    build(Small(), library, frames, progress=False)
    assert "in metres" not in caplog.text


def test_another_descriptor_can_be_chosen_for_the_headings_of_a_network(images):
    frames, library = images
    network = build_network("panoresnet", "fourier", SIZE, circular=True)
    known = build(network, library, frames, heading="hog", progress=False)
    assert known.heading["name"] == "hog"
    assert not known.heading_by_network
    with pytest.raises(ConfigError, match="network cannot find the headings of a map by hog"):
        build("hog", library, frames, heading=as_descriptor(network), progress=False)
    other = build(build_network("panoresnet", "flat", SIZE, circular=True), library, frames, progress=False)
    assert other.heading is None
