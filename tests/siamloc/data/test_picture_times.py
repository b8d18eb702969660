"""Times of pictures: in their names, and in the files, as cameras write them."""

from __future__ import annotations

import logging
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import siamloc.data
from siamloc.data.picture_times import taken_at
from siamloc.data.recorded import read_recorded
from siamloc.errors import DataError

START = datetime(2026, 5, 12, 10, 59, 58, tzinfo=timezone.utc).timestamp()  # an hour ends on the way


def pictures(folder, names, tags=()):
    """Write a picture under each name, with the EXIF tags that are given for it."""
    folder.mkdir()
    for number, name in enumerate(names):
        exif = Image.Exif()
        exif.get_ifd(0x8769).update(tags[number] if tags else {})
        Image.new("RGB", (32, 16), (number, 0, 0)).save(folder / name, exif=exif)
    return [folder / name for name in names]


def taken(*fractions, zone=None):
    """Tags of pictures that are taken two seconds apart, on a clock two hours ahead of UTC."""
    clock = ("2026:05:12 12:59:58", "2026:05:12 13:00:00", "2026:05:12 13:00:02")
    rows = [{0x9003: text, 0x9291: fraction} for text, fraction in zip(clock, fractions, strict=False)]
    return [row if zone is None else row | {0x9011: zone} for row in rows]


@pytest.mark.parametrize(
    ("names", "fractions"),
    [
        (["IMG_20260512_105958.jpg", "IMG_20260512_110000.jpg", "IMG_20260512_110003.jpg"], [0.5, 2.5, 5.5]),
        (["20260512_105958_250.jpg", "20260512_105958_750.jpg", "20260512_110000_125.jpg"], [0.25, 0.75, 2.125]),
        (["PXL_20260512_105958250.jpg", "PXL_20260512_110000125.MP.jpg"], [0.25, 2.125]),
        (["20260512105958.png", "20260512110000.png"], [0.5, 2.5]),
        (["2026-05-12 10.59.58.jpg", "2026-05-12 11.00.00.jpg"], [0.5, 2.5]),
        (["Image 2026-05-12 at 10.59.58.jpg", "Image 2026-05-12 at 11.00.00.jpg"], [0.5, 2.5]),
        (["IMG_20260512_105958_00_001.jpg", "IMG_20260512_110000_00_002.jpg"], [0.5, 2.5]),
        (["20260512_105958_001.jpg", "20260512_110000_002.jpg", "20260512_110003_003.jpg"], [0.5, 2.5, 5.5]),
    ],
)
def test_dates_in_the_names_of_telephones_and_cameras(tmp_path, names, fractions, caplog):
    """What follows a date is a fraction of a second, or a counter. An hour does not end after 9999 s."""
    with caplog.at_level(logging.WARNING, "siamloc"):
        np.testing.assert_allclose(taken_at(pictures(tmp_path / "monday", names)) - START, fractions, atol=1e-6)
    assert "are taken for UTC: if they are local times" in caplog.text


@pytest.mark.parametrize(
    ("names", "known"),
    [
        (["2026-05-12T12-59-58.250+0200.jpg", "2026-05-12T13-00-00.125+0200.jpg"], True),
        (["20260512T125958250+0200.jpg", "20260512T130000125+0200.jpg"], True),
        (["2026-05-12T10_59_58.250Z.jpg", "2026-05-12T11_00_00.125Z.jpg"], True),
        (["2026-05-12T04-59-58.250-0600_left.jpg", "2026-05-12T05-00-00.125-0600_left.jpg"], True),
        (["2026-05-12T12-59-58.250+0200.jpg", "2026-05-12T12-00-00.125+0100.jpg"], True),
        (["20260512_105958_250-0100.jpg", "20260512_110000_125-0101.jpg"], False),
        (["20260512_105958_250Zoom.jpg", "20260512_110000_125Zoom.jpg"], False),
    ],
)
def test_a_time_zone_in_the_names(tmp_path, names, known, caplog):
    """What differs from name to name by less than a quarter of an hour is a counter."""
    np.testing.assert_allclose(taken_at(pictures(tmp_path / "monday", names)) - START, [0.25, 2.125], atol=1e-6)
    assert known != ("are taken for UTC" in caplog.text)


def test_the_camera_writes_the_time_into_the_file(tmp_path, caplog):
    names = [f"R00100{number}.JPG" for number in (23, 24, 25)]
    found = taken_at(pictures(tmp_path / "zoned", names, taken("25", "000", "5", zone="+02:00")))
    np.testing.assert_allclose(found - START, [0.25, 2, 4.5], atol=1e-6)
    assert not caplog.text
    found = taken_at(pictures(tmp_path / "local", names, taken("25", "000", "5")))
    np.testing.assert_allclose(found - START, np.array([0.25, 2, 4.5]) + 7200, atol=1e-6)
    assert "are taken for UTC" in caplog.text
    dated = [f"IMG_20260512_{clock}.jpg" for clock in ("125958", "130000", "130002")]
    found = taken_at(pictures(tmp_path / "both", dated, taken("25", "000", "5", zone="+02:00")))
    np.testing.assert_allclose(found - START, [0.25, 2, 4.5], atol=1e-6)


@pytest.mark.parametrize("tags", [{}, {0x9003: "0000:00:00 00:00:00"}, {0x9003: "2026:05:12 12:59:58"}])
@pytest.mark.parametrize("name", ["R00100{}.jpg", "VID_20260512_105958_{}.jpg", "VID_20260512_105958_{}00.jpg"])
def test_counters_and_the_time_of_a_whole_drive_are_no_times(tmp_path, name, tags):
    files = pictures(tmp_path / "monday", [name.format(number) for number in range(10, 15)], [tags] * 5)
    assert np.isnan(taken_at(files)).all()


