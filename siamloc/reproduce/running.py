"""`reproduce`: run a recipe, put its numbers beside the published ones, and hold the claims against them."""

from __future__ import annotations

import csv
import io
import os
import platform
import re
import sys
import textwrap
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from siamloc.calls import typed
from siamloc.errors import ConfigError, DataError, FormatError, hint
from siamloc.files import content_key, plain, read_json, storage_errors, write_json, write_text
from siamloc.progress import track
from siamloc.reproduce.claims import Claim, claim, holds
from siamloc.reproduce.panels import grouped, names_of, said, shown, title, unit
from siamloc.reproduce.published import Record, Source, measures, published
from siamloc.reproduce.recipe_book import (
    SCALES,
    Job,
    Recipe,
    data_named,
    data_names,
    experiment,
    recipe,
    recipes,
    seconds_of,
    without_measurement,
)
from siamloc.settings import NotNegative, Text, checked

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from siamloc.reproduce.experiments import Data

_VERSION = 1
"""Of what the experiments measure: records by another version are measured again."""

VERDICTS = MappingProxyType({True: "holds", False: "does not hold", None: "not decidable at this scale"})


_WITH = ("published with", "ours with")
_FEW = 8
_HIDDEN = {
    *("data", "size", "lighting", "method", "version", "information"),
    *("different_share", "same_pairs", "different_pairs"),
}
"""Settings that follow from others or stand elsewhere."""


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
        """Ours minus the published one, in the measure's unit; None where one is missing, or only a bound is known."""
        if self.published is None or self.ours is None or self.published.relation in "<>":
            return None
        return self.ours.value - self.published.value


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
        seconds: what measuring them took by experiment, whenever that was.
        machines: where they were measured, as far as that is known.
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
        """Say in one line what was measured, and what became of the claims."""
        verdicts = [VERDICTS[one.ours] for one in self.verdicts]
        said = ", ".join(f"{verdicts.count(word)} {word}" for word in VERDICTS.values() if word in verdicts)
        return f"{self.recipe.id}, {len(self.records)} numbers{'; claims: ' + said if said else ''}"

    @property
    def rows(self) -> list[Row]:
        """The published numbers, each beside ours where the recipe measures it."""
        printed = [one for entry in self.recipe.entries for one in published(entry).records()]
        asked = [one for one in printed if self.recipe.where.items() <= one.settings.items()]
        ours = _best(self.records, self.recipe)
        return [Row(one, _beside(one, self.records if "bound" in one.settings else ours, self.recipe)) for one in asked]

    @property
    def verdicts(self) -> list[Verdict]:
        """The claims, each held against our numbers."""
        named = [claim(id) for id in self.recipe.claims]
        return [Verdict(one, holds(one.check, self.records), one.printed()) for one in named]

    def table(self) -> str:
        """Return published and measured numbers as a Markdown table; our own alone where nothing was printed."""
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
            # What is the same in all rows is said once, above them.
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
        """Return every number as a row: published ones with ours, and all others measured."""
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
        return [*files, *self.save_plot(folder)]

    def save_plot(self, folder: str | Path) -> list[Path]:
        """Write ID.png where there is a figure; return the file, or nothing.

        Raises:
            StorageError: the disk refuses.
        """
        from siamloc.report.draw.look import save

        return [save(self.plot(), Path(folder) / f"{self.recipe.id}.png")] if self.recipe.figure else []

    def _where(self) -> str:
        source, title = self.recipe.source, data_named(self.data)["title"]
        place = ", ".join(filter(None, [f"[{source.document}] section {source.section}", _place(source)]))
        return f"{place}. On {title}; {self._protocol()}. Scale {self.scale}, {sum(self.seconds.values()):.0f} s."

    def _protocol(self) -> str:
        return "; ".join(f"{role}: {says}" for role, says in self.recipe.protocol(self.scale).items())

    def _best_table(self) -> list[str]:
        """Return the smallest and largest of our numbers in each figure, by what it tells apart."""
        lines: list[list[str]] = []
        for figure in self.recipe.figure:
            found = shown(figure, [*self.records, *self.beside])
            names = _apart_by(figure, found)
            for key, part in grouped(names, found).items():
                low, high = min(part, key=lambda one: one.value), max(part, key=lambda one: one.value)
                numbers = [cell for one in (low, high) for cell in (f"{one.value:.3g}", _settings(one, *names))]
                of = ", ".join(title(name, value) for name, value in zip(names, key, strict=True) if value is not None)
                line = [_measure(figure["measure"]), of, *numbers]
                lines += [line] if line not in lines else []
        return _markdown(["measure", "of", "smallest", "with", "largest", "with"], lines) if lines else []


