"""How a camera is mounted on its robot: `Mounting`, and `find_mounting`, which learns it from a drive.

Seen from one image, the camera at yaw Y and offset o from the robot's centre moves by u if the robot moves by t and
turns by D: R(Y) u = t + (R(D) - 1) o, the hand-eye equation in the plane. Without poses, t is taken to be straight
ahead, along an arc.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from analytic import Descriptor
from foundation.calls import typed
from foundation.settings import Settings
from siamloc.data.drive_pairs import ahead, near_pairs, successive_pairs, travel
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.moves import inverse, relative, wrapped
from siamloc.data.panorama import PanoramaView, PolarRing
from siamloc.data.trajectory import Array
from siamloc.errors import ConfigError

STRAIGHT = 2.0
"""Degrees of yaw that are left as they are: they cost next to nothing, and an estimate may be off by as much."""
NEAR = 0.2
"""Offset of the camera that is left as it is, in the unit of the positions: comparisons are biased by up to 0.15 m in a
house whose walls are always on one side."""
CERTAIN = 2.0
"""Largest deviation of a yaw, in degrees, with which a camera is known to look straight ahead."""
_FEWEST = 12  # pairs, of those that turn as well
_TURNS = np.radians(15)  # a pair turns from here on
_TURNED = np.radians(2)  # least mean turn that the images and the headings have in common, in either direction
_AGREE = 0.7  # share of these turns that must tell the same direction of columns
_FITS = 0.5  # largest part of the moves that may remain unexplained
_STATED = 5.0  # largest deviation of a yaw that is stated, in degrees
_PARTS = (5, 8)  # fewest and most parts of the drive, each of which is left out once to learn the deviations
_SURE = 3  # deviations from which on the camera's offset counts, and a yaw that is not certain
_BIASED = 0.05  # part of a move by which all comparisons along a drive may be off alike
_RIMS = (25.0, -50.0)  # elevations in degrees taken for the outer and inner rim of a mirror, where nobody knows them
_HARDLY_TURNS = "the drive hardly turns: whether panoramas are mirrored, and the camera's offset, are unknown"
_NO_OFFSET = "the drive turns too little, or in too few places: the camera's offset is unknown"
_UNPOSED = "whether panoramas are mirrored, and the camera's offset, are unknown without poses"
_EXCHANGED = (
    "the camera moves in the images as if the poses were those of the map as seen from the robot: exchange the two "
    "frames, such as map:base_link for base_link:map, or invert the poses, unless y or theta has the wrong sign"
)
_ROUNDS = 5
_WORST = 0.02  # by which a comparison may be off however certain it says it is, in the unit of x and y


@dataclass(frozen=True)
class Mounting(Settings):
    """How a camera is mounted on the robot, or how its panoramas are stored.

    Attributes:
        yaw: how far the middle column of a panorama looks to the left of the robot's heading, in degrees; of a mirrored
            panorama, after it is flipped.
        mirrored: whether the columns run counter-clockwise, so that the panorama shows the left on its right.
        ahead: where the camera is ahead of the point of the robot whose poses are given, in the unit of the poses.
        left: where the camera is to the left of that point.

    Example:
        >>> Mounting(yaw=90).straight(np.arange(8)).tolist()  # the robot's front is a quarter turn to the right
        [2, 3, 4, 5, 6, 7, 0, 1]
        >>> Mounting(mirrored=True).straight(np.arange(4)).tolist()
        [3, 2, 1, 0]
    """

    WHERE: ClassVar[str] = "mounting"

    yaw: float = 0.0
    mirrored: bool = False
    ahead: float = 0.0
    left: float = 0.0

    @typed
    def straight(self, panoramas: NDArray) -> NDArray:
        """Return panoramas (..., W) that are flipped and turned, by whole columns, so that their middle looks ahead."""
        columns = round(self.yaw * panoramas.shape[-1] / 360)
        panoramas = np.ascontiguousarray(panoramas[..., ::-1]) if self.mirrored else panoramas
        return np.roll(panoramas, -columns, axis=-1) if columns else panoramas

    def offset(self, theta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the camera's offset from that point of the robot (..., 2) in the map, at headings (...) in rad."""
        cosine, sine = np.cos(theta), np.sin(theta)
        return np.stack([cosine * self.ahead - sine * self.left, sine * self.ahead + cosine * self.left], axis=-1)


