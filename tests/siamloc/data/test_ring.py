import cv2
import numpy as np
import pytest

from siamloc.data import (
    AutoRing,
    ColdRing,
    DualFisheyeCamera,
    EquirectangularCamera,
    FrameTable,
    HyperbolicMirror,
    PanoramaLibrary,
    PanoramaView,
    PolarRing,
    find_camera,
    find_centres,
    find_ring,
    seen,
    unwrap,
)
from siamloc.data.rims import inner_rim
from siamloc.data.ring import draw_ring, likely_mirror
from siamloc.errors import ConfigError, DataError
from tests.drawn import written

INNER, OUTER = 22.0, 88.0


def drive(count=12, centre=(151.3, 108.6), outer=OUTER, shakes=0.0, scene=1.0, struts=True, size=(220, 300), floor=1.0):
    """Paint the pictures of a drive, and return them with the centre in each; `floor` is what changes there, up to
    40 px, as a share of what changes farther out."""
    rng = np.random.default_rng(5)
    y, x = np.mgrid[0 : size[0], 0 : size[1]]
    centres = np.array(centre) + shakes * rng.uniform(-1, 1, (count, 2))
    pictures = []
    for cx, cy in centres:
        radius = np.hypot(x - cx, y - cy)
        share = np.clip(outer + 0.5 - radius, 0, 1) * np.clip(radius - INNER + 0.5, 0, 1)
        if struts:
            share[(abs(y - cy) < 5) & (x < cx)] = 0
        paint = cv2.GaussianBlur(rng.uniform(0, 255, size).astype(np.float32), (0, 0), 4)
        paint = 120 + scene * 8 * (paint - paint.mean())
        paint = np.where(radius < 40, 120 + floor * (paint - 120), paint)
        if floor < 1:  # a corner of the robot's deck
            share[(abs(np.arctan2(y - cy, x - cx)) < 0.5) & (radius < 35)] = 0
        picture = paint * share + 25 * (1 - share) * (1 + 0.3 * (radius < 9))
        picture = cv2.GaussianBlur(picture, (0, 0), 0.8) * rng.uniform(0.9, 1.1) + rng.normal(0, 2, size)
        pictures.append(picture.clip(0, 255).astype(np.uint8))
    return np.stack(pictures), centres


def test_a_ring_off_centre_with_a_strut_is_found():
    pictures, centres = drive()
    found = find_ring(pictures)
    assert np.hypot(*(np.array(found.ring.centre) - centres[0])) < 0.3
    assert abs(found.ring.outer - OUTER) < 0.5
    assert abs(found.ring.inner - INNER) < 1.5
    assert not found.shakes
    assert found.pictures == 12
    assert 0.8 < found.around <= 1
    assert "ring around (151." in found.describe()


def test_a_dull_floor_does_not_pass_for_the_middle_of_the_mirror():
    """The rim has the larger step, and the floor's end shows in more directions."""
    pictures, _ = drive(floor=0.3)
    assert abs(find_ring(pictures).ring.inner - INNER) < 1.5


def test_the_inner_rim_is_where_the_scene_begins_and_not_where_it_changes_most():
    """Half of the step at the rim counts, although the scene changes four times as much 10 px farther out."""
    y, x = np.mgrid[0:220, 0:220]
    beyond = np.hypot(x - 110, y - 110) - 30
    moving = 0.6 + 10 * (1 + beyond.clip(0, 10) / 3) * np.clip(beyond / 3 + 0.5, 0, 1)
    assert abs(inner_rim(moving, np.array([110.0, 110.0]), 100.0) - 30) < 1.5


def test_a_lens_that_looks_up_is_no_mirror_with_a_tiny_hole():
    """The ceiling above the camera changes less than what is around it."""
    radius = np.hypot(*(np.mgrid[0:220, 0:220] - 110))
    with pytest.raises(DataError, match=r"no inner rim .*: the scene reaches into the middle"):
        inner_rim(np.where(radius < 5, 2.0, 10.0), np.array([110.0, 110.0]), 100.0)


