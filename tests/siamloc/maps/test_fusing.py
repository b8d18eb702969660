"""Maps by fused descriptors: typical distances, and weights from validation frames."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import cv2
import numpy as np
import pytest

import analytic
import siamloc
from analytic import Description, Descriptor, Fused
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.errors import ConfigError, DataError
from siamloc.maps import ErrorModel, Refinement, VisualMap, build, describe, match
from siamloc.maps.fusing import _grid, check_apart, weighted
from siamloc.models import as_descriptor
from siamloc.models import build as build_network
from tests.drawn import ROOMS, draw_panorama
from tests.siamloc.maps.conftest import placed

SIZE = (32, 128)


class Given(Descriptor):
    """A part whose descriptors the tests give themselves."""

    name = "given"
    identity: ClassVar = {"name": "given"}

    def describe(self, batch):
        raise NotImplementedError


def weights_of(blocks, frames, asked=None, validation=None):
    """Weigh parts (n, D_i) given by name, with those of the validation frames (m, D_i)."""
    by = Fused({name: Given() for name in blocks}, widths={name: one.shape[1] for name, one in blocks.items()})
    joined = [None if some is None else by.joined(some) for some in (blocks, asked)]
    return weighted(by, joined[0], frames, joined[1], validation)


@pytest.fixture
def parts():
    """A part that shows the place, and a part of noise with larger distances, in a map and on a validation drive."""
    rng = np.random.default_rng(0)
    along = np.arange(20.0)
    shows = [(at[:, None] * [1, 0]).astype(np.float32) for at in (along, along + 0.3)]
    noise = [rng.normal(size=(20, 30), scale=50).astype(np.float32) for _ in range(2)]
    known, asked = ({"shows": a, "noise": b} for a, b in zip(shows, noise, strict=True))
    frames = placed(np.stack([along, 0 * along], 1), room=np.where(along < 10, "a", "b"))
    validation = placed(np.stack([along + 0.3, 0 * along], 1), room=np.where(along < 10, "a", "b"))
    return known, frames, asked, validation


def test_a_useless_part_gets_no_weight_and_typical_distances_are_medians(parts):
    known, frames, asked, validation = parts
    by, told = weights_of(known, frames, asked, validation)
    assert by.complete
    assert by.weights["shows"] > by.weights["noise"]
    assert "learned on 20 validation frames: mean error 0.30 m" in told
    apart = np.abs(np.subtract.outer(np.arange(20), np.arange(20)))[np.triu_indices(20, 1)]
    assert by.typical["shows"] == np.median(apart)


def test_without_positions_rooms_count(parts):
    known, frames, asked, validation = parts
    bare = [FrameTable(path=table.path, room=table.room) for table in (frames, validation)]
    by, told = weights_of(known, bare[0], asked, bare[1])
    assert by.weights["shows"] > 0.5
    assert "share of wrong rooms 0.0%" in told


def test_without_validation_frames_weights_are_equal_and_a_sentence_says_why(parts):
    known, frames, asked, validation = parts
    by, told = weights_of(known, frames)
    assert by.weights == {"shows": 0.5, "noise": 0.5}
    assert told == "shows 0.5, noise 0.5 (equal, since there are no validation frames to learn them from)"
    _, told = weights_of(known, frames, asked, FrameTable(path=validation.path))
    assert "neither positions nor rooms" in told


@pytest.mark.parametrize("parts", [2, 3, 5, 9])
def test_a_grid_of_weights_has_the_sum_1_everywhere(parts):
    grid = _grid(parts)
    np.testing.assert_allclose(grid.sum(axis=1), 1)
    assert (grid >= 0).all()
    assert len(np.unique(grid, axis=0)) == len(grid) <= 300
    for corner in np.eye(parts):
        assert (grid == corner).all(axis=1).any()


@pytest.fixture(scope="module")
def drives():
    images = siamloc.data.example()
    return images, *(images.frames.select(sequence=day) for day in ("monday", "tuesday"))


def test_a_map_keeps_weights_and_describes_queries_from_its_file_alone(drives, tmp_path):
    images, monday, tuesday = drives
    known = build(["hog", "hsv", "thumbnail"], images, monday, validation=tuesday, progress=False)
    assert known.made["fusion"].endswith("with equal weights 0.00 m)")
    known.save(tmp_path / "map.npz")
    loaded = VisualMap.load(tmp_path / "map.npz")
    assert loaded.descriptor.identity == known.descriptor.identity
    seen = Description.concatenate(list(describe(loaded, images, monday)))
    np.testing.assert_array_equal(seen.position, known.descriptors)
    assert match(loaded, seen).indices[:, 0].tolist() == list(range(len(monday)))
    assert loaded.heading_by.tells_heading
    bare = Fused({name: analytic.descriptor(name) for name in ("hog", "hsv", "thumbnail")})
    assert loaded.with_descriptor(bare).descriptor.weights == known.descriptor.weights
    other = Fused(bare.parts, weights={"hog": 1, "hsv": 0, "thumbnail": 0})
    with pytest.raises(ConfigError, match=r"weights\.hog is 0\.\d+ in the map, 1\.0 here"):
        loaded.with_descriptor(other)


def test_weights_are_not_learned_by_positions_in_another_unit(drives):
    images, monday, tuesday = drives
    millimetres = replace(tuesday, x=1000 * tuesday.x, y=1000 * tuesday.y, unit="mm")
    with pytest.raises(DataError, match="positions count in m and mm cannot be joined or compared"):
        build(["hog", "hsv"], images, monday, validation=millimetres, progress=False)
    nowhere = replace(millimetres, x=np.full(len(tuesday), np.nan))
    known = build(["hog", "hsv"], images, monday, validation=nowhere, progress=False)
    assert "share of wrong rooms" in known.made["fusion"]


def test_parts_in_another_order_are_joined_in_that_of_the_map(drives):
    images, monday, _ = drives
    known = build(["hsv", "hog"], images, monday, progress=False)
    turned = Fused({name: analytic.descriptor(name) for name in ("hog", "hsv")})
    by = known.with_descriptor(turned)
    np.testing.assert_array_equal(Description.concatenate(list(describe(by, images, monday))).position, by.descriptors)
    numbers = {key: known.identity[key] for key in ("weights", "typical", "widths")}
    other = build(Fused(turned.parts, **numbers), images, images.frames.select(sequence="tuesday"), progress=False)
    with pytest.raises(ConfigError, match="the parts are hsv, hog in the map, hog, hsv here"):
        known.merge(other)


def test_given_weights_need_no_other_drive(drives):
    images, monday, _ = drives
    by = Fused({name: analytic.descriptor(name) for name in ("hog", "hsv")}, weights={"hog": 1, "hsv": 1})
    assert build(by, images, monday, validation=monday, progress=False).made["fusion"].endswith("(as given)")


def test_frames_without_drives_are_told_apart_by_their_images():
    tables = [FrameTable(path=paths) for paths in (["a.png", "b.png"], ["c.png"], ["b.png"])]
    check_apart(*tables[:2])
    with pytest.raises(ConfigError, match=r"b\.png' is in the map and in the validation"):
        check_apart(tables[0], tables[2])


def test_a_bundle_of_names_whose_columns_are_no_full_turn_and_whose_errors_are_of_its_map(drives, tmp_path):
    table = drives[1]
    images = PanoramaLibrary(drives[0].frames, tmp_path / "cache", image_size=SIZE, circular=False)
    known = build(["hsv", "hog"], images, table, progress=False)
    seen = Description.concatenate(list(describe(known, images, drives[2])))
    fitted = ErrorModel.fit(match(known, seen, 5), table.xy, np.linspace(0, 1, len(drives[2])))
    errors = replace(fitted, map_digest=known.digest)
    made = siamloc.runtime.export(["hsv", "hog"], known, tmp_path / "bundle", errors=errors)
    assert [one.get("circular") for one in made.identity["parts"].values()].count(False) >= 1
    assert made.about["errors"]["map_digest"] == made.load("map.npz").placed().digest != errors.map_digest


@pytest.mark.parametrize(
    ("names", "says"),
    [
        ([], "a list of two descriptors or more"),
        (["hog"], "a list of two descriptors or more"),
        (["hog", "hog"], "hog is twice among the parts"),
        (["hog", "hgo"], "did you mean 'hog'"),
    ],
)
def test_lists_that_make_no_sense(drives, names, says):
    images, monday, _ = drives
    with pytest.raises(ConfigError, match=says):
        build(names, images, monday, progress=False)


def test_weights_are_not_learned_on_the_drive_of_the_map(drives):
    images, monday, _ = drives
    with pytest.raises(ConfigError, match="'monday' is in the map and in the validation"):
        build(["hog", "hsv"], images, monday, validation=monday, progress=False)


def test_a_network_that_compares_images_still_refines_poses(tmp_path):
    for number in range(6):
        drawn = draw_panorama(0.3 * number, -0.2, 0.0, ROOMS[number // 3], size=SIZE)
        assert cv2.imwrite(str(tmp_path / f"{number}.png"), drawn)
    frames = FrameTable(
        path=[str(tmp_path / f"{number}.png") for number in range(6)],
        x=0.3 * np.arange(6),
        y=np.zeros(6),
        theta=np.zeros(6),
    )
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=SIZE)
    relative = {"image_size": SIZE, "circular": True, "relative": True, "colours": True}
    network = as_descriptor(build_network("panoresnet", "fourier", **relative), "cpu")
    known = build(["hog", network], images, frames, progress=False)
    assert list(known.descriptor.parts) == ["network", "hog"], "the part that compares comes first"
    assert known.heading_by_network
    alone = build(network, images, frames, progress=False)
    scale = np.linalg.norm(known.learned[0]) / np.linalg.norm(alone.learned[0])
    np.testing.assert_allclose(known.learned, alone.learned * scale, rtol=1e-4, atol=1e-6)
    seen = Description.concatenate(list(describe(known, images, frames)))
    found = match(known, seen, 3)
    poses = Refinement("relative", 3, 1.0, map_digest=known.digest).poses(known, seen, found)
    assert np.isfinite(poses.xy).all()
    idle = build(Fused(known.descriptor.parts, weights={"network": 0, "hog": 1}), images, frames, progress=False)
    assert idle.learned.any(axis=1).all(), "a network that does not count leaves the other parts to learn from"
    assert match(idle, Description.concatenate(list(describe(idle, images, frames)))).indices[:, 0].tolist() == [
        *range(6)
    ]
