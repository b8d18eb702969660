from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from siamloc.data.cameras import HyperbolicMirror
from siamloc.data.panorama import (
    PanoramaView,
    PolarRing,
    azimuth_column,
    column_azimuth,
    finer,
    points_of,
    seen,
    unwrap,
)
from siamloc.errors import ConfigError, DataError
from tests.oracles import mirror as oracle

VIEW = PanoramaView()
MIRRORS = [
    HyperbolicMirror(),
    HyperbolicMirror(fx=700, fy=650, cx=500.5, cy=480, eccentricity=1.2, focal_parameter=0.1),
    HyperbolicMirror(forward=37.0),
    HyperbolicMirror(mirrored=False, forward=-120.0),
]
# Azimuth and elevation in degrees: all around, across the seam behind the robot, up and down.
DIRECTIONS = [(0, 0), (90, 10), (-90, -30), (180, -10), (-179, 5), (45, 20), (-135, -40), (12.3, -5)]


def elevation_row(view, elevation):
    """The row at which an elevation in rad appears: rows are evenly spaced in its tangent."""
    high, low = np.tan(np.radians([view.top, view.bottom]))
    return (np.tan(elevation) - high) / (low - high) * view.height - 0.5


def direction(azimuth: float, elevation: float) -> np.ndarray:
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def with_blob(size: tuple[int, int], column: float, row: float, channels: int = 0) -> np.ndarray:
    """Draw one bright Gaussian blob at a fractional pixel."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    image = np.round(255 * np.exp(-((columns - column) ** 2 + (rows - row) ** 2) / 12.5)).astype(np.uint8)
    return np.stack([image] * channels, axis=-1) if channels else image


def blob_at(panorama: np.ndarray) -> tuple[float, float]:
    """Return the fractional column (on the circle) and row of the centre of brightness."""
    weight = panorama.astype(float)
    assert weight.sum() > 0, "nothing is seen"
    angle = 2 * np.pi * np.arange(weight.shape[1]) / weight.shape[1]
    column = np.angle((weight.sum(axis=0) * np.exp(1j * angle)).sum()) * weight.shape[1] / (2 * np.pi)
    row = (weight.sum(axis=1) * np.arange(weight.shape[0])).sum() / weight.sum()
    return column % weight.shape[1], row


def circular_gap(a: float, b: float, period: float) -> float:
    return abs((a - b + period / 2) % period - period / 2)


def test_the_middle_looks_ahead_and_columns_run_clockwise():
    assert azimuth_column(0.0, 512) == 255.5
    assert azimuth_column(np.pi / 2, 512) == pytest.approx(127.5)
    assert azimuth_column(-np.pi / 2, 512) == pytest.approx(383.5)
    assert column_azimuth(512)[0] == pytest.approx(np.pi - np.pi / 512)


@pytest.mark.parametrize("mirror", MIRRORS)
@pytest.mark.parametrize("angles", DIRECTIONS)
def test_projection_agrees_with_tracing_a_ray_that_the_mirror_reflects(mirror, angles):
    """The ray meets the hyperbola's sheet, and reflection there sends it to the camera."""
    unit = direction(*angles)
    np.testing.assert_allclose(mirror.project(3.7 * unit), oracle.pixel(unit, mirror), atol=1e-6)
    point = mirror.focal_parameter / (1 - mirror.eccentricity * unit[2]) * unit
    assert oracle.path_difference(point, mirror) == pytest.approx(2 * oracle.half_axis(mirror), rel=1e-9)
    normal = oracle.surface_normal(point, mirror)
    to_camera = np.array([0, 0, -mirror.camera_depth]) - point
    reflected = -unit - 2 * (-unit @ normal) * normal
    np.testing.assert_allclose(reflected, to_camera / np.linalg.norm(to_camera), atol=1e-6)


