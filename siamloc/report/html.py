"""The report: one HTML page with everything inside it, made from the result files of one run or several."""

from __future__ import annotations

import datetime
import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from string import Template

from siamloc import __version__
from siamloc.errors import DataError
from siamloc.files import write_text
from siamloc.report import sections, tables
from siamloc.report.curves import compared_curves
from siamloc.report.gathered import Evaluation, RunFiles, gather
from siamloc.report.markup import Markup, count, join, plural, script_data, tag
from siamloc.report.pictures import Decoder, Sheets, make_large, make_sheets
from siamloc.report.plan_data import Plan, make_plan

MAX_BYTES = 4_900_000
_MOST_QUERIES = 12_000  # on all plans of a page together; their numbers are 1.3 MB
_LARGE_SHARE = 0.27
_ASSETS = Path(__file__).parent / "assets"


@dataclass(eq=False)
class _Part:
    """An evaluation on its way into the page."""

    run: RunFiles
    evaluation: Evaluation
    number: int
    plan: Plan | None
    decoder: Decoder
    sheets: int = -1

    @property
    def anchor(self) -> str:
        return f"part-{self.number}"

    @property
    def title(self) -> str:
        """The run, and the descriptor where the run's name does not say it."""
        name = self.evaluation.name
        alone = len(self.run.evaluations) == 1
        return self.run.title if alone and self.run.title == name else f"{self.run.title} · {name}"


def write_report(folders: Sequence[str | Path], out: str | Path, max_bytes: int = MAX_BYTES) -> Path:
    """Write the page and return its path.

    The numbers come from the result files alone; the pictures are read from the files that they name. Pictures become
    smaller, then fewer, until the page keeps to its size, and the page says so.

    Args:
        folders: of runs, or of single evaluations. Several are compared first and shown one after another.
        out: the file to write.
        max_bytes: the largest size of the file.

    Raises:
        ConfigError: a folder that is missing or holds no evaluation.
        FormatError: result files that are not whole.
        DataError: so many runs that even without pictures the page would be too large.
        StorageError: the disk refuses.
    """
    runs = gather(folders)
    parts = _parts(runs)
    large = _large_pictures(parts, int(max_bytes * _LARGE_SHARE))
    bare = _page(runs, parts, large, [])
    room = max_bytes - len(bare.encode()) - _reserve(parts)
    page = _page(runs, parts, large, _sheets(parts, room) if room > 0 else [])
    size = len(page.encode())
    if size > max_bytes:
        raise DataError(
            f"a page of {plural(len(parts), 'evaluation')} would have {size:,} bytes, more than {max_bytes:,}: "
            "report on fewer runs at once"
        )
    out = Path(out)
    write_text(out, page)
    return out


