"""The report: one HTML page with everything inside it, made from the result files of one run or several."""

from __future__ import annotations

import datetime
import json
from collections.abc import Sequence
from pathlib import Path
from string import Template

from siamloc import __version__
from siamloc.errors import DataError
from siamloc.files import write_text
from siamloc.report import estimate_sections, room_sections, sections, tables
from siamloc.report.curves import compared_curves
from siamloc.report.gathered import FURTHER, Evaluation, RunFiles, gather
from siamloc.report.hierarchical_section import hierarchical
from siamloc.report.illustrated import Part, large_pictures, notes_on, parts_of, reserve, sheets_of
from siamloc.report.markup import Markup, join, plural, script_data, tag
from siamloc.report.parts import section
from siamloc.report.pictures import Sheets
from siamloc.report.robustness_section import compared_robustness, robustness

MAX_BYTES = 4_900_000
_LARGE_SHARE = 0.27
_ASSETS = Path(__file__).parent / "assets"


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
    parts = parts_of(runs)
    large = large_pictures(parts, int(max_bytes * _LARGE_SHARE))
    bare = _page(runs, parts, large, [])
    room = max_bytes - len(bare.encode()) - reserve(parts)
    page = _page(runs, parts, large, sheets_of(parts, room) if room > 0 else [])
    size = len(page.encode())
    if size > max_bytes:
        raise DataError(
            f"a page of {plural(len(parts), 'evaluation')} would have {size:,} bytes, more than {max_bytes:,}: "
            "report on fewer runs at once"
        )
    out = Path(out)
    write_text(out, page)
    return out


def _page(runs: list[RunFiles], parts: list[Part], large: dict[tuple[int, str], str], sheets: list[Sheets]) -> Markup:
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


def _head(title: str, parts: list[Part]) -> Markup:
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


def _comparison(parts: list[Part]) -> Markup | None:
    """Return the tables and curves of what several evaluations measured; None where none of it is measured twice."""
    measured = [part for part in parts if part.evaluation.measured]
    disturbed = compared_robustness(
        {part.method: part.evaluation for part in parts if part.evaluation.kind == "robustness"}
    )
    own = _compared(measured) if len(measured) > 1 else None
    return tag("article.overview", own, disturbed) if own or disturbed else None


def _compared(parts: list[Part]) -> Markup:
    """Return the table of all evaluations, and a warning where they did not answer the same queries."""
    notes = []
    asked = {_identity(part.evaluation) for part in parts}
    protocols = {str(part.evaluation.results.get("protocol")) for part in parts}
    if len(protocols) > 1:
        notes.append("These evaluations follow different protocols: their errors must not be compared with each other.")
    elif len(asked) > 1:
        notes.append("These evaluations differ in their queries or in their map: compare them with care.")
    rows = {part.title: (part.evaluation, part.anchor) for part in parts}
    return section(
        "Comparison",
        tables.comparison(rows),
        *(tag("p.note", note) for note in notes),
        compared_curves({part.title: part.evaluation for part in parts}),
        name="compared",
    )


def _identity(evaluation: Evaluation) -> tuple[object, ...]:
    if evaluation.queries is None or evaluation.known is None:
        return (json.dumps(evaluation.results["denominators"], sort_keys=True),)
    return (tuple(evaluation.queries["path"].tolist()), tuple(evaluation.known["path"].tolist()))


def _evaluation(part: Part, large: dict[tuple[int, str], str], sheets: list[Sheets], one: bool) -> Markup:
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
    notes = notes_on(part, uris, sheets)
    sections_ = {
        "summary": sections.summary(evaluation),
        "nodes": hierarchical(evaluation),
        "floor plan": sections.floor_plan(evaluation, part.plan, part.number, notes),
        "cumulative errors": sections.cumulative(evaluation),
        **{sign: estimate_sections.further_estimate(evaluation, name) for name, sign in FURTHER.items()},
        "expected errors": estimate_sections.expected_errors(evaluation),
        "worst queries": sections.worst(part.plan, uris),
        "rooms": room_sections.confusion(evaluation, part.number),
        "pairs": room_sections.pairs(evaluation),
        "robustness": robustness(evaluation),
        "further measures": sections.further(evaluation),
    }
    found = {name: made for name, made in sections_.items() if made is not None}
    places = {name: f"{part.anchor}-{name.replace(' ', '-')}" for name in found}
    links = [tag("a", name, href=f"#{place}") for name, place in places.items()]
    return tag(
        "article",
        head,
        tag("nav.contents", *links, aria_label=f"contents, {part.title}") if len(links) > 1 else None,
        sections.unscored(evaluation),
        *(tag("div", made, id=places[name]) for name, made in found.items()),
        id=part.anchor,
        data_evaluation=part.number,
    )


def _date(evaluation: Evaluation) -> str:
    """Return when an evaluation was made, in UTC, as people write it."""
    try:
        made = datetime.datetime.fromisoformat(str(evaluation.results.get("created")))
    except ValueError:
        return ""
    return f"{made:%d %B %Y, %H:%M}" + (" UTC" if made.utcoffset() == datetime.timedelta(0) else "")
