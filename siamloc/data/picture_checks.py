"""What a camera expert sees in the panoramas of one drive: each check returns a sentence for a fault, or None.

Panoramas are (n, 3, H, W), uint8, RGB, in capture order. Those of a standing robot say little: the checks compare what
moves through the picture with what stays where it is.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from analytic import Descriptor
from siamloc.data.decoding import Preprocessing
from siamloc.data.frames import FrameTable
from siamloc.data.levelling import tilt_of
from siamloc.data.library import PanoramaLibrary
from siamloc.data.mounting import CERTAIN, Mounting, MountingEstimate, find_mounting, orientation_parts
from siamloc.data.moves import wrapped
from siamloc.data.panorama import Array, column_azimuth

_BANDS = 8  # rows of a panorama in which turns are measured
_EVEN = 2.0  # deviation of grey values below which a column shows nothing
_MISSING = 5.0  # degrees
_SEAM = 3.0  # difference of neighbouring columns, in usual ones
_DARK, _BRIGHT, _SHARE = 8, 247, 0.4  # grey values that are no longer told apart, and the share of pixels with such
_SMOOTH = 0.3  # see `blur`: 0.25 if neighbouring differences are proportional to the distance
_STILL, _OWN = 0.12, 0.02  # change over time of the robot's own picture, in usual ones, and its share of the panorama
_BAND = 0.25  # of a row, from which it is the robot's own, and not that of a person or a mast
_LEVEL = 2.0  # degrees
_TURNS, _STRAY = np.radians(5), np.radians(10)  # what counts as a turn, and what as a wrong measurement
_FEWEST = 10  # frames, and turns
_MIRRORED_POSES = "the poses are (y and headings with the wrong sign, as with z down)"
_LOOKED_AT, _IN_A_ROW = 64, 300  # frames, and those in which turns are measured
_LATEST, _OFFSETS = 2.0, 401  # largest offset of times in s, in frames that are close together, and how many are tried
_PROMPT = 0.05  # s; a smaller offset of times is let pass: a robot drives some centimetres meanwhile


def drive_faults(
    frames: FrameTable, images: PanoramaLibrary, described_by: Descriptor | None = None, mounting: bool = True
) -> list[str]:
    """Return the faults that the panoramas of a drive show, alone and compared with its poses and odometry.

    Args:
        frames: the frames of the drive, in capture order; nothing is said about fewer than 10.
        images: their panoramas.
        described_by: a network that compares, for `find_mounting` and for turns; None to measure turns by correlation.
        mounting: whether that network finds how the camera is mounted.
    """
    if len(frames) < _FEWEST:
        return []
    spread = np.unique(np.linspace(0, len(frames) - 1, _LOOKED_AT).astype(int))
    sees = images.seen(str(frames.sequence[0]))
    turn = images.circular and (sees is None or bool(sees.any(axis=0).all()))  # what is not seen is filled
    given = bool(np.isfinite(frames.tilt).any())
    found = picture_faults(images.batch(images.rows(frames.take(spread))), images.preprocessing, turn, sees, given)
    if images.circular:
        part = _turning(frames)
        seen = turns_seen(images.batch(images.rows(part)))
        headed = (np.isfinite(part.theta) | np.isfinite(part.odom_theta)).any() and np.isfinite(part.time).all()
        by_network = described_by if headed and getattr(described_by, "compares", False) else None
        found.append(other_times(seen if by_network is None else turns_compared(by_network, images, part), part))
        estimate = MountingEstimate()
        if mounting and described_by is not None and frames.has_position.any():
            estimate = find_mounting(described_by, images, frames)
        found.append(mounted(estimate, frames.unit))
        if estimate.mirrored is None:
            found.append(direction(seen, wrapped(np.diff(part.theta))))
    return [fault for fault in found if fault is not None]


def _turning(frames: FrameTable) -> FrameTable:
    """Return the frames in a row among which a drive turns most, by its headings, or else by its odometry."""
    theta = frames.theta if np.isfinite(frames.theta).any() else frames.odom_theta
    turned = np.concatenate([[0.0], np.cumsum(np.nan_to_num(np.abs(wrapped(np.diff(theta)))))])
    begins = np.arange(max(1, len(frames) - _IN_A_ROW + 1))
    ends = np.minimum(begins + _IN_A_ROW, len(frames))
    begin = int((turned[ends - 1] - turned[begins]).argmax())
    return frames.take(slice(begin, begin + _IN_A_ROW))


def picture_faults(
    panoramas: NDArray[np.uint8],
    made_by: Preprocessing,
    circular: bool,
    sees: NDArray[np.bool_] | None = None,
    tilt_given: bool = False,
) -> list[str | None]:
    """Return the faults of a drive's panoramas that show without poses."""
    grey = panoramas.mean(axis=1, dtype=np.float32)
    if (text := exposure(grey)) is not None:
        return [text]  # nothing else can be judged
    around = [missing_azimuth(grey) or seam(grey), horizon(panoramas, made_by, sees, tilt_given)] if circular else []
    return [blur(grey), own_robot(grey), *around]


