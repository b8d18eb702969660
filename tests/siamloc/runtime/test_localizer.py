"""The robot's side: what a bundle gives, with and without headings and an error model, and without torch or scipy."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

import analytic
from foundation.files import file_hash, read_json
from siamloc.data.decoding import Preprocessing
from siamloc.data.names import NamedPose
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.maps import headings
from siamloc.maps.error_model import ErrorModel
from siamloc.models import as_descriptor, build
from siamloc.runtime import Bundle, Localizer, Located, export, locate_all, written
from tests.drawn import ROOMS
from tests.installed import printed
from tests.siamloc.runtime.conftest import IMAGES, SIZE, batch, drive, mapped, rewritten

PICTURES = drive(2)[0]


@pytest.fixture(scope="module")
def world(small):
    """A network, a map with headings, and an error model."""
    network, _ = small
    known = mapped(network, analytic.descriptor("hog", rows=1))
    pictures, _ = drive(1)
    found = known.search(network.describe(batch(pictures)).position, 20)
    errors = ErrorModel("ratio", 1.0, 20, (0.0, 0.5, 1.0), (0.1, 0.4, 3.0), 24, map_digest=known.digest)
    return network, known, replace(errors, lost_above=float(np.median(errors.predict(found, known.frames.xy))))


@pytest.fixture(scope="module")
def bundle(world, tmp_path_factory):
    network, known, errors = world
    return export(network, known, tmp_path_factory.mktemp("robot") / "bundle", errors=errors).path


def test_theta_and_error_are_those_of_the_evaluation(world, bundle):
    _, known, errors = world
    seen = known.describe(batch(PICTURES))
    found = known.search(seen.position, 20)
    theta = headings(known, seen, found)[:, 0]
    expected = errors.predict(found, known.frames.xy)
    localizer = Localizer(bundle, top=2)
    locations = [localizer.locate(picture) for picture in PICTURES]
    np.testing.assert_allclose([location.theta for location in locations], theta, rtol=0, atol=1e-9)
    np.testing.assert_allclose([location.error_m for location in locations], expected, rtol=1e-3)
    assert [location.lost for location in locations] == (expected > errors.lost_above).tolist()
    assert {location.lost for location in locations} == {True, False}
    assert [location.x for location in locations] == known.frames.x[found.indices[:, 0]].tolist()
    assert {len(location.candidates) for location in locations} == {2}


def test_where_frames_have_no_room_the_robot_is_told_its_building_if_there_are_several(tmp_path):
    hog = analytic.descriptor("hog", rows=4)
    known = mapped(hog)

    def told(name, **columns):
        frames = known.frames.with_columns(**columns)
        localizer = Localizer(export(hog, replace(known, frames=frames), tmp_path / name).path, top=1)
        found = [
            localizer.locate(drive(0)[0][row], tracker) for row in (0, -1) for tracker in (None, localizer.tracker())
        ]
        assert [one.room for one in found] == [one.candidates[0].room for one in found]
        return [one.room for one in found[::2]]

    two = np.repeat(["up", "down"], 12)
    assert told("bare", building=two, room=[""] * 24) == ["up", "down"]
    assert told("half", building=two, room=np.where(two == "up", "", "lab")) == ["up", "down/lab"]
    assert told("one", building=["up"] * 24, room=[""] * 24) == ["", ""]


def test_turning_the_robot_turns_theta_alone(bundle):
    localizer, picture = Localizer(bundle), drive(0)[0][5]
    straight = localizer.locate(picture)
    for columns in (10, -36, 64):
        turned = localizer.locate(np.roll(picture, columns, axis=1))
        if turned.candidates[0] == straight.candidates[0]:
            off = turned.theta - straight.theta - columns * math.tau / 128
            assert math.remainder(off, math.tau) == pytest.approx(0)
        assert -math.pi < turned.theta <= math.pi


def test_bundle_json_says_what_the_robot_is_told(world, bundle):
    _, known, errors = world
    about = read_json(bundle / "bundle.json")
    assert set(about["sha256"]) == {"model.onnx", "map.npz", "error_model.json"}
    assert about["heading"]["identity"] == known.heading
    assert (about["precision"], about["search"], about["figures"]) == ("float32", None, None)
    opened = Bundle.open(bundle)
    errors = replace(errors, map_digest=opened.load("map.npz").digest)  # whose frames name no folder of the writer
    assert ErrorModel.from_dict(about["errors"]) == errors == ErrorModel.load(bundle / "error_model.json")
    assert opened.files == ("model.onnx", "map.npz", "error_model.json")
    np.testing.assert_array_equal(opened.load("map.npz").descriptors, known.descriptors)
    assert (opened.load("error_model.json"), opened.load("refinement.json")) == (errors, None)
    assert opened.preprocessing.parameters() == IMAGES
    assert "the robot gets: position, heading (by hog), expected error (lost above" in opened.summary()


def test_what_the_bundle_lacks_is_not_told(bare):
    assert sorted(path.name for path in bare.iterdir()) == ["bundle.json", "map.npz", "model.onnx"]
    location = Localizer(bare).locate(PICTURES[0])
    assert math.isnan(location.theta)
    assert math.isnan(location.error_m)
    assert location.lost is None
    assert location.room in ROOMS


def test_an_empty_image_is_refused_in_one_sentence(bare):
    for image in (np.zeros((0, 0, 3), np.uint8), np.zeros((0, 640, 3), np.uint8), []):
        with pytest.raises(DataError, match="the image is empty: the camera returned no data"):
            Localizer(bare).locate(image)
    with pytest.raises(DataError, match="a file or an array of pixels, got Image: give the file's path"):
        Localizer(bare).locate(Image.fromarray(PICTURES[0]))


def test_a_bundle_without_a_map_describes_alone(world, tmp_path):
    network, _, _ = world
    with pytest.raises(ConfigError, match=r"give preprocessing=images\.preprocessing"):
        export(network, None, tmp_path / "bundle")
    opened = export(network.module, None, tmp_path / "bundle", preprocessing=Preprocessing.of(IMAGES))
    assert (opened.load("map.npz"), opened.image_size) == (None, SIZE)
    assert "descriptors only" in opened.summary()
    with pytest.raises(ConfigError, match="holds no map"):
        Localizer(tmp_path / "bundle")


def test_what_does_not_belong_together_is_not_exported(world, tmp_path):
    network, known, _ = world
    hog, other = analytic.descriptor("hog"), build("simple1", "fc500_500_5", SIZE, seed=1)
    wide, narrow = Preprocessing.of(IMAGES), Preprocessing.of({**IMAGES, "width": 64})
    for by, on, preprocessing, says in (
        (hog, known, None, "described differently from the queries: name is"),
        (hog, None, wide, "a bundle by hog needs a map: run `siamloc map descriptor=hog` first"),
        (other, known, None, "described differently from the queries: weights is"),
        (network, known, narrow, r"images\.width is 128 in the map, 64 here"),
    ):
        with pytest.raises(ConfigError, match=says):
            export(by, on, tmp_path / "bundle", preprocessing=preprocessing)
    assert not list(tmp_path.iterdir())


def test_locations_are_written_as_a_table(bundle, tmp_path):
    location = Localizer(bundle).locate(PICTURES[0])
    pose = NamedPose(0.0, location.x, location.y + 2, 0.0)
    located = [
        Located("a.png", location),
        Located("b.png", replace(location, theta=math.nan), pose=pose),
        Located("c.png", None, "c.png cannot be located"),
    ]
    assert list(written(tmp_path / "locations.csv", located)) == located
    header, first, second, third = (tmp_path / "locations.csv").read_text().splitlines()
    assert header == (
        "image,x,y,theta,room,error_m,lost,covariance_xx,covariance_xy,covariance_yy,agreement,match,distance,ms,off_by"
    )
    assert first.startswith(f"a.png,{location.x},{location.y},{location.theta},{location.room},")
    assert second.startswith(f"b.png,{location.x},{location.y},,{location.room},")
    assert (first[-1], second.rpartition(",")[2], third) == (",", "2.0", f"c.png{14 * ','}")
    assert location.describe("m").startswith(f"x {location.x:.2f} m, y {location.y:.2f} m, heading ")
    assert ", heading" not in replace(location, theta=math.nan).describe()
    assert ", heading 0 deg" in replace(location, theta=-0.001).describe()
    assert located[1].describe().endswith("; 2.00 m from the pose in its name")
    assert located[2].describe() == "left out: c.png cannot be located"


def test_lines_of_json_hold_the_same(bundle, tmp_path):
    location = Localizer(bundle).locate(PICTURES[0])
    for _ in written(tmp_path / "locations.jsonl", [Located("a.png", location), Located("b.png", None, "why")]):
        pass
    first, second = map(json.loads, (tmp_path / "locations.jsonl").read_text().splitlines())
    assert (first["x"], first["candidates"][0]["image"]) == (location.x, location.candidates[0].image)
    assert (first["covariance"], first["pose"], first["off_by"], first["fault"]) == (None, None, None, None)
    assert second == {"image": "b.png", "fault": "why", "pose": None, "off_by": None}
    with pytest.raises(ConfigError, match=r"must be a table \(\.csv\) or lines of JSON \(\.jsonl\)"):
        next(written(tmp_path / "locations.txt", []))


@pytest.mark.parametrize("stop", [KeyboardInterrupt("stop"), DataError("camera:0 gives no more images")])
def test_what_was_located_before_an_interrupt_or_an_error_is_kept(tmp_path, stop):
    def located(count):
        for number in range(count):
            yield Located(f"{number}.png", None, "why")
        raise stop

    target = tmp_path / "locations.csv"
    with pytest.raises(type(stop)):
        list(written(target, located(3)))
    assert [line.partition(",")[0] for line in target.read_text().splitlines()] == ["image", "0.png", "1.png", "2.png"]
    with pytest.raises(type(stop)):
        list(written(target, located(0)))
    assert "2.png" in target.read_text(), "where nothing was located, what is there stays"
    assert [path.name for path in tmp_path.iterdir()] == ["locations.csv"]


def test_names_may_begin_at_home_and_hold_bytes_that_are_no_text(bundle, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    name = os.fsdecode(b"\xe9.png")
    (tmp_path / name).write_bytes(cv2.imencode(".png", PICTURES[3])[1].tobytes())
    for kind in ("csv", "jsonl"):
        list(written(tmp_path / f"locations.{kind}", locate_all(Localizer(bundle), f"~/{name}")))
    assert "/\\udce9.png," in (tmp_path / "locations.csv").read_text()
    assert json.loads((tmp_path / "locations.jsonl").read_text())["image"] == str(tmp_path / name)


def test_a_picture_that_does_not_fit_the_camera_does_not_end_the_drive(bundle, tmp_path):
    ring = Preprocessing.checked((32, 128), {"kind": "polar", "inner": 50})
    localizer = Localizer(bundle)
    localizer.bundle = replace(localizer.bundle, preprocessing=ring)
    small, large = tmp_path / "small.png", tmp_path / "large.png"
    cv2.imwrite(str(small), np.full((20, 20, 3), 90, np.uint8))
    cv2.imwrite(str(large), np.full((240, 240, 3), 90, np.uint8))
    first, second = locate_all(localizer, [small, large])
    assert "small.png cannot be located" in first.fault
    assert second.location is not None
    with pytest.raises(DataError, match="an image of 20 x 20 cannot be located"):
        localizer.locate(np.full((20, 20, 3), 90, np.uint8))
    whole = Preprocessing.checked((32, 128), {"kind": "equirectangular"})
    localizer.bundle = replace(localizer.bundle, preprocessing=whole)
    for size, says in (((60, 80), r"say unwrap\.highest .*\(unwrap is that of"), ((80, 40), "turn it upright")):
        with pytest.raises(DataError, match=says):
            localizer.locate(np.full((*size, 3), 90, np.uint8))


def test_a_tilt_that_no_camera_model_takes_out_is_said_once(bundle, caplog):
    for angles in ([0.0, 0.0], [0.1, 0.0], [0.1, 0.2]):
        Localizer(bundle).locate(PICTURES[0], tilt=angles)
    assert [one.getMessage() for one in caplog.records] == [
        f"{bundle} knows no camera model: the tilt of the robot stays in its images"
    ]


def test_files_folders_and_videos_are_located_in_order(bundle, tmp_path):
    localizer = Localizer(bundle)
    photos = tmp_path / "photos"
    photos.mkdir()
    names = ["t1.0_x0.5_y0.25_a0.0.png", "u.png"]
    for name, picture in zip(names, PICTURES, strict=False):
        cv2.imwrite(str(photos / name), picture[..., ::-1])
    (photos / "v.png").write_text("no picture")
    film = cv2.VideoWriter(str(tmp_path / "film.avi"), cv2.VideoWriter.fourcc(*"FFV1"), 5, SIZE[::-1])
    for picture in PICTURES[:4]:
        film.write(np.ascontiguousarray(picture[..., ::-1]))
    film.release()
    found = list(locate_all(localizer, [photos, tmp_path / "film.avi", photos / "u.png"]))
    video = [f"{tmp_path / 'film.avi'}#{number}" for number in range(4)]
    first, second, damaged = (str(photos / name) for name in (*names, "v.png"))
    assert [one.image for one in found] == [first, second, damaged, *video, second]
    assert found[0].pose == NamedPose(1.0, 0.5, 0.25, 0.0)
    assert found[0].off_by == pytest.approx(math.hypot(found[0].location.x - 0.5, found[0].location.y - 0.25))
    assert found[1].pose is None
    assert found[2].location is None
    assert "v.png cannot be located" in found[2].fault
    for number, picture in enumerate(PICTURES[:4]):
        expected = localizer.locate(picture)
        got = found[3 + number].location
        assert (got.x, got.y, got.candidates) == (expected.x, expected.y, expected.candidates)
    with pytest.raises(DataError, match=r"v\.png cannot be located"):
        list(locate_all(localizer, photos, on_error="raise"))


def test_a_damaged_picture_of_a_video_is_reported_and_the_next_ones_are_located(bundle, tmp_path):
    path = tmp_path / "film.avi"
    film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 5, SIZE[::-1])
    for picture in PICTURES[:4]:
        film.write(np.ascontiguousarray(picture[..., ::-1]))
    film.release()
    content = path.read_bytes()
    _, start, after, *_ = [found.start() for found in re.finditer(b"\xff\xd8\xff", content)]
    end = after - 16  # before the head of the next picture
    path.write_bytes(content[:start] + bytes(end - start) + content[end:])
    found = list(locate_all(Localizer(bundle), path))
    assert [one.image for one in found] == [f"{path}#{number}" for number in range(4)]
    assert [one.location is None for one in found] == [False, True, False, False]
    with pytest.raises(DataError, match=r"film\.avi#1 cannot be decoded"):
        list(locate_all(Localizer(bundle), path, on_error="raise"))


def test_an_empty_video_is_one_sentence_and_no_word_of_its_decoder(tmp_path):
    (tmp_path / "film.mp4").write_bytes(b"no film")
    code = "import sys; from siamloc.runtime.stream import pictures; list(pictures(sys.argv[1]))"
    command = [sys.executable, "-c", code, tmp_path / "film.mp4"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "cannot be read as a video" in done.stderr.splitlines()[-1]
    assert done.stderr.startswith("Traceback")


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("nowhere.png", "there is no image"),
        ("empty", "holds no images; it holds: nothing$"),
        ("tuesday", r"holds no images; it holds: hall, up\.HEIC; \.heic: .*; there are some in .*tuesday/hall$"),
        ("drive.bag", "is a ROS bag: `siamloc prepare recording.file=.*drive.bag` writes its images"),
        ("monday", "monday is a ROS bag: `siamloc prepare recording.file=.*monday` writes its images"),
        ("camera:99", "camera:99 gives no image: check that it is plugged in"),
        ("camera:front", "is not a camera: give its number"),
    ],
)
def test_what_gives_no_images_is_said(bundle, tmp_path, name, says):
    (tmp_path / "empty").mkdir()
    (tmp_path / "tuesday" / "hall").mkdir(parents=True)
    for picture in ("up.HEIC", "hall/1.jpg"):
        (tmp_path / "tuesday" / picture).touch()
    (tmp_path / "drive.bag").touch()
    (tmp_path / "monday").mkdir()
    (tmp_path / "monday" / "metadata.yaml").touch()
    given = name if name.startswith("camera") else tmp_path / name
    with pytest.raises((ConfigError, DataError), match=says):
        list(locate_all(Localizer(bundle), given))
    with pytest.raises(ConfigError, match="no images given"):
        list(locate_all(Localizer(bundle), []))


def test_what_the_parts_lack_is_not_told(world, bundle, tmp_path):
    _, known, errors = world
    foreign = Localizer(
        rewritten(bundle, tmp_path / "foreign", errors=replace(errors, foreign_above=-1e6, foreign_weight=1.0))
    )
    found = [foreign.locate(picture) for picture in PICTURES]
    assert all(one.lost and np.isnan(one.error_m) for one in found), "no image shows anything of the map"
    assert "expected error" not in found[0].describe()
    silent = rewritten(bundle, tmp_path / "silent", errors=replace(errors, lost_above=None))
    location = Localizer(silent).locate(PICTURES[0])
    assert location.error_m >= 0
    assert location.lost is None
    blind = replace(known, frames=replace(known.frames, theta=np.full(len(known), np.nan)))
    assert math.isnan(Localizer(rewritten(bundle, tmp_path / "blind", map=blind)).locate(PICTURES[0]).theta)


def test_the_expected_error_rests_on_frames_that_have_a_position(world, bundle, tmp_path):
    network, known, errors = world
    bare = np.arange(len(known)) % 3 == 1
    holes = replace(known, frames=replace(known.frames, x=np.where(bare, np.nan, known.frames.x)))
    placed = holes.take(~bare)
    assert replace(errors, map_digest=placed.digest).learned_on(holes)
    assert not errors.learned_on(holes)
    localizer = Localizer(rewritten(bundle, tmp_path / "bundle", map=holes))
    vectors = network.describe(batch(PICTURES)).position
    nearest = holes.search(vectors).indices[:, 0]
    expected = errors.predict(placed.search(vectors, 20), placed.frames.xy)
    told = [localizer.locate(picture).error_m for picture in PICTURES]
    np.testing.assert_allclose(told, np.where(bare[nearest], np.nan, expected), rtol=1e-3)
    assert 0 < bare[nearest].sum() < len(nearest)


def test_a_model_learned_on_another_map_is_refused(world, tmp_path):
    with pytest.raises(ConfigError, match="learned on another map than the bundle's: learn it again"):
        export(*world[:2], tmp_path / "bundle", errors=replace(world[2], map_digest=""))
    assert not list(tmp_path.iterdir())


def test_altered_files_are_refused_and_a_bundle_takes_the_place_of_an_older_one(world, bundle, tmp_path):
    folder = rewritten(bundle, tmp_path / "bundle")
    for name in ("map.npz", "error_model.json"):
        whole = (folder / name).read_bytes()
        (folder / name).write_bytes(whole + b" ")
        with pytest.raises(FormatError, match=f"{name} is missing or not the file the bundle was written with"):
            Localizer(folder)
        (folder / name).write_bytes(whole)
    export(*world[:2], folder)
    assert not (folder / "error_model.json").exists()
    assert file_hash(folder / "map.npz") == read_json(folder / "bundle.json")["sha256"]["map.npz"]


def test_the_robot_needs_numpy_opencv_and_onnxruntime_alone(bundle, tmp_path):
    np.save(tmp_path / "picture.npy", PICTURES[3])
    shown = printed(
        f"""