def test_files_and_colours_and_large_pictures_give_the_same_ring(tmp_path):
    pictures, centres = drive(8)
    large = [cv2.cvtColor(cv2.resize(one, None, fx=3, fy=3), cv2.COLOR_GRAY2BGR) for one in pictures]
    ring = find_ring(written(tmp_path, large)).ring
    np.testing.assert_allclose((np.array(ring.centre) + 0.5) / 3 - 0.5, centres[0], atol=0.5)
    assert abs(ring.outer / 3 - OUTER) < 1


def test_a_centre_that_shakes_is_measured_in_each_picture():
    pictures, centres = drive(shakes=3.0)
    found = find_ring(pictures)
    assert found.shakes
    np.testing.assert_allclose(found.ring.centre, centres.mean(axis=0), atol=0.3)
    np.testing.assert_allclose(find_centres(pictures, found.ring), centres, atol=0.5)
    with pytest.raises(ConfigError, match="a ring with centre and outer radius"):
        find_centres(pictures, type(found.ring)())


@pytest.mark.parametrize(
    ("pictures", "words"),
    [
        (lambda: drive(3)[0], "from 4 pictures of a drive or more, got 3"),
        (lambda: drive(8, scene=0.0)[0][:1].repeat(8, axis=0), "all alike"),
        (lambda: drive(12, centre=(151.3, 70.0))[0], "the edge of the picture cuts the ring"),
        (lambda: np.random.default_rng(0).integers(0, 255, (9, 120, 160)).astype(np.uint8), "no circle"),
        (lambda: drive(floor=0.2)[0], "two circles are as likely"),
        (lambda: [*drive(4)[0], np.zeros((50, 60), np.uint8)], "have one size"),
        (lambda: np.zeros((6, 9, 9), np.uint8), "from 40 pixels a side"),
        (lambda: ["nowhere.png"] * 5, "nowhere.png cannot be read"),
    ],
)
def test_what_is_not_sure_is_refused(pictures, words):
    with pytest.raises(DataError, match=words):
        find_ring(pictures())


def table(folder, pictures):
    return FrameTable(path=written(folder, pictures), sequence=["monday"] * len(pictures))


def test_a_library_unwraps_each_drive_by_its_own_ring(tmp_path):
    pictures, centres = drive(8)
    images = PanoramaLibrary(
        table(tmp_path, pictures), tmp_path / "cache", image_size=(32, 128), unwrap={"kind": "auto"}
    )
    ring = images.cameras["monday"]
    np.testing.assert_allclose(ring.centre, centres[0], atol=0.3)
    assert images.preprocessing.camera == AutoRing()
    expected = unwrap(cv2.cvtColor(pictures[0], cv2.COLOR_GRAY2BGR), ring, images.preprocessing.view)
    np.testing.assert_array_equal(images.batch([0])[0], expected.transpose(2, 0, 1))
    drawn = draw_ring(cv2.cvtColor(pictures[0], cv2.COLOR_GRAY2BGR), ring)
    assert drawn.shape[0] == 220
    assert (drawn[:, :300] != pictures[0][..., None]).any()
    with pytest.raises(ConfigError, match="not in single ones"):
        unwrap(pictures[0], AutoRing())


def test_the_ring_of_a_drive_is_kept_until_its_pictures_change(tmp_path, monkeypatch):
    frames = table(tmp_path, drive(6)[0])

    def camera():
        images = PanoramaLibrary(frames, tmp_path / "cache", image_size=(32, 128), unwrap=AutoRing(forward=30.0))
        return images.cameras["monday"]

    first = camera()
    with monkeypatch.context() as patched:
        patched.setattr("siamloc.data.ring.find_ring", None)
        assert camera() == first
    table(tmp_path, drive(6, centre=(140.0, 100.0))[0])
    assert camera().centre[0] == pytest.approx(140.0, abs=0.3)


