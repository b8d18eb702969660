"""Poses finer than the map: answers that agree are joined, stray ones left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from analytic import Description
from analytic.descriptors.thumbnail import Thumbnail
from siamloc.data import FrameTable
from siamloc.errors import ConfigError, DataError
from siamloc.maps import RefinedPoses, Retrieval, VisualMap, refine
from siamloc.maps.joining import _most_likely as most_likely

THETA = np.array([0.3, -2.0, 3.0, 1.0])
XY = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [8.0, 8.0]])
TRUE, HEADING = np.array([0.4, 0.3]), 2.5


def map_of(theta: np.ndarray = THETA) -> VisualMap:
    frames = FrameTable(path=[f"{n}.png" for n in range(4)], x=XY[:, 0], y=XY[:, 1], theta=theta)
    # The parts say which frame they are of, so that what compares them knows the right answer.
    parts = np.ones((4, 8, 2), dtype=np.float16)
    parts[:, 0, 0] = 2 + np.arange(4)
    return VisualMap(np.eye(4), frames, orientation=parts, heading={"name": "network"})


def number(parts: np.ndarray) -> np.ndarray:
    return np.rint(parts[:, 0, 0] / parts[:, 1, 0]).astype(int) - 2


def exact(queries: np.ndarray, known: np.ndarray):
    rows = number(known)
    apart = TRUE - XY[rows]
    cosine, sine = np.cos(THETA[rows]), np.sin(THETA[rows])
    pose = np.stack(
        [cosine * apart[:, 0] + sine * apart[:, 1], cosine * apart[:, 1] - sine * apart[:, 0], HEADING - THETA[rows]], 1
    )
    return pose, np.tile(np.diag([100.0, 400.0, 1e4]), (len(rows), 1, 1)), np.full(len(rows), 3.0)


class Compares(Thumbnail):
    """A descriptor that compares, exactly."""

    compares = True

    def compare(self, queries: np.ndarray, known: np.ndarray):
        return exact(queries, known)


def asked(count: int = 1) -> Description:
    return Description(np.zeros((count, 4)), np.ones((count, 8, 2), dtype=np.float32))


def found(*rows: int) -> Retrieval:
    return Retrieval(np.array([rows]), np.arange(len(rows), dtype=float)[None])


def astray(sure: float, likely: float = 3.0):
    """Return what compares exactly but for the second map frame, whose answer is wrong, as sure and as likely."""

    def compare(queries: np.ndarray, known: np.ndarray):
        pose, information, match = exact(queries, known)
        wrong = number(known) == 1
        pose[wrong] += [3.0, -2.0, 1.0]
        information[wrong] *= sure
        return pose, information, np.where(wrong, likely, match)

    return compare


@pytest.mark.parametrize("rows", [(0,), (2, 1), (0, 1, 2)])
def test_right_answers_give_the_pose(rows):
    poses = refine(map_of(), asked(), found(*rows), exact, k=3)
    np.testing.assert_allclose(poses.xy[0], TRUE, atol=1e-9)
    np.testing.assert_allclose(poses.theta, [HEADING], atol=1e-9)
    assert len(poses) == 1
    assert poses.agreement[0] > 0.9


@pytest.mark.parametrize("rows", [(0, 1, 2), (1, 0, 2), (2, 0, 1)])
@pytest.mark.parametrize("sure", [0.5, 1.0, 1.2, 3.0])
def test_a_stray_answer_is_left_out_however_sure_it_is(rows, sure):
    poses = refine(map_of(), asked(), found(*rows), astray(sure), k=3)
    np.testing.assert_allclose(poses.xy[0], TRUE, atol=0.01)
    np.testing.assert_allclose(poses.theta, [HEADING], atol=0.01)
    assert poses.frame[0] != 1
    assert 0.6 < poses.agreement[0] < 0.7, "two of three"


def test_an_answer_that_is_no_match_does_not_count():
    no_match = astray(100, likely=-12.0)
    poses = refine(map_of(), asked(), found(1, 0), no_match, k=2)
    np.testing.assert_allclose(poses.xy[0], TRUE, atol=0.01)
    assert poses.frame.tolist() == [0]
    assert poses.match.tolist() == [3.0]
    assert refine(map_of(), asked(), found(1, 0), no_match, k=1).match.tolist() == [-12.0]


def test_frames_without_a_heading_say_nothing():
    theta = THETA.copy()
    theta[0] = np.nan
    poses = refine(map_of(theta), asked(), found(0, 1), exact, k=2)
    np.testing.assert_allclose(poses.xy[0], TRUE, atol=1e-9)
    assert poses.frame.tolist() == [1]
    bare = map_of()
    frames = bare.frames.with_columns(x=np.where(np.arange(4) == 0, np.nan, XY[:, 0]))
    unplaced = replace(bare, frames=frames)
    np.testing.assert_allclose(refine(unplaced, asked(), found(0, 1), exact, k=2).xy[0], TRUE, atol=1e-9)
    alone = refine(map_of(theta), asked(), found(0), exact, k=1)
    np.testing.assert_array_equal(alone.xy[0], XY[0])
    assert np.isnan(alone.theta).all()
    assert alone.match.tolist() == [-np.inf]
    assert not alone.information.any()
    assert np.isnan(alone.inside(TRUE[None])).all()


def test_ellipses_hold_the_share_that_they_should():
    rng = np.random.default_rng(0)
    count, scale = 20_000, np.array([[0.5, 0.2], [0.2, 0.3]])
    errors = rng.multivariate_normal(np.zeros(2), scale, count) / np.sqrt(rng.chisquare(4, count) / 4)[:, None]
    information = np.tile(np.linalg.inv(scale), (count, 1, 1))
    zeros = np.zeros(count)
    poses = RefinedPoses(np.zeros((count, 2)), zeros, information, zeros, zeros.astype(np.int64), zeros)
    for share in (0.5, 0.9, 0.99):
        assert poses.inside(errors, share).mean() == pytest.approx(share, abs=0.01)
    assert poses.widening(errors) == pytest.approx(1, abs=0.05)
    half = poses.widened(poses.widening(2 * errors))
    assert half.inside(2 * errors).mean() == pytest.approx(0.9, abs=1e-3)
    with pytest.raises(DataError, match="10 refined validation frames or more, got 5"):
        refine(map_of(), asked(5), Retrieval(np.zeros((5, 1), int), np.zeros((5, 1))), exact).widening(np.zeros((5, 2)))
    for share in (0, 1, 90):
        with pytest.raises(ConfigError, match=f"share must be a number between 0 and 1, got {share}"):
            poses.inside(errors, share)
    for factor in (0, -1):
        with pytest.raises(ConfigError, match=f"factor must be a number above 0, got {factor}"):
            poses.widened(factor)


def test_what_cannot_be_refined_is_refused():
    known = map_of()
    with pytest.raises(DataError, match="no map frame has a heading"):
        refine(map_of(np.full(4, np.nan)), asked(), found(0), exact)
    with pytest.raises(DataError, match="no orientation parts"):
        refine(known, Description(np.zeros((1, 4))), found(0), exact)
    with pytest.raises(ConfigError, match="k must be a whole number from 1"):
        refine(known, asked(), found(0), exact, k=0)
    thumbnails = replace(known, identity={"name": "hog"})
    able = Compares()
    with pytest.raises(ConfigError, match="does not hold what its network compares by"):
        refine(replace(known, heading={"name": "hog"}, describes=able), asked(), found(0))
    own = replace(known, describes=able)
    np.testing.assert_allclose(refine(own, asked(), found(0)).xy[0], TRUE, atol=1e-9)
    feet = replace(own, frames=replace(own.frames, unit="ft"))
    with pytest.raises(ConfigError, match="answer in metres, and the map is in 'ft': give x and y in metres"):
        refine(feet, asked(), found(0))
    with pytest.raises(ConfigError, match=r"hog does not tell .*model\.relative=true"):
        refine(thumbnails, asked(), found(0))


def test_map_frames_of_another_building_do_not_count():
    known = map_of()
    elsewhere = replace(known, frames=known.frames.with_columns(building=["here", "there", "here", "here"]))
    assert refine(known, asked(), found(0, 1), exact).agreement[0] > 0.9
    alone = refine(elsewhere, asked(), found(0, 1), exact)
    assert alone.agreement[0] == pytest.approx(refine(known, asked(), found(0), exact, k=1).agreement[0] / 2)
    np.testing.assert_allclose(alone.xy[0], TRUE, atol=1e-9)


def test_one_answer_knows_what_it_says():
    """Its spread is that of the answer, turned into the map's axes, as far as it is no stray one, and 1 cm."""
    poses = refine(map_of(), asked(), found(0), exact, k=1)
    cosine, sine = np.cos(THETA[0]), np.sin(THETA[0])
    turned = np.array([[cosine, -sine], [sine, cosine]])
    spread = turned @ np.diag([1 / 100, 1 / 400]) @ turned.T / poses.agreement[0] + 0.01**2 * np.eye(2)
    np.testing.assert_allclose(np.linalg.inv(poses.information[0]), spread)


