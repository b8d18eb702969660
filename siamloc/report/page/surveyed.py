"""The survey of a run, for a report page: what was said of it, and its plan."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path

from foundation.files import read_json
from foundation.settings import misfit
from siamloc.errors import FormatError
from siamloc.report.page.markup import Markup, plural, section, tag

_KEYS = {"notes": list[str], "summary": str | None, "torn": int | None, "walk": list[str] | None}


@dataclass(frozen=True, eq=False)
class Surveyed:
    """The survey of the frames of a run.

    Attributes:
        lines: the decisions of the walk, or else the notes and the summary of the survey.
        torn: number of places where it is torn.
        plan: picture of the surveyed path, PNG.
    """

    lines: list[str]
    torn: int
    plan: bytes

    @property
    def doubt(self) -> Markup | None:
        """What follows the figures of a torn survey; None if it is whole."""
        places = plural(self.torn, "place")
        return tag("p.note", f"Do not rely on these figures: the survey is torn in {places}.") if self.torn else None

    def section(self) -> Markup:
        """Return the section with the plan and the lines."""
        source = "data:image/png;base64," + base64.b64encode(self.plan).decode()
        plan = tag("figure.picture", tag("img", src=source, alt="plan of the survey: path and loops"))
        lines = [
            tag("p.note" if line.startswith("note: ") else "p.caption", line.removeprefix("note: "))
            for line in "\n".join(self.lines).splitlines()
        ]
        return section("Survey", plan, *lines, name="survey")


def read_survey(folder: Path) -> Surveyed | None:
    """Read the survey in the folder of a run; None if there is none.

    Raises:
        FormatError: survey.json was altered.
    """
    about, plan = folder / "survey.json", folder / "survey.png"
    if not (about.is_file() and plan.is_file()):
        return None
    found = read_json(about, "survey again")
    if not isinstance(found, dict) or (wrong := misfit(found, _KEYS)):
        raise FormatError(f"{about} was altered{f' in {wrong}' if isinstance(found, dict) else ''}: survey again")
    lines = [*(f"note: {note}" for note in found["notes"]), *filter(None, [found.get("summary")])]
    return Surveyed(found.get("walk") or lines, found.get("torn") or 0, plan.read_bytes())
