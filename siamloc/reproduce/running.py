"""`reproduce`: run a recipe, put its numbers beside the published ones, and hold the claims against them."""

from __future__ import annotations

import csv
import io
import platform
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from siamloc.calls import typed
from siamloc.errors import ConfigError, FormatError, hint
from siamloc.files import content_key, plain, read_json, storage_errors, write_json, write_text
from siamloc.progress import track
from siamloc.reproduce.claims import Claim, claim, holds
from siamloc.reproduce.published import Record, measures, published
from siamloc.reproduce.recipe_book import SCALES, Job, Recipe, data_named, data_names, experiment, recipe, recipes
from siamloc.settings import NotNegative, Text, checked

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from siamloc.reproduce.experiments import Data

_VERSION = 1
"""Of what the experiments measure: records by another version are measured again."""

VERDICTS = MappingProxyType({True: "holds", False: "does not hold", None: "not decidable at this scale"})


_WITH = ("published with", "ours with")


@dataclass(frozen=True)
class Row:
    """A published number beside ours.

    Attributes:
        published: as it was published; None where only we have one.
        ours: as measured; None where the recipe has none.
    """

    published: Record | None
    ours: Record | None

    @property
    def measure(self) -> str:
        """What both measure."""
        one = self.published or self.ours
        assert one is not None
        return one.measure

    @property
    def settings(self) -> Mapping[str, Any]:
        """What both were measured with."""
        ours = {} if self.ours is None else self.ours.settings
        return {**ours, **({} if self.published is None else self.published.settings)}

    @property
    def difference(self) -> float | None:
        """Ours minus the published one, in the measure's unit; None where one of them is missing."""
        return None if self.published is None or self.ours is None else self.ours.value - self.published.value


@dataclass(frozen=True)
class Verdict:
    """What became of a claim.

    Attributes:
        claim: it.
        ours: whether our numbers bear it out; None where they do not decide.
        printed: whether the document's own numbers do; None where they were not printed.
    """

    claim: Claim
    ours: bool | None
    printed: bool | None