def test_further_answers_make_a_pose_less_uncertain_but_not_as_if_their_errors_were_independent():
    known = replace(map_of(), frames=map_of().frames.with_columns(theta=np.zeros(4)))

    def compare(queries, known):
        pose, information, match = exact(queries, known)
        rows = number(known)
        pose[:, :2], information[:, :2, :2] = TRUE - XY[rows], 1e4 * np.eye(2)
        return pose, information, match + 30  # none of them is a stray one

    spread = [np.linalg.inv(refine(known, asked(), found(*range(k)), compare, k=k).information[0]) for k in (1, 2, 4)]
    for k, one in zip((1, 2, 4), spread, strict=True):
        mean_of_correlated = 1e-4 * (1 + (k - 1) / 2) / k
        np.testing.assert_allclose(one, (mean_of_correlated + 0.01**2) * np.eye(2), rtol=0.005, atol=1e-9)


def test_what_is_known_of_the_maps_own_deviations_is_contained():
    known = map_of()
    deviation = np.array([0.2, np.nan, 0.1, np.nan])
    surveyed = replace(known, frames=known.frames.with_columns(deviation=deviation))
    for rows, more in (((0,), 0.2**2), ((1,), 0.0), ((0, 2), (0.2**2 + 0.1**2) / 2)):
        plain, wider = (refine(one, asked(), found(*rows), exact, k=2) for one in (known, surveyed))
        np.testing.assert_array_equal(plain.xy, wider.xy)
        added = wider.covariance()[0] - plain.covariance()[0]
        np.testing.assert_allclose(added, more * np.eye(2), rtol=0.02, atol=1e-9)  # shares differ a little


