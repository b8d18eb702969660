from __future__ import annotations

import re
import sys

import cv2
import numpy as np
import pytest

from analytic import Description
from siamloc.data import FrameTable, MountingEstimate, PanoramaLibrary, PanoramaView, Preprocessing, check
from siamloc.data.moves import wrapped
from siamloc.data.picture_checks import (
    direction,
    drive_faults,
    mounted,
    own_robot,
    picture_faults,
    time_offset,
    turns_seen,
)
from tests.drawn import written

N, H, W = 60, 32, 128
MADE_BY = Preprocessing(PanoramaView(), None)
THETA = 1.2 * np.sin(np.arange(N) / 5)


def texture(seed: int) -> np.ndarray:
    """A texture (H, W) of large and small things that continues at its edges."""
    noise = np.random.default_rng(seed).normal(0, 1, (H, 3 * W))
    noise[:, :W] = noise[:, 2 * W :] = noise[:, W : 2 * W]
    large, small = (size * cv2.GaussianBlur(noise, (0, 0), sigma) for size, sigma in ((250, 4), (12, 0.6)))
    return (large + small)[:, W : 2 * W]


def drive() -> np.ndarray:
    """Panoramas (n, 3, H, W) of a robot that turns by THETA, in surroundings that change every ten frames."""
    light = -60 * np.tanh(np.linspace(-2, 2, H))[:, None]  # from the ceiling to the floor
    textures = [texture(seed) for seed in range(N // 10 + 1)]
    found = []
    for row, theta in enumerate(THETA):
        at, share = divmod(row / 10, 1)
        mixed = (1 - share) * textures[int(at)] + share * textures[int(at) + 1] + 128 + light
        found.append(np.roll(mixed, round(theta * W / (2 * np.pi)), axis=1))
    grey = np.stack(found).clip(0, 255).astype(np.uint8)
    return np.repeat(grey[:, None], 3, axis=1)


def each(panoramas: np.ndarray, change) -> np.ndarray:
    return np.stack([change(one.transpose(1, 2, 0)).transpose(2, 0, 1) for one in panoramas])


def blurred(panoramas):
    wide = np.concatenate([panoramas] * 3, axis=3)
    return each(wide, lambda one: cv2.GaussianBlur(one, (0, 0), 2.5))[..., W : 2 * W]


def cut(panoramas):
    return each(panoramas[..., 12:], lambda one: cv2.resize(np.ascontiguousarray(one), (W, H)))


def without_a_part(panoramas):
    panoramas[..., 100:] = 0
    return panoramas


def without_the_floor(panoramas):
    panoramas[:, :, H // 2 :] = 0
    return panoramas


def with_robot(panoramas):
    panoramas[:, :, 28:, 40:90] = panoramas[0, :, 28:, 40:90]
    return panoramas


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        (lambda one: one // 30, "60 of 60 images are more than 40% black: use a longer exposure"),
        (lambda one: np.clip(one.astype(int) * 4, 0, 255).astype(np.uint8), "more than 40% white: use a shorter"),
        (without_the_floor, "50% of the panorama is black in all images: check unwrap"),
        (blurred, "60 of 60 images are blurred"),
        (cut, "there is a seam where the panoramas begin and end"),
        (lambda one: np.concatenate([one[..., :30], one[..., 40:], one[..., -10:]], axis=3), "a seam at column 30"),
        (without_a_part, "79 degrees of the panoramas show nothing, around 141 degrees to the right .* cut"),
        (with_robot, "5% of the panorama, in rows 28 to 31 of 32, never change: the robot sees itself"),
    ],
)
def test_each_fault_of_pictures_is_named(fault, says):
    found = [text for text in picture_faults(fault(drive()), MADE_BY, True) if text is not None]
    assert sum(bool(re.search(says, text)) for text in found) == 1, found


def test_nothing_is_said_about_pictures_as_they_should_be():
    assert not any(picture_faults(drive(), MADE_BY, True))
    assert not any(picture_faults(drive(), MADE_BY, False))


def test_turns_are_those_of_the_headings():
    off = wrapped(turns_seen(drive()) - np.diff(THETA))
    assert np.abs(off).max() < 1.1 * 2 * np.pi / W, "the drive turns by whole columns"


def test_images_that_turn_against_the_headings_are_recognized():
    seen, turned = turns_seen(drive()), np.diff(THETA)
    assert direction(seen, turned) is None
    assert "images turn against the headings" in (direction(turns_seen(drive()[..., ::-1]), turned) or "")
    assert direction(seen, 0 * turned) is None, "of a drive that never turns nothing is known"


@pytest.mark.parametrize("late", [-0.4, 0.3])
def test_poses_of_other_times_are_recognized(late):
    time = np.arange(N) * 0.2
    theta = 1.2 * np.sin((time - late) / 1.0)
    seen = turns_seen(drive())
    assert time_offset(seen, time, THETA) == 0
    assert time_offset(seen, time, theta) == pytest.approx(late, abs=0.05), "headings of whole columns"
    assert time_offset(-seen, time, theta) == pytest.approx(late, abs=0.05), "of mirrored images"
    assert time_offset(seen, np.full(N, np.nan), theta) == 0


@pytest.mark.parametrize("rate", [5, 30])
def test_an_offset_of_times_is_found_at_any_rate_or_not_told(rate):
    time = np.arange(0, 40, 1 / rate)
    rng = np.random.default_rng(0)
    seen = np.diff(1.2 * np.sin(time) + 0.5 * np.sin(2.3 * time)) + rng.normal(0, 0.02, len(time) - 1)
    seen[rng.random(len(seen)) < 0.1] = np.nan  # images that are not alike
    for late, told in ((0.0, 0.0), (0.02, 0.0), (-1.5, -1.5), (0.4, 0.4)):
        theta = 1.2 * np.sin(time - late) + 0.5 * np.sin(2.3 * (time - late))
        assert time_offset(seen, time, theta) == pytest.approx(told, abs=0.03)
    assert time_offset(rng.normal(0, 0.02, len(seen)), time, 1.2 * np.sin(time)) == 0, "images that show no turns"
    assert time_offset(seen, time, 0 * time) == 0, "a drive that never turns"


@pytest.mark.parametrize("unknown", [(34, 40), (0, 5), (18, 21), (18, 18.5)])
def test_an_offset_of_times_is_found_by_the_headings_that_are_known(unknown):
    """Odometry stops early, begins late, or has a gap."""
    time = np.arange(0, 40, 0.2)
    for late in (0.4, -0.4, 0.0):
        theta = 1.2 * np.sin(0.7 * (time - late)) + 0.5 * np.sin(1.7 * (time - late))
        theta[(time >= unknown[0]) & (time <= unknown[1])] = np.nan
        seen = np.diff(1.2 * np.sin(0.7 * time) + 0.5 * np.sin(1.7 * time))
        assert time_offset(seen, time, theta) == pytest.approx(late, abs=0.01)
    assert time_offset(seen, time, np.where(time < 3, theta, np.nan)) == 0, "too few are known"


class TrueTurns:
    """Stands for a network: each image's grey value is its row in the drive, whose headings are known."""

    name, compares = "true turns", True

    def describe(self, batch):
        return Description(np.zeros((len(batch), 1)), batch[:, :1, :1, 0].astype(np.float32))

    def compare(self, queries, known):
        turned = np.interp(queries[:, 0, 0], range(N), THETA) - np.interp(known[:, 0, 0], range(N), THETA)
        pose = np.column_stack([np.full(len(turned), 0.2), np.zeros(len(turned)), turned])
        return pose, np.tile(np.eye(3), (len(turned), 1, 1)), np.ones(len(turned))


def test_a_network_finds_offsets_of_poses_and_odometry_that_correlation_does_not(tmp_path, monkeypatch):
    paths, time = written(tmp_path, [np.full((H, W, 3), row, np.uint8) for row in range(N)]), np.arange(N) * 0.2
    late = 1.2 * np.sin(time - 0.4)
    frames = FrameTable(path=paths, x=0.2 * np.arange(N), y=np.zeros(N), theta=late, odom_theta=late, time=time)
    images = PanoramaLibrary(frames, tmp_path / "cache", image_size=(H, W))

    def said(by, **columns):
        found = drive_faults(frames.with_columns(**columns), images, by, mounting=False)
        return [text for text in found if " s after" in text or " s before" in text]

    assert said(None) == []
    (poses,) = said(TrueTurns())
    assert re.fullmatch(
        r"the images turn 0\.[34]\d s before the headings do: the poses are those of other times\. "
        r"Add \+0\.[34]\d s to the times of the images \(column time, data\.offset or recording\.offset\)",
        poses,
    )
    monkeypatch.setattr(sys.modules["siamloc.data.picture_checks"], "_IN_A_ROW", N - 10)
    straight = np.arange(N) < 6
    (later,) = said(TrueTurns(), theta=np.where(straight, late[6], late))
    assert "the poses are those of other times" in later, "in the part of the drive that turns"
    (wheels,) = said(TrueTurns(), theta=THETA)
    assert re.search(r"before the odometry does: .* Add -0\.[34]\d s to the times of the odometry", wheels)
    (unposed,) = said(TrueTurns(), theta=np.full(N, np.nan))
    assert re.search(r"before the odometry does: .* Add \+0\.[34]\d s to the times of the images", unposed)
    assert said(TrueTurns(), theta=THETA, odom_theta=THETA) == []


def test_a_mounting_is_named_only_if_it_matters():
    assert mounted(MountingEstimate(0.4, 0.3, False, (0.0, 0.0), (0.01, 0.01), 100)) is None
    said = mounted(MountingEstimate(-30.0, 0.3, True, (0.0, 0.0), (0.01, 0.01), 100))
    assert said is not None
    assert said.startswith(
        "the camera's mounting: it looks 30.0 +- 0.3 degrees right of the heading; its panoramas are"
    )
    assert said.endswith(
        "; if they are not, the poses are (y and headings with the wrong sign, as with z down), and so is the map"
    )
    unsure = mounted(MountingEstimate(-10.0, 4.0, False, (0.0, 0.0), (0.01, 0.01), 100))
    assert unsure == "the camera's mounting: it looks 10.0 +- 4.0 degrees right of the heading", "no map corrects it"
    assert mounted(MountingEstimate(reasons=("no poses",))) is None
    for mirrored in (None, True):  # which a map makes up for only if the rest fits
        said = mounted(MountingEstimate(mirrored=mirrored, pairs=50, reasons=("check them",)))
        assert said is not None
        assert said.endswith("check them")


def test_check_looks_at_the_pictures_of_each_drive(tmp_path):
    paths = written(tmp_path, [one.transpose(1, 2, 0) for one in (*drive(), *drive()[..., ::-1])])
    x = np.tile(np.cumsum(0.2 * np.cos(THETA)), 2)
    y = np.tile(np.cumsum(0.2 * np.sin(THETA)), 2)
    sequence = ["good"] * N + ["mirrored"] * N
    frames = FrameTable(path=paths, x=x, y=y, theta=np.tile(THETA, 2), sequence=sequence)
    found = check(frames, PanoramaLibrary(frames, tmp_path / "cache", image_size=(H, W)))
    (said,) = [one for one in found if one.startswith("sequence")]
    assert said.startswith("sequence mirrored: images turn against the headings: they are mirrored")


def test_a_mast_in_view_is_the_robot_s_own():
    views = np.random.default_rng(0).uniform(0, 255, (20, 64, 256)).astype(np.float32)
    views[:, :, 100:108] = np.linspace(0, 255, 64)[:, None]
    assert "a narrow part, never change" in own_robot(views)


def test_who_carries_the_camera_is_no_reason_to_leave_rows_out():
    """A person in an eighth of the azimuth, from the middle to the lower edge, or to the upper one."""
    views = np.random.default_rng(0).uniform(0, 255, (20, 64, 256)).astype(np.float32)
    views[:, 32:, 100:132] = np.linspace(0, 255, 32)[:, None]
    for seen in (views, views[:, ::-1]):
        assert re.search("^6% of the panorama, a narrow part, .* No setting is needed", own_robot(seen))
    views[:, :4] = np.linspace(0, 255, 256)
    assert re.search(r"in rows 0 to 3 of 64, .* leave these rows out \(unwrap.top\)", own_robot(views))


@pytest.mark.parametrize("period", [3, 6, 12])
def test_turns_to_the_left_and_right_in_equal_times_are_not_those_of_other_times(period):
    rng, step = np.random.default_rng(0), period / 3
    time = np.arange(120) * step
    theta = np.cumsum(np.where(np.arange(120) // 3 % 2, 1, -1) * np.where(np.arange(120) % 3 == 0, 1.5, 0.0))
    turned = np.diff(theta) + rng.normal(0, 0.03, 119)
    for seen in (turned, -turned):
        assert time_offset(seen, time, theta) == 0


def test_dropped_pictures_do_not_hide_another_clock():
    time = np.sort(np.random.default_rng(0).permutation(150)[:105]).astype(float)

    def heading(at):
        return 2.0 * np.sin(at / 4) + np.sin(at / 1.7)

    assert time_offset(np.diff(heading(time)), time, heading(time - 1.5)) == pytest.approx(1.5, abs=0.2)
