"""Prepare the evaluations of a report page: their figures, and which of their images fit."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest

from siamloc.data.occupancy import OccupancyMap
from siamloc.report.draw.look import Picture
from siamloc.report.draw.suitable import name_of, pictures
from siamloc.report.page.gathered import Evaluation, RunFiles
from siamloc.report.page.inline import inline
from siamloc.report.page.markup import Markup, plural
from siamloc.report.page.pictures import Decoder, read_large
from siamloc.report.page.plan import Plan, make_plan
from siamloc.tables import count

_MOST_QUERIES = 12_000  # on all plans of a page together; their numbers take 1.3 MB
_MOST_SMALL = 1500  # small images on a page; they take about 3 MB


@dataclass(eq=False)
class Part:
    """An evaluation prepared for the page.

    Attributes:
        run: the run that was evaluated, with its title in the report.
        evaluation: measures and tables of the evaluation.
        alone: whether the page is about this run only.
        number: number of the part, from 0.
        plan: data of the floor plan; None if nothing was localized.
        decoder: reads and keeps the images of the plan.
        occupancy: the map of the building to draw behind plans, if there is one.
    """

    run: RunFiles
    evaluation: Evaluation
    alone: bool
    number: int
    plan: Plan | None
    decoder: Decoder
    occupancy: OccupancyMap | None = None

    def figure(self, key: str, title: str) -> Markup | None:
        """Return a figure as SVG for the page; None if there are no numbers for it.

        Args:
            key: name of the figure, listed in `siamloc.report.draw.suitable.pictures`, such as "floor_plan".
            title: beginning of the description for screen readers; the part's title follows.
        """
        draw = self._figures.get(key)
        return None if draw is None else inline(draw(), f"{key}-{self.number}", f"{title}, {self.title}")

    @cached_property
    def _figures(self) -> dict[str, Callable[[], Picture]]:
        evaluation = self.evaluation
        name = name_of(evaluation.results) if evaluation.kind == "mapping" else evaluation.name
        return pictures(evaluation.results["measures"], evaluation.tables, name, self.occupancy)

    @property
    def anchor(self) -> str:
        """The part's id in links on the page."""
        return f"part-{self.number}"

    @property
    def title(self) -> str:
        """The title of the evaluation, with the run unless it is the only run or has the same name."""
        name = self.evaluation.title
        return name if self.alone or self.run.title == self.evaluation.name else f"{self.run.title} · {name}"


def parts_of(runs: list[RunFiles], occupancy: OccupancyMap | None = None) -> list[Part]:
    """Return the parts of a page, run by run.

    Raises:
        DataError: an evaluation whose positions are not on the map of the building.
    """
    evaluations = [(run, evaluation) for run in runs for evaluation in run.evaluations]
    most = max(500, _MOST_QUERIES // len(evaluations))
    decoders: dict[str, Decoder] = {}
    parts = []
    for number, (run, evaluation) in enumerate(evaluations):
        if occupancy is not None and evaluation.positions is not None:
            occupancy.check(evaluation.positions, evaluation.unit)
        decoder = Decoder(evaluation.results["config"])
        decoder = decoders.setdefault(json.dumps(decoder.parameters, sort_keys=True), decoder)
        parts.append(
            Part(run, evaluation, len(runs) == 1, number, make_plan(evaluation, most, occupancy), decoder, occupancy)
        )
    return parts


def read_pictures(parts: list[Part]) -> list[Decoder]:
    """Read the images that the plans show, and return their decoders; a frame of several plans is read once."""
    plans = [(part.decoder, part.plan) for part in parts if part.plan is not None]
    read_large((decoder, path) for decoder, plan in plans for path in plan.worst_pictures)
    decoders = list(dict.fromkeys(decoder for decoder, _ in plans))
    orders = []
    for decoder in decoders:
        # In turn, so that every evaluation gets some images if there is no room for all.
        turns = zip_longest(*(plan.picture_order() for own, plan in plans if own is decoder))
        orders.append(list(dict.fromkeys(path for turn in turns for path in turn if path is not None)))
    total = sum(map(len, orders))
    for decoder, order in zip(decoders, orders, strict=True):
        decoder.fill_sheets(order, max(1, _MOST_SMALL * len(order) // total))
    return decoders


def notes_on(plan: Plan, decoder: Decoder) -> list[str]:
    """Return notes on what a plan does not show."""
    notes = []
    if len(plan.rows) < plan.total:
        notes.append(
            f"The plan shows {count(len(plan.rows))} of {count(plan.total)} queries, the worst among them, to keep "
            "this page small. The tables and curves include all."
        )
    if not set(plan.worst_pictures) <= {*decoder.large, *decoder.missing}:
        notes.append("Some of the worst queries are shown without pictures to keep this page small.")
    order = plan.picture_order()
    missing = [path for path in order if path in decoder.missing]
    if missing:
        notes.append(
            f"{plural(len(missing), 'picture')} of {count(len(order))} could not be read, the first being {missing[0]} "
            f"({decoder.missing[missing[0]]})."
        )
    without = sum(path not in decoder.place for path in plan.queries["path"].tolist())
    if without:
        notes.append(
            f"Some pictures are left out to keep this page small: {count(len(plan.rows) - without)} of "
            f"{count(len(plan.rows))} queries have one, the worst among them."
        )
    return notes