@typed
def reproduce(
    id: str | Recipe,
    *,
    data: str = "freiburg_sim",
    root: str | Path | None = None,
    scale: str = "short",
    out: str | Path = "reproduced",
    measure: bool = True,
    progress: bool = True,
) -> Reproduction:
    """Measure what a recipe asks for; what was measured before on the same data is read from `out`.

    Args:
        id: of the recipe, such as "figure_3_11", or one of your own.
        data: "cold", "freiburg_sim" or "mini".
        root: where the data lie; where the data set usually lies if None.
        scale: "smoke" (seconds), "short" (minutes) or "full" (as published).
        out: folder of the measured numbers; every job is kept there as soon as it is done.
        measure: whether to measure what is not there; else that is refused.
        progress: whether to show how far the work is.

    Raises:
        ConfigError: an unknown recipe, data set or scale.
        DataError: data that are not there, or lack a drive, and the sentence says where they should lie; something
            that was not measured before, with `measure=False`.
        StorageError: the disk refuses; what was finished before stays.

    Example:
        >>> reproduce("figure_3_11", scale="long")
        Traceback (most recent call last):
        siamloc.errors.ConfigError: unknown scale 'long': valid: smoke, short, full
    """
    chosen = recipe(id) if isinstance(id, str) else id
    _check(data, scale)
    measured = Path(out) / "measured"
    with storage_errors(measured):
        measured.mkdir(parents=True, exist_ok=True)  # refused here, and not after the first job
    jobs, opened = chosen.jobs(scale), _Opened(data, None if root is None else Path(root), Path(out) / "training")
    records: list[Record] = []
    beside: list[Record] = []
    seconds, machines = dict.fromkeys(chosen.experiments, 0.0), []
    for job in track(jobs, len(jobs), f"measuring {chosen.id}") if progress else jobs:
        done = _done(job, opened, Path(out), data, measure)
        (beside if experiment(job.experiment).beside else records).extend(_with_size(done["records"], job))
        seconds[job.experiment] += done["seconds"]
        machines.append(done["machine"])
    return Reproduction(
        chosen, data, scale, tuple(records), tuple(beside), seconds, tuple(dict.fromkeys(filter(None, machines)))
    )


@typed
def listing(data: str = "freiburg_sim", scale: str = "short") -> str:
    """Return what can be reproduced: for each id what it is, what it needs, and about how long it takes.

    Args:
        data: "cold", "freiburg_sim" or "mini".
        scale: "smoke", "short" or "full".

    Raises:
        ConfigError: an unknown data set or scale.
    """
    _check(data, scale)
    lines: list[str] = []
    for one in recipes():
        lines += [f"{one.id:<14} {one.title}", f"{'':<14} {_needs(one, data, scale)}"]
    about = data_named(data)
    covered = [f"{id:<14} is measured by {one.id}" for one in recipes() for id in one.covers]
    nothing = [f"{id:<14} {reason}" for id, reason in without_measurement().items()]
    return "\n".join(
        [
            f"What there is, what it needs, and about how long it takes alone at scale={scale} on two processor cores:",
            *("", *lines, ""),
            *("Panels of these, or the same numbers drawn otherwise:", "", *covered, ""),
            *("Nothing to measure:", "", *nothing, ""),
            *textwrap.wrap(f"data={data} is {about['title']}: {about['how']}", 118, break_on_hyphens=False),
        ]
    )


def _needs(one: Recipe, data: str, scale: str) -> str:
    jobs = one.jobs(scale)
    runs = sorted({run for job in jobs for role in job.roles.values() for run in role["runs"]})
    trained = sum(job.kind in ("trained", "named_rooms") for job in jobs)
    parts = [
        f"[{one.source.document}] {_place(one.source) or 'section ' + one.source.section}",
        f"drives {' '.join(runs)}",
    ]
    if any(job.dense for job in jobs) and data_named(data).get("dense"):
        parts.append("frames every 5 cm")
    if any(job.kind == "buildings" for job in jobs):
        parts.append(f"the same drive of {data_named(data)['other']['folder']}")
    if trained:
        parts.append(f"{trained} training{'s' if trained > 1 else ''}")
    if trained and scale == "full":
        return "; ".join([*parts, "hours each on a graphics card"])
    return "; ".join([*parts, _lasting(sum(seconds_of(job, scale) for job in jobs))])


def _lasting(seconds: float) -> str:
    """Say about how long something takes."""
    if seconds < 90:
        return "seconds" if seconds < 30 else "a minute"
    return f"{seconds / 60:.0f} minutes" if seconds < 5400 else f"{seconds / 3600:.0f} hours"


def _place(source: Source) -> str:
    """Say which table or figures a source is."""
    if source.table:
        return f"table {source.table}"
    several = source.figures is not None and bool(re.search("-| and ", source.figures))
    return f"figure{'s' if several else ''} {source.figures}" if source.figures else ""


