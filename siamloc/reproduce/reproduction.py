"""`Reproduction`: the measured numbers of a study, next to the published ones, with the claims checked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foundation.calls import typed
from foundation.files import csv_text, write_text
from siamloc.errors import ConfigError
from siamloc.report.draw.look import save
from siamloc.reproduce.claims import Claim, Finding, claim, examine
from siamloc.reproduce.drawing import drawn, names_of, said, shown, titled, unit
from siamloc.reproduce.published import Record, grouped, measures, published
from siamloc.reproduce.study_book import Study, data_named, experiment

if TYPE_CHECKING:
    from matplotlib.figure import Figure

VERDICTS = {True: "holds", False: "does not hold", None: "not decidable"}
CONTRADICTED = "contradicted by the document's own numbers"

_METHODS = ("descriptor", "method", "version", "distance")
_FEW = 8
_HIDDEN = {
    *("data", "size", "lighting", "method", "version", "information"),
    *("different_share", "same_pairs", "different_pairs"),
}
"""Settings that follow from others or are shown elsewhere."""


@dataclass(frozen=True)
class Row:
    """A published number next to the number that was measured here.

    Attributes:
        published: the published record; None if there is only a measured one.
        ours: the measured record; None if the study has none.
    """

    published: Record | None
    ours: Record | None

    @property
    def measure(self) -> str:
        """The measure of both numbers."""
        return next(one.measure for one in (self.published, self.ours) if one is not None)

    @property
    def settings(self) -> Mapping[str, Any]:
        """The settings of both numbers."""
        return {**_settings(self.ours), **_settings(self.published)}

    @property
    def difference(self) -> float | None:
        """The measured minus the published number, in the measure's unit; None if one is missing or only a bound."""
        if self.published is None or self.ours is None or self.published.relation in "<>":
            return None
        return self.ours.value - self.published.value


@dataclass(frozen=True)
class Verdict:
    """Whether a claim of a document holds for measured numbers.

    Attributes:
        claim: the sentence of the document, with its check.
        finding: whether our numbers support it, or why they do not decide.
        printed: whether the document's own numbers support it; None if they were not printed.
    """

    claim: Claim
    finding: Finding
    printed: bool | None

    @property
    def counted(self) -> str:
        """How the claim counts in totals: by our numbers, unless the document's own numbers contradict it."""
        return CONTRADICTED if self.printed is False else VERDICTS[self.finding.holds]