def mounted(found: MountingEstimate, unit: str = "m") -> str | None:
    """Say how a camera is mounted that does not look straight ahead, or whose moves do not fit the poses."""
    straight = found.mounting == Mounting()
    if straight and (found.yaw_deviation <= CERTAIN or not found.pairs):
        return None
    remedy = "; a map of this drive, by a network that compares images, makes up for it"
    if straight or np.isnan(found.yaw):
        remedy = ""
    elif found.mirrored:
        remedy += f"; if they are not, {_MIRRORED_POSES}, and so is the map"
    return f"the camera's mounting: {found.summary(unit)}{remedy}"


def exposure(grey: Array) -> str | None:
    """Look for pictures (n, H, W) in which much is too dark or too bright to tell anything apart."""
    if _SHARE < (always := (grey <= _DARK).all(axis=0).mean()) < 1:
        return (
            f"{always:.0%} of the panorama is black in all images: check unwrap, and what covers the camera, or use a "
            "longer exposure"
        )
    for share, how, what in (
        ((grey <= _DARK).mean(axis=(1, 2)), "black", "longer"),
        ((grey >= _BRIGHT).mean(axis=(1, 2)), "white", "shorter"),
    ):
        if (count := int((share > _SHARE).sum())) > len(grey) / 4:
            return f"{count} of {len(grey)} images are more than {_SHARE:.0%} {how}: use a {what} exposure"
    return None


def blur(grey: Array) -> str | None:
    """Look for pictures (n, H, W) without any detail of the size of a pixel.

    In a sharp picture, the squared difference of pixels two columns apart is hardly more than that of neighbours, in a
    smooth one four times as large.
    """
    near, far = ((((grey[..., step:] - grey[..., :-step]) ** 2).mean(axis=(1, 2))) for step in (1, 2))
    count = int(((near < _SMOOTH * far) & (far > 1)).sum())
    if count <= len(grey) / 4:
        return None
    return f"{count} of {len(grey)} images are blurred: look at focus, exposure time, and the size of the images"


def missing_azimuth(grey: Array) -> str | None:
    """Look for columns of panoramas (n, H, W) that show nothing: bars beside the pictures, or a mask."""
    empty = (grey.std(axis=1) < _EVEN).mean(axis=0) > 0.9
    if empty.sum() * 360 / len(empty) < _MISSING:
        return None
    azimuth = np.degrees(np.angle(np.exp(1j * column_azimuth(len(empty))[empty]).mean()))
    where = f"{abs(azimuth):.0f} degrees to the {'left' if azimuth > 0 else 'right'} of their middle"
    return (
        f"{empty.sum() * 360 / len(empty):.0f} degrees of the panoramas show nothing, around {where}: if these are "
        "black bars beside the pictures, which count as a part of the turn, cut them off. A part that something covers "
        "needs nothing"
    )


