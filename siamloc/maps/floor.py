"""How far a robot moved, by the floor that it drove over.

How far away things look depends on how large they are: comparisons take displacements for too long in small rooms, and
for too short in large ones. The floor where a robot drives, though, is a plane that nothing stands on, one height of
the camera below it. A displacement is right, in units of that height, if it brings what both ends see of the floor into
agreement ([Kitt et al. 2011], who find the scale of monocular odometry by the plane of the road).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from siamloc.data.cameras import HyperbolicMirror
from siamloc.data.levelling import tilt_of
from siamloc.data.library import PanoramaLibrary
from siamloc.data.panorama import PanoramaView, PolarRing
from siamloc.errors import ConfigError
from siamloc.maps.comparing import ODDS
from siamloc.maps.loops import Pairs
from siamloc.maps.pose_graph import Array, Edges

DEVIATION = 0.03
"""Standard deviation of the scale that follows from a known height, as a share."""
_BELOW = -0.25  # tangent of the elevation from which on the floor is looked at: out to four heights
_STEEPEST = -2.0  # and to where: the robot hides what is below it
_FEWEST = 8  # rows of floor
_SHOWN = 0.95  # share of the floor's pixels that a camera sees
_COLUMNS, _ROWS = 256, 128  # of panoramas, and rows at most
_BLUR = 3.0  # pixels: what is brighter or darker over a wider area is light, not pattern
_STILL = 0.3  # share of the usual changes: pixels that change less show the robot itself
_LANE = 0.5  # half the width of the lane that the robot drives in, in heights
_MOVES = 0.2, 2.0  # least and largest displacement that is usual of frames so far apart, in heights
_LEAST = 0.1  # least displacement, in heights
_STEP = 0.05
_FACTORS = np.linspace(-10, 10, 21) * _STEP  # logarithms of the factors that displacements are tried with
_HEIGHTS = np.linspace(-18, 28, 47) * _STEP  # and of the reciprocal heights in metres
_EVERY = 4  # panoramas, of which one tells how the camera is pitched
_TRIED = 150  # displacements that tell which height fits
_WRONG = 0.5  # logarithm of a given height over that one, beyond which no displacement is tried: it cannot be true
_ALONE, _MOST = 6.0, 60.0  # pixels that tell as much as one alone, and how many count at most
_USUAL = 0.2  # standard deviation of the logarithms of factors, and of those of neighbouring steps
_AROUND = 2.0  # standard deviation of the way over which factors are alike, in metres
_CELL = 0.1  # metres
_EXACT = 0.05  # standard deviation of a displacement that a floor tells, as a share, however much pattern it has
_TELLS = 0.4  # by how much the best factor is more likely than the others are on average, at least


@dataclass(frozen=True, eq=False)
class FloorScale:
    """What compared displacements must be multiplied by, so that they agree with the floor.

    Attributes:
        factors: (n,) at each frame.
        height: height of the camera above the floor, in metres.
        given: whether the height was given; else it is the one with which comparisons are right on average.
    """

    factors: Array
    height: float
    given: bool

    def lengthened(self, edges: Edges) -> Edges:
        """Return edges whose displacements are multiplied."""
        return _multiplied(edges, np.sqrt(self.factors[edges.first] * self.factors[edges.second]))


def shows_floor(images: PanoramaLibrary, height: float | None) -> bool:
    """Return whether panoramas show enough of the floor, at elevations that are known or presumed.

    Raises:
        ConfigError: a height of the camera is given, and they do not, or at presumed elevations.
    """
    view = images.preprocessing.view
    own = np.tan(view.row_elevation()) < _BELOW
    rings = any(isinstance(camera, PolarRing) for camera in images.cameras.values())
    shown = not rings and min(_rows(view)[1].sum(), own.sum()) >= _FEWEST and seen_by_all(images)[own].mean() >= _SHOWN
    if height is not None and (not shown or _presumed(images)):
        raise ConfigError(
            "survey.height needs panoramas that show the floor at known elevations: a ring of two radii does not say "
            "what it sees, so give the camera's calibration (unwrap=calibrated), and let it and the panoramas see "
            "the floor two heights of the camera away and nearer (elevations down to -30 degrees)"
        )
    return shown


def elevations_known(images: PanoramaLibrary) -> bool:
    """Return whether it is known which elevations panoramas show, so that lengths on the floor give metres.

    Those of pictures that are only resized are assumed, unless siamloc simulated them.
    """
    return not _presumed(images) and (images.simulated or None not in images.cameras.values())


def _presumed(images: PanoramaLibrary) -> bool:
    """Return whether a camera is a mirror that is presumed in a ring."""
    return any(isinstance(camera, HyperbolicMirror) and camera.presumed for camera in images.cameras.values())


def seen_by_all(images: PanoramaLibrary) -> NDArray[np.bool_]:
    """Return which pixels (H, W) of panoramas every drive's camera is known to see; resized ones count as seen."""
    every = np.ones(images.image_size, dtype=bool)
    for name in images.frames.rows_by("sequence"):
        if images.cameras[name] is not None:
            sees = images.seen(name)
            every &= False if sees is None else sees
    return every