@dataclass(frozen=True, eq=False)
class Reproduction:
    """The measured numbers of a study.

    Attributes:
        study: the study that was measured.
        data: name of the data set.
        scale: "smoke", "short" or "full".
        records: measured numbers.
        beside: measured numbers of experiments that the documents do not have, on the same frames.
        seconds: measuring time by experiment, including earlier measurements.
        machines: machines on which the numbers were measured, as far as known.
    """

    study: Study
    data: str
    scale: str
    records: tuple[Record, ...]
    beside: tuple[Record, ...]
    seconds: Mapping[str, float]
    machines: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Reproduction({self.study.id}: {len(self.records)} numbers on {self.data}, {self.scale})"

    def summary(self) -> str:
        """Return one line with what was measured and whether the claims hold."""
        verdicts = Counter(one.counted for one in self.verdicts)
        said = ", ".join(f"{number} {word}" for word, number in verdicts.items())
        return f"{self.study.id}, {len(self.records)} numbers{'; claims: ' + said if said else ''}"

    @property
    def rows(self) -> list[Row]:
        """The published numbers, each next to the measured number if the study has one."""
        printed = [one for entry in self.study.entries for one in published(entry).records()]
        asked = [one for one in printed if self.study.where.items() <= one.settings.items()]
        best = _best(self.records, self.study)
        return [Row(one, _beside(one, self.records if "bound" in one.settings else best, self.study)) for one in asked]

    @property
    def verdicts(self) -> list[Verdict]:
        """The claims, each checked against our numbers; first those that the document's own numbers contradict."""
        asked = [claim(id) for id in self.study.claims]
        found = [Verdict(one, examine(one.check, self.records), one.printed()) for one in asked]
        return sorted(found, key=lambda one: one.printed is not False)

    def table(self) -> str:
        """Return published and measured numbers as a Markdown table; only our own if nothing was printed."""
        source, about = self.study.source, data_named(self.data)
        folders = [about["at"].get(job.at, "{}") for job in self.study.jobs(self.scale, self.data)]
        where = " and ".join(dict.fromkeys(about["title"] if "{}" in folder else folder for folder in folders))
        place = ", ".join(filter(None, [f"[{source.document}] section {source.section}", source.place]))
        measured = f"Scale {self.scale}, {sum(self.seconds.values()):.0f} s."
        lines = [f"### {self.study.title}", "", f"{place}. On {where}; {self._protocol()}. {measured}"]
        lines += self._comparison() if self.rows else []
        if self.study.figure:
            lines += ["", *self._best_table()]
        if self.study.claims:
            verdicts = [_verdict_row(one) for one in self.verdicts]
            lines += ["", *_markdown(["claim", "the document's own numbers", "ours"], verdicts)]
        if self.study.notes:
            lines += ["", *(f"- {note}" for note in self.study.notes)]
        return "\n".join(lines) + "\n"

    def as_csv(self) -> str:
        """Return every number as a row of CSV: published numbers with measured ones, then other measured numbers."""
        rows = self.rows
        joined = {id(row.ours) for row in rows}
        rows += [Row(None, one) for one in (*self.records, *self.beside) if id(one) not in joined]
        heads = list(dict.fromkeys(name for row in rows for name in row.settings))
        lines: list[list[Any]] = [
            [*heads, "measure", "unit", "published", "ours", "difference", "protocol", "data", "scale"]
        ]
        ending = self._protocol(), self.data, self.scale
        for row in rows:
            settings = [row.settings.get(name) for name in heads]
            unit_of = measures().get(row.measure, {}).get("unit")
            values = [getattr(one, "value", None) for one in (row.published, row.ours)]
            lines.append([*settings, row.measure, unit_of, *values, row.difference, *ending])
        return csv_text(lines)

    def plot(self) -> Figure:
        """Return a figure of the measured numbers in the form of the published figure.

        Raises:
            ConfigError: the study has no figure.
        """
        if not self.study.figure:
            raise ConfigError(f"{self.study.id} has no figure: see its table")
        return drawn(self.study.figure, [*self.records, *self.beside])

    @typed
    def save(self, folder: str | Path) -> list[Path]:
        """Write ID.md, ID.csv, and ID.png if there is a figure; return the files.

        Raises:
            StorageError: the disk is full or cannot be written to.
        """
        texts = {f"{self.study.id}.md": self.table(), f"{self.study.id}.csv": self.as_csv()}
        for name, text in texts.items():
            write_text(Path(folder) / name, text)
        return [*(Path(folder) / name for name in texts), *self.save_plot(folder)]

    def save_plot(self, folder: str | Path) -> list[Path]:
        """Write ID.png if there is a figure; return the file, if any.

        Raises:
            StorageError: the disk is full or cannot be written to.
        """
        return [save(self.plot(), Path(folder) / f"{self.study.id}.png")] if self.study.figure else []

    def _protocol(self) -> str:
        by_words: dict[str, list[str]] = {}
        for one in map(experiment, self.study.experiments):
            if not one.beside:
                says = "; ".join(f"{role}: {words}" for role, words in one.protocol_in_words(self.scale).items())
                by_words.setdefault(says, []).append(one.id)
        if len(by_words) == 1:
            return next(iter(by_words))
        return " / ".join(f"{', '.join(ids)}: {says}" for says, ids in by_words.items())

    def _comparison(self) -> list[str]:
        """Return the lines of the table with the published numbers next to ours."""
        rows = self.rows
        listed = {row.measure for row in rows}
        rows += [Row(None, one) for one in _best(self.records, self.study) if one.measure in self.study.also]
        rows += [Row(None, one) for one in _best(self.beside, self.study) if one.measure in listed]
        names = dict.fromkeys(name for row in rows for name in row.settings)
        apart = [name for name in names if len({_shown(row.settings.get(name)) for row in rows}) > 1]
        heads = [name for name in apart if self.study.join is None or name in self.study.join]
        other = [name for name in dict.fromkeys([*apart, *_unlike(rows)]) if name not in heads]
        columns = {name: [_shown(row.settings.get(name)) for row in rows] for name in heads}
        columns["measure"] = [_measure(row.measure) for row in rows]
        columns["published"] = [_number(row.published) for row in rows]
        columns["ours"] = [_number(row.ours) for row in rows]
        columns["difference"] = ["" if row.difference is None else f"{row.difference:+.3g}" for row in rows]
        beside = {
            "published with": [_with(row.published, other) for row in rows],
            "ours with": [_with(row.ours, other) for row in rows],
        }
        # What is the same in all rows is stated once, above them.
        same = "; ".join(f"{name} {max(cells)}" for name, cells in beside.items() if len({*cells} - {""}) == 1)
        columns |= {name: cells for name, cells in beside.items() if len({*cells} - {""}) > 1}
        lines = [f"{same[0].upper()}{same[1:]}."] if same else []
        return [*lines, "", *_markdown(list(columns), zip(*columns.values(), strict=True))]

    def _best_table(self) -> list[str]:
        """Return the smallest and largest of our numbers in each figure, by its distinguishing settings."""
        lines: list[list[str]] = []
        for figure in self.study.figure:
            records = shown(figure, [*self.records, *self.beside])
            names = _apart_by(figure, records)
            for key, part in grouped(names, records).items():
                line = [_measure(figure["measure"]), titled(names, key)]
                for pick in (min, max):
                    one = pick(part, key=lambda one: one.value)
                    line += [f"{one.value:.3g}", _with(one, [name for name in one.settings if name not in names])]
                lines += [line] if line not in lines else []
        return _markdown(["measure", "of", "smallest", "with", "largest", "with"], lines) if lines else []