def _parts(runs: list[RunFiles]) -> list[_Part]:
    evaluations = [(run, evaluation) for run in runs for evaluation in run.evaluations]
    most = max(500, _MOST_QUERIES // len(evaluations))
    decoders: dict[str, Decoder] = {}
    parts = []
    for number, (run, evaluation) in enumerate(evaluations):
        decoder = Decoder(evaluation.results["config"])
        decoder = decoders.setdefault(json.dumps(decoder.parameters, sort_keys=True), decoder)
        parts.append(_Part(run, evaluation, number, make_plan(evaluation, most), decoder))
    return parts


def _large_pictures(parts: list[_Part], budget: int) -> dict[tuple[int, str], str]:
    wanted = [
        (part.decoder, path)
        for part in parts
        if part.plan is not None
        for row in part.plan.worst.tolist()
        for path in part.plan.triple(row)
    ]
    return make_large(wanted, budget)


def _reserve(parts: list[_Part]) -> int:
    """Return bytes for what is written when the pictures are known: their numbers, and notes on them."""
    frames = sum(len(part.plan.rows) + len(part.plan.known["x"]) for part in parts if part.plan is not None)
    return 5 * frames + 2000 * len(parts)


def _sheets(parts: list[_Part], budget: int) -> list[Sheets]:
    """Return a set of sheets per decoder; frames that several evaluations show are in it once."""
    sets: dict[int, list[_Part]] = {}
    for part in parts:
        if part.plan is not None:
            sets.setdefault(id(part.decoder), []).append(part)
    orders = []
    for members in sets.values():
        # By turns, so that no evaluation goes without pictures where there is not room for all.
        turns = zip_longest(*(part.plan.picture_order() for part in members if part.plan is not None))
        orders.append(list(dict.fromkeys(path for turn in turns for path in turn if path is not None)))
    total = sum(map(len, orders))
    sheets = []
    for number, (members, order) in enumerate(zip(sets.values(), orders, strict=True)):
        for part in members:
            part.sheets = number
        sheets.append(make_sheets(members[0].decoder, order, budget * len(order) // total))
    return sheets


def _page(runs: list[RunFiles], parts: list[_Part], large: dict[tuple[int, str], str], sheets: list[Sheets]) -> Markup:
    one = len(parts) == 1
    title = runs[0].title if len(runs) == 1 else ", ".join(run.title for run in runs)
    body = [_head(title, parts), _comparison(parts) if not one else None]
    for run in runs:
        own = [part for part in parts if part.run is run]
        body += [_evaluation(part, large, sheets, one) for part in own]
        body.append(tag("article.run", sections.training(run), sections.configuration(run)))
    data = [script_data("sheets", [sheet.plain() for sheet in sheets])]
    for part in parts:
        if part.plan is not None:
            place = sheets[part.sheets].place if part.sheets >= 0 and sheets else {}
            data.append(script_data(f"data-{part.number}", part.plan.plain(place, part.sheets)))
    texts = {name: (_ASSETS / f"report.{name}").read_text(encoding="utf-8") for name in ("css", "js", "html")}
    return Markup(
        Template(texts["html"]).substitute(
            title=tag("title", f"{title} · siamloc report"),
            style=texts["css"],
            script=texts["js"],
            body=join(*body),
            data=join(*data),
            version=__version__,
        )
    )


def _head(title: str, parts: list[_Part]) -> Markup:
    dates = sorted(filter(None, (_date(part.evaluation) for part in parts)))
    when = f"measured {dates[0]}" + (f" to {dates[-1]}" if dates[-1] != dates[0] else "") if dates else None
    facts = [when]
    if len(parts) == 1:
        results = parts[0].evaluation.results
        facts.append(f"descriptor {parts[0].evaluation.name}")
        if results.get("protocol"):
            facts.append(f"protocol {results['protocol'].replace('_', ' ')}")
        figures = sections.key_figures(parts[0].evaluation)
    else:
        facts.append(plural(len(parts), "evaluation"))
        figures = None
    links = [tag("a", part.title, href=f"#{part.anchor}") for part in parts] if len(parts) > 1 else []
    return tag(
        "header",
        tag("p.kicker", "siamloc report"),
        tag("h1", title),
        tag("p.meta", " · ".join(filter(None, facts))),
        figures,
        tag("nav", *links, aria_label="parts of this page") if links else None,
    )


def _comparison(parts: list[_Part]) -> Markup:
    """Return the table of all evaluations, and a warning where they did not answer the same queries."""
    notes = []
    asked = {_identity(part.evaluation) for part in parts}
    protocols = {str(part.evaluation.results.get("protocol")) for part in parts}
    if len(protocols) > 1:
        notes.append("These evaluations follow different protocols: their errors must not be compared with each other.")
    elif len(asked) > 1:
        notes.append("These evaluations differ in their queries or in their map: compare them with care.")
    rows = {part.title: (part.evaluation, part.anchor) for part in parts}
    return tag(
        "article.overview",
        sections.section(
            "Comparison",
            tables.comparison(rows),
            *(tag("p.note", note) for note in notes),
            compared_curves({part.title: part.evaluation for part in parts}),
            name="compared",
        ),
    )


def _identity(evaluation: Evaluation) -> tuple[object, ...]:
    if evaluation.queries is None or evaluation.known is None:
        return (json.dumps(evaluation.results["denominators"], sort_keys=True),)
    return (tuple(evaluation.queries["path"].tolist()), tuple(evaluation.known["path"].tolist()))


def _evaluation(part: _Part, large: dict[tuple[int, str], str], sheets: list[Sheets], one: bool) -> Markup:
    evaluation = part.evaluation
    uris = {path: uri for (decoder, path), uri in large.items() if decoder == id(part.decoder)}
    head = None
    if not one:
        facts = [
            _date(evaluation),
            f"protocol {evaluation.results['protocol']}" if "protocol" in evaluation.results else "",
        ]
        head = join(
            tag("h2", part.title),
            tag("p.meta", " · ".join(filter(None, facts)).replace("_", " ")),
            sections.key_figures(evaluation),
        )
    return tag(
        "article",
        head,
        sections.summary(evaluation),
        sections.floor_plan(evaluation, part.plan, part.number, _notes(part, uris, sheets)),
        sections.cumulative(evaluation),
        sections.worst(part.plan, uris),
        sections.confusion(evaluation),
        sections.further(evaluation),
        id=part.anchor,
        data_evaluation=part.number,
    )


def _notes(part: _Part, uris: dict[str, str], sheets: list[Sheets]) -> list[str]:
    """Say what the plan does not show."""
    plan = part.plan
    if plan is None:
        return []
    notes = []
    if len(plan.rows) < plan.total:
        notes.append(
            f"The plan shows {count(len(plan.rows))} of {count(plan.total)} queries, the worst among them, to keep "
            "this page small. The tables and curves rest on all."
        )
    bare = [path for row in plan.worst.tolist() for path in plan.triple(row) if path not in uris]
    if not set(bare) <= set(part.decoder.missing):
        notes.append("Some of the worst queries are shown without pictures to keep this page small.")
    if not sheets:
        return notes
    place = sheets[part.sheets].place
    order = plan.picture_order()
    missing = [path for path in order if path in part.decoder.missing]
    if missing:
        notes.append(
            f"{plural(len(missing), 'picture')} of {count(len(order))} could not be read, the first is {missing[0]} "
            f"({part.decoder.missing[missing[0]]})."
        )
    without = sum(path not in place for path in plan.queries["path"].tolist())
    if without:
        notes.append(
            f"Pictures are thinned out to keep this page small: {count(len(plan.rows) - without)} of "
            f"{count(len(plan.rows))} queries have one, the worst among them."
        )
    return notes


def _date(evaluation: Evaluation) -> str:
    """Return when an evaluation was made, in UTC, as people write it."""
    try:
        made = datetime.datetime.fromisoformat(str(evaluation.results.get("created")))
    except ValueError:
        return ""
    return f"{made:%d %B %Y, %H:%M}" + (" UTC" if made.utcoffset() == datetime.timedelta(0) else "")
