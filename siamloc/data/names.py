"""Parse COLD's names: an image's name holds its time and pose, a folder's its sequence, building and lighting.

Images are called `t<seconds>_x<metres>_y<metres>_a<radians>.jpeg`, and `t<seconds>.jpeg` where no pose is known.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple
from unicodedata import normalize

LIGHTINGS = ("cloudy", "night", "sunny")
BUILDINGS = ("freiburg", "ljubljana", "saarbruecken")

NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_NAME = re.compile(
    rf"t(?P<time>{NUMBER})(?:_x(?P<x>{NUMBER})_y(?P<y>{NUMBER})_a(?P<theta>{NUMBER}))?\.(?:jpe?g|png)",
    re.IGNORECASE,
)
_SEQUENCE = re.compile(
    rf"(?:(?P<place>.+?)[_-])?(?P<run>seq_?[0-9]+[_-]?(?:{'|'.join(LIGHTINGS)})[0-9]*(?:_month[0-9]+)?)"
)
_PART = re.compile(r"(?:(?P<building>.+?)[_-])?part[_-]?(?P<part>[a-z])")
_SHORT_PART = re.compile(r"(?P<building>.+)[_-](?P<part>[ab])")


class NamedPose(NamedTuple):
    """Time in s, position in m and heading in rad that a COLD image name holds; NaN without a pose."""

    time: float
    x: float = math.nan
    y: float = math.nan
    theta: float = math.nan


def parse_name(name: str) -> NamedPose | None:
    """Return the time and pose that a file name (without its folder) carries, or None if it is not a COLD name.

    The whole name has to match, and the numbers have to be finite; exponents such as `1e-05` and `-0.000000` are
    understood, as are `.jpg` and `.png`.
    """
    match = _NAME.fullmatch(name)
    if match is None:
        return None
    given = {key: float(value) for key, value in match.groupdict().items() if value is not None}
    return NamedPose(**given) if all(map(math.isfinite, given.values())) else None


def format_name(pose: NamedPose, suffix: str = ".jpeg") -> str:
    """Return the COLD file name of a pose, with six decimals as the database writes them, and the suffix at the end."""
    return f"t{pose.time:.6f}_x{pose.x:.6f}_y{pose.y:.6f}_a{pose.theta:.6f}{suffix}"


def lighting_in(text: str) -> str:
    """Return the lighting (cloudy, night or sunny) that a text names, in any case, if it names only one; else ""."""
    named = [lighting for lighting in LIGHTINGS if lighting in text.lower()]
    return named[0] if len(named) == 1 else ""


class SequenceName(NamedTuple):
    """Canonical name of a sequence (`freiburg_a_seq2_cloudy3`), of its building (`freiburg_a`), and its lighting."""

    sequence: str
    building: str
    lighting: str


def name_sequence(folder: Path, label: str, rooms: Sequence[str]) -> SequenceName:
    """Name a sequence after its folder and the suffix of its room codes.

    The folder may be named `freiburg/part_a/seq2_cloudy3`, `cold-freiburg_part_a_seq2_cloudy3`,
    `cold-freiburg_part_a/seq2_cloudy3`, `freiburg_seq2_cloudy3` or `freiburg_a_seq2_cloudy3`. If the folders do not
    name the part, it follows from the room codes if all of them end in -A or all in -B. The simulator adds the month of
    a drive, as in `seq2_cloudy3_month6`.

    Args:
        folder: the sequence's folder; the folders above it may name building and part.
        label: name of the sequence if its folder has none of these names.
        rooms: room codes of the sequence, as written.
    """
    parts = [part.lower() for part in folder.absolute().parts]
    match = _SEQUENCE.fullmatch(parts[-1])
    if match is None:
        return SequenceName(nfc(label), "", lighting_in(folder.name))
    building, part = _place(match["place"] or "")
    if not building:
        building, upper_part = _place_above(parts[:-1], part)
        part = part or upper_part
    suffixes = {room[-2:].lower() for room in rooms if room}
    if not part and building and suffixes in ({"-a"}, {"-b"}):
        part = suffixes.pop()[1]
    whole = "_".join(word for word in (building, part) if word)
    run = re.sub(r"seq_?([0-9]+)[_-]?([a-z]+)", r"seq\1_\2", match["run"])
    return SequenceName(nfc("_".join(word for word in (whole, run) if word)), whole, lighting_in(run))


def nfc(label: str) -> str:
    """Return a label whose letters with accents are one character each, since some systems write them as two.

    Example:
        >>> len("Bu\N{COMBINING DIAERESIS}ro"), len(nfc("Bu\N{COMBINING DIAERESIS}ro"))
        (5, 4)
    """
    return normalize("NFC", label)


def _place(text: str) -> tuple[str, str]:
    """Return the building and part that a folder name holds; either may be empty."""
    text = re.sub(r"^cold[_-]", "", text)
    match = _PART.fullmatch(text) or _SHORT_PART.fullmatch(text)
    return (match["building"] or "", match["part"]) if match else (text, "")


def _place_above(parents: list[str], part: str) -> tuple[str, str]:
    """Return the building and part that the folders above a sequence name.

    A folder counts as a building if COLD has one of that name, or if it names a part or contains a folder that does.
    """
    for name in reversed(parents[-3:]):
        building, named_part = _place(name)
        if building in BUILDINGS or (building and (named_part or part)):
            return building, named_part or part
        part = named_part or part
    return "", part
