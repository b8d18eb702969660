"""`locate`: where the frames of a drive were taken in a map, by all of the drive at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from foundation.calls import typed
from siamloc.data.checks import wrong_odometry
from siamloc.data.frames import FrameTable, concatenate
from siamloc.errors import ConfigError, DataError
from siamloc.maps.buildings import buildings_of
from siamloc.maps.comparing import comparison_of
from siamloc.maps.survey_checks import check_lengths
from siamloc.maps.survey_steps import with_odometry
from siamloc.maps.surveying import SurveySettings, of_descriptions
from siamloc.maps.visual_map import VisualMap


@typed
def locate(
    known: VisualMap, drive: VisualMap, *, settings: SurveySettings | None = None, progress: bool = True
) -> FrameTable:
    """Estimate the poses of the frames of a drive in a map; positions in the drive are not used.

    A filter knows what a robot has seen so far. When the drive is over, more is known: each frame is compared with the
    frames before it and with those of the map and of the drive that look alike, and with the odometry, if there is any,
    the most likely poses of all frames follow at once. It is a survey (`siamloc.maps.survey`) in which the map's frames
    keep their poses, so that comparisons with a part of the building that has changed are outvoted by the others.

    Args:
        known: a map in metres whose frames have positions and headings, described by a network that compares.
        drive: one or several drives, in capture order, described as the map was (`siamloc.maps.build` with
            `mounting=known.mounting`).
        settings: how loops are searched.
        progress: whether to show the progress.

    Returns:
        The frames of the drive with x, y and theta, their standard deviations, `deviation` and `theta_deviation`, and
        the building: the stated one, if the map has it, else that of the nearest map frame, or, where buildings lie
        over each other, the one that looks most like the drive.

    Raises:
        ConfigError: a map whose descriptor does not compare images, or whose distances are not Euclidean, or a drive
            that was described differently.
        DataError: a map that is not in metres, a map frame without a pose, a drive of a building that the map lacks, or
            one that `siamloc.maps.survey` would refuse, such as one that has no place in common with the map.

    Example:
        >>> tuesday = siamloc.maps.build("pretrained", images, frames, mounting=known.mounting)  # doctest: +SKIP
        >>> siamloc.maps.locate(known, tuesday).xy  # doctest: +SKIP
    """
    if known.unit != "m":
        raise DataError(f"a drive is located in a map in metres, and this map is in {known.unit!r}")
    compare = comparison_of(known)
    if compare is None:
        raise ConfigError(
            "a drive is located by a network that compares images, with euclidean distances, and this map is by "
            f"{known.identity.get('name', 'an unknown descriptor')}, with {known.distance} distances: build the map "
            "with pretrained"
        )
    check_lengths(drive.frames)
    for finding in wrong_odometry(drive.frames):
        raise DataError(f"the odometry of the drive cannot be used: {finding}")
    if not (known.frames.has_position & np.isfinite(known.frames.theta)).all():
        raise DataError("a map frame has no pose: a drive is located in a map whose frames have x, y and theta")
    there, stated = (sorted(set(one.frames.building.tolist())) for one in (known, drive))
    if "" not in there and (others := set(stated) - {"", *there}):
        raise DataError(
            f"the drive states the building {', '.join(sorted(others))}, and the map has {', '.join(there)}: name one "
            "that the map has, or leave the column building out"
        )
    of_map = np.arange(len(known) + len(drive)) < len(known)
    names = [f"the map's {name}" for name in known.frames.sequence.tolist()]  # the drive may be in the map already
    known = replace(known, frames=known.frames.with_columns(sequence=names))
    frames = concatenate([known.frames, drive.frames])
    order = np.concatenate(list(frames.rows_by("sequence").values()))
    frames, described, of_map = frames.take(order), known.merge(drive).take(order), of_map[order]
    frames = with_odometry(frames, np.where(of_map[:, None], np.nan, frames.odometry))
    chosen = SurveySettings() if settings is None else settings
    found = of_descriptions(frames, described, compare, frames.take(of_map), None, chosen, progress).frames
    rows = np.argsort(order)[len(known) :]
    poses = {name: getattr(found, name)[rows] for name in ("x", "y", "theta", "deviation", "theta_deviation")}
    located = drive.frames.with_columns(**poses)
    return located.with_columns(building=buildings_of(known, replace(drive, frames=located)))
