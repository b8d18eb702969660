from __future__ import annotations

import dataclasses
import shlex

import cv2
import numpy as np
import pytest

from siamloc.cli.compose import composed
from siamloc.data import DualFisheyeCamera, FisheyeCamera, OCamCamera
from siamloc.data.decoding import Preprocessing
from siamloc.data.image_files import UnreadableImageError, decode_image, read_image
from siamloc.data.panorama import PanoramaView, PolarRing, unwrap
from siamloc.errors import ConfigError, DataError


def picture(rows: int = 48, columns: int = 64, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).integers(0, 256, (rows, columns, 3), dtype=np.uint8)
    return cv2.GaussianBlur(noise, (0, 0), 2)


def test_resizing_averages_areas_and_colours_come_as_red_green_blue(tmp_path):
    image = picture(32, 128)
    cv2.imwrite(str(tmp_path / "a.png"), image)
    panorama = Preprocessing.checked((16, 32)).panorama(tmp_path / "a.png")
    assert panorama.flags.c_contiguous
    expected = image.reshape(16, 2, 32, 4, 3).mean(axis=(1, 3))[..., ::-1].transpose(2, 0, 1)
    assert np.abs(panorama - expected).max() <= 0.5


def test_unwrapping_uses_the_camera_and_the_view(tmp_path):
    image = picture(100, 120)
    cv2.imwrite(str(tmp_path / "a.png"), image)
    ring, view = PolarRing(inner=10, outer=40), PanoramaView(16, 32, top=20, bottom=-10)
    got = Preprocessing(view, ring).panorama(tmp_path / "a.png")
    np.testing.assert_array_equal(got, unwrap(image[..., ::-1].copy(), ring, view).transpose(2, 0, 1))


@pytest.mark.parametrize("camera", [None, PolarRing()])
def test_grey_images_get_three_equal_channels(tmp_path, camera):
    cv2.imwrite(str(tmp_path / "a.jpg"), picture()[..., 0])
    panorama = Preprocessing.checked((16, 32), camera).panorama(tmp_path / "a.jpg")
    assert panorama.max() > 0
    np.testing.assert_array_equal(panorama[0], panorama[1])
    np.testing.assert_array_equal(panorama[0], panorama[2])


