"""`Reproduction`: the measured numbers of a recipe, next to the published ones, with the claims checked."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from foundation.calls import typed
from foundation.files import write_text
from siamloc.errors import ConfigError
from siamloc.reproduce.claims import Claim, claim, holds
from siamloc.reproduce.drawing import drawn, names_of, said, shown, titled, unit
from siamloc.reproduce.published import Record, grouped, measures, published
from siamloc.reproduce.recipe_book import Recipe, data_named

if TYPE_CHECKING:
    from matplotlib.figure import Figure

VERDICTS = MappingProxyType({True: "holds", False: "does not hold", None: "not decidable at this scale"})

_WITH = ("published with", "ours with")
_FEW = 8
_HIDDEN = {
    *("data", "size", "lighting", "method", "version", "information"),
    *("different_share", "same_pairs", "different_pairs"),
}
"""Settings that follow from others or are shown elsewhere."""


@dataclass(frozen=True)
class Row:
    """A published number next to ours.

    Attributes:
        published: as published; None if only we have one.
        ours: as measured; None if the recipe has none.
    """

    published: Record | None
    ours: Record | None

    @property
    def measure(self) -> str:
        """The measure of both."""
        one = self.published or self.ours
        assert one is not None
        return one.measure

    @property
    def settings(self) -> Mapping[str, Any]:
        """The settings of both."""
        ours = {} if self.ours is None else self.ours.settings
        return {**ours, **({} if self.published is None else self.published.settings)}

    @property
    def difference(self) -> float | None:
        """Ours minus the published one, in the measure's unit; None if one is missing, or only a bound is known."""
        if self.published is None or self.ours is None or self.published.relation in "<>":
            return None
        return self.ours.value - self.published.value


@dataclass(frozen=True)
class Verdict:
    """Whether a claim holds.

    Attributes:
        claim: the claim.
        ours: whether our numbers support it; None if they do not decide.
        printed: whether the document's own numbers support it; None if they were not printed.
    """

    claim: Claim
    ours: bool | None
    printed: bool | None


