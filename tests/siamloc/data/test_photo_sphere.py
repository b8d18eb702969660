from __future__ import annotations

import cv2
import numpy as np
import pytest

from siamloc.data import EquirectangularCamera, FrameTable, PanoramaLibrary, PolarRing, check, seen
from siamloc.data.decoding import Preprocessing
from siamloc.data.photo_sphere import is_equirectangular, stated
from siamloc.data.ring import find_camera
from siamloc.maps import build
from siamloc.runtime import Localizer, export

KIND = "equirectangular"
SIZE, WIDE = (64, 128), 1024  # of the panoramas, and pixels of a whole picture
ELEVATIONS = (30.0, -45.0)


def world(azimuth, elevation):
    """Colours (..., 3), BGR, by azimuth (counter-clockwise) and elevation in rad: smooth, and different everywhere."""
    waves = [np.cos(azimuth - 0.3), np.sin(2 * azimuth) * np.cos(elevation), np.sin(3 * elevation + np.cos(azimuth))]
    return (127 + 100 * np.stack(waves, axis=-1)).round().astype(np.uint8)


def photo(pitch=0.0, roll=0.0):
    """Return a whole equirectangular picture by a camera whose middle looks `pitch` degrees up, its right side down."""
    rows, columns = WIDE // 2, WIDE
    right = ((np.arange(columns) + 0.5) / columns - 0.5) * 2 * np.pi
    up = (0.5 - (np.arange(rows) + 0.5) / rows) * np.pi
    right, up = np.meshgrid(right, up)
    x, y, z = np.cos(up) * np.sin(right), np.sin(up), np.cos(up) * np.cos(right)  # to the right, up, ahead
    phi, rho = np.radians([pitch, roll])
    x, y = x * np.cos(rho) + y * np.sin(rho), y * np.cos(rho) - x * np.sin(rho)  # its right side was down
    y, z = y * np.cos(phi) + z * np.sin(phi), z * np.cos(phi) - y * np.sin(phi)  # and its front up
    return world(np.arctan2(-x, z), np.arcsin(np.clip(y, -1, 1)))


def saved(path, picture, form="attributes", **said):
    """Write a JPEG with Photo Sphere properties, as attributes or as elements of its XMP."""
    data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    namespace = 'xmlns:GPano="http://ns.google.com/photos/1.0/panorama/"'
    if form == "attributes":
        about = f"<rdf:Description {namespace} " + " ".join(f'GPano:{key}="{value}"' for key, value in said.items())
        about += "/>"
    else:
        inside = "".join(f"<GPano:{key}>{value}</GPano:{key}>\n" for key, value in said.items())
        about = f"<rdf:Description {namespace}>{inside}</rdf:Description>"
    segment = b"http://ns.adobe.com/xap/1.0/\0" + f"<x:xmpmeta><rdf:RDF>{about}</rdf:RDF></x:xmpmeta>".encode()
    app1 = b"\xff\xe1" + (len(segment) + 2).to_bytes(2, "big") + segment
    path.write_bytes(data[:2] + app1 + data[2:] if said else data)
    return str(path)


