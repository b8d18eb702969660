"""The rims of a mirror: circles around what changes in the pictures of a drive."""

from __future__ import annotations

import cv2
import numpy as np

from siamloc.data.panorama import Array
from siamloc.errors import DataError

_SECTORS = 90
_COARSE = 8  # pixels of a picture's side that become one for the first guess
_QUIET = 0.6  # grey levels; a picture that changes less than this shows a camera that stands still
_CONTRAST = 1.6  # how many times more the scene has to change than what is next to it
_RIM = 0.4  # share of the directions in which a rim has to be found
_RISE = 0.3  # least mean rise of the logarithm of the variance at the inner rim
_EDGED = 0.3  # share of the directions in which a part of the robot may end at the same radius
_LEAST = 0.07  # share of the outer radius; the holes of mirrors are larger
_SECOND = 2 / 3  # largest rise at another radius, as a share of that at the inner rim
_ROUNDING = 1 / 12  # variance of a grey level that is rounded
_REACH = 8.0  # pixels by which a picture's centre may be off that of the drive
_GAP = 150.0  # largest angle in degrees without a rim


def changes(pictures: Array, still: Array) -> Array:
    """Return how much each pixel changes over pictures (n, rows, columns), apart from the light.

    The light of the room and the exposure change the brightness of everything. How much is measured where nothing else
    changes: in the pixels `still` (rows, columns), of which bright ones count most.
    """
    smooth = np.stack([cv2.GaussianBlur(picture, (0, 0), 1.0) for picture in pictures])
    mean = smooth.mean(axis=0)
    smooth -= mean
    light = smooth[:, still] @ mean[still]
    light /= np.linalg.norm(light) or 1.0
    smooth -= light[:, None, None] * np.tensordot(light, smooth, axes=1)
    return np.asarray(np.sqrt((smooth**2).sum(axis=0) / (len(smooth) - 2)))