def _rows(view: PanoramaView) -> tuple[Array, NDArray[np.bool_]]:
    """Return the tangent of the elevation of each row of panoramas with 256 columns, and which rows show the floor."""
    rows = min(round(_COLUMNS * view.height / view.width), _ROWS)
    slopes = np.tan(replace(view, height=max(rows, 1)).row_elevation())
    return slopes, (slopes < _BELOW) & (slopes > _STEEPEST)


@dataclass(frozen=True, eq=False)
class Floor:
    """What n frames see of the floor.

    Attributes:
        patterns: (n, R, 256 + 4) brightness relative to the surroundings, with two columns wrapped on either side; NaN
            where the robot itself is seen.
        slopes: (R,) tangent of the elevation of each row.
        pitch: of the camera on average, in rad, positive where it looks down ahead, by the edges that stand upright.
    """

    patterns: NDArray[np.float32]
    slopes: Array
    pitch: float

    @classmethod
    def seen(
        cls, batches: Iterable[NDArray[np.uint8]], view: PanoramaView, sees: NDArray[np.bool_] | None = None
    ) -> Floor:
        """Return the floor in the panoramas (B, 3, H, W) of n frames, in order, whose middle looks ahead.

        Args:
            batches: the panoramas.
            view: the elevations of their rows.
            sees: which of their pixels (H, W) the camera sees; all if None.
        """
        slopes, floor = _rows(view)
        made, pitches = list[NDArray[np.float32]](), list[float]()
        for batch in batches:
            made.append(_patterns(batch, floor))
            pitches += [tilt_of(panorama.transpose(1, 2, 0), view, sees)[1] for panorama in batch[::_EVERY]]
        patterns = np.concatenate(made)
        changes = patterns.std(axis=0)
        patterns[:, changes < _STILL * np.median(changes)] = np.nan
        return cls(patterns, slopes[floor], float(np.median(pitches)))

    def likelihoods(self, pairs: Edges, factors: Array) -> Array:
        """Return how likely displacements (p,) are when multiplied by factors (q,), given by their logarithms: (p, q).

        Logarithms, up to a constant: those of a linear relation with normal errors between the floors as both ends see
        it. All are 0 if the least factor is the most likely: what moves along with the robot, as reflections do, tells
        nothing.

        Args:
            pairs: displacements of the second frames as seen from the first.
            factors: displacements then count in heights of the camera.
        """
        slopes = self.slopes
        azimuth = (_COLUMNS / 2 - np.arange(_COLUMNS) - 0.5) * (2 * np.pi / _COLUMNS)
        ahead, up = _pitched(np.cos(azimuth), slopes[:, None], self.pitch)
        x, y = (-ahead / up).ravel(), (-np.sin(azimuth) / up).ravel()
        step = (slopes[-1] - slopes[0]) / (len(slopes) - 1)
        by, made = np.exp(factors)[:, None], np.zeros((len(pairs), len(factors)))
        for row, (ahead, left, turn) in enumerate(pairs.pose):
            one, other = self.patterns[pairs.first[row]], self.patterns[pairs.second[row], :, 2:-2].ravel()
            cosine, sine = np.cos(turn), np.sin(turn)
            x_there, y_there = cosine * x - sine * y, sine * x + cosine * y
            lane = np.abs(ahead * y_there - left * x_there) < _LANE * np.hypot(ahead, left)
            x_there, y_there, other = x_there[lane] + by * ahead, y_there[lane] + by * left, other[lane]
            x_there, up = _pitched(x_there, -1, -self.pitch)
            columns = (_COLUMNS / 2 - 0.5 - np.arctan2(y_there, x_there) * _COLUMNS / (2 * np.pi)) % _COLUMNS + 2
            rows = (up / np.hypot(x_there, y_there) - slopes[0]) / step
            sampled = cv2.remap(one, columns.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR)
            inside = (rows > 0) & (rows < len(slopes) - 1) & np.isfinite(sampled) & np.isfinite(other)
            products = (np.where(inside, of, 0) for of in (sampled * other, sampled**2, other**2))
            both, own, others = (of.sum(axis=1) for of in products)
            alike = np.clip(both / np.sqrt(own * others + 1e-9), 0, 0.98)
            made[row] = -0.5 * np.log1p(-(alike**2)) * np.minimum(inside.sum(axis=1) / _ALONE, _MOST)
        made[made.argmax(axis=1) == 0] = 0
        return made