@dataclass(frozen=True)
class GivenMounting(Settings):
    """What a user says of how a camera is mounted: the keys of `Mounting`, all None if it is to be estimated.

    Example:
        >>> GivenMounting(yaw=90).known
        Mounting(yaw=90, mirrored=False, ahead=0.0, left=0.0)
    """

    WHERE: ClassVar[str] = "mounting"

    yaw: float | None = None
    mirrored: bool | None = None
    ahead: float | None = None
    left: float | None = None

    @property
    def known(self) -> Mounting | None:
        """The mounting, straight where nothing else is said; None if nothing is said at all."""
        said = {key: value for key, value in self.plain().items() if value is not None}
        if self.yaw is not None:
            said["yaw"] = (self.yaw + 180) % 360 - 180
        return Mounting.of(said) if said else None


@dataclass(frozen=True)
class MountingEstimate:
    """How a camera is mounted, with standard deviations, and the reasons for what is unknown.

    Attributes:
        yaw: how far the panorama's middle looks to the left of the heading, in degrees; NaN if unknown.
        yaw_deviation: its standard deviation, in degrees: how far parts of the drive, short and long moves, and the two
            orders of the images disagree.
        mirrored: whether columns run counter-clockwise; None if unknown.
        offset: where the camera is ahead and to the left of the robot's centre, in the unit of the positions; NaN if
            unknown.
        offset_deviation: standard deviation of each, in that unit: how far parts of the drive disagree, and what moves
            that all comparisons see too long, or to one side, would pass for; NaN if unknown.
        pairs: number of pairs of images compared.
        reasons: a sentence for what is unknown.
    """

    yaw: float = np.nan
    yaw_deviation: float = np.nan
    mirrored: bool | None = None
    offset: tuple[float, float] = (np.nan, np.nan)
    offset_deviation: tuple[float, float] = (np.nan, np.nan)
    pairs: int = 0
    reasons: tuple[str, ...] = ()

    def ring(self, used: PolarRing) -> PolarRing:
        """Return the ring that makes panoramas whose middle looks ahead, from the ring that made the given ones.

        What is unknown stays as it is in that ring.

        Example:
            >>> MountingEstimate(yaw=30, mirrored=True).ring(PolarRing(forward=90.0, mirrored=True))
            PolarRing(centre=None, inner=None, outer=None, forward=120.0, mirrored=False, inside_up=False)
        """
        turned = self.yaw if bool(self.mirrored) == used.mirrored else -self.yaw
        forward = used.forward if np.isnan(turned) else round(used.forward + turned, 1) % 360
        return replace(used, forward=forward, mirrored=used.mirrored is not bool(self.mirrored))

    @property
    def mounting(self) -> Mounting:
        """The mounting to correct for: nothing of what is unknown or uncertain, and no yaw too small to matter."""
        least = max((2 if self.yaw_deviation <= CERTAIN else _SURE) * self.yaw_deviation, STRAIGHT)
        yaw = self.yaw if abs(self.yaw) > least else 0.0  # nor if either is NaN
        ahead, left = self.offset if np.hypot(*self.offset) > NEAR else (0.0, 0.0)
        return Mounting(round(yaw, 2), bool(self.mirrored), round(ahead, 3), round(left, 3))

    def summary(self, unit: str = "m") -> str:
        """Return what is known, and the reasons for the rest, in one line."""
        side = "left" if self.yaw > 0 else "right"
        found = []
        if np.isfinite(self.yaw):
            found.append(f"it looks {abs(self.yaw):.1f} +- {self.yaw_deviation:.1f} degrees {side} of the heading")
        if self.mirrored:
            found.append("its panoramas are mirrored")
        if self.mounting.ahead or self.mounting.left:
            (ahead, left), (one, other) = self.offset, self.offset_deviation
            found.append(
                f"it is {ahead:.2f} +- {one:.2f} {unit} ahead and {left:.2f} +- {other:.2f} {unit} to the left of the "
                "point whose poses are given"
            )
        return "; ".join([*found, *self.reasons])