@pytest.mark.parametrize(("centre", "corrected"), [((155.0, 105.0), True), ((120.0, 108.0), False)])
def test_a_given_ring_is_corrected_only_by_one_near_it(tmp_path, centre, corrected):
    pictures, centres = drive(8)
    given = AutoRing(centre=centre, inner=25.0, outer=80.0, forward=30.0)
    images = PanoramaLibrary(table(tmp_path, pictures), tmp_path / "cache", image_size=(32, 128), unwrap=given)
    ring = images.cameras["monday"]
    assert ring.forward == 30.0
    np.testing.assert_allclose(ring.centre, centres[0] if corrected else centre, atol=0.3)


def test_a_drive_without_a_ring_keeps_the_given_one_or_is_refused(tmp_path):
    still = table(tmp_path, drive(6)[0][:1].repeat(6, axis=0))
    given = AutoRing(centre=(150.0, 110.0), inner=20.0, outer=80.0)
    images = PanoramaLibrary(still, tmp_path / "cache", image_size=(32, 128), unwrap=given)
    assert images.cameras["monday"] == given
    with pytest.raises(DataError, match=r"unwrap=auto finds no ring in .*all alike"):
        PanoramaLibrary(still, tmp_path / "cache", image_size=(32, 128), unwrap=AutoRing())


def test_the_ring_of_the_database_begins_at_the_right_and_runs_counter_clockwise():
    """Column 0 looks where the picture's right is, a quarter of the width later at its top; the outer rim is on top."""
    picture = np.zeros((480, 640, 3), np.uint8)
    picture[:, 450:] = 255
    panorama = unwrap(picture, ColdRing())
    assert panorama[0, 0].min() > 200
    assert panorama[-1, 0].max() < 50
    picture[:] = 0
    picture[:120] = 255
    panorama = unwrap(picture, ColdRing())
    assert panorama[0, 128].min() > 200
    assert panorama[0, 384].max() < 50


@pytest.mark.parametrize("columns", [300, 416])
def test_the_camera_of_a_ring_is_found_with_what_is_known_of_it(columns, tmp_path):
    pictures, centres = drive(size=(220, columns))
    files = written(tmp_path, [pictures[0][:, :200], *pictures])  # the first one does not count
    camera = find_camera(files, AutoRing(forward=90, mirrored=False))
    assert (camera.forward, camera.mirrored) == (90, False)
    assert camera.presumed
    assert np.hypot(camera.cx - centres[0][0], camera.cy - centres[0][1]) < 0.3
    ahead = camera.project([np.cos(np.pi / 6), 0, np.sin(np.pi / 6)])
    assert abs(np.hypot(*(ahead - [camera.cx, camera.cy])) - OUTER) < 0.5  # the rim is at 30 degrees
    with pytest.raises(DataError, match="the pictures of a drive have one size"):  # in which the ring would count?
        find_camera(written(tmp_path, [*(picture[:200] for picture in pictures[:5]), *pictures[5:]]), AutoRing())


@pytest.mark.parametrize("eccentricity", [1.2, 1.4, 1.6])
def test_the_likely_mirror_of_a_ring_that_shows_just_the_panorama_is_the_true_one(eccentricity):
    true = HyperbolicMirror(eccentricity=eccentricity, forward=40)
    up, down = np.radians([30, -45])
    outer, inner = (float(np.hypot(*(true.project([np.cos(a), 0, np.sin(a)]) - [319.5, 239.5]))) for a in (up, down))
    found = likely_mirror(PolarRing(centre=(319.5, 239.5), inner=inner, outer=outer, forward=40))
    np.testing.assert_allclose([found.eccentricity, found.fx, found.fy], [eccentricity, 340, 340], rtol=1e-6)
    assert found.forward == 40
    assert np.degrees(found.lowest_elevation) == pytest.approx(-45)


