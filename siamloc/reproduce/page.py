"""The report: what was reproduced, on which machine, and whether the claims hold; one page of Markdown."""

from __future__ import annotations

import datetime
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from foundation.calls import typed
from foundation.files import write_text
from siamloc.reproduce.claims import combined
from siamloc.reproduce.reproduction import CONTRADICTED, VERDICTS, Reproduction, Verdict
from siamloc.reproduce.study_book import data_named
from siamloc.results import versions

_ABOUT = """\
Each part below is a published table or figure, measured again: `siamloc reproduce ID data=... scale=...` produces it,
and `siamloc reproduce --list` lists all. Published numbers and claims come from three texts: **[I]** Román et al. 2020,
**[C]** Cebollada et al. 2019, **[T]** Román's thesis of 2023. They were measured on other images, partly with other
protocols, on other machines; each part says what replaces what here. A claim is a sentence of a text with a check that
numbers can be tested against: it *holds*, *does not hold*, or is *not decidable* if the study, the data or the scale
lack what it compares, if all compared numbers are equal, or if they differ by less than such a difference varies
between seeds and choices of frames. This spread is the largest of the experiments of the same kind that were repeated,
as `benchmarks/results/spreads.json` has it, for maps that of spectral clustering; for errors of trained networks it is
that of `augmentation_training.json`. Claims that the document's own numbers contradict come first and are counted
apart, whatever ours say. A claim that several parts check stands in the row of each, but counts once in the totals, by
its worst verdict. The notes of a part say what is known about why a claim does not hold here; if they say nothing, we
know of no reason. Neither the building nor a check is tuned to a claim.
"""


@typed
def write_report(results: Sequence[Reproduction], path: str | Path, missing: Mapping[str, str] | None = None) -> Path:
    """Write the page of several reproductions and their plots to the same folder, and return its path.

    Args:
        results: reproductions on one data set and scale.
        path: path of the page, name.md.
        missing: reasons why other studies could not be measured, by id.

    Raises:
        StorageError: the disk is full or cannot be written to.
    """
    path = Path(path)
    for one in results:
        one.save_plot(path.parent)
    write_text(path, report(results, missing))
    return path


def report(results: Sequence[Reproduction], missing: Mapping[str, str] | None = None) -> str:
    """Return the Markdown page of several reproductions."""
    first = results[0]
    verdicts, rows = [one for each in results for one in each.verdicts], [row for one in results for row in one.rows]
    counted = Counter(_over_studies(verdicts))
    contradicted, ours = counted.pop(CONTRADICTED, 0), sum(row.ours is not None for row in rows)
    minutes = sum({name: seconds for one in results for name, seconds in one.seconds.items()}.values()) / 60
    machines = " and ".join(dict.fromkeys(name for one in results for name in one.machines)) or "an unknown machine"
    made = ", ".join(f"{name} {version}" for name, version in versions().items())
    lines = [
        f"# Reproduced: {len(results)} tables and figures on {data_named(first.data)['title']}",
        "",
        _ABOUT,
        f"Scale `{first.scale}`; measured in {minutes:.0f} minutes on {machines}; written by {made}; "
        f"{datetime.datetime.now(datetime.timezone.utc):%d %B %Y}.",
        "",
        f"Of {counted.total() + contradicted} claims the documents' own numbers contradict {contradicted}. Of the "
        f"other {counted.total()}, {counted[VERDICTS[True]]} hold here, {counted[VERDICTS[False]]} do not, and "
        f"{counted[VERDICTS[None]]} cannot be decided. Of {len(rows)} published numbers, {ours} have one of ours next "
        "to them.",
        "",
        "| | | claims contradicted by their own document | that hold | that do not | not decidable "
        "| published numbers next to ours |",
        "|---|---|---|---|---|---|---|",
    ]
    for one in results:
        counted, rows = Counter(verdict.counted for verdict in one.verdicts), one.rows
        beside = f"{sum(row.ours is not None for row in rows)} of {len(rows)}" if rows else ""
        cells = [str(counted[key] or "") for key in (CONTRADICTED, *VERDICTS.values())]
        lines.append(f"| [{one.study.id}](#{one.study.id}) | {one.study.title} | {' | '.join(cells)} | {beside} |")
    for id, reason in (missing or {}).items():
        lines.append(f"| {id} | not measured: {reason} | | | | | |")
    for one in results:
        lines += ["", f'<a id="{one.study.id}"></a>', "", one.table()]
        if one.study.figure:
            lines.append(f"![{one.study.title}]({one.study.id}.png)")
    return "\n".join(lines) + "\n"


def _over_studies(verdicts: Sequence[Verdict]) -> list[str]:
    """Return how each claim counts in the totals, from all studies that check it."""
    each: dict[str, list[Verdict]] = {}
    for one in verdicts:
        each.setdefault(one.claim.id, []).append(one)
    return [replace(part[0], finding=combined([one.finding for one in part])).counted for part in each.values()]