def lengthening(compared: Pairs, scale: FloorScale, floor: Floor) -> Pairs:
    """Return a function that compares frames as another does, and then multiplies the displacements.

    Where two frames were taken near each other and see enough of the same floor, their displacement gets a factor of
    its own.
    """
    tried = _FACTORS - float(np.log(scale.height))

    def comparing(first: NDArray[np.int64], second: NDArray[np.int64]) -> tuple[Edges, Array]:
        edges, odds = compared(first, second)
        edges = scale.lengthened(edges)
        moved = np.hypot(edges.pose[:, 0], edges.pose[:, 1]) / scale.height
        rows = np.flatnonzero((odds >= ODDS) & (moved > _LEAST) & (moved < _MOVES[1]))
        likely = floor.likelihoods(edges.take(rows), tried)
        clear = _clearness(likely) >= _TELLS
        logarithms, deviation = _peaks(likely[clear])
        factors = np.ones(len(edges))
        factors[rows[clear]] = np.exp(logarithms)
        return _more_certain(_multiplied(edges, factors), rows[clear], deviation), odds

    return comparing


def floor_scale(floor: Floor, steps: Edges, way: Array, height: float | None) -> tuple[FloorScale, Edges] | None:
    """Return the factors of compared displacements at each of n frames, and the steps with lengths by the floor.

    Steps that are too long for the floor are left out, unless they lead to the next frame. None if the floor shows too
    little.

    Args:
        floor: what the n frames see of it.
        steps: compared pairs of frames between which the robot moved a little.
        way: (n,) way that the robot drove, in metres, with gaps between drives.
        height: of the camera above the floor, in metres; None if unknown.
    """
    moved, between = np.hypot(steps.pose[:, 0], steps.pose[:, 1]), steps.second - steps.first
    some = np.flatnonzero((moved > _MOVES[0] / 2) & (moved < _MOVES[1]))
    some = some[np.unique(np.linspace(0, len(some) - 1, min(_TRIED, len(some))).astype(int))]
    tried = floor.likelihoods(steps.take(some), _HEIGHTS).sum(axis=0)
    if not tried.any():
        return None
    fits, given = float(np.exp(-_HEIGHTS[tried.argmax()])), height is not None
    height = fits if height is None else height
    if abs(np.log(height / fits)) > _WRONG:
        return None
    moving = moved > _LEAST * height
    usual = {gap: np.median(moved[moving & (between == gap)]) / height for gap in np.unique(between[moving]).tolist()}
    told = [gap for gap, length in usual.items() if _MOVES[0] < length < _MOVES[1]]
    used = np.flatnonzero(np.isin(between, told) & moving)
    near, moved = steps.take(used), moved[used]
    found = floor.likelihoods(near, _FACTORS - float(np.log(height)))
    telling = found[found.any(axis=1)]
    if not len(telling) or np.median(_clearness(telling)) < _TELLS:
        return None
    cell = np.round((way - way.min()) / _CELL).astype(int)
    middle = (cell[near.first] + cell[near.second]) // 2

    def around(values: Array) -> Array:
        """Return sums of values of the steps (p, k) around each cell of the way (c, k)."""
        sums, spread = np.zeros((cell.max() + 1, values.shape[1])), _AROUND / _CELL
        np.add.at(sums, middle, values)
        return np.asarray(gaussian_filter1d(sums, spread, axis=0, mode="constant") * spread * np.sqrt(2 * np.pi))

    usually = _peaks(around(found))[0][middle]
    own, deviation = _peaks(found, usually[:, None])
    own = np.exp(own)
    compared, by_floor = around(np.column_stack([moved, moved * own])).T
    factors = np.where(compared > 1e-3, by_floor / np.maximum(compared, 1e-3), 1.0)[cell]
    every = np.sqrt(factors[steps.first] * factors[steps.second])
    every[used] = own
    steps, kept = _more_certain(_multiplied(steps, every), used, deviation), np.flatnonzero(between == 1)
    return FloorScale(factors, height, given), steps.take(np.union1d(used, kept))