@dataclass(frozen=True, eq=False)
class Reproduction:
    """The measured numbers of a recipe.

    Attributes:
        recipe: the recipe.
        data: name of the data set.
        scale: "smoke", "short" or "full".
        records: measured numbers.
        beside: measured numbers of our own experiments, on the same frames.
        seconds: measuring time by experiment, including earlier measurements.
        machines: machines they were measured on, as far as known.
    """

    recipe: Recipe
    data: str
    scale: str
    records: tuple[Record, ...]
    beside: tuple[Record, ...]
    seconds: Mapping[str, float]
    machines: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"Reproduction({self.recipe.id}: {len(self.records)} numbers on {self.data}, {self.scale})"

    def summary(self) -> str:
        """Return one line with what was measured and whether the claims hold."""
        verdicts = [VERDICTS[one.ours] for one in self.verdicts]
        said = ", ".join(f"{verdicts.count(word)} {word}" for word in VERDICTS.values() if word in verdicts)
        return f"{self.recipe.id}, {len(self.records)} numbers{'; claims: ' + said if said else ''}"

    @property
    def rows(self) -> list[Row]:
        """The published numbers, each next to ours if the recipe measures it."""
        printed = [one for entry in self.recipe.entries for one in published(entry).records()]
        asked = [one for one in printed if self.recipe.where.items() <= one.settings.items()]
        ours = _best(self.records, self.recipe)
        return [Row(one, _beside(one, self.records if "bound" in one.settings else ours, self.recipe)) for one in asked]

    @property
    def verdicts(self) -> list[Verdict]:
        """The claims, each checked against our numbers."""
        named = [claim(id) for id in self.recipe.claims]
        return [Verdict(one, holds(one.check, self.records), one.printed()) for one in named]

    def table(self) -> str:
        """Return published and measured numbers as a Markdown table; only our own if nothing was printed."""
        lines = [f"### {self.recipe.title}", "", f"{self._where()}"]
        rows = self.rows
        if rows:
            measured = {row.measure for row in rows}
            rows += [Row(None, one) for one in _best(self.beside, self.recipe) if one.measure in measured]
            apart = _told_apart(rows)
            heads = [name for name in apart if self.recipe.join is None or name in self.recipe.join]
            other = [name for name in dict.fromkeys([*apart, *_unlike(rows)]) if name not in heads]
            cells = [[*_row(row, heads), *(_with(one, other) for one in (row.published, row.ours))] for row in rows]
            names = [*heads, "measure", "published", "ours", "difference", *_WITH]
            # What is the same in all rows is stated once, above them.
            values = {at: {row[at] for row in cells} - {""} for at, name in enumerate(names) if name in _WITH}
            same = "; ".join(f"{names[at]} {min(values[at])}" for at in values if len(values[at]) == 1)
            lines += [f"{same[0].upper()}{same[1:]}."] if same else []
            kept = [at for at in range(len(names)) if at not in values or len(values[at]) > 1]
            lines += ["", *_markdown([names[at] for at in kept], [[row[at] for at in kept] for row in cells])]
        if self.recipe.figure:
            lines += ["", *self._best_table()]
        if self.recipe.claims:
            lines += [
                "",
                *_markdown(["claim", "printed numbers", "ours"], [_verdict_row(one) for one in self.verdicts]),
            ]
        if self.recipe.notes:
            lines += ["", *(f"- {note}" for note in self.recipe.notes)]
        return "\n".join(lines) + "\n"

    def as_csv(self) -> str:
        """Return every number as a row: published ones with ours, then all other measured ones."""
        rows = self.rows
        joined = {id(row.ours) for row in rows}
        rows += [Row(None, one) for one in (*self.records, *self.beside) if id(one) not in joined]
        heads = list(dict.fromkeys(name for row in rows for name in row.settings))
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow([*heads, "measure", "unit", "published", "ours", "difference", "protocol", "data", "scale"])
        units = measures()
        protocol = self._protocol()
        for row in rows:
            writer.writerow(
                [
                    *("" if row.settings.get(name) is None else row.settings[name] for name in heads),
                    row.measure,
                    units.get(row.measure, {}).get("unit", ""),
                    "" if row.published is None else row.published.value,
                    "" if row.ours is None else row.ours.value,
                    "" if row.difference is None else row.difference,
                    protocol,
                    self.data,
                    self.scale,
                ]
            )
        return out.getvalue()

    def plot(self) -> Figure:
        """Return the figure in the form of the published one.

        Raises:
            ConfigError: the recipe has no figure.
        """
        if not self.recipe.figure:
            raise ConfigError(f"{self.recipe.id} has no figure: see its table")
        return drawn(self.recipe.figure, [*self.records, *self.beside])

    @typed
    def save(self, folder: str | Path) -> list[Path]:
        """Write ID.md, ID.csv, and ID.png if there is a figure; return the files.

        Raises:
            StorageError: the disk is full or cannot be written to.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        files = [folder / f"{self.recipe.id}.md", folder / f"{self.recipe.id}.csv"]
        write_text(files[0], self.table())
        write_text(files[1], self.as_csv())
        return [*files, *self.save_plot(folder)]

    def save_plot(self, folder: str | Path) -> list[Path]:
        """Write ID.png if there is a figure; return the file, if any.

        Raises:
            StorageError: the disk is full or cannot be written to.
        """
        from siamloc.report.draw.look import save

        return [save(self.plot(), Path(folder) / f"{self.recipe.id}.png")] if self.recipe.figure else []

    def _where(self) -> str:
        source, title = self.recipe.source, data_named(self.data)["title"]
        place = ", ".join(filter(None, [f"[{source.document}] section {source.section}", source.place]))
        return f"{place}. On {title}; {self._protocol()}. Scale {self.scale}, {sum(self.seconds.values()):.0f} s."

    def _protocol(self) -> str:
        return "; ".join(f"{role}: {says}" for role, says in self.recipe.protocol(self.scale).items())

    def _best_table(self) -> list[str]:
        """Return the smallest and largest of our numbers in each figure, by its distinguishing settings."""
        lines: list[list[str]] = []
        for figure in self.recipe.figure:
            found = shown(figure, [*self.records, *self.beside])
            names = _apart_by(figure, found)
            for key, part in grouped(names, found).items():
                low, high = min(part, key=lambda one: one.value), max(part, key=lambda one: one.value)
                numbers = [cell for one in (low, high) for cell in (f"{one.value:.3g}", _settings(one, *names))]
                line = [_measure(figure["measure"]), titled(names, key), *numbers]
                lines += [line] if line not in lines else []
        return _markdown(["measure", "of", "smallest", "with", "largest", "with"], lines) if lines else []


def _best(records: Sequence[Record], chosen: Recipe) -> list[Record]:
    """Return the records; of those with the same `join` settings, only the ones with the largest `best`."""
    if chosen.best is None or chosen.join is None:
        return list(records)
    kept: dict[tuple[Any, ...], Record] = {}
    for one in records:
        key = tuple(one.settings.get(name) for name in chosen.join)
        if one.measure == chosen.best and (key not in kept or one.value > kept[key].value):
            kept[key] = one
    return [one for one in records if any(dict(one.settings) == dict(best.settings) for best in kept.values())]


def _beside(one: Record, ours: Sequence[Record], chosen: Recipe) -> Record | None:
    """Return our number for a published one; for a bound, the smallest or largest of ours."""
    join = None if chosen.join is None else [name for name in chosen.join if name != "bound"]
    found = [our for our in ours if _same(one, our, join)]
    if not found or "bound" not in one.settings:
        return found[0] if found else None
    return (min if one.settings["bound"] == "lowest" else max)(found, key=lambda our: our.value)


def _same(one: Record, ours: Record, join: Sequence[str] | None) -> bool:
    """Return whether a published and a measured number belong together."""
    if one.measure != ours.measure:
        return False
    names = join if join is not None else [name for name in one.settings if name in ours.settings]
    return bool(names) and all(one.settings.get(name) == ours.settings.get(name) for name in names)


def _told_apart(rows: Sequence[Row]) -> list[str]:
    """Return the settings in which rows differ."""
    names = dict.fromkeys(name for row in rows for name in row.settings)
    return [name for name in names if len({_shown(row.settings.get(name)) for row in rows}) > 1]


def _apart_by(figure: Mapping[str, Any], found: Sequence[Record]) -> list[str]:
    """Return the settings that distinguish the numbers of a figure: all if there are few groups, else the first."""

    def differ(*names: str) -> list[str]:
        return [name for name in dict.fromkeys(names) if len({one.settings.get(name) for one in found}) > 1]

    drawn = [name for key in ("panels", "series") for name in names_of(figure, key)]
    names = differ(*drawn) or differ("descriptor", "method", "version", "distance")
    if len(grouped(names, found)) > _FEW:
        names = differ("descriptor", "method", "version", "distance", *names)[:1]
    return names or ["descriptor"]


def _row(row: Row, heads: Sequence[str]) -> list[str]:
    difference = "" if row.difference is None else f"{row.difference:+.3g}"
    told = [_shown(row.settings.get(name)) for name in heads]
    return [*told, _measure(row.measure), _printed(row.published), _number(row.ours), difference]


def _with(one: Record | None, names: Sequence[str]) -> str:
    settings = {} if one is None else one.settings
    return ", ".join(f"{name} {_shown(settings[name])}" for name in names if name in settings and name not in _HIDDEN)


def _measure(name: str) -> str:
    """Return the label of a measure, with its unit."""
    return f"{said(name)} [{unit(name)}]" if unit(name) not in ("", "share") else said(name)


def _settings(one: Record | None, *but: str) -> str:
    """Return the settings of a number in words, without some of them."""
    return "" if one is None else _with(one, [name for name in one.settings if name not in but])


def _unlike(rows: Sequence[Row]) -> list[str]:
    """Return the settings in which a published number and ours next to it differ."""
    pairs = [(row.published.settings, row.ours.settings) for row in rows if row.published and row.ours]
    return [
        name
        for name in dict.fromkeys(name for settings, _ in pairs for name in settings)
        if any(
            name in ours and _shown(ours[name]) != _shown(settings.get(name, ours[name])) for settings, ours in pairs
        )
    ]


def _markdown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}", *(f"| {' | '.join(row)} |" for row in rows)]


def _verdict_row(one: Verdict) -> list[str]:
    printed = "" if one.printed is None else VERDICTS[one.printed]
    reading = f" *({one.claim.reading})*" if one.claim.reading else ""
    return [f"{one.claim.sentence}{reading}", printed, VERDICTS[one.ours]]


def _shown(value: Any) -> str:
    return "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _printed(one: Record | None) -> str:
    if one is None:
        return ""
    return f"{'' if one.relation == '=' else one.relation}{one.value:.4g}"


def _number(one: Record | None) -> str:
    return "" if one is None else f"{one.value:.4g}"
