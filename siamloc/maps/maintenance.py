"""Map maintenance ([T] 1.2): `update` lets a map follow its building, by a drive."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from foundation.calls import OF_FIELDS, takes
from foundation.settings import Count, Positive, Share
from siamloc.data.checks import wrong_headings
from siamloc.data.frames import FrameTable, check_units
from siamloc.data.panorama import shows_nothing
from siamloc.errors import ConfigError, DataError, logger
from siamloc.maps.axes import check_axes
from siamloc.maps.buildings import buildings_of
from siamloc.maps.checked_arrays import check_placed
from siamloc.maps.comparing import comparison_of
from siamloc.maps.describing import build
from siamloc.maps.evidence import Judged, enough_of, judged, map_reasons, repeated, strange, usual_distance
from siamloc.maps.following import followed, left_by, nodes_of, numbers_of
from siamloc.maps.grouping import Built
from siamloc.maps.history import GONE, JOINED, UPKEEP, History, Reason, upkeep_of
from siamloc.maps.matching import match
from siamloc.maps.thinning import Budget, thin
from siamloc.maps.visual_map import VisualMap

if TYPE_CHECKING:
    from siamloc.data.library import PanoramaLibrary

_REPEATS = 0.6  # share of the usual distance up to which two frames that would join show almost the same
_COMPARED = 3  # map frames that locate each frame
_MOST = 0.9  # share of the frames in known places that may contradict a map without a warning


@dataclass(frozen=True)
class Maintenance(Budget):
    """How much evidence changes a map, and how large it may become.

    Attributes:
        radius: distance within which frames show the same place, in the unit of the positions.
        usual: share of the map frames that differ from their most similar neighbour by less than a frame of the drive
            has to differ from the map to contradict it; if None, only frames located elsewhere do.
        contradicted: number of contradicting frames in a window that call for an update; at most `window`.
        window: number of consecutive frames of the drive that are judged together, of those taken in known places.
        forget: number of drives in a row that do not recognize a map frame until it is forgotten; never if None.
        extend: whether frames taken where the map has none are added.
        certain: largest standard deviation of a position that is used, in the unit of the positions.
        growth: largest number of frames, as a multiple of those that the map had before its first update and of those
            of new places; without limit if None.
    """

    WHERE = "update"

    radius: Positive = 1.0
    usual: Share | None = 0.95
    contradicted: Count = 3
    window: Count = 5
    forget: Count | None = 10
    extend: bool = True
    certain: Positive = 0.25
    growth: Positive | None = 1.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.contradicted > self.window:
            raise ConfigError(f"contradicted={self.contradicted} frames cannot be among window={self.window}: lower it")
        if self.growth is not None and self.growth < 1:
            raise ConfigError(f"growth={self.growth:g} would shrink a map that nothing contradicts: give 1 or more")


@dataclass(frozen=True, eq=False, repr=False)
class Update:
    """What a drive says about a map, and the map after maintenance.

    Attributes:
        known: the map after the update: the frames that stay, followed by those that joined it.
        built: the nodes over the frames of `known`; None if no nodes were given.
        before: the map before (m frames), with its history after the drive.
        map_reason: (m,) of `Reason`: why each frame of `before` stays or leaves.
        drive: the n readable frames of the drive, in their order.
        reason: (n,) of `Reason`: why each frame of the drive joined the map, or did not.
        contradicted: (n,) whether a frame taken in a known place was located elsewhere, or is unlike the map there.
        known_place: (n,) whether a frame was taken in a place of the map, with a certain position.
        window: number of frames in known places without which a map is not judged.
    """

    known: VisualMap
    built: Built | None
    before: VisualMap
    map_reason: NDArray[np.object_]
    drive: FrameTable
    reason: NDArray[np.object_]
    contradicted: NDArray[np.bool_]
    known_place: NDArray[np.bool_]
    window: int

    def __repr__(self) -> str:
        return f"Update({self.summary().removeprefix('update: ')})"

    @property
    def added(self) -> NDArray[np.bool_]:
        """Which frames of the drive joined the map (n,)."""
        return np.isin(self.reason, JOINED)

    @property
    def forgotten(self) -> NDArray[np.bool_]:
        """Which frames of the map before left it (m,)."""
        return np.isin(self.map_reason, GONE)

    def summary(self) -> str:
        """Return one line about the evidence, and about the frames that joined the map and left it."""
        known, joined = int(self.known_place.sum()), Counter(self.reason[self.added].tolist())
        text = f"update: {self.contradicted.sum()} of {known} frames in known places contradict the map"
        if joined[Reason.NEW_PLACE]:
            text += f", {joined[Reason.NEW_PLACE]} show new places"
        if known < self.window and not joined:
            return f"{text}: too few to judge the map, at least window={self.window} are needed"
        text += f"; {self.added.sum()} joined the map, {self.forgotten.sum()} left it, {len(self.known)} are in it"
        few = int((self.reason == Reason.FEW).sum())
        if not (self.added.any() or self.forgotten.any() or few):
            return f"{text}: the map is up to date"
        return f"{text}; {few} left out, fewer in their node than smallest_node" if few else text


@takes(Maintenance)
def update(
    known: VisualMap,
    images: PanoramaLibrary,
    drive: FrameTable,
    *,
    deviation: ArrayLike | None = None,
    built: Built | None = None,
    progress: bool = True,
    settings: Maintenance = OF_FIELDS,
    **fields: Any,
) -> Update:
    """Find where a map is out of date, on another drive, and let the map follow.

    A drive without positions is first located in the map by `siamloc.maps.locate`, if the map can compare images.

    A frame of the drive contradicts the map if it was taken within `radius` of a map frame and is located farther away
    than that, or differs from all map frames within `radius` more than neighbours in the map usually do, or is compared
    with those and most of them tell a wrong pose. The map is out of date where `contradicted` of `window` consecutive
    frames contradict it; a single frame is no evidence, because a person in view is enough. There, the frames that
    contradict it join the map, and so do frames of new places, except those that look like a frame that has just
    joined.

    A drive recognizes a map frame if one of its frames, taken within half the radius of it, resembles it more than all
    map frames beyond the radius; see `Reason` for what follows. Frames that are not recognized several times in a row
    are forgotten, unless the drives were driven in another light. If the map becomes larger than it may be, frames are
    forgotten as by `siamloc.maps.thin`.

    A frame that joins belongs to the node of the nearest map frame. In an incremental map, the mapper locates the
    frames of the drive, and whole stretches join, as another mode of their node (`IncrementalMapper.maintain`), since
    a mode needs many frames; frames of new places do not. With contradicted=15, window=20 and usual=None, the counts
    are those with which [T] 4.6 decides, from frames that are in no node, that a map needs a new node.

    Args:
        known: a map whose frames all have positions; it is not changed.
        images: panoramas of the drive.
        drive: n frames of one drive in capture order, all or some with positions in the map's coordinates, or none.
            Those that state no building get the one of the map in which they were taken; one that the map lacks is
            a new one if there are positions, and else refused.
        deviation: (n,) standard deviation of each position, such as `drive.deviation`, NaN where it is unknown;
            all positions are certain if None.
        built: nodes over the map's frames. Nodes of an incremental map need their mapper, as `siamloc.maps.group`
            returns it, able to grow.
        progress: whether to show the progress of describing the drive.
        settings: all settings in one object, instead of one keyword each.

    Raises:
        ConfigError: a setting out of range, or an image size or descriptor other than the map's.
        DataError: no frames, frames of several drives or given twice, a map frame without a position, no frame of the
            drive with a certain one, pictures that show nothing, or mostly nothing that is on the map, positions in two
            units or with other axes than the map's, headings in degrees or clockwise that the map would compare, nodes
            over another map, or an incremental map without its mapper.
        AnalyticError: a mapper that is read-only.

    Example:
        >>> import siamloc
        >>> images = siamloc.data.example(frames=40)
        >>> monday, tuesday = (images.frames.select(sequence=day) for day in ("monday", "tuesday"))
        >>> known = siamloc.maps.build("hog", images, monday, progress=False)
        >>> found = update(known, images, tuesday, progress=False)
        >>> len(found.known) == len(known) + sum(found.added.tolist()) - sum(found.forgotten.tolist())
        True
        >>> int(found.known.history.confirmed.max())
        1
    """
    check_units([known.frames, drive])
    if not len(drive):
        raise DataError("the drive has no frames: look at how they were selected")
    if len(drives := drive.rows_by("sequence")) != 1:
        raise DataError(
            f"an update takes the frames of one drive, and these are of {len(drives)}: call it for each in turn, with "
            "the map of the update before"
        )
    keys = drive.identities()
    if len(set(keys)) < len(keys):
        twice, _ = Counter(keys).most_common(1)[0]
        raise DataError(
            f"{len(keys) - len(set(keys))} of {len(keys)} frames of the drive are repeated, such as {twice[1]}: give "
            "each frame once"
        )
    describe = partial(
        build, known.descriptor, images, heading=known.heading_descriptor, mounting=known.mounting, progress=progress
    )
    seen = None
    if deviation is None and not drive.has_position.any() and comparison_of(known) is not None:
        from siamloc.maps.locating import locate  # needs scipy, which a robot does without

        seen = describe(drive)
        drive = locate(known, seen, progress=progress)
        seen, deviation = replace(seen, frames=drive), drive.deviation
    elif comparison_of(known) is not None:
        for finding in wrong_headings(drive):
            raise DataError(f"the headings of the drive cannot be compared: {finding}")
    sure = drive.has_position
    if deviation is not None:
        spread = np.asarray(deviation, dtype=np.float64)
        if spread.shape != (len(drive),):
            raise DataError(f"{len(drive)} frames of the drive need a deviation each, got shape {spread.shape}")
        if (spread < 0).any():
            raise DataError(f"a deviation is 0 or more, or NaN where it is unknown, got {np.nanmin(spread):g}")
        sure = sure & (spread <= settings.certain)
        drive = drive.with_columns(deviation=spread)
    new = drive.rows_in(known.frames) < 0
    if not new.any():
        raise DataError(f"all {len(drive)} frames of the drive are in the map already: update it by another drive")
    if not (sure & new).any():
        there = (new & drive.has_position).any()
        raise DataError(
            f"none of the {int(new.sum())} frames of the drive that the map lacks has "
            + (
                f"a deviation of at most certain={settings.certain:g}: leave the deviations out if the positions are "
                "good, or give a larger certain"
                if there
                else "a certain position: give their x and y, or a map in metres whose descriptor compares images, "
                "which locates them"
            )
        )
    used = sure & new
    part = describe(drive.take(used)) if seen is None else seen.take(used)
    readable = (drive.rows_in(part.frames) >= 0) | ~used
    reason = np.full(len(drive), Reason.UNSURE, dtype=object)
    reason[sure] = Reason.HELD
    blank = np.concatenate([shows_nothing(panoramas) for panoramas in images.batches(part.frames)])
    if blank.all():
        raise DataError(f"none of the {len(blank)} pictures shows anything: look whether the camera is covered")
    reason[np.flatnonzero(used & readable)[blank]] = Reason.BLANK
    found = updated(known, part.take(~blank), built=built, settings=settings)
    used &= reason != Reason.BLANK
    building = drive.building.astype(object)
    building[used & readable] = found.drive.building
    drive = drive.with_columns(building=building)
    reason, now = reason[readable], used[readable]
    contradicted, known_place = np.zeros((2, len(now)), dtype=bool)
    reason[now], contradicted[now], known_place[now] = found.reason, found.contradicted, found.known_place
    return replace(found, drive=drive.take(readable), reason=reason, contradicted=contradicted, known_place=known_place)


def updated(
    known: VisualMap, drive: VisualMap, *, built: Built | None = None, settings: Maintenance | None = None
) -> Update:
    """Update a map as `update` does, by a drive that is described and whose positions are all certain; needs no torch.

    Raises:
        DataError, AnalyticError: as `update`.
    """
    settings = Maintenance() if settings is None else settings
    check_placed(known.frames, "an update")
    if built is not None:
        built.check_map(known)
        if built.mapper is None and "ids" in built.layer.made:
            raise DataError("an incremental map is updated with its mapper, which a layer read from a file lacks")
    if (unstated := drive.frames.building == "").any():
        building = np.where(unstated, buildings_of(known, drive, settings.radius), drive.frames.building)
        drive = replace(drive, frames=drive.frames.with_columns(building=building))
    there = set(known.frames.building.tolist())
    if "" in there and (others := sorted(set(drive.frames.building.tolist()) - there)):
        logger.warning(
            "drive %s states the building %s, and frames of the map state none: it is taken for another building; if "
            "it is the same, leave the column building out",
            *(drive.frames.sequence[0], ", ".join(others)),
        )
    upkeep = _upkeep(known, settings)
    found = judged(known, drive, settings.radius)
    reason, contradicted = _joining(known, drive, found, built, upkeep["usual"], settings)
    before, map_reason = _told(known, drive, found, upkeep, settings)
    upkeep["frames"] += int((reason == Reason.NEW_PLACE).sum())
    _thin(before, map_reason, drive, reason, upkeep["frames"], settings)
    mapper, node = None, np.zeros(len(drive), dtype=np.int64)
    if built is not None:
        node = nodes_of(built.layer, known.frames, drive.frames)
    if built is not None and built.mapper is not None:
        leaving = np.flatnonzero(np.isin(map_reason, GONE))
        mapper, left = left_by(built, leaving)
        map_reason[np.setdiff1d(leaving, left)] = Reason.NEEDED
        joined = np.isin(reason, JOINED)
        size = np.bincount(node[joined], minlength=len(built.layer))
        reason[joined & (size[node] < mapper.parameters.smallest_node)] = Reason.FEW
    kept, rows = np.flatnonzero(~np.isin(map_reason, GONE)), np.flatnonzero(np.isin(reason, JOINED))
    if mapper is not None:
        rows = rows[np.argsort(node[rows], kind="stable")]  # as the mapper counts them
    after = before if len(kept) == len(before) else before.take(kept)
    if len(rows):
        history = replace(History.none(len(rows)), joined=np.ones(len(rows), dtype=bool))
        after = after.merge(replace(drive.take(rows), history=history))
    after = replace(after, made={**after.made, UPKEEP: upkeep})
    if built is not None and after.digest != known.digest:
        built = followed(built, after, kept, node[rows], mapper)
    known_place, window = found.away <= settings.radius, settings.window
    return Update(after, built, before, map_reason, drive.frames, reason, contradicted, known_place, window)


def _upkeep(known: VisualMap, settings: Maintenance) -> dict[str, Any]:
    """Return what a map keeps for its updates, with the usual distance by these settings."""
    upkeep, how = upkeep_of(known.made, len(known)), [settings.usual, settings.radius]
    if upkeep["learned"] != how:  # learned once: frames that join are unlike their neighbours by choice
        joined = known.history.joined
        own = known if joined.all() else known.take(~joined)
        distance = None if settings.usual is None else usual_distance(own, settings.radius, settings.usual)
        upkeep |= {"usual": distance, "learned": how}
    return upkeep


def _joining(
    known: VisualMap,
    drive: VisualMap,
    found: Judged,
    built: Built | None,
    usual: float | None,
    settings: Maintenance,
) -> tuple[NDArray[np.object_], NDArray[np.bool_]]:
    """Return why each frame of a drive (n,) joins the map or not, and which contradict it (n,)."""
    mapper, alike = None if built is None else built.mapper, match(known, drive.turning(), _COMPARED)
    located = alike.indices[:, 0]
    if built is not None and mapper is not None:
        row_of = np.zeros(len(mapper), dtype=np.int64)
        row_of[numbers_of(built.layer)] = np.arange(len(known))
        frames = (drive.description.take(slice(row, row + 1)) for row in range(len(drive)))
        located = row_of[[mapper.locate(frame).frame for frame in frames]]
    known_place = found.away <= settings.radius
    near, foreign = int(known_place.sum()), int((known_place & strange(known, drive, alike)).sum())
    if near >= settings.window and foreign > near / 2:
        raise DataError(
            f"{foreign} of {near} pictures taken in known places show nothing that is on the map: the camera may be "
            "covered, turned over or another one, or the drive is of another building; if everything there is new, map "
            "the drive by itself, and merge the maps"
        )
    check_axes(known, drive, alike, located, settings.radius)
    off = np.linalg.norm(known.frames.xy[located] - drive.frames.xy, axis=1)
    contradicts = (off > settings.radius) | (known.frames.building[located] != drive.frames.building)
    contradicts |= found.misplaced
    if usual is not None:
        contradicts |= found.unlike > usual
    contradicts &= known_place
    if near >= settings.window and contradicts.sum() > _MOST * near:
        logger.warning(
            "%d of %d frames of drive %s taken in known places contradict the map: the light may be another one, but "
            "look whether its camera is that of the map, uncovered and upright, and whether positions and building are "
            "right",
            contradicts.sum(),
            near,
            drive.frames.sequence[0],
        )
    outdated = np.zeros(len(drive), dtype=bool)
    outdated[known_place] = enough_of(contradicts[known_place], settings.contradicted, settings.window)
    stretches = usual is None or mapper is not None
    reason = np.full(len(drive), Reason.EXPLAINED, dtype=object)
    reason[contradicts] = Reason.ALONE
    reason[outdated & (contradicts | stretches)] = Reason.ADDED
    reason[~known_place] = Reason.NEW_PLACE if settings.extend and mapper is None else Reason.BEYOND
    if not stretches and (rows := np.flatnonzero(np.isin(reason, JOINED))).size:
        assert usual is not None
        reason[rows[repeated(drive.take(rows), settings.radius, _REPEATS * usual)]] = Reason.REPEATED
    return reason, contradicts


def _told(
    known: VisualMap, drive: VisualMap, found: Judged, upkeep: dict[str, Any], settings: Maintenance
) -> tuple[VisualMap, NDArray[np.object_]]:
    """Return a map with the history after a drive, and why each of its frames (m,) stays or is forgotten.

    A drive that the map counted before is not counted again.
    """
    reason = map_reasons(known, found, drive.frames.lighting.tolist())
    by_building = zip(drive.frames.building.tolist(), drive.frames.sequence.tolist(), strict=True)
    drives = [f"{building}/{name}" if building else name for building, name in dict.fromkeys(by_building) if name]
    if drives and set(drives) <= set(upkeep["drives"]):
        logger.warning("the map counted drive %s before: give each drive a name of its own", ", ".join(drives))
        return known, reason
    upkeep["drives"] = [*dict.fromkeys([*upkeep["drives"], *drives])]
    old, confirmed = known.history, reason == Reason.CONFIRMED
    history = History(
        old.confirmed + confirmed,
        np.where(confirmed, 0, old.contradicted + (reason == Reason.CONTRADICTED)),
        np.where(found.passed, found.changed / (upkeep["usual"] or np.nan), old.change),
        old.joined,
    )
    if settings.forget is not None:
        reason[(reason == Reason.CONTRADICTED) & (history.contradicted >= settings.forget)] = Reason.FORGOTTEN
    return replace(known, history=history), reason


def _thin(
    before: VisualMap,
    map_reason: NDArray[np.object_],
    drive: VisualMap,
    reason: NDArray[np.object_],
    frames: int,
    settings: Maintenance,
) -> None:
    """Set the reasons of the frames of map and drive that a budget leaves no room for."""
    limits = [settings.frames, None if settings.growth is None else int(settings.growth * frames)]
    most = min((limit for limit in limits if limit is not None), default=None)
    kept, rows = np.flatnonzero(~np.isin(map_reason, GONE)), np.flatnonzero(np.isin(reason, JOINED))
    whole = before.take(kept)
    whole = whole.merge(drive.take(rows)) if len(rows) else whole
    found = thin(whole, frames=most, per_square_metre=settings.per_square_metre, megabytes=settings.megabytes).reason
    gone = found != Reason.KEPT
    map_reason[kept[gone[: len(kept)]]] = found[: len(kept)][gone[: len(kept)]]
    reason[rows[gone[len(kept) :]]] = found[len(kept) :][gone[len(kept) :]]