def _best(records: Sequence[Record], chosen: Study) -> list[Record]:
    """Return the records; of records with the same `join` settings, only those with the largest `best`."""
    if chosen.best is None or chosen.join is None:
        return list(records)
    rated = [one for one in records if one.measure == chosen.best]
    kept = [max(part, key=lambda one: one.value).settings for part in grouped(chosen.join, rated).values()]
    return [one for one in records if one.settings in kept]


def _beside(one: Record, ours: Sequence[Record], chosen: Study) -> Record | None:
    """Return the measured number to show with a published one; with a bound, the smallest or largest of them."""
    records = [our for our in ours if _same(one, our, chosen.join)]
    if not records or "bound" not in one.settings:
        return records[0] if records else None
    return (min if one.settings["bound"] == "lowest" else max)(records, key=lambda our: our.value)


def _same(one: Record, ours: Record, join: Sequence[str] | None) -> bool:
    """Return whether a published and a measured number belong together."""
    common = [name for name in one.settings if name in ours.settings]
    names = common if join is None else [name for name in join if name != "bound"]
    same = all(one.settings.get(name) == ours.settings.get(name) for name in names)
    return one.measure == ours.measure and bool(names) and same


def _apart_by(figure: Mapping[str, Any], records: Sequence[Record]) -> list[str]:
    """Return the settings that distinguish the numbers of a figure: all if there are few groups, else the first."""

    def differ(*names: str) -> list[str]:
        return [name for name in dict.fromkeys(names) if len({one.settings.get(name) for one in records}) > 1]

    names = differ(*names_of(figure, "panels"), *names_of(figure, "series")) or differ(*_METHODS)
    if len(grouped(names, records)) > _FEW:
        names = differ(*_METHODS, *names)[:1]
    return names or ["descriptor"]


def _unlike(rows: Sequence[Row]) -> list[str]:
    """Return the settings in which any published number differs from the measured number next to it."""
    pairs = [(_settings(row.published), _settings(row.ours)) for row in rows if row.published and row.ours]
    return [
        name
        for name in dict.fromkeys(name for printed, _ in pairs for name in printed)
        if any(_shown(ours[name]) != _shown(printed.get(name, ours[name])) for printed, ours in pairs if name in ours)
    ]


def _settings(one: Record | None) -> Mapping[str, Any]:
    return {} if one is None else one.settings


def _with(one: Record | None, names: Sequence[str]) -> str:
    """Return some settings of a number in words, if it has them."""
    known = _settings(one)
    return ", ".join(f"{name} {_shown(known[name])}" for name in names if name in known and name not in _HIDDEN)


def _measure(name: str) -> str:
    """Return the label of a measure, with its unit."""
    return f"{said(name)} [{unit(name)}]" if unit(name) not in ("", "share") else said(name)


def _markdown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}", *(f"| {' | '.join(row)} |" for row in rows)]


def _verdict_row(one: Verdict) -> list[str]:
    printed = {True: "support it", False: "**contradict it**", None: ""}[one.printed]
    reading = f" *({one.claim.reading})*" if one.claim.reading else ""
    why = f": {one.finding.why}" if one.finding.why else ""
    return [f"{one.claim.sentence}{reading}", printed, f"{VERDICTS[one.finding.holds]}{why}"]


def _shown(value: Any) -> str:
    return "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _number(one: Record | None) -> str:
    """Return a number with "~", "<" or ">" if it is not exact."""
    return "" if one is None else f"{one.relation.removeprefix('=')}{one.value:.4g}"