@pytest.mark.parametrize("mirror", MIRRORS)
def test_project_and_back_project_are_inverse(mirror):
    rng = np.random.default_rng(0)
    azimuth = rng.uniform(-np.pi, np.pi, 500)
    elevation = rng.uniform(-1.5, mirror.highest_elevation - 0.02, 500)
    level = np.cos(elevation)
    units = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    np.testing.assert_allclose(mirror.back_project(mirror.project(units)), units, atol=1e-9)


def test_what_the_mirror_does_not_show_is_nan():
    mirror = HyperbolicMirror()
    high = direction(10, np.degrees(mirror.highest_elevation) + 1)
    assert np.isnan(mirror.project(high)).all()
    assert np.isnan(mirror.back_project(np.array([5000.0, 0.0]))).all()


@pytest.mark.parametrize("channels", [0, 3])
@pytest.mark.parametrize("angles", [angles for angles in DIRECTIONS if angles[1] <= 10])
@pytest.mark.parametrize("options", [{}, {"forward": 90.0}, {"forward": -33.0}, {"mirrored": False}])
def test_a_blob_in_the_mirror_is_found_at_its_azimuth_and_elevation(angles, options, channels):
    mirror = HyperbolicMirror(fx=600, fy=600, cx=639.5, cy=479.5, **options)
    column, row = oracle.pixel(direction(*angles), mirror)
    panorama = unwrap(with_blob((960, 1280), column, row, channels), mirror)
    assert panorama.shape == ((128, 512, 3) if channels else (128, 512))
    found_column, found_row = blob_at(panorama[..., 0] if channels else panorama)
    azimuth, elevation = np.radians(angles)
    assert circular_gap(found_column, azimuth_column(azimuth, 512), 512) < 0.5
    assert found_row == pytest.approx(float(elevation_row(VIEW, elevation)), abs=0.7)


@pytest.mark.parametrize("angles", [(0, 0.5), (90, 0.2), (-90, 0.8), (180, 0.5), (33, 0.7)])
@pytest.mark.parametrize("inside_up", [False, True])
@pytest.mark.parametrize("options", [{}, {"forward": 90.0}, {"mirrored": False}])
def test_a_blob_in_the_ring_is_found_by_polar_unwrapping(angles, inside_up, options):
    """By hand: angles turn clockwise from the upper rim, and the left appears on the right (or not)."""
    azimuth, share_from_top = np.radians(angles[0]), angles[1]
    ring = PolarRing(centre=(310.0, 250.0), inner=60, outer=230, inside_up=inside_up, **options)
    radius = 60 + share_from_top * 170 if inside_up else 230 - share_from_top * 170
    clockwise = np.radians(options.get("forward", 0)) + (azimuth if options.get("mirrored", True) else -azimuth)
    image = with_blob((480, 640), 310 + radius * np.sin(clockwise), 250 - radius * np.cos(clockwise))
    found_column, found_row = blob_at(unwrap(image, ring))
    assert circular_gap(found_column, azimuth_column(azimuth, 512), 512) < 0.5
    assert found_row == pytest.approx(share_from_top * 128 - 0.5, abs=0.7)


def test_a_ring_without_numbers_is_the_largest_in_the_image():
    image = np.zeros((101, 141, 3), np.uint8)
    cv2.circle(image, (70, 50), 49, (255, 0, 0), 2)
    panorama = unwrap(image, PolarRing())
    assert (panorama[:3, :, 0].max(axis=0) > 120).all()
    assert panorama[20:].max() == 0


