"""What a drive with known positions says about a map: `judged` compares its frames with the map frames nearby."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from siamloc.data.moves import relative
from siamloc.maps.comparing import ODDS, agree, compare_with, comparison_of
from siamloc.maps.error_model import STRANGE
from siamloc.maps.history import Reason
from siamloc.maps.matching import learned_distances
from siamloc.maps.search import Retrieval, slices
from siamloc.maps.thinning import compared_nearby
from siamloc.maps.visual_map import VisualMap

_COMPARED = 3  # map frames that each frame of a drive is compared with
_AT_ONCE = 64  # frames of a drive that are compared with all map frames
_FEWEST = 10  # map frames with a neighbour, from which the usual distance is learned
_SOME = 0.25  # share of the map frames that a drive recognizes at least, if it was driven in their light
_PRIOR = 10  # map frames that the share of the whole map counts for in the share of a drive


@dataclass(frozen=True, eq=False)
class Judged:
    """The frames of a drive (n) and of a map (m), compared.

    Attributes:
        away: (n,) distance of each frame of the drive to the nearest map frame; infinite if its building has none.
        unlike: (n,) descriptor distance to the most similar map frame within the radius; infinite if there is none.
        recognized: (m,) whether a frame taken near a map frame resembles it more than all map frames elsewhere.
        passed: (m,) whether the drive has a frame near the map frame.
        changed: (m,) descriptor distance from the map frame to the most similar of those; infinite if there is none.
        misplaced: (n,) whether the map says of a frame that it was taken where it was not: most comparisons with the
            map frames within the radius that it resembles most are off. False if the map's descriptor does not
            compare, or the map is not in metres.
    """

    away: NDArray[np.float64]
    unlike: NDArray[np.float64]
    recognized: NDArray[np.bool_]
    passed: NDArray[np.bool_]
    changed: NDArray[np.float64]
    misplaced: NDArray[np.bool_]


def judged(known: VisualMap, drive: VisualMap, radius: float) -> Judged:
    """Compare the frames of a drive with those of a map.

    A map frame that resembles the drive's frames, but says that most of them were taken where they were not, is not
    recognized: something else, such as a cupboard that was moved, is what both show.

    Args:
        known: a map of m frames with positions.
        drive: n frames with positions, described as the map was.
        radius: distance within which frames show the same place. A frame passes the map frames within half of it, and
            map frames beyond it are elsewhere.
    """
    n, m = len(drive), len(known)
    away, unlike = np.zeros((2, n))
    recognized, passed, changed = np.zeros(m, dtype=bool), np.zeros(m, dtype=bool), np.full(m, np.inf)
    misplaced, votes = np.zeros(n, dtype=bool), np.zeros(m, dtype=np.int64)
    for part in slices(n, _AT_ONCE):
        rows = np.arange(n)[part]
        alike = learned_distances(known, drive.turning(rows))
        apart = np.linalg.norm(drive.frames.xy[rows, None] - known.frames.xy, axis=2)
        apart[drive.frames.building[rows, None] != known.frames.building] = np.inf
        elsewhere = np.where(apart > radius, alike, np.inf).min(axis=1, keepdims=True)
        close = apart <= radius / 2
        passed |= close.any(axis=0)
        np.minimum(changed, np.where(close, alike, np.inf).min(axis=0), out=changed)
        recognized |= (close & (alike < elsewhere)).any(axis=0)
        away[part] = apart.min(axis=1)
        alike[apart > radius] = np.inf
        unlike[part] = alike.min(axis=1)
        misplaced[part] = _misplaced(known, drive.take(rows), alike, votes)
    return Judged(away, unlike, recognized & (votes >= 0), passed, changed, misplaced)


def _misplaced(
    known: VisualMap, drive: VisualMap, alike: NDArray[np.float64], votes: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return for which frames of a drive (n,) most comparisons with map frames that have headings give a wrong pose.

    Args:
        known: the map (m frames).
        drive: the frames.
        alike: (n, m) distances of the descriptors; infinite for map frames that are not to be compared.
        votes: (m,) of each map frame, to which the right comparisons are added and from which the wrong ones are taken.
    """
    compares, parts, frames = comparison_of(known), drive.turning().orientation, drive.frames
    oriented = np.isfinite(frames.theta)[:, None] & np.isfinite(known.frames.theta)
    if compares is None or parts is None or not oriented.any():
        return np.zeros(len(drive), dtype=bool)
    near = np.where(oriented, alike, np.inf)
    rows = np.argsort(near, axis=1)[:, :_COMPARED]
    found = compare_with(known, parts, rows, compares)
    usable = np.isfinite(np.take_along_axis(near, rows, axis=1)) & (found.match >= ODDS)
    own = np.repeat(np.arange(len(drive)), rows.shape[1]) + len(known)
    poses = np.column_stack([np.r_[known.frames.xy, frames.xy], np.r_[known.frames.theta, frames.theta]])
    right = agree(relative(poses, rows.ravel(), own), found.pose.reshape(-1, 3)).reshape(rows.shape)
    np.add.at(votes, rows[usable], np.where(right, 1, -1)[usable])
    return np.asarray((usable & ~right).sum(axis=1) > (usable & right).sum(axis=1))