def cropped(left, right, top, bottom, picture=None):
    said = {"ProjectionType": KIND, "FullPanoWidthPixels": WIDE, "FullPanoHeightPixels": WIDE // 2}
    said |= {"CroppedAreaImageWidthPixels": right - left, "CroppedAreaImageHeightPixels": bottom - top}
    return (photo() if picture is None else picture)[top:bottom, left:right], said | {
        "CroppedAreaLeftPixels": left,
        "CroppedAreaTopPixels": top,
    }


def difference(one, other):
    return np.abs(one.astype(float) - other).mean()


@pytest.mark.parametrize("form", ["attributes", "elements"])
@pytest.mark.parametrize(("pitch", "roll"), [(15.0, 0.0), (0.0, 12.0), (-8.0, 20.0)])
def test_pictures_are_levelled_by_the_tilt_that_they_state(tmp_path, form, pitch, roll):
    said = {"PosePitchDegrees": pitch, "PoseRollDegrees": roll, "PoseHeadingDegrees": 77.0}
    level = saved(tmp_path / "level.jpg", photo())
    tilted = saved(tmp_path / "tilted.jpg", photo(pitch, roll), form, **said)
    silent = saved(tmp_path / "silent.jpg", photo(pitch, roll))
    make = Preprocessing.checked(SIZE, EquirectangularCamera(azimuth=40), ELEVATIONS)
    expected = make.panorama(level)
    assert difference(make.panorama(tilted), expected) < 1  # JPEG, and half a pixel of interpolation
    assert difference(make.panorama(silent), expected) > 5


def test_a_tilt_that_the_user_gives_goes_before_that_of_the_picture(tmp_path):
    path = saved(tmp_path / "a.jpg", photo(), PosePitchDegrees=10.0)  # was levelled since, without a word
    whole, mounted, size = EquirectangularCamera(), EquirectangularCamera(elevation=3.0), (WIDE // 2, WIDE)
    assert stated(mounted, path, size) == mounted
    assert stated(whole, path, size, levelled=True) == whole
    assert stated(whole, path, size).elevation == 10
    make = Preprocessing.checked(SIZE, whole, ELEVATIONS)
    level = make.prepare(cv2.imread(path)[..., ::-1])
    np.testing.assert_array_equal(make.panorama(path, [0.0, 0.0]), level)
    assert difference(make.panorama(path), level) > 5
    assert difference(make.panorama(path, [np.nan, np.nan]), level) > 5
    for known, columns in ((False, {}), (True, {"roll": [0.0], "pitch": [0.0]})):
        frames = FrameTable(path=[path], **columns)
        images = PanoramaLibrary(frames, tmp_path / "cache", image_size=SIZE, unwrap=whole, elevations=ELEVATIONS)
        assert (difference(images.batch([0])[0], level) < 1) == known


@pytest.mark.parametrize("place", [(0, WIDE, 100, 420), (WIDE // 2, WIDE - 100, 60, 480), (200, 840, 80, 400)])
@pytest.mark.parametrize(("pitch", "roll"), [(0.0, 0.0), (10.0, -8.0)])
def test_a_part_is_placed_where_it_was_and_levelled(tmp_path, place, pitch, roll):
    """The last one is twice as wide as high, as a whole picture is."""
    part, said = cropped(*place, photo(pitch, roll))
    path = saved(tmp_path / "a.jpg", part, **said, PosePitchDegrees=pitch, PoseRollDegrees=roll)
    whole = Preprocessing.checked(SIZE, EquirectangularCamera(azimuth=30), ELEVATIONS)
    camera = stated(whole.camera, path, part.shape[:2])
    shown = seen(camera, whole.view, part.shape[:2])
    shown &= cv2.erode(shown.astype(np.uint8), np.ones((3, 3))) > 0
    assert shown.mean() > 0.2
    off = np.abs(whole.panorama(path).astype(float) - whole.panorama(saved(tmp_path / "whole.jpg", photo())))
    assert off[:, shown].mean() < 1
    pixels = np.array([[5.0, 100.0], [part.shape[1] - 9.0, 140.0]])
    np.testing.assert_allclose(camera.project(camera.back_project(pixels, part.shape[:2]), part.shape[:2]), pixels)


def test_each_picture_of_a_drive_shows_its_own_part(tmp_path):
    (tmp_path / "0.jpg").write_bytes(b"")
    paths = [str(tmp_path / "0.jpg"), saved(tmp_path / "1.jpg", photo())]
    for number, place in enumerate([(0, WIDE, 100, 420), (200, 840, 80, 400)], 2):
        part, said = cropped(*place)
        paths.append(saved(tmp_path / f"{number}.jpg", part, **said))
    assert find_camera(paths) == EquirectangularCamera()
    frames = FrameTable(path=paths, x=np.arange(4.0), y=np.zeros(4), room=["a"] * 4)
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=SIZE, unwrap={"kind": "equirectangular"})
    assert [one["path"] for one in images.rejected] == paths[:1]
    assert difference(images.batch([1])[0], images.batch([0])[0]) < 1
    middle = slice(SIZE[1] // 2 - 20, SIZE[1] // 2 + 20)
    assert difference(images.batch([2])[0][..., middle], images.batch([0])[0][..., middle]) < 1
    assert not [one for one in check(images.frames, images) if "shape" in one or "does not see" in one]


@pytest.mark.parametrize(
    "wrong",
    [
        {"CroppedAreaImageHeightPixels": 200},  # cut since, and not said
        {"FullPanoHeightPixels": WIDE},
        {"FullPanoWidthPixels": "none"},
        {"CroppedAreaTopPixels": -4},
        {"CroppedAreaTopPixels": ""},
        {"CroppedAreaLeftPixels": 40},
        {"FullPanoWidthPixels": "inf"},
        {"PosePitchDegrees": "1e300"},
        {"PoseRollDegrees": -181},
        {"PosePitchDegrees": "nan"},
    ],
)
def test_properties_that_make_no_sense_say_nothing(tmp_path, wrong):
    part, said = cropped(0, WIDE, 100, 420)
    if "Pose" in next(iter(wrong)):
        part, said = photo(), {"ProjectionType": "equirectangular"}
    path = saved(tmp_path / "a.jpg", part, **{**said, **wrong})
    assert stated(EquirectangularCamera(), path, part.shape[:2]) == EquirectangularCamera()
    assert is_equirectangular(path)


def test_what_the_user_says_of_a_part_stays(tmp_path):
    part, said = cropped(0, WIDE, 100, 420)
    path = saved(tmp_path / "a.jpg", part, **said)
    given = EquirectangularCamera(highest=40, lowest=-60)
    assert stated(given, path, part.shape[:2]) == given


def test_pictures_without_properties_missing_ones_and_other_cameras_say_nothing(tmp_path):
    whole, ring = EquirectangularCamera(), PolarRing()
    for path in (saved(tmp_path / "a.jpg", photo()), tmp_path / "missing.jpg"):
        assert not is_equirectangular(path)
        assert stated(whole, path, (WIDE // 2, WIDE)) == whole
    assert stated(ring, saved(tmp_path / "b.jpg", photo(), PosePitchDegrees=5), (WIDE // 2, WIDE)) == ring


def test_a_part_that_is_only_resized_is_warned_of(tmp_path, caplog):
    part, said = cropped(0, WIDE, 100, 420)
    frames = FrameTable(path=[saved(tmp_path / "a.jpg", part, **said)])
    PanoramaLibrary(frames, tmp_path / "cache")
    assert "images of 1024 x 320 px look like equirectangular pictures" in caplog.text


def test_a_picture_that_was_cut_since_is_not_taken_for_a_whole_one(tmp_path):
    part, said = cropped(0, WIDE, 100, 420)
    paths = [saved(tmp_path / "a.jpg", part[:300], **said), saved(tmp_path / "b.jpg", part[:300], ProjectionType=KIND)]
    assert find_camera(paths) is None
    assert find_camera([*paths, saved(tmp_path / "c.jpg", part, **said)]) == EquirectangularCamera()


def test_what_a_part_does_not_show_is_no_seam(tmp_path):
    part, said = cropped(100, 900, 60, 480)
    paths = [saved(tmp_path / f"{number}.jpg", np.roll(part, number, axis=1), **said) for number in range(12)]
    frames = FrameTable(path=paths, x=np.arange(12.0), y=np.zeros(12), room=["a"] * 12)
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=SIZE, unwrap={"kind": "equirectangular"})
    found = check(frames, images)
    assert [one for one in found if "does not see" in one]
    assert not [one for one in found if "seam" in one or "horizon" in one]


def test_the_robot_places_each_picture_as_the_map_did(tmp_path):
    (tmp_path / "drive").mkdir()
    paths = []
    for number in range(3):
        part, said = cropped(0, WIDE, 100, 420, np.roll(photo(), 70 * number, axis=1))
        paths.append(saved(tmp_path / f"drive/{number}.jpg", part, **said))
    frames = FrameTable(path=paths, x=np.arange(3.0), y=np.zeros(3))
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=SIZE, unwrap={"kind": "equirectangular"})
    export("hog", build("hog", images, frames, progress=False), tmp_path / "bundle")
    localizer = Localizer(tmp_path / "bundle")
    other, said = cropped(0, WIDE, 90, 400, np.roll(photo(), 70, axis=1))
    for image in (paths[1], np.roll(photo(), 70, axis=1)[..., ::-1], saved(tmp_path / "b.jpg", other, **said)):
        assert localizer.locate(image).x == 1