def guess(moving: Array) -> tuple[Array, float]:
    """Return the centre (2,) and radius of the circle that best separates what changes from what does not."""
    rows, columns = (side // _COARSE for side in moving.shape)
    image = cv2.resize(np.log(moving + 0.1), (columns, rows), interpolation=cv2.INTER_AREA)
    low, high = np.percentile(image, [5, 95])
    if np.exp(high) < _QUIET:
        raise DataError("the pictures are all alike: take some from a drive, not from a camera that stands still")
    image = np.clip((image - low) / max(high - low, 1e-6), 0, 1)
    y, x = np.mgrid[0:rows, 0:columns]
    best, found = 0.0, (0.0, 0.0, 0.0)
    total, mean = image.size, image.mean()
    for cy in range(rows // 4, rows - rows // 4):
        for cx in range(columns // 4, columns - columns // 4):
            radius = np.hypot(x - cx, y - cy).round().astype(int).ravel()
            count = np.bincount(radius).cumsum()[:-1]
            inside = np.bincount(radius, image.ravel()).cumsum()[:-1] / count - mean
            score = count / (total - count) * inside * abs(inside)  # the variance between the classes
            at = int(score.argmax())
            if score[at] > best:
                best, found = float(score[at]), (cx, cy, at + 0.5)
    if best == 0:
        raise DataError("no circle: what changes in the pictures is not in their middle")
    centre = (np.array(found[:2]) + 0.5) * _COARSE - 0.5
    return centre, found[2] * _COARSE


def _ways(count: int) -> Array:
    """Return unit vectors (count, 2) in all directions: columns and rows."""
    angle = (np.arange(count) + 0.5) * (2 * np.pi / count)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _profiles(image: Array, centre: Array, radii: Array, sectors: int) -> Array:
    """Return the mean of an image over the arcs of each sector, at each radius (sectors, radii); NaN outside."""
    rows, columns = image.shape
    fine = 8
    x, y = (middle + way[:, None] * radii for middle, way in zip(centre, _ways(sectors * fine).T, strict=True))
    found = cv2.remap(image.astype(np.float32), x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
    found[(x < 0) | (y < 0) | (x > columns - 1) | (y > rows - 1)] = np.nan
    return found.reshape(sectors, fine, -1).mean(axis=1)


def _edges(variance: Array, radii: Array) -> tuple[Array, Array]:
    """Return the radius at which each profile steps from much to little change (sectors,), NaN without such a step, and
    by which factor the change falls there."""
    found, falls = np.full(len(variance), np.nan), np.ones(len(variance))
    for number, profile in enumerate(variance):
        known = np.isfinite(profile)
        if known.sum() < 12:
            continue
        r, v = radii[known], profile[known]
        log = np.log(v + 0.01)
        count = np.arange(1, len(log))
        before, after = log.cumsum()[:-1] / count, log[::-1].cumsum()[::-1][1:] / count[::-1]
        score = count * count[::-1] * (before - after).clip(0) ** 2
        score[:4] = score[-4:] = 0
        at = int(score.argmax())
        if score[at] <= 0:
            continue
        floor = np.median(v[at + 4 : at + 16]) if at + 6 < len(v) else v[-1]
        excess = np.sqrt((v - floor).clip(0))
        plateau = np.median(excess[max(0, at - 12) : max(1, at - 3)])
        near = slice(max(0, at - 8), min(len(v), at + 9))
        above = excess[near] > plateau / 2
        cross = np.flatnonzero(above[:-1] & ~above[1:])
        if len(cross) == 0 or plateau <= 0:
            continue
        cross = cross[abs(cross + near.start - at).argmin()] + near.start
        share = (excess[cross] - plateau / 2) / max(excess[cross] - excess[cross + 1], 1e-9)
        found[number] = r[cross] + share * (r[cross + 1] - r[cross])
        falls[number] = np.sqrt((plateau**2 + floor) / (floor + 0.01))
    return found, falls


def outer_rim(moving: Array, centre: Array, radius: float) -> tuple[Array, float, float, float]:
    """Return centre and radius of the outer rim, the deviation of its points, and the share of directions with one."""
    for reach in (0.25, 0.12, 0.06, 0.06):
        half = max(reach * radius, 10.0)
        radii = np.arange(radius - half, radius + half, 0.5)
        radii = radii[radii > 1]
        edges, falls = _edges(_profiles(moving**2, centre, radii, _SECTORS), radii)
        sure = np.isfinite(edges) & (falls > _CONTRAST)
        points = centre + edges[sure, None] * _ways(_SECTORS)[sure]
        if len(points) < 0.25 * _SECTORS:
            raise DataError("no circle around what changes in the pictures")
        centre, radius, near = _circle(points, max(1.0, 0.02 * radius))
    kept = points[near]
    off = np.hypot(*(kept - centre).T) - radius
    around = np.sort(np.arctan2(*(kept - centre).T[::-1]))
    gap = np.degrees(np.diff([*around, around[0] + 2 * np.pi]).max())
    share = len(kept) / _SECTORS
    if share < _RIM or gap > _GAP:
        raise DataError(f"no circle that is sure: only {share:.0%} of the rim around the mirror shows")
    return centre, radius, float(off.std()), share


def _circle(points: Array, most: float) -> tuple[Array, float, Array]:
    """Return centre and radius of the circle on which most points (n, 2) lie, and which points do."""
    rng = np.random.default_rng(0)
    best, near = -1.0, np.zeros(len(points), bool)
    for _ in range(300):
        centre, radius = _through(points[rng.choice(len(points), 3, replace=False)])
        off = abs(np.hypot(*(points - centre).T) - radius)
        score = float((1 - (off / most) ** 2).clip(0).sum())
        if score > best:
            best, near = score, off < most
    for _ in range(5):
        centre, radius = _through(points[near])
        off = abs(np.hypot(*(points - centre).T) - radius)
        near = off < min(most, max(0.7, 3 * np.median(off[near])))
    return centre, radius, near


def _through(points: Array) -> tuple[Array, float]:
    """Return centre (2,) and radius of the circle through points (n, 2), by least squares (Kasa 1976)."""
    middle = points.mean(axis=0)
    shifted = points - middle
    sides = np.column_stack([2 * shifted, np.ones(len(points))])
    solved = np.linalg.lstsq(sides, (shifted**2).sum(axis=1), rcond=None)[0]
    return middle + solved[:2], float(np.sqrt(max(solved[2] + (solved[:2] ** 2).sum(), 0)))


def inner_rim(moving: Array, centre: Array, outer: float) -> float:
    """Return the radius of the inner rim: where the change rises in most directions at once.

    The directions in which it rises most do not count, as the edge of the robot's deck rises most of all.
    """
    half, step = 5, 0.5
    radii = np.arange(1.0, 0.6 * outer, step)
    variance = _profiles(moving**2, centre, radii, _SECTORS // 2)
    log = np.log(variance + _ROUNDING)
    wide = round(half / step)
    sums = np.concatenate([np.zeros((len(log), 1)), log.cumsum(axis=1)], axis=1)
    means = (sums[:, wide:] - sums[:, :-wide]) / wide
    gap = round(1.5 / step)
    if means.shape[1] <= wide + 2 * gap:
        raise DataError("no inner rim that is sure: the ring is only some pixels wide")
    rises = means[:, wide + 2 * gap :] - means[:, : -wide - 2 * gap]
    level = means.mean(axis=0)
    last = np.array([level[at : at + round(0.1 * outer / step)].min() for at in range(len(level))])
    lasting = last[wide + 2 * gap :] - level[: -wide - 2 * gap]  # the edge of something still is a ridge only
    counted = np.sort(rises, axis=0)[: round((1 - _EDGED) * len(rises))]
    score = counted.mean(axis=0) * (lasting > _RISE)
    at = int(score.argmax())
    if score[at] < _RISE:
        raise DataError("no inner rim that is sure: nothing round stands still in the middle of the ring")
    elsewhere = np.delete(score, slice(max(0, at - 2 * wide), at + 2 * wide))
    if elsewhere.max(initial=0) > _SECOND * score[at]:
        raise DataError("no inner rim that is sure: two circles are as likely to be it")
    sure = rises[:, at] > _RISE
    at += wide + gap  # the middle between both means
    floor = variance[:, at - wide - gap : at - gap].mean(axis=1)
    excess = np.sqrt((variance - floor[:, None]).clip(0))
    plateau = excess[:, at + 2 * gap : at + 2 * gap + wide].mean(axis=1)  # the logarithm rises before the change itself
    near = slice(at - wide, at + wide + gap)
    shares = excess[sure, near] / plateau[sure, None].clip(1e-6)
    inwards, outwards = np.minimum.accumulate(shares[:, ::-1], axis=1)[:, ::-1], np.maximum.accumulate(shares, axis=1)
    edges = [np.interp(0.5, one.clip(0, 1), radii[near]) for one in (*inwards, *outwards)]
    radius = float(np.median(edges))
    if radius < _LEAST * outer:
        raise DataError("no inner rim that is sure: the scene reaches into the middle of the circle, as by a lens")
    return radius


def shifts(pictures: Array, centre: Array, outer: float) -> Array:
    """Return by how many columns, rows and pixels of radius the rim of each picture is off the given one (n, 3)."""
    radii = np.arange(outer - 1.5 * _REACH, outer + 1.5 * _REACH, 0.5)
    steps = np.stack(np.meshgrid(*[np.arange(-_REACH, _REACH + 1, 2.0)] * 2), axis=-1).reshape(-1, 2)
    at = (outer + steps @ np.ascontiguousarray(_ways(_SECTORS).T) - radii[0]) / 0.5
    found = []
    for picture in pictures:
        profile = np.nan_to_num(_profiles(cv2.GaussianBlur(picture, (0, 0), 1.0), centre, radii, _SECTORS))
        slope = abs(np.gradient(profile, axis=1))
        wide = cv2.blur(slope / (slope + np.median(slope, axis=1, keepdims=True) + 0.25), (5, 1))
        score = wide[np.arange(_SECTORS), at.round().astype(int)].mean(axis=1)
        found.append(_edge_shift(slope, radii, outer, steps[score.argmax()]))
    return np.stack(found)


def _edge_shift(slope: Array, radii: Array, outer: float, shift: Array) -> Array:
    """Improve a centre's shift (2,) by the steepest points of a picture's profiles; also return that of the radius."""
    ways = np.column_stack([_ways(len(slope)), np.ones(len(slope))])
    rows, found = np.arange(len(slope)), np.append(shift, 0.0)
    for reach in (4.0, 3.0, 2.0, 2.0):
        wanted = outer + ways @ found
        near = np.where(abs(radii - wanted[:, None]) < reach, slope, 0)
        at = near.argmax(axis=1).clip(1, len(radii) - 2)
        a, b, c = (slope[rows, at + k] for k in (-1, 0, 1))
        edge = radii[at] + 0.5 * (radii[1] - radii[0]) * np.clip((a - c) / np.minimum(a - 2 * b + c, -1e-6), -1, 1)
        rest = edge - wanted
        weight = np.minimum(b, np.median(b)) * (abs(rest) < reach - 0.5) / (1 + (rest / 0.5) ** 2)
        found = found + np.linalg.lstsq(ways * weight[:, None], rest * weight, rcond=None)[0]
    return found


def moved(picture: Array, shift: Array) -> Array:
    """Return a picture that is shifted by some columns and rows."""
    move = np.array([[1, 0, shift[0]], [0, 1, shift[1]]], dtype=np.float32)
    return cv2.warpAffine(picture, move, picture.shape[::-1], borderMode=cv2.BORDER_REPLICATE)