def _check(data: str, scale: str) -> None:
    if scale not in SCALES:
        raise ConfigError(f"unknown scale {scale!r}: {hint(str(scale), SCALES)}")
    if data not in data_names():
        raise ConfigError(f"recipes run on no data set {data!r}; {hint(str(data), data_names())}")


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
                raise ConfigError(f"say where {about['title']} lies: root=FOLDER; {about['how']}")
            root = self.root or Path(about["root"])
            if job.dense and about.get("dense"):
                root = root.parent / "dense" / root.name
            self._held[key] = Data(self.name, root, key[1], self.work)
        return self._held[key]


def _done(job: Job, opened: _Opened, out: Path, data: str, measure: bool) -> dict[str, Any]:
    """Return the records of a job, and what they took; measured now, or read where they were measured before."""
    held = opened.of(job)
    wanted = {"version": _VERSION, "data": data, "frames": _fingerprint(job, held), **job.plain()}
    path = out / "measured" / job.experiment / f"{content_key(wanted)}.json"
    if (kept := _kept(path, wanted)) is not None:
        return kept
    if not measure:
        raise DataError(f"not all of it was measured before on these data and kept in {out}")
    from siamloc.reproduce.experiments import measured

    start = time.monotonic()
    records = list(measured(job, held))
    took = {"seconds": time.monotonic() - start, "machine": machine()}
    told = [{"measure": one.measure, "value": one.value, "settings": dict(one.settings)} for one in records]
    write_json(path, {"job": wanted, **took, "records": told, "key": content_key(told)})
    return {"records": records, **took}


def machine() -> str:
    """Say which machine this is: its processors, and its graphics card where PyTorch works on one."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    said = f"{os.cpu_count()} cores of {names[0] if names else platform.processor() or platform.machine()}"
    torch = sys.modules.get("torch")
    if torch is not None and torch.cuda.is_available():
        said += f" with {torch.cuda.get_device_name()}"
    return said


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
        # The first records name their processor by its family, which says little.
        known = str(kept.get("machine", ""))
        return {
            "records": [_of_plain(one) for one in told],
            "seconds": seconds,
            "machine": known if " " in known else "",
        }
    except (FormatError, ConfigError, KeyError):
        return None


def _fingerprint(job: Job, data: Data) -> str:
    """Return what changes with the frames that a job takes: their names, poses and rooms, wherever they lie."""
    told = []
    held = [data, data.other] if job.kind == "buildings" else [data]
    for name, role, one in ((*item, one) for one in held for item in sorted(job.roles.items())):
        frames = one.role(role)
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


def _beside(one: Record, ours: Sequence[Record], chosen: Recipe) -> Record | None:
    """Return our number beside a published one; beside a bound the smallest or largest of ours."""
    join = None if chosen.join is None else [name for name in chosen.join if name != "bound"]
    found = [our for our in ours if _same(one, our, join)]
    if not found or "bound" not in one.settings:
        return found[0] if found else None
    return (min if one.settings["bound"] == "lowest" else max)(found, key=lambda our: our.value)


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


def _apart_by(figure: Mapping[str, Any], found: Sequence[Record]) -> list[str]:
    """Return the settings that tell the numbers of a figure apart: all of a few, else the first."""

    def differ(*names: str) -> list[str]:
        return [name for name in dict.fromkeys(names) if len({one.settings.get(name) for one in found}) > 1]

    drawn = [name for key in ("panels", "series") for name in names_of(figure, key)]
    names = differ(*drawn) or differ("descriptor", "method", "version", "distance")
    if len(grouped(names, found)) > _FEW:
        names = differ("descriptor", "method", "version", "distance", *names)[:1]
    return names or ["descriptor"]


def _with_size(records: Sequence[Record], job: Job) -> list[Record]:
    """Return records of disturbed images with the size of the descriptor, over which [T] 3.5.2 draws them."""
    if job.kind != "disturbed" or job.options["descriptor"]["name"] == "pretrained":
        return list(records)
    from siamloc.reproduce.experiments import information

    size = information(job)
    return [Record(one.measure, one.value, MappingProxyType({**one.settings, "information": size})) for one in records]


def _row(row: Row, heads: Sequence[str]) -> list[str]:
    difference = "" if row.difference is None else f"{row.difference:+.3g}"
    told = [_shown(row.settings.get(name)) for name in heads]
    return [*told, _measure(row.measure), _printed(row.published), _number(row.ours), difference]


def _with(one: Record | None, names: Sequence[str]) -> str:
    settings = {} if one is None else one.settings
    return ", ".join(f"{name} {_shown(settings[name])}" for name in names if name in settings and name not in _HIDDEN)


def _measure(name: str) -> str:
    """Say what is measured, with its unit."""
    return f"{said(name)} [{unit(name)}]" if unit(name) not in ("", "share") else said(name)


def _settings(one: Record | None, *but: str) -> str:
    """Return what a number was measured with, but for some settings."""
    return "" if one is None else _with(one, [name for name in one.settings if name not in but])


def _unlike(rows: Sequence[Row]) -> list[str]:
    """Return the settings in which a published number and ours beside it differ."""
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