@dataclass(frozen=True, eq=False)
class Reproduction:
    """A recipe's numbers.

    Attributes:
        recipe: what was run.
        data: name of the data set.
        scale: "smoke", "short" or "full".
        records: measured numbers.
        beside: those of our own recipe, on the same frames.
        seconds: what measuring them took, whenever that was.
    """

    recipe: Recipe
    data: str
    scale: str
    records: tuple[Record, ...]
    beside: tuple[Record, ...]
    seconds: float

    def __repr__(self) -> str:
        return f"Reproduction({self.recipe.id}: {len(self.records)} numbers on {self.data}, {self.scale})"

    def summary(self) -> str:
        """Say in one line what was measured, and what became of the claims."""
        verdicts = [VERDICTS[one.ours] for one in self.verdicts]
        said = ", ".join(f"{verdicts.count(word)} {word}" for word in VERDICTS.values() if word in verdicts)
        return f"{self.recipe.id}, {len(self.records)} numbers{'; claims: ' + said if said else ''}"

    @property
    def rows(self) -> list[Row]:
        """The published numbers, each beside ours where the recipe measures it."""
        ours = _best(self.records, self.recipe)
        found = []
        for entry in self.recipe.entries:
            for one in published(entry).records():
                found.append(Row(one, next((our for our in ours if _same(one, our, self.recipe.join)), None)))
        return found

    @property
    def verdicts(self) -> list[Verdict]:
        """The claims, each held against our numbers."""
        named = [claim(id) for id in self.recipe.claims]
        return [Verdict(one, holds(one.check, self.records), one.printed()) for one in named]

    def table(self) -> str:
        """Return published and measured numbers as a Markdown table; our own alone where nothing was printed."""
        lines = [f"### {self.recipe.title}", "", f"{self._where()}", ""]
        rows = self.rows
        if rows:
            measured = {row.measure for row in rows}
            rows += [Row(None, one) for one in _best(self.beside, self.recipe) if one.measure in measured]
            heads = [name for name in _told_apart(rows) if not self.recipe.best or name in (self.recipe.join or ())]
            lines += _markdown(
                [*heads, "measure", "published", "ours", "difference", *(_WITH if self.recipe.best else ())],
                [
                    [
                        *(_shown(row.settings.get(name)) for name in heads),
                        row.measure,
                        _printed(row.published),
                        _number(row.ours),
                        "" if row.difference is None else f"{row.difference:+.3g}",
                        *([_settings(one, *heads) for one in (row.published, row.ours)] if self.recipe.best else []),
                    ]
                    for row in rows
                ],
            )
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
        """Return every number as a row: published ones with ours, and all others measured."""
        rows = self.rows
        joined = {id(row.ours) for row in rows}
        rows += [Row(None, one) for one in (*self.records, *self.beside) if id(one) not in joined]
        heads = list(dict.fromkeys(name for row in rows for name in row.settings))
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow([*heads, "measure", "unit", "published", "ours", "difference", "protocol", "data", "scale"])
        units = measures()
        protocol = "; ".join(f"{role}: {says}" for role, says in self.recipe.protocol.items())
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
        """Return the figure in the shape of the published one.

        Raises:
            ConfigError: the recipe has none.
        """
        from siamloc.reproduce.drawing import drawn

        if not self.recipe.figure:
            raise ConfigError(f"{self.recipe.id} has no figure: see its table")
        return drawn(self.recipe.figure, [*self.records, *self.beside])

    @typed
    def save(self, folder: str | Path) -> list[Path]:
        """Write ID.md, ID.csv, and ID.png where there is a figure; return the files.

        Raises:
            StorageError: the disk refuses.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        files = [folder / f"{self.recipe.id}.md", folder / f"{self.recipe.id}.csv"]
        write_text(files[0], self.table())
        write_text(files[1], self.as_csv())
        if self.recipe.figure:
            from siamloc.report.draw.look import save

            files.append(save(self.plot(), folder / f"{self.recipe.id}.png"))
        return files

    def _where(self) -> str:
        said = "; ".join(f"{role}: {says}" for role, says in self.recipe.protocol.items())
        source, title = self.recipe.source, data_named(self.data)["title"]
        where = f"table {source.table}" if source.table else f"figures {source.figures}" if source.figures else ""
        place = ", ".join(filter(None, [f"[{source.document}] section {source.section}", where]))
        return f"{place}. On {title}; {said}. Scale {self.scale}, {self.seconds:.0f} s."

    def _best_table(self) -> list[str]:
        """Return our best numbers by what the figures tell apart, where nothing was printed to join them with."""
        names = [panel["measure"] for panel in self.recipe.figure]
        lines: list[list[str]] = []
        for name in dict.fromkeys(names):
            found = [one for one in (*self.records, *self.beside) if one.measure == name]
            key = "descriptor" if len({one.settings.get("descriptor") for one in found}) > 1 else _series(self.recipe)
            for value in dict.fromkeys(one.settings.get(key) for one in found):
                part = [one for one in found if one.settings.get(key) == value]
                low, high = min(part, key=lambda one: one.value), max(part, key=lambda one: one.value)
                settings = [_settings(one, key) for one in (low, high)]
                lines.append([name, _shown(value), f"{low.value:.3g}", settings[0], f"{high.value:.3g}", settings[1]])
        heads = ["measure", _series(self.recipe), "smallest", "with", "largest", "with"]
        return _markdown(heads, lines) if lines else []


@typed
def reproduce(
    id: str | Recipe,
    *,
    data: str = "freiburg_sim",
    root: str | Path | None = None,
    scale: str = "short",
    out: str | Path = "reproduced",
    progress: bool = True,
) -> Reproduction:
    """Measure what a recipe asks for; what was measured before on the same data is read from `out`.

    Args:
        id: of the recipe, such as "figure_3_11", or one of your own.
        data: "cold", "freiburg_sim" or "mini".
        root: where the data lie; where the data set usually lies if None.
        scale: "smoke" (seconds), "short" (minutes) or "full" (as published).
        out: folder of the measured numbers; every job is kept there as soon as it is done.
        progress: whether to show how far the work is.

    Raises:
        ConfigError: an unknown recipe, data set or scale.
        DataError: data that are not there, or lack a drive; the sentence says where they should lie.

    Example:
        >>> reproduce("figure_3_11", scale="long")
        Traceback (most recent call last):
        siamloc.errors.ConfigError: unknown scale 'long': valid: smoke, short, full
    """
    chosen = recipe(id) if isinstance(id, str) else id
    if scale not in SCALES:
        raise ConfigError(f"unknown scale {scale!r}: {hint(str(scale), SCALES)}")
    if data not in data_names():
        raise ConfigError(f"recipes run on no data set {data!r}; {hint(str(data), data_names())}")
    measured = Path(out) / "measured"
    with storage_errors(measured):
        measured.mkdir(parents=True, exist_ok=True)  # refused here, and not after the first job
    jobs, opened = chosen.jobs(scale), _Opened(data, None if root is None else Path(root), Path(out) / "training")
    records: list[Record] = []
    beside: list[Record] = []
    seconds = 0.0
    for job in track(jobs, len(jobs), f"measuring {chosen.id}") if progress else jobs:
        done = _done(job, opened, Path(out), data)
        (beside if experiment(job.experiment).beside else records).extend(done["records"])
        seconds += done["seconds"]
    return Reproduction(chosen, data, scale, tuple(records), tuple(beside), seconds)


@typed
def listing(data: str = "freiburg_sim", scale: str = "short") -> str:
    """Return what can be reproduced: a line for each id with its title, its source, its jobs and what it needs."""
    lines = []
    for one in recipes():
        jobs = one.jobs(scale)
        dense = ", frames every 5 cm" if any(job.dense for job in jobs) and data_named(data).get("dense") else ""
        source = one.source
        where = f"table {source.table}" if source.table else f"figure {source.figures}" if source.figures else ""
        place = f"[{source.document}] {where or source.section}"
        lines.append(f"{one.id:<15} {place:<22} {one.title} ({len(jobs)} jobs at {scale}{dense})")
    about = data_named(data)
    return "\n".join([*lines, f"data={data} is {about['title']}: {about['how']}"])


class _Opened:
    """The data sets that jobs need, opened once."""

    def __init__(self, name: str, root: Path | None, work: Path) -> None:
        self.name, self.root, self.work = name, root, work
        self._held: dict[tuple[bool, tuple[int, int]], Data] = {}

    def of(self, job: Job) -> Data:
        from siamloc.reproduce.experiments import Data, image_size

        key = job.dense, image_size(job)
        if key not in self._held:
            about = data_named(self.name)
            if self.root is None and about["root"] is None:
                raise ConfigError(f"say where {about['title']} lies: root=FOLDER. {about['how']}")
            root = self.root or Path(about["root"])
            if job.dense and about.get("dense"):
                root = root.parent / "dense" / root.name
            self._held[key] = Data(self.name, root, key[1], self.work)
        return self._held[key]


def _done(job: Job, opened: _Opened, out: Path, data: str) -> dict[str, Any]:
    """Return the records of a job, and what they took; measured now, or read where they were measured before."""
    held = opened.of(job)
    wanted = {"version": _VERSION, "data": data, "frames": _fingerprint(job, held), **job.plain()}
    path = out / "measured" / job.experiment / f"{content_key(wanted)}.json"
    if (kept := _kept(path, wanted)) is not None:
        return kept
    from siamloc.reproduce.experiments import measured

    start = time.monotonic()
    records = list(measured(job, held))
    seconds = time.monotonic() - start
    told = [{"measure": one.measure, "value": one.value, "settings": dict(one.settings)} for one in records]
    machine = platform.processor() or platform.machine()
    held_in = {"job": wanted, "seconds": seconds, "machine": machine, "records": told, "key": content_key(told)}
    write_json(path, held_in)
    return {"records": records, "seconds": seconds}


def _kept(path: Path, wanted: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return what was kept of a job; None where nothing is, or not what was written: then it is measured again."""
    try:
        kept = checked(read_json(path), dict, "kept")
        told = checked(kept.get("records"), tuple[dict, ...], "records")
        seconds = float(checked(kept.get("seconds"), NotNegative, "seconds"))
        if not told or plain(kept.get("job")) != plain(dict(wanted)):
            return None
        if "key" in kept and kept["key"] != content_key(told):  # one that was kept by an older siamloc has none
            return None
        return {"records": [_of_plain(one) for one in told], "seconds": seconds}
    except (FormatError, ConfigError, KeyError):
        return None