@typed
def find_mounting(described_by: Descriptor, images: PanoramaLibrary, frames: FrameTable) -> MountingEstimate:
    """Estimate how the camera is mounted, from the images and poses of a drive.

    The network says for pairs of images how the camera moved and turned, the poses say how the robot did. Without
    headings, the robot is taken to look where it drives; without positions, only the yaw is known.
    `siamloc.maps.build` does the same with the frames of a map, and takes the result into account.

    Args:
        described_by: a network that compares, `siamloc.models.as_descriptor(siamloc.models.pretrained())`.
        images: panoramas of the frames.
        frames: frames in capture order, close together.

    Raises:
        ConfigError: a descriptor that does not compare.

    Example:
        >>> by = siamloc.models.as_descriptor(siamloc.models.pretrained())  # doctest: +SKIP
        >>> siamloc.data.find_mounting(by, images, frames).yaw  # doctest: +SKIP
        30.2
    """
    if not getattr(described_by, "compares", False):
        raise ConfigError(f"{described_by.name} does not compare images: take the network that ships with siamloc")
    readable = images.readable(frames)
    if not np.isfinite(readable.theta).any():
        readable = readable.with_columns(theta=travel(readable))
    posed = bool((np.isfinite(readable.theta) & readable.has_position).any())
    pairs = near_pairs(readable) if posed else successive_pairs(readable)
    rows = np.unique(np.concatenate(pairs))
    used = readable.take(rows)
    parts = orientation_parts(described_by, images, used)
    compares: Callable[..., tuple[Array, Array, Array]] = described_by.compare  # type: ignore[attr-defined]
    first, second = (np.searchsorted(rows, one) for one in pairs)
    straight = estimate(used, parts, compares, posed, (first, second))
    if posed and straight.pairs and np.isnan(straight.yaw):
        x, y, theta = inverse(np.column_stack([used.xy, used.theta])).T
        exchanged = estimate(used.with_columns(x=x, y=y, theta=theta), parts, compares)
        if np.isfinite(exchanged.yaw) and exchanged.mirrored is not None:
            return MountingEstimate(mirrored=exchanged.mirrored, pairs=exchanged.pairs, reasons=(_EXCHANGED,))
    return straight


def orientation_parts(described_by: Descriptor, images: PanoramaLibrary, frames: FrameTable) -> NDArray[Any]:
    """Return what a network compares of the images of n frames: their orientation parts (n, K, F)."""
    size = getattr(getattr(described_by, "module", None), "image_size", None) or images.image_size
    view = images.preprocessing.view
    rings = any(isinstance(camera, PolarRing) for camera in images.cameras.values())
    batches = (usual_rows(batch, view) if rings else batch for batch in images.batches(frames))
    found = [described_by.describe(resized(batch, size)).orientation for batch in batches]
    return np.concatenate(found) if len(frames) else np.zeros((0, 1, 1))  # type: ignore[arg-type]