def strange(known: VisualMap, drive: VisualMap, alike: Retrieval) -> NDArray[np.bool_]:
    """Return which frames of a drive (n,) show nothing that is on the map, as those of another building.

    Their strangeness is that of images from elsewhere, and no comparison with the map frames that resemble them most
    (n, k) is more likely right than wrong. None if the map's descriptor does not compare.
    """
    compares, parts, found = comparison_of(known), drive.turning().orientation, np.zeros(len(drive), dtype=bool)
    if compares is not None and parts is not None and alike.strangeness is not None:
        found |= alike.strangeness > STRANGE
        rows = np.flatnonzero(found)
        for part in (rows[one] for one in slices(len(rows), _AT_ONCE)):
            found[part] = (compare_with(known, parts[part], alike.indices[part], compares).match < 0).all(axis=1)
    return found


def usual_distance(known: VisualMap, radius: float, share: float) -> float | None:
    """Learn how much the neighbours in a map differ: None for a map whose frames have too few neighbours.

    Args:
        known: the map.
        radius: distance within which frames are neighbours.
        share: share of the frames whose most similar neighbour of the same drive is at most this far from them.

    Returns:
        The distance between descriptors.
    """
    nearest, drive = np.full(len(known), np.inf), known.frames.sequence
    for rows, _, apart in compared_nearby(known, radius, lambda a, b: (a != b) & (drive[a] == drive[b])):
        np.minimum.at(nearest, rows, apart)
    nearest = nearest[np.isfinite(nearest)]
    return None if len(nearest) < _FEWEST else float(np.quantile(nearest, share))


def enough_of(evidence: NDArray[np.bool_], least: int, window: int) -> NDArray[np.bool_]:
    """Return which of n consecutive frames lie in a window with evidence in at least `least` frames."""
    if len(evidence) < window:
        return np.zeros(len(evidence), dtype=bool)
    ones = np.ones(window, dtype=np.int64)
    enough = np.convolve(evidence, ones, "valid") >= least
    return np.asarray(np.convolve(enough, ones) > 0)


def repeated(drive: VisualMap, radius: float, usual: float) -> NDArray[np.bool_]:
    """Return which frames of a drive (n,) show almost the same as an earlier frame that is no repetition itself."""
    found = np.zeros(len(drive), dtype=bool)
    for rows, others, apart in compared_nearby(drive, radius, np.greater):  # the frames in order
        close = apart <= usual
        for row, earlier in zip(rows[close].tolist(), others[close].tolist(), strict=True):
            found[row] |= not found[earlier]
    return found


def map_reasons(known: VisualMap, found: Judged, lightings: Iterable[str]) -> NDArray[np.object_]:
    """Say for each frame of a map (m,) whether a drive recognized it.

    A frame that was not recognized is contradicted only if the drive was driven in its light: not if both lights have
    names that differ, nor if the drive recognized less than a quarter of the frames that joined the map on the same
    drive, where the share of the whole map counts as ten more frames.

    Args:
        known: the map.
        found: how it compares with the drive.
        lightings: names of the light of the drive's frames.
    """
    reason = np.full(len(known), Reason.KEPT, dtype=object)
    reason[found.passed & ~found.recognized] = Reason.CONTRADICTED
    reason[found.recognized] = Reason.CONFIRMED
    overall = found.recognized.sum() / max(found.passed.sum(), 1)
    other = np.zeros(len(known), dtype=bool)
    for rows in known.frames.rows_by("sequence").values():
        share = (found.recognized[rows].sum() + _PRIOR * overall) / (found.passed[rows].sum() + _PRIOR)
        other[rows] = share < _SOME
    if named := set(lightings) - {""}:
        other |= ~np.isin(known.frames.lighting, ["", *named])
    reason[(reason == Reason.CONTRADICTED) & other] = Reason.OTHER_LIGHT
    return reason