def test_what_lies_outside_the_image_is_known_and_filled_with_what_is_next_to_it():
    ring, view = PolarRing(inner=10, outer=80), PanoramaView()
    inside = seen(ring, view, (100, 100))
    radius = 80 - (np.arange(128) + 0.5) / 128 * 70
    assert not inside[radius > 49.5 * 2**0.5 + 1].any()
    assert inside[radius < 49].all()
    panorama = unwrap(np.full((100, 100), 200, np.uint8), ring)
    assert panorama.min() == panorama.max() == 200
    half = np.zeros((100, 100), np.uint8)
    half[:50] = 200
    filled = unwrap(half, ring)[0].astype(int)
    assert filled[256 - 40 : 256 + 40].min() > 180, "ahead"
    assert filled[[*range(40), *range(-40, 0)]].max() < 20, "behind"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PanoramaView(height=0), "panorama.height must be a whole number from 1 to .*, got 0"),
        (lambda: PanoramaView(top=-50), "-90 < bottom < top < 90"),
        (lambda: HyperbolicMirror(eccentricity=1.0), "unwrap.eccentricity must be a number above 1, got 1.0"),
        (lambda: HyperbolicMirror(fx=0), "unwrap.fx must be a number above 0, got 0"),
    ],
)
def test_impossible_geometry(make, message):
    with pytest.raises(ConfigError, match=message):
        make()


def test_impossible_unwrapping():
    image = np.zeros((100, 100, 3), np.uint8)
    with pytest.raises(ConfigError, match=r"ring from 0.2 to 1 px is thinner than a pixel.* images of 100 x 100"):
        unwrap(image, PolarRing(outer=1))
    with pytest.raises(ConfigError, match=r"only 0% of the ring around \(49.5, 49.5\) from 20000 to 100000 px lie in"):
        unwrap(image, PolarRing(outer=100_000))
    with pytest.raises(ConfigError, match=r"looks up to 60 degrees, .* above 45\.6 degrees: lower the view's top"):
        unwrap(image, HyperbolicMirror(eccentricity=1.4), PanoramaView(top=60))
    for shape in [(1, 100), (0, 0, 3), (100,)]:
        with pytest.raises(DataError, match="has shape"):
            unwrap(np.zeros(shape, np.uint8), PolarRing())


@pytest.mark.parametrize(
    ("returned", "got"),
    [
        (lambda columns, rows: (columns.T, rows.T), r"\(512, 128\) and \(512, 128\)"),
        (lambda columns, rows: (columns[:3, :3], rows), r"\(3, 3\) and \(128, 512\)"),
        (lambda columns, rows: (columns.tolist(), rows.tolist()), "list and list"),
        (lambda columns, rows: columns, r"\(128, 512\)"),
        (lambda columns, rows: None, "NoneType"),
    ],
)
def test_a_camera_of_ones_own_that_samples_in_another_shape_is_refused(returned, got):
    @dataclass(frozen=True)
    class Own:
        def sampling(self, view, image_size):
            return returned(*PolarRing().sampling(view, image_size))

    message = rf"`sampling` of Own must return two arrays \(H, W\) = \(128, 512\), .* got {got}$"
    view, size = PanoramaView(), (480, 640)
    for call in (
        lambda: unwrap(np.zeros(size, np.uint8), Own()),
        lambda: seen(Own(), view, size),
        lambda: finer(Own(), view, size),
        lambda: points_of(Own(), view, size),
    ):
        with pytest.raises(ConfigError, match=message):
            call()


def test_a_camera_of_ones_own_without_plain_values_is_refused():
    @dataclass(frozen=True)
    class Own:
        values: object = ()

        def sampling(self, view, image_size):
            return PolarRing().sampling(view, image_size)

    image = np.zeros((480, 640), np.uint8)
    assert unwrap(image, Own((1.0, 2.0))).shape == (128, 512)

    @dataclass
    class Changing:
        sampling = Own.sampling

    for camera in (Own([1.0, 2.0]), Own(np.ones(2)), Changing()):
        name = type(camera).__name__
        with pytest.raises(ConfigError, match=rf"{name} cannot be told .*unhashable.*: make it a frozen dataclass"):
            unwrap(image, camera)


def test_a_camera_of_ones_own_that_samples_only_one_size_is_refused():
    @dataclass(frozen=True)
    class Own:
        points = 2

        def sampling(self, view, image_size):
            return PolarRing().sampling(PanoramaView(), image_size)

    with pytest.raises(ConfigError, match=r"`sampling` of Own must return two arrays \(H, W\) = \(256, 1024\), "):
        unwrap(np.zeros((480, 640), np.uint8), Own())