def seam(grey: Array) -> str | None:
    """Look for neighbouring columns of panoramas (n, H, W) that never fit: a cut, a lost strip, or two lenses."""
    apart = np.abs(grey - np.roll(grey, 1, axis=2)).mean(axis=1)  # (n, W): with the column to the left
    ratio = np.median(apart / np.maximum(np.median(apart, axis=1, keepdims=True), 0.5), axis=0)
    at = int(ratio.argmax())
    if ratio[at] < _SEAM:
        return None
    where = "where the panoramas begin and end" if at == 0 else f"at column {at} of the panoramas"
    return f"there is a seam {where}: a strip is missing or doubled. Check where they are cut, or how lenses are joined"


def own_robot(grey: Array) -> str | None:
    """Look for parts of panoramas (n, H, W) that do not change while the robot moves."""
    change = grey.std(axis=0)
    usual = float(np.median(change))
    own = (change < _STILL * usual) & (grey.mean(axis=0).std() > _EVEN) & ~(grey.std(axis=1) < _EVEN).all(axis=0)
    if usual < _EVEN or own.mean() < _OWN:
        return None
    rows = np.flatnonzero(own.mean(axis=1) > _BAND)
    if not len(rows):
        return (
            f"{own.mean():.0%} of the panorama, a narrow part, never change: the robot, or who carries the camera, is "
            "in view. No setting is needed; a higher camera sees less of it"
        )
    edge = "bottom" if rows.min() else "top"
    return (
        f"{own.mean():.0%} of the panorama, in rows {rows.min()} to {rows.max()} of {len(own)}, never change: the "
        f"robot sees itself. Move the camera, or leave these rows out (unwrap.{edge}), with a network that was "
        "trained so"
    )


def horizon(
    panoramas: NDArray[np.uint8],
    made_by: Preprocessing,
    sees: NDArray[np.bool_] | None = None,
    tilt_given: bool = False,
) -> str | None:
    """Look for a camera that is mounted tilted, or sways: in most panoramas (n, 3, H, W), upright edges lean."""
    tilts = np.degrees([tilt_of(one.transpose(1, 2, 0), made_by.view, sees) for one in panoramas])
    roll, pitch = np.median(tilts, axis=0)
    tilt, sway = np.hypot(roll, pitch), np.median(np.hypot(*tilts.T))
    levelled = "choose the camera model that levels pictures (unwrap=, with unwrap.level=true)"
    if made_by.elevations is not None:
        levelled = "set unwrap.level=true, or give its tilt (the columns roll and pitch)"
        if tilt_given:
            levelled = "set unwrap.level=true and leave the given tilt out, which does not fit (columns roll and pitch)"
    if tilt >= _LEVEL:
        side = ("ahead", "on the left", "behind", "on the right")[round(np.arctan2(roll, -pitch) / (np.pi / 2)) % 4]
        return (
            f"the horizon is not level: things appear about {tilt:.0f} degrees lower {side}. Mount the camera upright, "
            f"or {levelled}"
        )
    if sway >= _LEVEL:
        return (
            f"the camera sways: it is tilted by {sway:.0f} degrees, now to one side and now to another. Hold it "
            f"upright, or {levelled}"
        )
    return None


def turns_seen(panoramas: NDArray[np.uint8]) -> Array:
    """Return how far the camera turned to the left between successive panoramas (n - 1,), in rad, by correlation."""
    bands = np.array_split(panoramas.mean(axis=1, dtype=np.float32), _BANDS, axis=1)
    profile = np.stack([band.mean(axis=1) for band in bands], axis=1)
    spectrum = np.fft.rfft(np.gradient(profile, axis=2))
    spectrum /= np.maximum(np.abs(spectrum), 1e-6) ** 0.5
    fit = np.fft.irfft((spectrum[1:] * spectrum[:-1].conj()).sum(axis=1), profile.shape[2])
    at = fit.argmax(axis=1)
    low, top, high = (fit[np.arange(len(fit)), (at + step) % fit.shape[1]] for step in (-1, 0, 1))
    shift = at + 0.5 * (low - high) / np.minimum(low - 2 * top + high, -1e-6)
    return wrapped(shift * (2 * np.pi / profile.shape[2]))