def test_what_lies_within_the_inner_rim_of_the_likely_mirror_is_not_seen():
    found, view = likely_mirror(PolarRing(centre=(319.5, 239.5), inner=60, outer=210)), PanoramaView(64, 256)
    low = np.degrees(found.lowest_elevation)
    assert low == pytest.approx(-36.7, abs=0.1)  # a mirror that shows more is not built
    rows = np.degrees(view.row_elevation())
    np.testing.assert_array_equal(seen(found, view, (480, 640)).all(axis=1), rows > low)
    within = found.back_project(np.array([[319.5, 239.5 + 59], [319.5, 239.5 + 61]]))
    np.testing.assert_array_equal(np.isfinite(within).all(axis=1), [False, True])


def test_a_ring_with_its_inside_up_or_a_tiny_hole_still_has_a_camera():
    ring = PolarRing(centre=(9, 9), inner=2, outer=8, inside_up=True)
    assert likely_mirror(ring) is ring
    thin = likely_mirror(PolarRing(centre=(331, 240), inner=2, outer=228))
    assert np.degrees(thin.highest_elevation) > 30  # a mirror that shows the upper edge of a panorama


WHOLE = EquirectangularCamera()


@pytest.mark.parametrize(
    ("size", "camera"), [((60, 120), WHOLE), ((60, 114), WHOLE), ((60, 126), WHOLE), ((60, 150), None)]
)
def test_the_shape_of_wide_pictures_says_what_they_are(size, camera, tmp_path):
    (tmp_path / "broken.png").write_bytes(b"nothing")
    paths = [str(tmp_path / "broken.png"), *written(tmp_path, np.zeros((2, *size, 3), np.uint8))]
    assert find_camera(paths) == camera


@pytest.mark.parametrize(("radius", "columns"), [(30, 120), (27, 120), (40, 120), (29, 116), (29, 126)])
def test_two_bright_circles_side_by_side_are_two_lenses(radius, columns, tmp_path):
    pictures = np.random.default_rng(0).integers(0, 9, (3, 60, columns, 3)).astype(np.uint8)
    for picture in pictures:
        for middle in (columns // 4 - 1, 3 * columns // 4 - 1):
            cv2.circle(picture, (middle, 29), radius, (90, 120, 200), -1)
    lenses = radius < 40  # larger circles reach into the corners
    assert find_camera(written(tmp_path, pictures)) == (DualFisheyeCamera() if lenses else WHOLE)


@pytest.mark.parametrize(
    ("size", "middles", "words"),
    [
        ((120, 60), [(30, 30), (30, 90)], r"one above the other: .*hstack' OUT` does$"),
        ((68, 120), [(30, 34), (90, 34)], r"side by side between borders: .* -vf crop=iw:iw/2 OUT` does$"),
        ((68, 120), [(60, 34)], r"name it: unwrap=fisheye .* for a lens that looks up, .* unwrap=equirectangular$"),
    ],
)
def test_two_lenses_in_another_shape_are_refused_with_what_to_do(size, middles, words, tmp_path):
    picture = np.full((*size, 3), 5, np.uint8)
    for middle in middles:
        cv2.circle(picture, middle, 29, (90, 120, 200), -1)
    with pytest.raises(DataError, match=words):
        find_camera(written(tmp_path, picture[None].repeat(4, axis=0)))


def test_pictures_without_a_camera_are_refused_in_a_sentence(tmp_path):
    with pytest.raises(DataError, match="none of the 1 pictures can be read"):
        find_camera([str(tmp_path / "missing.png")])
    with pytest.raises(DataError, match=r"finds no ring in .*: the pictures are all alike"):
        find_camera(written(tmp_path, np.full((6, 90, 120, 3), 99, np.uint8)))


def test_a_square_picture_without_a_ring_may_show_two_views(tmp_path):
    pictures = np.full((6, 96, 96, 3), 99, np.uint8)
    with pytest.raises(DataError, match=r"unwrap=equirectangular; of two views above each other, keep the upper one"):
        find_camera(written(tmp_path, pictures))
    with pytest.raises(ConfigError, match=r"cut black bars off.*; of two views above each other, .* `ffmpeg"):
        unwrap(pictures[0], WHOLE)
    with pytest.raises(ConfigError, match=r"unwrap.lowest in degrees$"):
        unwrap(pictures[0, :80], WHOLE)