def test_unreadable_files_say_why(tmp_path):
    jpeg, png = (cv2.imencode(suffix, picture())[1].tobytes() for suffix in (".jpg", ".png"))
    thumbnail = jpeg[:2] + b"\xff\xe1\x00\x08" + b"\xff\xda\xff\xd9\x00\x00" + jpeg[2 : len(jpeg) // 2]
    path = tmp_path / "a.jpg"
    for data, reason in (
        (b"", "the file is empty"),
        (jpeg[: len(jpeg) // 2], "cut short"),
        (jpeg[:-1], "cut short"),
        (thumbnail, "cut short"),
        (png[: len(png) // 2], "cut short"),
        (b"no image at all", "not an image"),
        (cv2.imencode(".tif", np.ones((8, 16), np.float32))[1].tobytes(), "32-bit floats: save it with 8 or 16 bits"),
        (b"\0\0\0\x1cftypheic\0\0\0\0mif1heic", "HEIC or AVIF picture or a video: convert it to JPEG"),
        (jpeg[:20] + b"\xff\xd9", "not an image|cannot be decoded"),
    ):
        path.write_bytes(data)
        with pytest.raises(UnreadableImageError, match=reason):
            read_image(path)
    path.write_bytes(jpeg + b"\0" * 10)
    assert read_image(path).shape == (48, 64, 3), "bytes after the end do no harm"
    for other, reason in ((tmp_path, "[Ii]s a directory"), (tmp_path / "none.jpg", "does not exist")):
        with pytest.raises(UnreadableImageError, match=reason):
            read_image(other)


@pytest.mark.parametrize("ending", ["png", "tif", "ppm"])
def test_images_that_use_twelve_of_sixteen_bits_are_brightened_alike(ending, tmp_path, caplog):
    shades = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64) % 256
    for name, image in (("dark", shades), ("light", shades << 4), ("other", shades << 3)):
        cv2.imwrite(str(tmp_path / f"{name}.{ending}"), cv2.merge([image] * 3))
    for name, shift in (("dark", 4), ("light", 0), ("other", 1)):
        found = read_image(tmp_path / f"{name}.{ending}")
        np.testing.assert_array_equal(found, np.repeat((shades >> shift)[..., None], 3, axis=2))
    (said,) = caplog.records
    assert "use 12 of 16 bits" in said.getMessage()
    whole = cv2.imencode(f".{ending}", cv2.merge([shades << 8] * 3))[1].tobytes()
    np.testing.assert_array_equal(decode_image(whole)[..., 0], shades)


def test_a_ppm_of_ten_bits_is_read_as_bright_as_it_says(tmp_path):
    shades = np.arange(48 * 64, dtype=">u2").reshape(48, 64) % 1024
    (tmp_path / "ten.ppm").write_bytes(b"P5 64 48 1023\n" + shades.astype(">u2").tobytes())
    np.testing.assert_array_equal(read_image(tmp_path / "ten.ppm")[..., 0], shades >> 2)


def test_dark_images_of_sixteen_bits_use_as_many_as_their_sensor_has(tmp_path):
    """The brightest of eleven bits is a dark one of twelve; and whoever knows the bits need not ask the folder."""
    shades = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64) % 2048
    cv2.imwrite(str(tmp_path / "dark.png"), shades)
    (content,) = (path.read_bytes() for path in tmp_path.iterdir())
    for found in (read_image(tmp_path / "dark.png"), decode_image(content)):
        np.testing.assert_array_equal(found[..., 0], shades >> 4)
    for found in (read_image(tmp_path / "dark.png", bits=14), decode_image(content, bits=14)):
        np.testing.assert_array_equal(found[..., 0], shades >> 6)


def test_pictures_of_another_size_are_scaled_to_the_pixels_in_which_the_camera_counts(tmp_path, caplog):
    ring = Preprocessing(PanoramaView(16, 64), PolarRing(centre=(63.5, 47.5), inner=10, outer=40), size=(96, 128))
    whole, large = picture(96, 128), cv2.resize(picture(96, 128), (256, 192))
    apart = ring.prepare(large).astype(int) - ring.prepare(whole)
    assert np.abs(apart).mean() < 2
    assert "have 256 x 192 px, and the camera's parameters count in those of 128 x 96: they are scaled" in caplog.text
    with pytest.raises(DataError, match=r"the picture has 128 x 128 px, .* give pictures of that size"):
        ring.prepare(picture(128, 128))


def test_a_camera_that_does_not_fit(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), picture())
    with pytest.raises(ConfigError, match="thinner than a pixel"):
        Preprocessing.checked((16, 32), PolarRing(inner=50)).panorama(tmp_path / "a.png")
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((1, 1, 3), np.uint8))
    with pytest.raises(UnreadableImageError, match="has shape"):
        Preprocessing.checked((16, 32), PolarRing()).panorama(tmp_path / "a.png")


@dataclasses.dataclass(frozen=True)
class OwnRing(PolarRing):
    """A camera class that siamloc does not know."""


@pytest.mark.parametrize(
    "camera",
    [
        DualFisheyeCamera(back=FisheyeCamera(fov=200.0, k=(0.1, 0.0, 0.0, -1e-7)), second=("_00_", "_10_")),
        OCamCamera(image_size=(480, 640), mirrored=True),
        PolarRing(centre=(31.5, 24.0), inner=3),
        OwnRing(inner=3),
        None,
    ],
)
def test_the_words_of_a_camera_are_those_of_the_command_line(camera):
    made = Preprocessing.checked((128, 512), camera)
    words = shlex.split(made.words())
    job = composed("prepare", ["data=manifest", "data.manifest=robot.csv", *words])
    assert Preprocessing.checked((128, 512), job.unwrap) == made
    assert len(words) <= 4 or type(camera) is OwnRing  # what is as usual is left out
