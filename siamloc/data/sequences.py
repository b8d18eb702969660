"""What the sequences of the COLD database are called, whatever folders they lie in."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from siamloc.data.names import LIGHTINGS, lighting_in

BUILDINGS = ("freiburg", "ljubljana", "saarbruecken")

_SEQUENCE = re.compile(rf"(?:(?P<place>.+?)[_-])?(?P<run>seq_?[0-9]+[_-]?(?:{'|'.join(LIGHTINGS)})[0-9]*)")
_PART = re.compile(r"(?:(?P<building>.+?)[_-])?part[_-]?(?P<part>[a-z])")
_SHORT_PART = re.compile(r"(?P<building>.+)[_-](?P<part>[ab])")


class SequenceName(NamedTuple):
    """Canonical name of a sequence (`freiburg_a_seq2_cloudy3`), of its building (`freiburg_a`), and its lighting."""

    sequence: str
    building: str
    lighting: str


def name_sequence(folder: Path, label: str, rooms: Sequence[str]) -> SequenceName:
    """Name a sequence from the folder it lies in, and from the suffix of its room codes.

    Understood are `freiburg/part_a/seq2_cloudy3`, `cold-freiburg_part_a_seq2_cloudy3`,
    `cold-freiburg_part_a/seq2_cloudy3`, `freiburg_seq2_cloudy3` and `freiburg_a_seq2_cloudy3`. Where the folders do
    not say the part, the room codes do if all of them end in -A or all in -B.

    Args:
        folder: the sequence's folder; the folders above it may say building and part.
        label: what to call a sequence whose folder has no such name.
        rooms: its room codes as written.
    """
    parts = [part.lower() for part in folder.absolute().parts]
    match = _SEQUENCE.fullmatch(parts[-1])
    if match is None:
        return SequenceName(label, "", lighting_in(folder.name))
    building, part = _place(match["place"] or "")
    if not building:
        building, upper_part = _place_above(parts[:-1], part)
        part = part or upper_part
    suffixes = {room[-2:].lower() for room in rooms if room}
    if not part and building and suffixes in ({"-a"}, {"-b"}):
        part = suffixes.pop()[1]
    whole = "_".join(word for word in (building, part) if word)
    run = re.sub(r"seq_?([0-9]+)[_-]?([a-z]+)", r"seq\1_\2", match["run"])
    return SequenceName("_".join(word for word in (whole, run) if word), whole, lighting_in(run))


def _place(text: str) -> tuple[str, str]:
    """Return building and part that one folder name says, each perhaps empty."""
    text = re.sub(r"^cold[_-]", "", text)
    match = _PART.fullmatch(text) or _SHORT_PART.fullmatch(text)
    return (match["building"] or "", match["part"]) if match else (text, "")


def _place_above(parents: list[str], part: str) -> tuple[str, str]:
    """Return building and part that the folders above a sequence say.

    A folder counts as a building if COLD has one of that name, or if it says a part or holds a folder that does.
    """
    for name in reversed(parents[-3:]):
        building, named_part = _place(name)
        if building in BUILDINGS or (building and (named_part or part)):
            return building, named_part or part
        part = named_part or part
    return "", part
