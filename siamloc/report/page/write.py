"""The report: one self-contained HTML page, made from the result files of one run or several."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from pathlib import Path

from foundation.calls import typed
from foundation.files import write_text
from siamloc import __version__
from siamloc.errors import ConfigError
from siamloc.report.page import sections, tasks
from siamloc.report.page.compared import comparison
from siamloc.report.page.gathered import Evaluation, RunFiles, gather
from siamloc.report.page.markup import Markup, fragment, join, plural, script_data, tag
from siamloc.report.page.parts import Part, large_pictures, notes_on, parts_of, sheets_of
from siamloc.report.page.pictures import Sheets
from siamloc.results import FURTHER


@typed
def write_report(folders: str | Path | Sequence[str | Path], out: str | Path) -> Path:
    """Write one self-contained HTML page about runs, and return its path.

    The numbers come from the result files only; the images are read from the files named there. If there are many,
    some are left out, which the page notes.

    Args:
        folders: folders of one run, of several runs, or of single evaluations. Several are compared first, then shown
            one after another.
        out: the file to write.

    Raises:
        ConfigError: a folder that is missing or holds no evaluation, or a file whose name does not end in .html.
        FormatError: incomplete result files.
        StorageError: the disk is full or cannot be written to.
    """
    if Path(out).suffix.lower() not in (".html", ".htm"):
        raise ConfigError(f"the report is a web page: give it a name ending in .html, not {out}")
    runs = gather([folders] if isinstance(folders, str | Path) else folders)
    parts = parts_of(runs)
    trained = [sections.training(run, number) for number, run in enumerate(runs)]
    page = _page(runs, parts, comparison(parts), trained, large_pictures(parts), sheets_of(parts))
    out = Path(out)
    write_text(out, page)
    return out


def _page(
    runs: list[RunFiles],
    parts: list[Part],
    overview: Markup | None,
    trained: list[Markup | None],
    large: dict[tuple[int, str], str],
    sheets: list[Sheets],
) -> Markup:
    one = len(parts) == 1
    title = runs[0].title if len(runs) == 1 else ", ".join(run.title for run in runs)
    body = [_head(title, parts), overview]
    for run, training in zip(runs, trained, strict=True):
        body += [_evaluation(part, large, sheets, one) for part in parts if part.run is run]
        body.append(tag("article.run", training, sections.configuration(run)))
    data = [script_data("sheets", [sheet.plain() for sheet in sheets])]
    for part in parts:
        if part.plan is not None:
            place = sheets[part.sheets].place if part.sheets >= 0 and sheets else {}
            data.append(script_data(f"data-{part.number}", part.plan.plain(place, part.sheets)))
    return fragment(
        "report.html",
        title=tag("title", f"{title} · siamloc report"),
        style=fragment("report.css"),
        script=fragment("report.js"),
        body=join(*body),
        data=join(*data),
        version=__version__,
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
        "nodes": tasks.hierarchical(part),
        "compact map": tasks.mapping(part),
        "compact maps": tasks.compact(part),
        "buildings": tasks.buildings(part),
        "floor plan": sections.floor_plan(evaluation, part.plan, part.number, notes),
        "cumulative errors": sections.cumulative(part),
        **{sign: tasks.further_estimate(part, name) for name, sign in FURTHER.items()},
        "expected errors": tasks.expected_errors(part),
        "worst queries": sections.worst(part.plan, uris),
        "rooms": tasks.confusion(part),
        "pairs": tasks.pairs(part),
        "robustness": tasks.robustness(part),
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
    """Return the date of an evaluation, in UTC, in readable form."""
    try:
        made = datetime.datetime.fromisoformat(str(evaluation.results.get("created")))
    except ValueError:
        return ""
    return f"{made:%d %B %Y, %H:%M}" + (" UTC" if made.utcoffset() == datetime.timedelta(0) else "")
