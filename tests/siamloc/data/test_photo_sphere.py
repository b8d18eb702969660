from __future__ import annotations

import cv2
import numpy as np
import pytest

from siamloc.data import EquirectangularCamera, FrameTable, PanoramaLibrary
from siamloc.data.decoding import Preprocessing
from siamloc.data.photo_sphere import framed, is_equirectangular, levelled
from siamloc.data.ring import find_camera
from siamloc.errors import DataError
from siamloc.maps import build
from siamloc.runtime import Localizer, export

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


def cropped(left, right, top, bottom):
    said = {"ProjectionType": "equirectangular", "FullPanoWidthPixels": WIDE, "FullPanoHeightPixels": WIDE // 2}
    said |= {"CroppedAreaImageWidthPixels": right - left, "CroppedAreaImageHeightPixels": bottom - top}
    return photo()[top:bottom, left:right], said | {"CroppedAreaLeftPixels": left, "CroppedAreaTopPixels": top}


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
    path = saved(tmp_path / "a.jpg", photo(10.0), PosePitchDegrees=10.0)
    whole, mounted = EquirectangularCamera(), EquirectangularCamera(elevation=3.0)
    assert levelled(mounted, path) == mounted
    assert levelled(whole, path).elevation == 10
    make = Preprocessing.checked(SIZE, whole, ELEVATIONS)
    given = make.panorama(path, [0.0, np.radians(10.0)])  # the front down, contrary to what the picture says
    np.testing.assert_array_equal(given, make.prepare(cv2.imread(path)[..., ::-1], [0.0, np.radians(10.0)]))


def test_a_part_is_placed_where_it_was(tmp_path):
    part, said = cropped(0, WIDE, 100, 420)
    paths = [saved(tmp_path / f"{number}.jpg", part, **said) for number in range(2)]
    whole = saved(tmp_path / "whole.jpg", photo())
    images = PanoramaLibrary(
        FrameTable(path=paths), tmp_path / "cache", unwrap=EquirectangularCamera(), elevations=ELEVATIONS
    )
    camera = images.cameras[""]
    assert (camera.turn, camera.azimuth) == (360, 0)
    assert (camera.highest, camera.lowest) == pytest.approx((90 - 180 * 100 / 512, 90 - 180 * 420 / 512))
    expected = Preprocessing.checked((128, 512), EquirectangularCamera(), ELEVATIONS).panorama(whole)
    assert difference(images.batch([0])[0], expected) < 1
    assert find_camera(paths) == camera
    assert Preprocessing(images.preprocessing.view, camera).words().startswith("unwrap=equirectangular unwrap.highest=")


def test_a_part_of_the_turn_looks_where_its_middle_was(tmp_path):
    left, right = WIDE // 2, WIDE - 100  # to the right of the middle
    part, said = cropped(left, right, 60, 480)
    path = saved(tmp_path / "a.jpg", part, **said)
    camera = framed(EquirectangularCamera(azimuth=10), path, part.shape[:2])
    seen = camera.back_project(np.array([[0.0, 100.0], [part.shape[1] - 1.0, 100.0]]), part.shape[:2])
    there = EquirectangularCamera(azimuth=10).back_project(
        np.array([[left, 160.0], [right - 1.0, 160.0]]), (WIDE // 2, WIDE)
    )
    np.testing.assert_allclose(seen, there, atol=1e-12)


@pytest.mark.parametrize(
    "wrong",
    [
        {"CroppedAreaImageHeightPixels": 200},  # cut since, and not said
        {"FullPanoHeightPixels": WIDE},
        {"FullPanoWidthPixels": "none"},
        {"CroppedAreaTopPixels": -4},
        {"CroppedAreaLeftPixels": 40},
        {"FullPanoWidthPixels": "inf"},
    ],
)
def test_properties_that_make_no_sense_say_nothing(tmp_path, wrong):
    part, said = cropped(0, WIDE, 100, 420)
    path = saved(tmp_path / "a.jpg", part, **{**said, **wrong})
    assert framed(EquirectangularCamera(), path, part.shape[:2]) == EquirectangularCamera()
    assert is_equirectangular(path)


def test_what_the_user_says_of_a_part_stays(tmp_path):
    part, said = cropped(0, WIDE, 100, 420)
    path = saved(tmp_path / "a.jpg", part, **said)
    given = EquirectangularCamera(highest=40, lowest=-60)
    assert framed(given, path, part.shape[:2]) == given


def test_pictures_without_properties_and_missing_ones_say_nothing(tmp_path):
    path = saved(tmp_path / "a.jpg", photo())
    for one in (path, tmp_path / "missing.jpg"):
        assert not is_equirectangular(one)
        assert levelled(EquirectangularCamera(), one) == framed(EquirectangularCamera(), one) == EquirectangularCamera()


def test_a_part_that_is_only_resized_is_warned_of(tmp_path, caplog):
    part, said = cropped(0, WIDE, 100, 420)
    frames = FrameTable(path=[saved(tmp_path / "a.jpg", part, **said)])
    PanoramaLibrary(frames, tmp_path / "cache")
    assert "images of 1024 x 320 px look like equirectangular pictures" in caplog.text


def test_the_robot_takes_pictures_of_the_part_that_the_map_s_pictures_show(tmp_path):
    part, said = cropped(0, WIDE, 100, 420)
    (tmp_path / "drive").mkdir()
    paths = [saved(tmp_path / f"drive/{number}.jpg", np.roll(part, 70 * number, axis=1), **said) for number in range(3)]
    frames = FrameTable(path=paths, x=np.arange(3.0), y=np.zeros(3))
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=SIZE, unwrap={"kind": "equirectangular"})
    export("hog", build("hog", images, frames, progress=False), tmp_path / "bundle")
    localizer = Localizer(tmp_path / "bundle")
    assert localizer.locate(paths[1]).x == localizer.locate(cv2.imread(paths[1])[..., ::-1]).x == 1
    with pytest.raises(DataError, match=r"1024 x 512 px, .* give pictures of that size"):
        localizer.locate(photo())