def estimate(
    frames: FrameTable,
    parts: NDArray[Any],
    compares: Callable[..., tuple[Array, Array, Array]],
    posed: bool = True,
    pairs: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None,
) -> MountingEstimate:
    """Estimate how the camera is mounted, from the orientation parts (n, K, F) of n frames; see `find_mounting`.

    Args:
        frames: frames in capture order.
        parts: their orientation parts.
        compares: compares orientation parts, see `siamloc.maps.comparing.Compares`.
        posed: whether the poses are known; if not, the robot is taken to drive ahead.
        pairs: rows of the frames that are compared; chosen among all frames if None.
    """
    first, second = pairs or (near_pairs(frames) if posed else successive_pairs(frames))
    if not len(first):
        return MountingEstimate(reasons=("no successive frames with headings are near each other",))
    pose, information, match = compares(*(np.asarray(parts[rows], dtype=np.float32) for rows in (second, first)))
    known = match > 0
    first, second, pose, information = first[known], second[known], pose[known], information[known]
    if len(first) < _FEWEST:
        reason = f"only {len(first)} pairs of successive images can be compared, and {_FEWEST} are needed"
        return MountingEstimate(pairs=len(first), reasons=(reason,))
    if posed:
        moved = relative(np.column_stack([frames.xy, frames.theta]), first, second)
        share = _agreeing(moved[:, 2], pose[:, 2])
        turns = int((np.abs(moved[:, 2]) > _TURNS).sum()) >= _FEWEST
    else:
        moved, share, turns = ahead(pose, second > first), np.nan, False
    mirrored = None if np.isnan(share) else share < 0.5
    seen = pose[:, :2] * (1, -1 if mirrored else 1)
    weight = 1 / (np.trace(np.linalg.inv(information)[:, :2, :2], axis1=1, axis2=2) / 2 + _WORST**2)
    rank = np.unique(np.minimum(first, second), return_inverse=True)[1]
    if rank.max() + 1 < _PARTS[0]:
        reason = f"only {rank.max() + 1} images can be compared with later ones, and {_PARTS[0]} are needed"
        return MountingEstimate(pairs=len(first), reasons=(reason,))
    part = rank * min(_PARTS[1], rank.max() + 1) // (rank.max() + 1)
    whole, off, left_over = _with_deviations(moved, seen, weight, turns, part)
    turns = turns and np.degrees(off[0]) < _STATED  # along one arc, any move may come from an offset
    offset = offset_off = np.full(2, np.nan)
    if turns:
        offset, offset_off = whole[1:], np.hypot(off[1:], _offset_bias(moved, weight))
    sure = (offset**2).sum() > _SURE * np.hypot(*(offset * offset_off))  # by the deviation in its own direction
    if not sure:  # what looks like an offset may be wrong comparisons
        whole, off, left_over = _with_deviations(moved, seen, weight, False, part)
        if not _SURE * max(offset_off) < NEAR:  # an offset that matters is not excluded either
            offset = offset_off = np.full(2, np.nan)
    camera = moved.copy()  # the moves of the camera, whose offset from the robot's centre is known by now
    camera[:, :2] += Mounting(ahead=whole[1], left=whole[2]).offset(moved[:, 2]) - whole[1:]
    unsure = float(np.degrees(np.hypot(off[0], _disagreement(camera, seen, weight, second > first) / 2)))
    mixed = max(share, 1 - share) < _AGREE
    if left_over > _FITS or unsure > _STATED or mixed:
        check = "does not follow from the poses: check them, and the headings, or give frames that are closer together"
        reason = f"how the camera moves in the images {check if posed else 'is not ahead, in one direction'}"
        return MountingEstimate(mirrored=None if mixed else mirrored, pairs=len(first), reasons=(reason,))
    reasons = (_NO_OFFSET,) if np.isnan(offset[0]) else ()
    if mirrored is None:
        reasons = (_HARDLY_TURNS if posed else _UNPOSED,)
    yaw, (x, y), (x_off, y_off) = float(np.degrees(whole[0])), offset.tolist(), offset_off.tolist()
    return MountingEstimate(yaw, unsure, mirrored, (x, y), (x_off, y_off), len(first), reasons)


def usual_rows(panoramas: NDArray[np.uint8], view: PanoramaView) -> NDArray[np.uint8]:
    """Return panoramas (B, 3, H, W) of a ring with each row where a usual mirror shows the elevation of that row.

    How a ring's mirror is bent is unknown. Comparisons err least with a mirror in the middle of what there is.

    Args:
        panoramas: made by a `PolarRing`, whose rows are evenly spaced between the rims.
        view: the view with which they were made.
    """
    (high, low), (outer, inner) = np.tan(np.radians([[view.top, view.bottom], _RIMS]))
    step = (high - low) / (outer - inner)
    first = (outer - high) / (outer - inner) * view.height + step / 2 - 0.5
    move, size = np.array([[1, 0, 0], [0, step, first]]), (panoramas.shape[3], view.height)
    flags, edge = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, cv2.BORDER_REPLICATE
    made = [cv2.warpAffine(one.transpose(1, 2, 0), move, size, flags=flags, borderMode=edge) for one in panoramas]
    return np.stack(made).transpose(0, 3, 1, 2)