import json
import numpy as np
from siamloc.runtime import Localizer
location = Localizer({str(bundle)!r}).locate(np.load({str(tmp_path / "picture.npy")!r}))
print(json.dumps([location.x, location.y, location.theta, location.error_m, location.lost]))
""",
        "robot",
    )
    here = Localizer(bundle).locate(PICTURES[3])
    assert json.loads(shown) == pytest.approx([here.x, here.y, here.theta, here.error_m, here.lost])


def test_a_network_that_finds_headings_needs_nothing_beside_it(tmp_path):
    network = as_descriptor(build("simple1", "fourier", SIZE, circular=True))
    known = mapped(network)
    bundle = export(network, known, tmp_path / "bundle")
    assert bundle.about["heading"]["identity"] == {"name": "network", "version": 1}
    assert bundle.parity["orientation"]["max_relative_difference"] <= 1e-4
    assert "the robot gets: position, heading (by network)" in bundle.summary()
    seen = known.describe(batch(PICTURES))
    expected = headings(known, seen, known.search(seen.position))[:, 0]
    localizer = Localizer(tmp_path / "bundle")
    step = 2 * np.pi / 1024
    for picture, theta in zip(PICTURES[:6], expected, strict=False):
        assert abs(math.remainder(localizer.locate(picture).theta - theta, math.tau)) <= 1.01 * step