def test_one_picture_without_a_time_is_named(tmp_path, caplog):
    tags = [*taken("0", "0", zone="+02:00"), {}]
    assert np.isnan(taken_at(pictures(tmp_path / "monday", ["R001.jpg", "R002.jpg", "map.png"], tags))).all()
    assert "1 of 3 pictures hold no time (EXIF), the first: map.png" in caplog.text


@pytest.mark.parametrize(
    "names",
    [
        ["2026-05-17T06-40-00.jpg", "2026-05-17T06-40-01.jpg", "map.png"],
        ["1779000000.572.jpg", "1779000001.200.jpg", "map.png"],
    ],
)
def test_one_name_without_a_time_is_named(tmp_path, caplog, names):
    assert np.isnan(taken_at(pictures(tmp_path / "monday", names))).all()
    assert "1 of 3 pictures hold no time (in the name), the first: map.png" in caplog.text


def test_counters_next_to_another_name_lack_no_time(tmp_path, caplog):
    names = ["VID_20260512_105958_1.jpg", "VID_20260512_105958_2.jpg", "3.jpg", "4.jpg", "map.png"]
    assert np.isnan(taken_at(pictures(tmp_path / "monday", names))).all()
    assert not caplog.text


def test_hidden_files_are_no_pictures(tmp_path):
    names = [".thumbnail.png", "._IMG_20260512_105958.jpg", "IMG_20260512_105958.jpg", "IMG_20260512_110000.jpg"]
    pictures(tmp_path / "monday", names)
    assert [Path(path).name for path in read_recorded(tmp_path / "monday").path.tolist()] == names[2:]


@pytest.mark.parametrize(
    "names",
    [
        ["1779000000.572.jpg", "1779000001200075008.jpg", "1779000002.343.jpg"],
        ["1779000000572.png", "1779000001.200.png"],
        ["2026-05-17T06-40-00.571657.jpg", "1779000001.200.jpg"],
    ],
)
def test_names_with_times_of_different_kinds_are_refused(tmp_path, names):
    files = pictures(tmp_path / "monday", names)
    with pytest.raises(DataError, match=rf"names such as .*{names[0]}.* hold times of different kinds.* times=FILE"):
        taken_at(files)


def test_a_trajectory_is_joined_by_the_times_in_the_files(tmp_path):
    pictures(tmp_path / "monday", ["R0010023.jpg", "R0010024.jpg"], taken("0", "5", zone="+0200"))
    poses = tmp_path / "poses.txt"
    poses.write_text("".join(f"{START + second} {second} 0 0 0 0 0 1\n" for second in range(6)))
    frames = siamloc.data.read("trajectory", images=tmp_path / "monday", poses=poses)
    np.testing.assert_allclose(frames.x, [0, 2.5], atol=1e-6)


def test_pictures_without_times_are_joined_with_nothing(tmp_path):
    """They count as a second apart, which is no time of the odometry's clock."""
    pictures(tmp_path / "monday", ["1.png", "2.png"])
    wheels = tmp_path / "wheels.txt"
    wheels.write_text("".join(f"{second} {second} 0 0\n" for second in range(6)))
    with pytest.raises(
        DataError, match=r"the images have no times: neither do their names .* counters\), so give times=FILE"
    ):
        siamloc.data.extract(tmp_path / "monday", tmp_path / "out", odometry=str(wheels))
    assert not (tmp_path / "out").exists()


def test_pictures_of_one_second_are_spread_over_it(tmp_path):
    """A clock that counts seconds cuts off fractions, so that times are right on average; file names give the order."""
    clocks = [f"2026:05:12 12:59:{50 + number // 4}" for number in range(9)]
    names = [f"R00{number}.jpg" for number in range(9)]
    files = pictures(tmp_path / "monday", names, [{0x9003: one, 0x9011: "+02:00"} for one in clocks])
    np.testing.assert_allclose(taken_at(files) - START + 8, [*(np.arange(8) / 4 + 0.125), 2.5], atol=1e-6)


def test_images_take_no_longer_than_the_trajectory(tmp_path):
    """A minute of pictures, counted in ms, within an hour of poses."""
    pictures(tmp_path / "monday", [f"{number}.png" for number in range(5)])
    (tmp_path / "times.txt").write_text("".join(f"{15_000 * number}\n" for number in range(5)))
    (tmp_path / "poses.txt").write_text("".join(f"{second} {second} 0 0 0 0 0 1\n" for second in range(3600)))
    frames = read_recorded(tmp_path / "monday", tmp_path / "poses.txt", times=tmp_path / "times.txt")
    np.testing.assert_allclose(frames.x, 15 * np.arange(5))


@pytest.mark.parametrize("factor", [1, 1e3])
def test_whole_numbers_count_what_the_trajectory_takes(tmp_path, factor):
    """Pictures every 15 s, or 15 ms as it would seem without the trajectory."""
    pictures(tmp_path / "monday", [f"{number}.png" for number in range(5)])
    (tmp_path / "times.txt").write_text("".join(f"{15 * factor * number:.0f}\n" for number in range(5)))
    (tmp_path / "poses.txt").write_text("".join(f"{second / 2} {second / 2} 0 0 0 0 0 1\n" for second in range(130)))
    frames = read_recorded(tmp_path / "monday", tmp_path / "poses.txt", times=tmp_path / "times.txt")
    np.testing.assert_allclose(frames.x, 15 * np.arange(5))