def direction(seen: Array, turned: Array) -> str | None:
    """Compare the turns (k,) in the images with those of the headings, both in rad to the left."""
    real = np.abs(turned) > _TURNS
    if real.sum() < _FEWEST:
        return None
    seen, turned = seen[real], turned[real]
    if (np.abs(wrapped(seen + turned)) < np.abs(wrapped(seen - turned))).mean() < 0.8:
        return None
    return (
        f"images turn against the headings: they are mirrored, or {_MIRRORED_POSES}, or the two frames of the poses "
        "are exchanged. Flip the images, correct unwrap.mirrored, or correct the poses; a map by a network that "
        "compares images makes up for mirrored images only"
    )


def turns_compared(described_by: Descriptor, images: PanoramaLibrary, frames: FrameTable) -> Array:
    """Return the turns of `turns_seen` (n - 1,) by a network that compares; NaN between images that are not alike."""
    parts = orientation_parts(described_by, images, frames).astype(np.float32)
    pose, _, match = described_by.compare(parts[1:], parts[:-1])  # type: ignore[attr-defined]
    return np.where(match > 0, pose[:, 2], np.nan)


def other_times(seen: Array, frames: FrameTable) -> str | None:
    """Compare the times of turns (n - 1,) in the images of a drive, in rad, with those of its poses and odometry."""
    posed = bool(np.isfinite(frames.theta).any())
    for theta, whose in (
        (frames.theta, "headings do: the poses are those of other times"),
        (frames.odom_theta, "odometry does: the odometry is that of other times"),
    ):
        offset = time_offset(seen, frames.time, theta)
        if offset == 0:
            continue
        side = "before" if offset > 0 else "after"
        remedy = f"{offset:+.2f} s to the times of the images (column time, data.offset or recording.offset)"
        if theta is frames.odom_theta and posed:  # the poses fit the images: the odometry is off
            remedy = f"{-offset:+.2f} s to the times of the odometry"
        return f"the images turn {abs(offset):.2f} s {side} the {whose}. Add {remedy}"
    return None


def time_offset(seen: Array, time: Array, theta: Array, signs: Sequence[int] = (1, -1)) -> float:
    """Return what to add to the times (n,) of images, in s, so that they turn when the headings (n,) do, in rad.

    0 if the offset is unknown or too small to matter. `seen` are the turns in the images (n - 1,), NaN where unknown;
    they are tried with each of the `signs`, since mirrored images turn the other way. A drive that turns left and right
    in equal times may fit either sign, so both are tried at each offset. Headings are NaN where unknown, as those of
    odometry that begins late: turns count whose headings are known at all offsets, so that all are judged alike.
    """
    known = np.isfinite(theta)
    if not (np.isfinite(time).all() and (np.diff(time) > 0).all() and known.any()):
        return 0.0
    step, headed, heading = float(np.median(np.diff(time))), time[known], np.unwrap(theta[known])
    reach = max(_LATEST, 3 * step)
    gaps = np.diff(np.flatnonzero(known)) > 1
    far = gaps & (np.diff(headed) > reach / 2)  # headings that are nearer to each other are interpolated
    begins, ends = headed[np.append(True, far)], headed[np.append(far, True)]
    within = np.searchsorted(begins, time[:-1] - reach, "right") - 1 == np.searchsorted(ends, time[1:] + reach)
    rows, by_headings = np.isfinite(seen) & within, np.diff(np.interp(time, headed, heading))
    if rows.sum() < _FEWEST or np.abs(by_headings)[rows].sum() < _FEWEST * _TURNS:
        return 0.0
    offsets = np.linspace(-reach, reach, _OFFSETS)
    turned = np.array([np.diff(np.interp(time + offset, headed, heading))[rows] for offset in offsets])
    by_sign = [np.abs(wrapped(sign * seen[rows] - turned)).clip(0, _STRAY).mean(axis=1) for sign in signs]
    off = np.min(by_sign, axis=0)
    best = int(off.argmin())
    if abs(offsets[best]) < max(_PROMPT, 0.3 * step) or off[best] > 0.7 * off[_OFFSETS // 2]:
        return 0.0
    return float(offsets[best])
