"""`siamloc.walk`, from a bag or a folder of pictures to a bundle that locates another drive."""

from __future__ import annotations

import html
import inspect
import re

import cv2
import numpy as np
import pytest

import siamloc
from siamloc.data import PanoramaView
from siamloc.data.ring import likely_mirror
from siamloc.errors import ConfigError, DataError
from tests.bags import Written, jpeg

START = 1_700_000_000


@pytest.fixture(scope="module")
def mini(tmp_path_factory):
    """Return a drive of 30 m by day, 0.3 m from frame to frame, and one at night, through a small building."""
    out = tmp_path_factory.mktemp("mini")
    for run, spacing, frames in (("cloudy1", 0.3, 100), ("night1", 1.5, 20)):
        siamloc.simulate.simulate(
            out=out, building="mini", camera="panorama", runs=[run], spacing=spacing, frames=frames
        )
    both = siamloc.data.read("cold", root=out / "mini")
    both = both.take(np.argsort(both.time, kind="stable"))
    return both.select(sequence="*cloudy1"), both.select(sequence="*night1")


def test_the_help_describes_every_keyword():
    described = re.findall(r"^    (\w+): ", siamloc.walk.__doc__ or "", flags=re.MULTILINE)
    assert set(inspect.signature(siamloc.walk).parameters) <= set(described)


def equirectangular(path):
    """Return a whole equirectangular picture (256, 512, 3) that shows what a panorama shows, and else is black."""
    panorama, view = cv2.imread(path), PanoramaView()
    elevation = np.pi / 2 - (np.arange(256) + 0.5) / 256 * np.pi
    high, low = np.tan(np.radians([view.top, view.bottom]))
    rows = (high - np.tan(elevation)) / (high - low) * view.height - 0.5
    across = np.broadcast_to(np.arange(512, dtype=np.float32), (256, 512))
    down = np.broadcast_to(rows[:, None], (256, 512)).astype(np.float32)
    return cv2.remap(panorama, across.copy(), down.copy(), cv2.INTER_LINEAR)


def pictures_of(frames, folder):
    """Make a folder of the pictures of frames, two a second, with times in their names."""
    folder.mkdir()
    for number, path in enumerate(frames.path.tolist()):
        (folder / f"{START + number / 2:.1f}.jpeg").hardlink_to(path)
    return folder


def test_a_bag_of_equirectangular_pictures_with_odometry_becomes_a_robot(mini, tmp_path):
    day, night = mini
    bag = Written(tmp_path / "monday", "mcap")
    with bag.writer:
        for number, (path, x, y, theta) in enumerate(zip(day.path.tolist(), day.x, day.y, day.theta, strict=True)):
            time = (2 * START + number) * 500_000_000
            content = np.frombuffer(jpeg(equirectangular(path)), dtype=np.uint8)
            kind = "sensor_msgs/msg/CompressedImage"
            bag.write("/camera/compressed", kind, time, header=bag.header(time), format="jpeg", data=content)
            bag.odometry("/odom", time, x, y, theta)
    said = []
    made = siamloc.walk(bag.path, tmp_path / "robot", say=said.append, spacing=0.25)
    assert "with odometry" in said[0]
    assert said[1].startswith("camera: unwrap=equirectangular")
    assert made.survey.fixed_by == "odometry"
    located = siamloc.runtime.Localizer(made.bundle.path)
    asked = [located.locate(equirectangular(path)[..., ::-1]) for path in night.path.tolist()]
    found = siamloc.data.moves.composed(
        np.tile([day.x[0], day.y[0], day.theta[0]], (len(asked), 1)), np.array([[one.x, one.y, 0] for one in asked])
    )
    assert np.median(np.hypot(*(found[:, :2] - night.xy).T)) < 0.3  # a key frame is 0.3 m from the next
    page = (tmp_path / "robot" / "report.html").read_text(encoding="utf-8")
    assert "coloured dots the surveyed positions of queries" in page
    assert all(html.escape(line.removeprefix("note: ")) in page for line in said[:-3]), "each decision is on the page"


def test_a_folder_of_panoramas_without_odometry_becomes_a_robot(mini, tmp_path, monkeypatch):
    day, _ = mini
    monkeypatch.setattr("siamloc.walking._POSITIONS", 0.001)
    pictures, said = pictures_of(day, tmp_path / "monday"), []
    height = siamloc.maps.SurveySettings(height=0.95)  # of the simulated camera
    made = siamloc.walk(pictures, tmp_path / "robot", say=said.append, spacing=0.25, survey=height)
    assert "without odometry" in said[0]
    assert said[1].startswith("camera: unwrap=none (unwrap=), for pictures of ")
    assert ", assumed to be panoramas of 30 to -45 degrees of elevation: " in said[1]
    assert "unwrap=equirectangular unwrap.highest=30 unwrap.lowest=-45" in said[1]
    assert made.survey.fixed_by == "height"
    (doubted,) = (line for line in said if line.startswith("note: "))
    assert doubted.startswith("note: the survey is not exact, its positions only within 0.")
    assert "give odometry (recording.odometry=), or record a way" in doubted  # the height is given
    wanted = day.xy[np.rint(2 * (made.survey.frames.time - START)).astype(int)]
    spread, expected = (np.sqrt(one.var(axis=0).sum()) for one in (made.survey.frames.xy, wanted))
    assert spread / expected == pytest.approx(1, abs=0.06)
    assert made.bundle.path == tmp_path / "robot" / "bundle"
    parts = siamloc.data.read("manifest", manifest=tmp_path / "robot" / "parts.csv").rows_by("sequence")
    counts = {name: len(rows) for name, rows in parts.items()}
    assert counts["map"] == pytest.approx(2 * sum(counts.values()) / 3, abs=1)
    assert abs(counts["query"] - counts["validation"]) <= 1