def _fingerprint(job: Job, data: Data) -> str:
    """Return what changes with the frames that a job takes: their names, poses and rooms, wherever they lie."""
    told = []
    for name, role in sorted(job.roles.items()):
        frames = data.role(role)
        names = [Path(path).name for path in frames.path.tolist()]
        told.append([name, frames.sequence.tolist(), names, frames.xy.tolist(), frames.room.tolist()])
    return content_key(told)


def _of_plain(one: Mapping[str, Any]) -> Record:
    """Return a record as it was kept.

    Raises:
        ConfigError, KeyError: something else.
    """
    measure, settings = checked(one["measure"], Text, "measure"), checked(one["settings"], dict, "settings")
    for name, value in settings.items():
        checked(value, str | bool | int | float | None, name)
    return Record(measure, float(checked(one["value"], float, "value")), MappingProxyType(settings))


def _best(records: Sequence[Record], chosen: Recipe) -> list[Record]:
    """Return the records, of those with the same `join` settings only the ones beside the largest `best`."""
    if chosen.best is None or chosen.join is None:
        return list(records)
    kept: dict[tuple[Any, ...], Record] = {}
    for one in records:
        key = tuple(one.settings.get(name) for name in chosen.join)
        if one.measure == chosen.best and (key not in kept or one.value > kept[key].value):
            kept[key] = one
    return [one for one in records if any(dict(one.settings) == dict(best.settings) for best in kept.values())]


def _same(one: Record, ours: Record, join: Sequence[str] | None) -> bool:
    """Return whether a published and a measured number are of the same thing."""
    if one.measure != ours.measure:
        return False
    names = join if join is not None else [name for name in one.settings if name in ours.settings]
    return bool(names) and all(one.settings.get(name) == ours.settings.get(name) for name in names)


def _told_apart(rows: Sequence[Row]) -> list[str]:
    """Return the settings in which rows differ."""
    names = dict.fromkeys(name for row in rows for name in row.settings)
    return [name for name in names if len({_shown(row.settings.get(name)) for row in rows}) > 1]


def _series(chosen: Recipe) -> str:
    return str(chosen.figure[0].get("series", "descriptor")) if chosen.figure else "descriptor"


def _settings(one: Record | None, *but: str) -> str:
    """Return what a number was measured with, but for some settings."""
    hidden = {*but, "data", "size", "lighting", "method", "version"}
    if one is None:
        return ""
    return ", ".join(f"{name} {_shown(value)}" for name, value in one.settings.items() if name not in hidden)


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
