"""Rows of words in a text file: lists of times, and trajectories."""

from __future__ import annotations

import csv
import re
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from foundation.files import read_text
from siamloc.errors import DataError

_DATED = re.compile(  # 2011-09-26 13:02:25.964, maybe with a time zone
    r"(\d{4}-\d\d-\d\d)[ T](\d\d:\d\d:\d\d)(\.\d+)?(Z|[+-]\d\d:?\d\d)?(?=[\s,;\"]|$)"
)


def text_rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return the line number and the words of each line of a text file that is neither empty nor a comment.

    Spaces, commas or semicolons separate words, which may be quoted. A date with a time of day becomes a
    number of seconds since 1970, as in UTC where it has no time zone.

    Raises:
        DataError: the file cannot be read, or is empty.
    """
    try:
        text = read_text(path).removeprefix("\ufeff")
        lines = (_DATED.sub(_since_1970, text) if ":" in text else text).splitlines()
        rows = [(number, _split(line)) for number, line in enumerate(lines, 1)]
    except (OSError, ValueError, csv.Error) as error:
        raise DataError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from error
    rows = [(number, words) for number, words in rows if words and not words[0].startswith("#")]
    if not rows:
        raise DataError(f"{path} is empty: expected a line for each entry")
    return rows


def _split(line: str) -> list[str]:
    mark = next((mark for mark in ";," if mark in line), " ")
    if mark == " " and '"' not in line:
        return line.split()  # fast
    (words,) = csv.reader([line.replace("\t", " ").strip()], delimiter=mark, skipinitialspace=True)
    return [word.strip() for word in words if word.strip()]


def headed(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Return the names of the columns, in a line without numbers or in a comment before the first row, and the rows."""
    rows = text_rows(path)
    first, second = (words[0][0].isdigit() or any(map(is_number, words)) for _, words in (rows * 2)[:2])
    if second > first:
        return rows[0][1], rows[1:]
    above = [] if rows[0][0] == 1 else read_text(path).removeprefix("\ufeff").splitlines()[: rows[0][0] - 1]
    for names in reversed([_split(line.lstrip("#")) for line in above if line.startswith("#")]):
        if len(names) == len(rows[0][1]) > 1 and any(word.endswith("x") for word in name_words(names[1].lower())):
            return names, rows
    return [], rows


def _since_1970(dated: re.Match[str]) -> str:
    zone = datetime.strptime(dated[4] or "Z", "%z").tzinfo
    time = datetime.fromisoformat(f"{dated[1]} {dated[2]}").replace(tzinfo=zone)
    return f"{time.timestamp():.0f}{dated[3] or ''}"


def name_words(name: str) -> set[str]:
    """Return the words of lower-case letters in the name of a column."""
    return set(re.findall("[a-z]+", name))


def is_number(word: str) -> bool:
    """Return whether a word is a number."""
    with suppress(ValueError):
        float(word)
        return True
    return False