def _multiplied(edges: Edges, factors: Array) -> Edges:
    """Return edges whose displacements are multiplied by factors (e,), as certain in proportion."""
    by = np.column_stack([factors, factors, np.ones_like(factors)])
    return replace(edges, pose=edges.pose * by, information=edges.information / (by[:, :, None] * by[:, None]))


def _more_certain(edges: Edges, rows: NDArray[np.int64], deviation: Array) -> Edges:
    """Return edges with more information in some rows (r,), whose lengths are by the floor.

    Args:
        edges: the edges (e).
        rows: rows of the edges with such lengths.
        deviation: standard deviations of the logarithms of these lengths (r,).
    """
    length, information = np.hypot(edges.pose[rows, 0], edges.pose[rows, 1]), edges.information.copy()
    along = edges.pose[rows, :2] / (length**2 * np.hypot(_EXACT, deviation))[:, None]
    information[rows, :2, :2] += along[:, :, None] * along[:, None]
    return replace(edges, information=information)


def _patterns(batch: NDArray[np.uint8], floor: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Return the patterns (B, R, 256 + 4) of the rows of the floor in panoramas; see `Floor`."""
    around = round(5 * _BLUR)
    made = np.empty((len(batch), int(floor.sum()), _COLUMNS + 4), dtype=np.float32)
    for one, panorama in zip(made, batch, strict=True):
        grey = cv2.resize(panorama.mean(axis=0, dtype=np.float32), (_COLUMNS, len(floor)), interpolation=cv2.INTER_AREA)
        wide = np.pad(np.log(grey + 8), ((0, 0), (around, around)), mode="wrap")
        one[:] = (wide - cv2.GaussianBlur(wide, (0, 0), _BLUR))[floor, around - 2 : 2 - around]
    return made


def _pitched(ahead: Array, up: Array | float, pitch: float) -> tuple[Array, Array]:
    """Turn directions (ahead, up) from the view of a camera that is pitched down into the view of a level camera."""
    return np.cos(pitch) * ahead + np.sin(pitch) * up, np.cos(pitch) * up - np.sin(pitch) * ahead


def _clearness(likelihoods: Array) -> Array:
    """Return by how much the best factor of each row (n, q) is more likely than the others are on average (n,)."""
    return np.asarray(likelihoods.max(axis=1) - likelihoods.mean(axis=1))


def _peaks(likelihoods: Array, usually: Array | float = 0.0) -> tuple[Array, Array]:
    """Return the logarithm of the most probable factor of each row, by a parabola, and its standard deviation.

    Args:
        likelihoods: (n, q), logarithms.
        usually: logarithm of the factor that is usual, for all rows or each (n, 1).
    """
    values = likelihoods - ((_FACTORS - usually) / _USUAL) ** 2 / 2
    rows, best = np.arange(len(values)), values.argmax(axis=1).clip(1, values.shape[1] - 2)
    before, here, after = (values[rows, best + by] for by in (-1, 0, 1))
    bend = np.maximum(2 * here - before - after, 1e-9)
    return _FACTORS[best] + np.clip((after - before) / bend / 2, -1, 1) * _STEP, _STEP / np.sqrt(bend)