def resized(batch: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return panoramas (B, 3, H, W) of the size that a network takes."""
    if batch.shape[2:] == tuple(size):
        return batch
    made = [cv2.resize(one.transpose(1, 2, 0), size[::-1], interpolation=cv2.INTER_AREA) for one in batch]
    return np.stack(made).transpose(0, 3, 1, 2)


def _agreeing(turned: Array, seen: Array) -> float:
    """Return the share of the turns in the images that agree with the turns of the headings; NaN if hardly any turn."""
    common = np.abs(wrapped(seen + turned)) - np.abs(wrapped(seen - turned))  # 2 min(|seen|, |turned|), or minus that
    whole = float(np.abs(common).mean())
    return np.nan if whole / 2 < _TURNED else float((1 + common.mean() / whole) / 2)


def _disagreement(moved: Array, seen: Array, weight: Array, onwards: NDArray[np.bool_]) -> float:
    """Return by how many rad the yaws of pairs of either order, and of short and long moves, differ together.

    A network that takes what it sees for something else errs in all parts of a drive alike, but not in these.
    """
    long = np.hypot(moved[:, 0], moved[:, 1]).argsort().argsort() >= len(moved) // 2
    differences = [
        np.subtract(*(_solved(moved[rows], seen[rows], weight[rows], turns=False)[0][0] for rows in (half, ~half)))
        for half in (onwards, long)
        if 0 < half.sum() < len(half)
    ]
    return float(np.linalg.norm(wrapped(np.array(differences))))


def _with_deviations(
    moved: Array, seen: Array, weight: Array, turns: bool, part: NDArray[np.int64]
) -> tuple[Array, Array, float]:
    """Return the yaw and offset of `_solved`, their deviations (3,), and the part of the moves that is left over.

    The deviations follow from leaving out each part of the drive once.
    """
    whole, left_over = _solved(moved, seen, weight, turns)
    rest = [part != one for one in np.unique(part)]
    apart = np.array([_solved(moved[rows], seen[rows], weight[rows], turns)[0] for rows in rest]) - whole
    apart[:, 0] = wrapped(apart[:, 0])
    return whole, np.sqrt((len(rest) - 1) / len(rest) * (apart**2).sum(axis=0)), left_over


def _offset_bias(moved: Array, weight: Array) -> float:
    """Return by how much the camera's offset would be off if comparisons erred by `_BIASED` of each move.

    In a corridor, say, all parts of a drive err alike, so that leaving out one of them does not show it. Turns of the
    robot move a camera off its centre; the less of the moves are turns, the more an error passes for an offset.
    """
    length, lever = np.hypot(moved[:, 0], moved[:, 1]), 2 * np.abs(np.sin(moved[:, 2] / 2))
    return float(_BIASED * (weight * lever) @ length / (weight @ lever**2))


def _solved(moved: Array, seen: Array, weight: Array, turns: bool) -> tuple[Array, float]:
    """Return the yaw in rad and the camera's offset (3,), and the part of the moves that these do not explain.

    Least squares on `scale R(yaw) seen - (R(turn) - 1) offset = moved`, reweighted so that wrong comparisons do not
    count; the scale takes any unit of the positions.
    """
    (x, y), cosine, sine = seen.T, np.cos(moved[:, 2]) - 1, np.sin(moved[:, 2])
    columns = np.stack([[x, -y, -cosine, sine], [y, x, -sine, -cosine]]).transpose(2, 0, 1)  # (p, 2, 4)
    columns = columns if turns else columns[..., :2]
    trust = np.ones(len(seen))
    for _ in range(_ROUNDS):
        root = np.sqrt(weight * trust)[:, None]
        left, right = (columns * root[..., None]).reshape(-1, columns.shape[2]), (moved[:, :2] * root).ravel()
        solution = np.linalg.lstsq(left, right, rcond=None)[0]
        off = np.hypot(*(columns @ solution - moved[:, :2]).T)
        trust = 1 / (1 + (off / max(2 * float(np.median(off)), 1e-9)) ** 2)
    length = np.hypot(moved[:, 0], moved[:, 1])
    offset = solution[2:] if turns else np.zeros(2)
    left_over = float(np.median(off) / max(float(np.median(length)), 1e-9))
    return np.array([np.arctan2(solution[1], solution[0]), *offset]), left_over
