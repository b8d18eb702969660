"""The robot's side: what a bundle gives, with and without headings and an error model, and without torch or scipy."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import analytic
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError, FormatError
from siamloc.files import file_hash, read_json, write_json
from siamloc.maps import HeadingPart, VisualMap, WithHeading, estimated_headings
from siamloc.maps.error_model import ErrorModel
from siamloc.models import SiameseModule
from siamloc.runtime import Bundle, Localizer, write_bundle
from siamloc.runtime.bundle import learned_on
from tests.drawn import ROOMS, draw_panorama, draw_sequence

SIZE = (32, 128)
IMAGES = {"height": 32, "width": 128, "camera": None}


def drive(seed: int, lighting: str = "cloudy") -> tuple[np.ndarray, FrameTable]:
    poses = draw_sequence(seed, 8)
    pictures = [draw_panorama(p["local_x"], p["y"], p["theta"], p["room"], lighting)[..., ::-1] for p in poses]
    columns = {key: np.array([pose[key] for pose in poses]) for key in ("x", "y", "theta", "room")}
    return np.stack(pictures), FrameTable(np.array([f"{seed}/{i}.png" for i in range(len(poses))]), **columns)


@pytest.fixture(scope="module")
def world():
    """A network, a map with headings, and an error model."""
    network = SiameseModule("simple1", "fc500_500_5", SIZE)
    hog = analytic.descriptor("hog", rows=1)
    both = WithHeading(network, hog)
    pictures, frames = drive(0)
    seen = both.describe(pictures.transpose(0, 3, 1, 2))
    part = HeadingPart.of(hog, seen.orientation)
    known = VisualMap(seen.position, frames, {**network.identity, "images": IMAGES}, heading=part)
    pictures, _ = drive(1)
    found = known.search(network.describe(pictures.transpose(0, 3, 1, 2)).position, 20)
    errors = ErrorModel("ratio", 1.0, 20, (0.0, 0.5, 1.0), (0.1, 0.4, 3.0), 24, map_digest=known.digest)
    return network, known, replace(errors, lost_above=float(np.median(errors.predict(found, known.frames.xy))))


def bundled(folder, world, **changed):
    network, known, errors = world
    errors = changed.get("errors", errors)
    write_bundle(
        folder,
        network,
        known,
        image_size=SIZE,
        unwrap={"kind": "none"},
        circular=True,
        identity=known.identity,
        errors=errors,
    )
    return folder


@pytest.fixture(scope="module")
def bundle(world, tmp_path_factory):
    return bundled(tmp_path_factory.mktemp("robot") / "bundle", world)


@pytest.fixture(scope="module")
def bare(world, tmp_path_factory):
    return bundled(tmp_path_factory.mktemp("robot") / "bare", replaced(world, heading=None), errors=None)


def replaced(world, **changed):
    network, known, errors = world
    known = replace(known, **changed)
    return network, known, replace(errors, map_digest=known.digest)


def rewritten(bundle, folder, **parts):
    """A copy of a bundle with other parts, as if it had been exported with them."""
    shutil.copytree(bundle, folder)
    about = read_json(folder / "bundle.json")
    for name, part in parts.items():
        file = {"map": "map.npz", "errors": "error_model.json"}[name]
        part.save(folder / file)
        about["sha256"][file] = file_hash(folder / file)
    write_json(folder / "bundle.json", about)
    return folder


def test_theta_and_error_are_those_of_the_evaluation(world, bundle):
    network, known, errors = world
    pictures, _ = drive(2)
    seen = WithHeading(network, known.heading.descriptor()).describe(pictures.transpose(0, 3, 1, 2))
    found = known.search(seen.position, 20)
    theta = estimated_headings(known.oriented(), seen, known.heading.descriptor(), found)
    expected = errors.predict(found, known.frames.xy)
    localizer = Localizer(bundle, top=2)
    locations = [localizer.locate(picture) for picture in pictures]
    np.testing.assert_allclose([location.theta for location in locations], theta, rtol=0, atol=1e-9)
    np.testing.assert_allclose([location.error_m for location in locations], expected, rtol=1e-3)
    assert [location.lost for location in locations] == errors.lost(expected).tolist()
    assert {location.lost for location in locations} == {True, False}
    assert [location.x for location in locations] == known.frames.x[found.indices[:, 0]].tolist()
    assert {len(location.candidates) for location in locations} == {2}


def test_turning_the_robot_turns_theta_alone(bundle):
    localizer, picture = Localizer(bundle), drive(0)[0][5]
    straight = localizer.locate(picture)
    for columns in (10, -36, 64):
        turned = localizer.locate(np.roll(picture, columns, axis=1))
        if turned.candidates[0] == straight.candidates[0]:
            assert math.remainder(turned.theta - straight.theta - columns * math.tau / 128, math.tau) == pytest.approx(
                0
            )
        assert -math.pi < turned.theta <= math.pi


def test_frames_of_the_map_are_found_with_their_own_heading(world, bundle):
    pictures, frames = drive(0)
    localizer = Localizer(bundle)
    located = [localizer.locate(picture) for picture in pictures]
    np.testing.assert_allclose(
        np.angle(np.exp(1j * (np.array([at.theta for at in located]) - frames.theta))), 0, atol=1e-9
    )
    np.testing.assert_allclose([at.error_m for at in located], world[2].errors[0], atol=1e-3)


def test_bundle_json_says_what_the_robot_is_told(world, bundle):
    _, known, errors = world
    about = read_json(bundle / "bundle.json")
    assert set(about["sha256"]) == {"model.onnx", "map.npz", "heading.onnx", "error_model.json"}
    assert about["heading"]["identity"] == known.heading.identity
    assert about["heading"]["parity"]["headings"] == 4
    assert ErrorModel.from_dict(about["errors"]) == errors == ErrorModel.load(bundle / "error_model.json")
    opened = Bundle.open(bundle)
    assert (opened.has_map, opened.has_heading, opened.has_errors) == (True, True, True)


def test_what_the_bundle_lacks_is_not_told(bare):
    assert sorted(path.name for path in bare.iterdir()) == ["bundle.json", "map.npz", "model.onnx"]
    location = Localizer(bare).locate(drive(2)[0][0])
    assert math.isnan(location.theta)
    assert math.isnan(location.error_m)
    assert location.lost is None
    assert location.room in ROOMS


def test_a_bundle_of_the_first_version_opens(bare, tmp_path):
    folder = rewritten(bare, tmp_path / "older")
    about = read_json(folder / "bundle.json")
    assert about["version"] == 2
    older = {key: value for key, value in about.items() if key not in ("heading", "errors")}
    write_json(folder / "bundle.json", {**older, "version": 1})
    assert Localizer(folder).locate(drive(2)[0][0]).lost is None
    write_json(folder / "bundle.json", {**about, "version": 3})
    with pytest.raises(FormatError, match="bundle version 3, this siamloc reads up to 2: update siamloc"):
        Localizer(folder)


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("version", None, "was not written by `siamloc export`"),
        ("version", "2", "was not written by `siamloc export`"),
        ("sha256", [], "is altered in sha256"),
        ("sha256", {}, "lists no model.onnx"),
        ("image_size", 5, "is altered in image_size"),
        ("image_size", [32], "is altered in image_size or unwrap"),
        ("unwrap", None, "lacks unwrap"),
        ("unwrap", {"kind": "polar", "centre": 3}, "is altered in image_size or unwrap"),
        ("unwrap", {"kind": "fisheye"}, "is altered in image_size or unwrap"),
        ("identity", "vgg16", "is altered in identity"),
    ],
)
def test_an_altered_description_is_refused(bare, tmp_path, key, value, says):
    folder = rewritten(bare, tmp_path / "bundle")
    about = read_json(folder / "bundle.json")
    write_json(folder / "bundle.json", {k: v for k, v in {**about, key: value}.items() if v is not None})
    with pytest.raises(FormatError, match=f"{says}.*: export anew"):
        Bundle.open(folder)


def test_a_model_without_threshold_gives_no_verdict(world, bundle, tmp_path):
    folder = rewritten(bundle, tmp_path / "bundle", errors=replace(world[2], lost_above=None))
    location = Localizer(folder).locate(drive(2)[0][0])
    assert location.error_m >= 0
    assert location.lost is None


def test_a_map_without_thetas_gives_no_heading(world, bundle, tmp_path):
    known = world[1]
    blind = replace(known, frames=replace(known.frames, theta=np.full(len(known), np.nan)))
    assert math.isnan(Localizer(rewritten(bundle, tmp_path / "bundle", map=blind)).locate(drive(2)[0][0]).theta)


def test_the_expected_error_rests_on_frames_that_have_a_position(world, bundle, tmp_path):
    network, known, errors = world
    bare = np.arange(len(known)) % 3 == 1
    holes = replace(known, frames=replace(known.frames, x=np.where(bare, np.nan, known.frames.x)))
    placed = holes.take(~bare)
    assert learned_on(replace(errors, map_digest=placed.digest), holes)
    assert not learned_on(errors, holes)
    localizer = Localizer(rewritten(bundle, tmp_path / "bundle", map=holes))
    pictures, _ = drive(2)
    vectors = network.describe(pictures.transpose(0, 3, 1, 2)).position
    nearest = holes.search(vectors).indices[:, 0]
    expected = errors.predict(placed.search(vectors, 20), placed.frames.xy)
    told = [localizer.locate(picture).error_m for picture in pictures]
    np.testing.assert_allclose(told, np.where(bare[nearest], np.nan, expected), rtol=1e-3)
    assert 0 < bare[nearest].sum() < len(nearest)


def test_a_model_learned_on_another_map_is_refused(world, tmp_path):
    with pytest.raises(ConfigError, match="learned on another map than the bundle's: learn it anew"):
        bundled(tmp_path / "bundle", world, errors=replace(world[2], map_digest=""))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["heading.onnx", "error_model.json"])
def test_altered_files_are_refused(bundle, tmp_path, name):
    folder = rewritten(bundle, tmp_path / "bundle")
    (folder / name).write_bytes((folder / name).read_bytes() + b" ")
    with pytest.raises(FormatError, match=f"{name} is missing or not the file the bundle was written with"):
        Localizer(folder)


def test_a_bundle_takes_the_place_of_an_older_one(world, bundle, tmp_path):
    folder = rewritten(bundle, tmp_path / "bundle")
    bundled(folder, world, errors=None)
    assert not (folder / "error_model.json").exists()
    assert file_hash(folder / "heading.onnx") == read_json(folder / "bundle.json")["sha256"]["heading.onnx"]


def test_the_robot_needs_numpy_opencv_and_onnxruntime_alone(bundle, tmp_path):
    np.save(tmp_path / "picture.npy", drive(2)[0][3])
    code = f"""
import sys
for name in ("torch", "torchvision", "lightning", "scipy", "sklearn", "pandas", "hydra", "omegaconf", "onnx", "rich"):
    sys.modules[name] = None
import json
import numpy as np
from siamloc.runtime import Localizer
location = Localizer({str(bundle)!r}).locate(np.load({str(tmp_path / "picture.npy")!r}))
print(json.dumps([location.x, location.y, location.theta, location.error_m, location.lost]))
"""
    root = Path(__file__).parents[3]
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, cwd=root)
    assert done.returncode == 0, done.stderr
    here = Localizer(bundle).locate(drive(2)[0][3])
    assert json.loads(done.stdout) == pytest.approx([here.x, here.y, here.theta, here.error_m, here.lost])
