"""What a camera expert sees in the panoramas of one drive: each check returns a sentence for a fault, or None.

Panoramas are (n, 3, H, W), uint8, RGB, in capture order. Those of a standing robot say little: the checks compare what
moves through the picture with what stays where it is.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic import Descriptor
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.mounting import CERTAIN, Mounting, MountingEstimate, find_mounting
from siamloc.data.moves import wrapped
from siamloc.data.panorama import column_azimuth

Array = NDArray[Any]

_BANDS = 8  # rows of a panorama in which turns are measured
_EVEN = 2.0  # deviation of grey values below which a column shows nothing
_MISSING = 5.0  # degrees
_SEAM = 3.0  # difference of neighbouring columns, in usual ones
_DARK, _BRIGHT, _SHARE = 8, 247, 0.4  # grey values that are no longer told apart, and the share of pixels with such
_SMOOTH = 0.3  # see `blur`: 0.25 if neighbouring differences are proportional to the distance
_STILL, _OWN = 0.12, 0.02  # change over time of the robot's own picture, in usual ones, and its share of the panorama
_LEVEL = 2.0  # degrees
_TURNS, _STRAY = np.radians(5), np.radians(10)  # what counts as a turn, and what as a wrong measurement
_FEWEST = 10  # frames, and turns
_MIRRORED_POSES = "the poses are (y and headings with the wrong sign, as with z down)"
_LOOKED_AT, _IN_A_ROW = 64, 300  # frames, and those in which turns are measured


def drive_faults(frames: FrameTable, images: PanoramaLibrary, described_by: Descriptor | None = None) -> list[str]:
    """Return the faults that the panoramas of a drive show, alone and compared with its poses.

    Args:
        frames: the frames of the drive, in capture order; nothing is said about fewer than 10.
        images: their panoramas.
        described_by: a network that compares, for `find_mounting`; None to leave that out.
    """
    if len(frames) < _FEWEST:
        return []
    spread = np.unique(np.linspace(0, len(frames) - 1, _LOOKED_AT).astype(int))
    sees = images.seen(str(frames.sequence[0]))
    turn = images.circular and (sees is None or bool(sees.any(axis=0).all()))  # what is not seen is filled
    found = picture_faults(images.batch(images.rows(frames.take(spread))), turn)
    if images.circular:
        part = frames.take(slice(0, _IN_A_ROW))
        seen = turns_seen(images.batch(images.rows(part)))
        found.append(time_offset(seen, part.time, part.theta))
        mounting = MountingEstimate()
        if described_by is not None and frames.has_position.any():
            mounting = find_mounting(described_by, images, frames)
        found.append(mounted(mounting, frames.unit))
        if mounting.mirrored is None:
            found.append(direction(seen, wrapped(np.diff(part.theta))))
    return [fault for fault in found if fault is not None]


def picture_faults(panoramas: NDArray[np.uint8], circular: bool) -> list[str | None]:
    """Return the faults of a drive's panoramas that show without poses."""
    grey = panoramas.mean(axis=1, dtype=np.float32)
    if (text := exposure(grey)) is not None:
        return [text]  # nothing else can be judged
    return [blur(grey), own_robot(grey), *([missing_azimuth(grey) or seam(grey), horizon(grey)] if circular else [])]


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
    """Look for columns of panoramas (n, H, W) that show nothing: not the full turn, or a mask."""
    empty = (grey.std(axis=1) < _EVEN).mean(axis=0) > 0.9
    if empty.sum() * 360 / len(empty) < _MISSING:
        return None
    azimuth = np.degrees(np.angle(np.exp(1j * column_azimuth(len(empty))[empty]).mean()))
    return (
        f"{empty.sum() * 360 / len(empty):.0f} degrees of the panoramas show nothing, around {azimuth:.0f} degrees to "
        "the left of their middle: they are no full turn. Say how much they show (unwrap=equirectangular unwrap.turn)"
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
    rows = np.flatnonzero(own.mean(axis=1) > 0.05)
    if not len(rows):
        return f"{own.mean():.0%} of the panorama, a narrow part, never change: the robot sees itself"
    return (
        f"{own.mean():.0%} of the panorama, in rows {rows.min()} to {rows.max()} of {len(own)}, never change: the "
        "robot sees itself. Leave these rows out (unwrap.bottom), or move the camera"
    )


def horizon(grey: Array) -> str | None:
    """Look for a camera that is mounted tilted: on average over a drive (n, H, W), one side shows things lower."""
    mean = grey.mean(axis=0)
    mean = mean - mean.mean(axis=0)
    usual = mean.mean(axis=1)
    slope = np.gradient(usual)
    slope -= slope.mean()  # sides may be brighter than others, which is no shift
    lower = -(mean - usual[:, None]).T @ slope / max(float(slope @ slope), 1e-6)  # rows, of each column
    azimuth = column_azimuth(len(lower))
    first = 2 * (lower * np.exp(-1j * azimuth)).mean()
    tilt = abs(first) * 360 / len(lower)
    rest = lower - (first * np.exp(1j * azimuth)).real
    if tilt < _LEVEL or abs(first) < 1.5 * rest.std():
        return None
    side = ("ahead", "on the left", "behind", "on the right")[round(-np.angle(first) / (np.pi / 2)) % 4]
    return (
        f"the horizon is not level: things appear about {tilt:.0f} degrees lower {side}. Mount the camera upright, or "
        "give its tilt (unwrap.elevation and unwrap.roll, or the columns roll and pitch)"
    )


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


def time_offset(seen: Array, time: Array, theta: Array) -> str | None:
    """Compare the times of turns (n - 1,) in the images of a drive with those of its headings (n,), in s and rad."""
    if not (np.isfinite(time).all() and np.isfinite(theta).all() and (np.diff(time) > 0).all()):
        return None
    heading = np.unwrap(theta)
    if (np.abs(np.diff(heading)) > _TURNS).sum() < _FEWEST:
        return None
    step = float(np.median(np.diff(time)))
    offsets = np.linspace(-3, 3, 121) * step
    moved = [np.diff(np.interp(time + offset, time, heading)) for offset in offsets]
    off = np.array([np.abs(wrapped(seen - one))[4:-4].clip(0, _STRAY).mean() for one in moved])
    best = int(off.argmin())
    if abs(offsets[best]) < 0.3 * step or off[best] > 0.7 * off[len(offsets) // 2]:
        return None
    side = "before" if offsets[best] > 0 else "after"
    return (
        f"the images turn {abs(offsets[best]):.2f} s {side} the headings do: the poses are those of other times. Add "
        f"{offsets[best]:+.2f} s to the times of the images (data.offset or recording.offset)"
    )
