"""The report: one self-contained HTML page, made from the result files of one run or several."""

from __future__ import annotations

import base64
import datetime
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from foundation.calls import typed
from foundation.files import real_path, write_text
from foundation.settings import shortened
from siamloc import __version__
from siamloc.data.occupancy import read_occupancy
from siamloc.errors import ConfigError
from siamloc.report.page import sections, tasks
from siamloc.report.page.compared import comparison
from siamloc.report.page.gathered import Evaluation, gather
from siamloc.report.page.markup import Markup, fragment, join, plural, script_data, tag
from siamloc.report.page.parts import Part, parts_of, read_pictures
from siamloc.results import FURTHER

_MOST_RUNS = 4  # named in the title; of more, the folders that were given
_SECTIONS: dict[str, tuple[str | None, Callable[[Part], Markup | None]]] = {
    "summary": (None, sections.summary),
    "nodes": ("hierarchical", tasks.hierarchical),
    "compact map": ("mapping", tasks.mapping),
    "compact maps": ("compact", tasks.compact),
    "buildings": ("buildings", tasks.buildings),
    "floor plan": (None, sections.floor_plan),
    "cumulative errors": (None, sections.cumulative),
    **{sign: (f"absolute_{name}", partial(tasks.further_estimate, name=name)) for name, sign in FURTHER.items()},
    "expected errors": ("calibration", tasks.expected_errors),
    "worst queries": (None, sections.worst),
    "rooms": ("room_retrieval", tasks.confusion),
    "pairs": ("room_pairs", tasks.pairs),
    "robustness": ("robustness", tasks.robustness),
}
"""The sections of an evaluation in their order, each with the measure that it needs, if any, and its function."""


@typed
def write_report(folders: str | Path | Sequence[str | Path], out: str | Path, plan: str | Path | None = None) -> Path:
    """Write one self-contained HTML page about runs, and return its path.

    The numbers come from the result files only; the images are read from the files named there. If there are many
    images, some are left out, which the page notes.

    Args:
        folders: folders of one run, of several runs, or of single evaluations. Several are compared first, then shown
            one after another.
        out: the file to write.
        plan: map.yaml of a map server, which is drawn behind floor plans; see `siamloc.data.read_occupancy`.

    Raises:
        ConfigError: a folder that is missing or holds no evaluation, or a file whose name does not end in .html.
        DataError: a map that cannot be read, or shows another part of the world.
        FormatError: incomplete result files.
        StorageError: the disk is full or cannot be written to.
    """
    if Path(out).suffix.lower() not in (".html", ".htm"):
        raise ConfigError(f"the report is a web page: give it a name ending in .html, not {out}")
    named = [folders] if isinstance(folders, str | Path) else folders
    runs = gather(named)
    occupancy = None if plan is None else read_occupancy(plan)
    parts = parts_of(runs, occupancy)
    decoders = read_pictures(parts)
    titles = [run.title for run in runs] if len(runs) <= _MOST_RUNS else [real_path(one).name for one in named]
    title = shortened(", ".join(titles))
    body = [_head(title, parts), comparison(parts)]
    for number, run in enumerate(runs):
        if run.survey is not None:
            body.append(tag("article.run", tag("h2", run.title) if len(runs) > 1 else None, run.survey.section()))
        body += [_evaluation(part, len(parts) == 1) for part in parts if part.run is run]
        body.append(tag("article.run", sections.training(run, number), sections.configuration(run)))
    data = [script_data("sheets", [decoder.plain() for decoder in decoders])]
    data += [
        script_data(f"data-{part.number}", part.plan.plain(part.decoder.place, decoders.index(part.decoder)))
        for part in parts
        if part.plan is not None
    ]
    if occupancy is not None:
        data.append(script_data("occupancy", {"png": base64.b64encode(occupancy.png()).decode(), **occupancy.placed()}))
    page = fragment(
        "report.html",
        title=tag("title", f"{title} · siamloc report"),
        style=fragment("report.css"),
        script=fragment("report.js"),
        body=join(*body),
        data=join(*data),
        version=__version__,
    )
    write_text(out, page)
    return Path(out)


def _head(title: str, parts: list[Part]) -> Markup:
    by_time = sorted((part.evaluation for part in parts), key=lambda one: str(one.results.get("created")))
    dates = list(dict.fromkeys(filter(None, map(_date, by_time))))
    facts = [f"measured {' to '.join([*dates[:1], *dates[1:][-1:]])}"] if dates else []
    if len(parts) == 1:
        results = parts[0].evaluation.results
        facts.append(f"descriptor {parts[0].evaluation.name}")
        if results.get("protocol"):
            facts.append(f"protocol {results['protocol'].replace('_', ' ')}")
        figures = _figures(parts[0])
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


def _evaluation(part: Part, alone: bool) -> Markup:
    """Return an evaluation with its sections, and its own heading unless it is alone on the page."""
    evaluation, head = part.evaluation, None
    if not alone:
        protocol = f"protocol {evaluation.results['protocol']}" if "protocol" in evaluation.results else ""
        facts = " · ".join(filter(None, [_date(evaluation), protocol])).replace("_", " ")
        head = join(tag("h2", part.title), tag("p.meta", facts), _figures(part))
    measures = {None, *evaluation.results["measures"]}
    drawn = {name: draw(part) for name, (measure, draw) in _SECTIONS.items() if measure in measures}
    made = {name: shown for name, shown in drawn.items() if shown is not None}
    places = {name: f"{part.anchor}-{name.replace(' ', '-')}" for name in made}
    links = [tag("a", name, href=f"#{place}") for name, place in places.items()]
    return tag(
        "article",
        head,
        tag("nav.contents", *links, aria_label=f"contents, {part.title}") if len(links) > 1 else None,
        sections.unscored(evaluation),
        *(tag("div", shown, id=places[name]) for name, shown in made.items()),
        id=part.anchor,
        data_evaluation=part.number,
    )


def _figures(part: Part) -> Markup:
    """Return the headline numbers of an evaluation, and what has to follow them."""
    survey = part.run.survey
    return join(sections.key_figures(part.evaluation), None if survey is None else survey.doubt)


def _date(evaluation: Evaluation) -> str:
    """Return the date of an evaluation, in UTC, in readable form."""
    try:
        made = datetime.datetime.fromisoformat(str(evaluation.results.get("created")))
    except ValueError:
        return ""
    return f"{made:%d %B %Y, %H:%M}" + (" UTC" if made.utcoffset() == datetime.timedelta(0) else "")
