"""The archives of the COLD database: which sequences there are, where they lie, and how many frames they have.

Nothing here could be checked against the archives themselves: the addresses, the lightings of Ljubljana and
Saarbruecken and the numbers of frames come from papers and from code of people who worked with the data. Correct this
table if an archive proves it wrong; numbers of frames are only compared, and never decide whether a sequence is used.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase

from siamloc.data.names import BUILDINGS, LIGHTINGS
from siamloc.errors import ConfigError, hint

ADDRESS = "https://www.cas.kth.se/COLD/db"
"""Where the database lies; a mirror has the same folders below another address."""

_FRAMES: dict[str, tuple[int | None, ...]] = {
    "freiburg_a_seq1_cloudy": (1459, 1832, 1672),
    "freiburg_a_seq1_night": (1911, 1582, 1703),
    "freiburg_a_seq1_sunny": (1598, 1514, 1551, 1777),
    "freiburg_a_seq2_cloudy": (2146, 2595, 2778),
    "freiburg_a_seq2_night": (2876, 2707, 2896),
    "freiburg_a_seq2_sunny": (2319, 2114, 2231, 2807),
    "freiburg_b_seq3_cloudy": (2236, 2008, 1898),
    "freiburg_b_seq3_sunny": (1754, 1797, 2225),
    "ljubljana_a_seq1_cloudy": (2112, None, None),
    "ljubljana_a_seq1_night": (None, None, None),
    "ljubljana_a_seq1_sunny": (None, None, None),
    "ljubljana_a_seq2_cloudy": (2267, None, None),
    "ljubljana_a_seq2_night": (None, None, None),
    "ljubljana_a_seq2_sunny": (None, None, None),
    "saarbruecken_a_seq1_cloudy": (997, None, None),
    "saarbruecken_a_seq1_night": (None, None, None),
    "saarbruecken_a_seq2_cloudy": (2815, None, None),
    "saarbruecken_a_seq2_night": (None, None, None),
    "saarbruecken_b_seq3_cloudy": (858, None, None),
    "saarbruecken_b_seq3_night": (None, None, None),
    "saarbruecken_b_seq3_sunny": (None, None, None),
    "saarbruecken_b_seq4_cloudy": (1371, None, None),
    "saarbruecken_b_seq4_night": (None, None, None),
    "saarbruecken_b_seq4_sunny": (None, None, None),
}
"""Frames of run 1, 2, ... of each drive's path and lighting; None where the number is unknown."""

_NAME = re.compile(rf"({'|'.join(BUILDINGS)})_([ab])_(seq[0-9]_(?:{'|'.join(LIGHTINGS)})[0-9]+)")


@dataclass(frozen=True)
class Archive:
    """The archive of one sequence.

    Attributes:
        sequence: name of the sequence, such as "freiburg_a_seq2_cloudy3".
        frames: number of frames; None if unknown.
    """

    sequence: str
    frames: int | None = None

    @property
    def folder(self) -> str:
        """The folder of the sequence within the database, such as "cold-freiburg/part_a/seq2_cloudy3"."""
        building, part, run = _NAME.fullmatch(self.sequence).groups()  # type: ignore[union-attr]
        return f"cold-{building}/part_{part}/{run}"


def archives(sequences: Iterable[str] = ("*",)) -> list[Archive]:
    """Return the archives of sequences, given by names or shell patterns such as "freiburg_a_seq2_*".

    A name of COLD's form is taken as it is, even if the table does not have it.

    Raises:
        ConfigError: a name that is not COLD's, or a pattern that no sequence of the table fits.

    Example:
        >>> archives(["freiburg_a_seq2_cloudy3"])
        [Archive(sequence='freiburg_a_seq2_cloudy3', frames=2778)]
    """
    table = {f"{name}{run}": count for name, counts in _FRAMES.items() for run, count in enumerate(counts, 1)}
    found: dict[str, Archive] = {}
    for wanted in sequences:
        names = [name for name in table if fnmatchcase(name, wanted)] or [wanted] * bool(_NAME.fullmatch(wanted))
        if not names:
            runs = [f"{name}*" for name in _FRAMES]
            raise ConfigError(f"COLD has no sequence {wanted!r}; {hint(wanted, runs)}")
        found |= {name: Archive(name, table.get(name)) for name in names}
    return list(found.values())