def test_ellipses_that_queries_of_the_same_survey_teach_do_not_shrink_the_maps_own_deviations():
    rng = np.random.default_rng(0)
    count, map_deviation = 2000, 0.25
    information = np.tile(np.eye(2) / 0.05**2, (count, 1, 1))
    zeros = np.zeros(count)
    poses = RefinedPoses(
        np.zeros((count, 2)), zeros, information, zeros, zeros.astype(np.int64), zeros, zeros + map_deviation**2
    )
    surveyed = 0.02 * rng.standard_t(4, (count, 2))  # the map's own error is the same in the queries' positions
    factor = poses.widening(surveyed)
    assert factor == pytest.approx((0.02 / 0.05) ** 2, rel=0.2)
    wide = poses.widened(factor)
    true = surveyed + rng.normal(0, map_deviation, (count, 2))
    np.testing.assert_allclose(wide.covariance()[0], np.cov(true.T), atol=0.1 * map_deviation**2)
    assert wide.inside(true).mean() == pytest.approx(0.9, abs=0.06)


def test_a_query_alone_has_the_answer_that_it_has_among_others():
    rng = np.random.default_rng(0)
    at, factor = rng.normal(0, 0.5, (60, 4, 2)), rng.normal(0, 4, (60, 4, 2, 2))
    about, probability = factor @ factor.swapaxes(-1, -2) + np.eye(2), rng.random((60, 4))
    together = most_likely(at, about, probability)
    alone = [most_likely(at[row : row + 1], about[row : row + 1], probability[row : row + 1]) for row in range(60)]
    for found, one_by_one in zip(together, zip(*alone, strict=True), strict=True):
        np.testing.assert_allclose(found, np.concatenate(one_by_one), atol=1e-9)


def test_no_queries_have_no_poses():
    assert len(refine(map_of(), asked(0), Retrieval(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2))), exact)) == 0


@pytest.mark.parametrize("odds", [-40.0, -800.0])
def test_answers_that_cannot_be_right_give_no_pose(odds):
    def compare(queries, known):
        pose, information, match = exact(queries, known)
        return pose, information, np.full_like(match, odds)

    theta = THETA.copy()
    theta[3] = np.nan  # the nearest map frame, which has no heading and no answer, stands at (8, 8)
    found_pose = refine(map_of(theta), asked(), found(3, 0, 1), compare)
    assert np.isfinite(found_pose.xy).all()
    if odds < -700:
        assert found_pose.xy[0].tolist() == [8.0, 8.0]
        assert np.isnan(found_pose.theta[0])
        assert not found_pose.information.any()
    else:
        np.testing.assert_allclose(found_pose.xy[0], TRUE, atol=1e-6)
