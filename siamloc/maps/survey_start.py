"""Where a survey begins: drives brought into one frame by their loops, and moved to the anchors."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from siamloc.data.frames import FrameTable, concatenate
from siamloc.data.moves import TURN, composed, inverse, way_along, wrapped
from siamloc.errors import DataError
from siamloc.maps.loops import Loops
from siamloc.maps.pose_graph import Array

_NEAR, _ALIKE = 3.0, np.radians(20)  # how far a loop between drives may be off before drift is undone: metres, rad
_MEETING = 3  # loops that must agree about how two drives lie
_VOTERS = 500  # loops at most that are compared with each other for that
_PLACE = 10  # frames of a place: a meeting at a single place is told
_UNIT, _SHORT = 10.0, 0.3  # ratio of ways from which on units differ, and metres by which an anchor may be off
_MOST = 0.7  # share of the pairs of anchors, more than a wrong one of three spoils
_COMPARED = 30  # anchors of a drive that are compared with each other, at most


def brought_together(
    start: Array,
    loops: Loops,
    drive: NDArray[np.int64],
    names: list[str],
    notes: list[str],
    placed: set[int],
) -> Array:
    """Return start poses (n, 3) with each drive moved to where most of its loops to placed drives agree.

    Args:
        start: start poses (n, 3), each drive in a frame of its own.
        loops: judged loops, of which the accepted ones count.
        drive: number of the drive of each frame (n,).
        names: names of the drives.
        notes: gets a sentence about each drive that meets the others at a single place.
        placed: numbers of the drives that are where they belong, such as those with anchors.

    Raises:
        DataError: a drive that no loops connect with the others.
    """
    start, used = start.copy(), loops.take(loops.accepted)
    known, own = np.concatenate([[used.first, used.second], [used.second, used.first]], axis=1)  # each loop both ways
    seen = np.concatenate([used.pose, inverse(used.pose)])
    placed = set(placed)
    waiting, known_name = set(range(len(names))) - placed, names[min(placed)]
    while waiting:
        tried = []
        for number in waiting:
            mine = np.isin(drive[known], list(placed)) & (drive[own] == number)
            tried.append((*_most_agreed(start, known[mine], own[mine], seen[mine]), number))
        votes, places, origin, number = max(tried, key=lambda one: one[0])
        if votes < _MEETING:
            lost = ", ".join(names[one] for one in sorted(waiting))
            raise DataError(
                f"no places were found that {lost} and {known_name} have in common: survey drives apart that never "
                "meet, give one more drive that connects them, or anchors in each"
            )
        if places == 1:
            notes.append(f"drive {names[number]} meets the others at a single place: check that it does")
        rows = drive == number
        start[rows] = composed(origin[None], start[rows])
        placed.add(number)
        waiting.remove(number)
    return start


def _most_agreed(start: Array, known: NDArray[np.int64], own: NDArray[np.int64], seen: Array) -> tuple[int, int, Array]:
    """Return how many loops agree about where a drive lies, at how many places, and the pose of its frame (3,).

    Args:
        start: start poses (n, 3).
        known: frames of placed drives that see the drive (p,).
        own: frames of the drive that they see (p,).
        seen: poses of these frames as seen from the known ones (p, 3).
    """
    if not len(known):
        return 0, 0, np.zeros(3)
    some = np.unique(np.linspace(0, len(known) - 1, _VOTERS).astype(np.int64))
    wanted, mine = composed(start[known[some]], seen[some]), start[own[some]]
    origins = composed(wanted, inverse(mine))
    agreeing = np.empty((len(some), len(some)), dtype=bool)
    for row, origin in enumerate(origins):
        moved = composed(origin[None], mine)
        near = np.hypot(*(moved - wanted)[:, :2].T) < _NEAR
        agreeing[row] = near & (np.abs(wrapped(moved[:, 2] - wanted[:, 2])) < _ALIKE)
    best = int(agreeing.sum(axis=1).argmax())
    places = len(np.unique(known[some][agreeing[best]] // _PLACE))
    return int(agreeing[best].sum()), places, origins[best]


def of_drives(tables: Sequence[FrameTable]) -> FrameTable:
    """Join tables that each hold other drives.

    Raises:
        DataError: no table, or two with drives of one name.
    """
    counts = Counter(name for table in tables for name in table.rows_by("sequence"))
    if not counts or max(counts.values()) > 1:
        twice = next((name or "(unnamed)" for name, count in counts.items() if count > 1), None)
        found = "got none" if twice is None else f"and {twice} is in two: give each drive a sequence of its own"
        raise DataError(f"a survey needs tables of different drives, {found}")
    return concatenate(tables)


def check_anchors(frames: FrameTable, anchors: FrameTable | None) -> None:
    """Check that anchors are frames of a survey and have poses.

    Raises:
        DataError: an anchor that is not among the frames, is given twice, or without a pose.
    """
    if anchors is None:
        return
    rows, given = set(frames.identities()), anchors.identities()
    missing = [key for key in given if key not in rows]
    if missing:
        drive, path = missing[0]
        raise DataError(
            f"the anchor {path} of drive {drive or '(unnamed)'} is not among the {len(frames)} frames of the survey"
        )
    if twice := [path for (_, path), count in Counter(given).items() if count > 1]:
        raise DataError(f"the anchor {twice[0]} is given twice: give each frame once")
    unknown = ~(anchors.has_position & np.isfinite(anchors.theta))
    if unknown.any():
        raise DataError(f"the anchor {anchors.path[unknown][0]} has no pose: give its x, y and theta")


def anchored(
    start: Array, drive: NDArray[np.int64], frames: FrameTable, anchors: FrameTable | None
) -> tuple[NDArray[np.int64], Array]:
    """Return the rows of the anchors, and start poses (n, 3) with each drive that has anchors moved to them.

    A drive is moved to its first anchor, and then bent so that all its anchors have their poses.

    Args:
        start: start poses (n, 3).
        drive: number of the drive of each frame (n,).
        frames: the frames (n).
        anchors: frames with poses; those whose image could not be read are left out.

    Raises:
        DataError: anchors of a drive that are in another unit than its way, in degrees, or mirrored.
    """
    if anchors is None:
        return np.empty(0, np.int64), start
    fixed = anchors.rows_in(frames)
    held, fixed = anchors.take(fixed >= 0), fixed[fixed >= 0]
    true = np.column_stack([held.xy, held.theta])
    start = start.copy()
    for number in np.unique(drive[fixed]):
        mine = np.flatnonzero(drive[fixed] == number)
        mine = mine[np.argsort(fixed[mine])]
        frame = np.flatnonzero(drive == number)
        some = mine[np.unique(np.linspace(0, len(mine) - 1, _COMPARED).astype(np.int64))]
        _check_poses(frames.sequence[frame[0]], start[frame], fixed[some] - frame[0], true[some])
        origin = composed(true[mine[:1]], inverse(start[fixed[mine[:1]]]))
        start[frame] = composed(origin, start[frame])
        off = true[mine] - start[fixed[mine]]
        off[:, 2] = np.unwrap(wrapped(off[:, 2]))
        start[frame] += np.column_stack([np.interp(frame, fixed[mine], one) for one in off.T])
    start[fixed, :2] = true[:, :2]
    return fixed, start


def _check_poses(name: str, start: Array, rows: NDArray[np.int64], true: Array) -> None:
    """Refuse the poses (k, 3) of anchors if most of them contradict the start poses (n, 3) of their drive alike.

    Args:
        name: the drive.
        start: by odometry or comparisons.
        rows: the anchors' rows among these (k,).
        true: the poses of the anchors.
    """
    first, second = np.triu_indices(len(rows), 1)
    apart = np.hypot(*(true[second] - true[first])[:, :2].T)
    path = way_along(start)[rows]
    way, said = path[second] - path[first], f"the anchors of drive {name or '(unnamed)'}"
    if len(first) and (apart > _UNIT * (way + _SHORT)).mean() > _MOST:
        raise DataError(
            f"{said} are {np.median(apart / (way + _SHORT)):.3g} times as far apart as the robot drove between them: "
            "give their x and y in metres"
        )
    turned, wanted = (one[second, 2] - one[first, 2] for one in (true, start[rows]))
    telling = np.abs(np.sin(wanted)) > np.sin(_ALIKE)

    def off(turn: Array) -> float:
        return float(np.median(np.abs(wrapped(turn - wanted)[telling])))

    if not telling.any():
        return
    if np.abs(true[:, 2]).max() > TURN and off(np.radians(turned)) < min(_ALIKE, off(turned) / 2):
        raise DataError(f"{said} have theta in degrees, as the turns between them show: give radians")
    if telling.sum() >= _MEETING and off(-turned) < _ALIKE < off(turned):
        raise DataError(
            f"{said} turn left where its images turn right: headings grow counter-clockwise; give their y and theta "
            "with the other sign, or mirror the panoramas"
        )