def test_a_short_way_is_refused(mini, tmp_path):
    pictures = pictures_of(mini[0].take(range(5)), tmp_path / "monday")
    with pytest.raises(DataError, match=r"has [2-5] key frames, and a map needs 60: record [123]\d\.0 times this way"):
        siamloc.walk(pictures, tmp_path / "robot", spacing=0.25)


def test_pictures_without_their_second_ones_are_not_judged(tmp_path):
    pictures, said = tmp_path / "monday", []
    pictures.mkdir()
    for number in range(4):
        cv2.imwrite(str(pictures / f"front_{number}.png"), np.zeros((80, 80, 3), np.uint8))
    lenses = {"kind": "dual_fisheye", "second": ["front", "back"]}
    with pytest.raises(DataError, match=r"none of the 4 images can be read, .*its second picture .* does not exist"):
        siamloc.walk(pictures, tmp_path / "robot", say=said.append, unwrap=lenses)
    assert not any(line.startswith("level: ") for line in said)


def test_a_ring_does_not_show_its_direction(mini, tmp_path, monkeypatch):
    pictures, said = pictures_of(mini[0].take(range(3)), tmp_path / "monday"), []
    ring = siamloc.data.PolarRing(centre=(255.5, 63.5), inner=10, outer=60, forward=90)
    monkeypatch.setattr("siamloc.walking.find_camera", lambda *_: ring)
    with pytest.raises(DataError, match="key frames"):
        siamloc.walk(pictures, tmp_path / "robot", say=said.append)
    assert said[2] == "direction: the robot is taken to drive ahead, and the picture to be mirrored (unwrap.mirrored=)"


def test_the_elevation_of_an_inner_rim_is_said_if_it_is_not_that_of_a_panorama(mini, tmp_path, monkeypatch):
    pictures, said = pictures_of(mini[0].take(range(3)), tmp_path / "monday"), []
    ring = likely_mirror(siamloc.data.PolarRing(centre=(255.5, 63.5), inner=10, outer=60))
    monkeypatch.setattr("siamloc.walking.find_camera", lambda *_: ring)
    with pytest.raises(DataError, match="key frames"):
        siamloc.walk(pictures, tmp_path / "robot", say=said.append)
    assert said[2].startswith("rims: the inner rim is taken for -")


def test_faults_of_the_pictures_are_said_first(mini, tmp_path):
    pictures, said = tmp_path / "monday", []
    pictures.mkdir()
    for number, path in enumerate(mini[0].path.tolist()[:12]):
        image = cv2.imread(path)
        image[: len(image) // 2] = 0
        cv2.imwrite(str(pictures / f"{START + number / 2:.1f}.png"), image)
    (pictures / f"{START + 9:.1f}.png").write_bytes(b"cut short")  # which is left out
    with pytest.raises(DataError, match="key frames"):
        siamloc.walk(pictures, tmp_path / "robot", say=said.append)
    assert [line for line in said if line.startswith("note: ")] == [
        "note: 50% of the panorama is black in all images: check unwrap, and what covers the camera, or use a longer "
        "exposure"
    ]


def test_a_camera_that_does_not_see_all_around_is_named_first(tmp_path):
    pictures, said = tmp_path / "monday", []
    pictures.mkdir()
    for number in range(4):
        cv2.imwrite(str(pictures / f"{START + number}.png"), np.full((80, 80, 3), 90, np.uint8))
    with pytest.raises(DataError, match="key frames"):
        siamloc.walk(pictures, tmp_path / "robot", say=said.append, unwrap={"kind": "fisheye", "fov": 190})
    (note,) = (line for line in said if line.startswith("note: "))
    assert note.startswith("note: the camera does not see 47% of a panorama from 30 to -45 degrees (in no row all ")


pytestmark = pytest.mark.slow


def test_a_bundle_that_robots_updated_is_not_replaced_unasked(tmp_path):
    frames = siamloc.data.FrameTable(path=["a.png", "b.png"])
    known = siamloc.maps.VisualMap(np.eye(2), frames, made={"upkeep": {"drives": ["monday", "drive-1@2.5"]}})
    known.save(tmp_path / "bundle" / "map.npz")
    with pytest.raises(ConfigError, match=r"lacks, 1 of them, the last is drive-1@2.5: .* with overwrite=true"):
        siamloc.walk(tmp_path / "nowhere", tmp_path)
