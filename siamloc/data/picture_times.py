"""Times at which pictures were taken: in their names, or in the files, where cameras write them (EXIF)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime, timedelta, timezone
from functools import partial
from pathlib import Path

import numpy as np

from siamloc.data.trajectory import Array, seconds
from siamloc.errors import DataError, say_once

_STAMP = re.compile(r"\d+(?:\.\d+)?$")
_IN_PARTS = re.compile(r"(\d{10})[_-](\d{9})$")  # s and ns
_DATE = re.compile(  # 20260512_101523, 20260512_101523123, 2026-05-12 at 10.15.23, and the like, maybe with a time zone
    r"(?<!\d)(20\d\d)[-_.]?(\d\d)[-_.]?(\d\d)\D{0,4}(\d\d)[-_.:]?(\d\d)[-_.:]?(\d\d)(?:[-_.]?(\d{3,9}))?"
    r"(Z(?![A-Za-z])|[+-](?:0\d|1[0-4]):?[0-5]\d)?(?!\d)"
)
_COUNTER = 1e8, 1e4  # whole numbers below it, in smaller steps, count images and are no times
_A_SECOND = 30  # pictures of one second, at most
_QUARTER = 900  # s; time zones differ by whole quarters of an hour
NO_DRIVE = 1e9  # s, 30 years: times so far apart are in different units
_PICTURE_TAGS, _TAKEN, _FRACTION, _ZONE = 0x8769, 0x9003, 0x9291, 0x9011  # of EXIF


def taken_at(files: Sequence[Path], span: float | None = None) -> Array:
    """Return the times at which pictures were taken (n,), in s since 1970 or any other start; NaN if unknown.

    The number at the end of a name is a time, unless a date or a counter; else the camera's own time in the file
    (EXIF), else the date and time in the name.

    Args:
        files: pictures of one drive, in the order of their names.
        span: as for `seconds`.

    Raises:
        DataError: names with times of different kinds.
    """
    folder, dates = str(files[0].parent), _dates(files)
    if dates is None and (stamps := _stamps(files, span)) is not None:
        _check_alike(files, stamps)
        return stamps
    if (held := _of_cameras(files)) is not None:
        times, zoned = held
    elif dates is not None:
        times, zoned = dates
    else:
        _name_lacking(files, span)
        return np.full(len(files), np.nan)
    if not zoned:
        say_once(
            f"{folder}: the clock times of its pictures are taken for UTC: if they are local times, and poses are "
            "joined by time, give offset=SECONDS, such as -7200 for a clock two hours ahead"
        )
    return times


def _stamps(files: Sequence[Path], span: float | None) -> Array | None:
    """Return the times by the numbers at the ends of the names; None if a name has none, or they are counters."""
    stamps = [_STAMP.search(_IN_PARTS.sub(r"\1.\2", file.stem)) for file in files]
    if all(stamps):
        numbers = np.array([float(stamp[0]) for stamp in stamps if stamp])
        large = numbers.max() >= _COUNTER[0] or np.ptp(numbers) >= _COUNTER[1] * len(numbers)
        if large or any("." in stamp[0] for stamp in stamps if stamp):
            return seconds(numbers, str(files[0].parent), span)
    return None


def _check_alike(files: Sequence[Path], stamps: Array) -> None:
    dated = [_DATE.search(file.stem) is not None for file in files]
    one, other = int(stamps.argmin()), int(stamps.argmax())
    if any(dated) and not all(dated):
        one, other = dated.index(True), dated.index(False)
    elif stamps[other] - stamps[one] < NO_DRIVE:
        return
    raise DataError(
        f"{files[0].parent}: names such as {files[one].name} and {files[other].name} hold times of different kinds: "
        "name all pictures alike, or give times=FILE"
    )


def _dates(files: Sequence[Path]) -> tuple[Array, bool] | None:
    """Return the times by the dates in the names, in s since 1970, and whether their time zone is known.

    None if the dates do not say when each picture was taken, or some name has no date. Unlike counters, time
    zones are whole quarters of an hour, and at most two in a drive.
    """
    found = [match for file in files if (match := _DATE.search(file.stem))]
    try:
        times = [_utc(datetime(*map(int, match.groups()[:6]))) for match in found]  # type: ignore[arg-type]
    except ValueError:  # a month 13
        return None
    parts = [match[7] or "0" for match in found]
    if len(parts) < 2 or not (np.diff([float(part) for part in parts]) > 0).all():  # else it is a counter
        times = [time + float(f"0.{part}") for time, part in zip(times, parts, strict=True)]
    zones = [match[8] for match in found]
    ahead = [(datetime.strptime(zone or "Z", "%z").utcoffset() or timedelta()).total_seconds() for zone in zones]
    if zoned := None not in zones and len({*ahead}) <= 2 and not any(offset % _QUARTER for offset in ahead):
        times = [time - offset for time, offset in zip(times, ahead, strict=True)]
    made = _of_each(times, len(files))
    return None if made is None else (made, zoned)


def _name_lacking(files: Sequence[Path], span: float | None) -> None:
    """Warn of the pictures without a time in their names, if most pictures have one."""
    for pattern, times_of in ((_DATE, _dates), (_STAMP, partial(_stamps, span=span))):
        those = [file for file in files if pattern.search(file.stem)]
        if 2 * len(those) > len(files) and times_of(those) is not None:
            _say_lacking(files, [file.name for file in files if file not in those], "in the name")
            return


def _say_lacking(files: Sequence[Path], lacking: Sequence[str], where: str) -> None:
    if lacking:
        say_once(
            f"{files[0].parent}: {len(lacking)} of {len(files)} pictures hold no time ({where}), the first: "
            f"{lacking[0]}; so the times of the others are not used: take these out, or give times=FILE"
        )


def _of_cameras(files: Sequence[Path]) -> tuple[Array, bool] | None:
    """Return the times in the files, in s since 1970, and whether time zones are known; None if they are unknown."""
    if not (_of_camera(files[0]) or _of_camera(files[-1])):
        return None
    held = {file.name: _of_camera(file) for file in files}
    _say_lacking(files, [name for name, one in held.items() if one is None], "EXIF")
    known = [one for one in held.values() if one is not None]
    made = _of_each([time for time, _ in known], len(files))
    return None if made is None else (made, all(zoned for _, zoned in known))


def _of_camera(file: Path) -> tuple[float, bool] | None:
    """Return the time in a file, in s since 1970, and whether its time zone is known; None if there is none."""
    try:
        from PIL import Image
    except ModuleNotFoundError:  # a robot needs no times
        return None
    try:
        with Image.open(file) as picture:
            held = picture.getexif().get_ifd(_PICTURE_TAGS)
        tags = {key: str(value).strip(" \0") for key, value in held.items()}
        taken = datetime.strptime(tags[_TAKEN], "%Y:%m:%d %H:%M:%S")
        zone = datetime.strptime(tags[_ZONE], "%z").utcoffset() if tags.get(_ZONE) else None
        return _utc(taken - (zone or timedelta())) + float(f"0.{tags.get(_FRACTION) or 0}"), zone is not None
    except (OSError, KeyError, ValueError, SyntaxError, Image.DecompressionBombError):
        return None  # no picture, or without a time


def _of_each(times: Sequence[float], count: int) -> Array | None:
    """Return the times of `count` pictures as an array; None if a picture lacks its time, or too many share one time.

    Times that most pictures share say when the drive was, not when each picture was taken. A clock that counts seconds
    cuts off fractions: the pictures of a second are spread over it, and a single one is put in its middle.
    """
    if len(times) != count or len(set(times)) < max(count / _A_SECOND, min(count, 2)):
        return None
    made = np.array(times)
    if not (made % 1).any():
        order = np.argsort(made, kind="stable")
        first, after = (np.searchsorted(made[order], made[order], side=side) for side in ("left", "right"))
        made[order] += (np.arange(count) - first + 0.5) / (after - first)
    return made


def _utc(time: datetime) -> float:
    return time.replace(tzinfo=timezone.utc).timestamp()
