"""`siamloc reproduce`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from foundation.settings import Text
from siamloc.errors import DataError
from siamloc.jobs.choices import Folder
from siamloc.jobs.job import Job, Say, quiet


@dataclass(frozen=True)
class Reproduce(Job):
    """Reproduce a published table or figure.

    Runs the experiments of a published table or figure, writes our numbers next to the published ones (ID.md,
    ID.csv, ID.png), and reports which claims of the text they support. Anything already measured on the same data
    is not measured again.

        ID                     such as table_4_2 or figure_3_11; all for everything, with a report
        --list                 list what can be reproduced, and what each item needs
        data=freiburg_sim      or mini, small and quick; or cold, with root=FOLDER
        scale=short            smoke takes seconds, short minutes; full is the published scale
        out=reproduced         output folder
        page=FOLDER            with ID all: where the report and its plots go, if not to out
        measure=false          only read earlier measurements

    Example:
        $ siamloc reproduce figure_3_11 data=mini scale=smoke
    """

    ALONE = "id"

    id: Text | None = None
    list: bool = False
    data: Literal["cold", "freiburg_sim", "mini"] = "freiburg_sim"
    root: Text | None = None
    scale: Literal["smoke", "short", "full"] = "short"
    out: Folder = "reproduced"
    page: Text | None = None
    measure: bool = True

    def run(self, say: Say = quiet) -> None:
        """Reproduce a published table or figure, or all of them."""
        from siamloc.reproduce import listing, reproduce, studies, study, write_report

        if self.list or self.id is None:
            say(listing(self.data, self.scale))
            return
        options = {key: getattr(self, key) for key in ("data", "root", "scale", "out", "measure")}
        if self.id != "all":
            chosen = study(self.id)
            if chosen.id != self.id:
                say(f"{self.id} is measured by {chosen.id}")
            result = reproduce(chosen, **options)
            say(result.table())
            for path in result.save(self.out):
                say(f"written: {path}")
            return
        results, missing = [], dict[str, str]()
        for one in studies():
            try:
                results.append(reproduce(one, **options))
            except DataError as error:  # the others can still be measured
                missing[one.id] = str(error)
                continue
            say(f"{results[-1].summary()}: {results[-1].save(self.out)[0]}")
        for reason in dict.fromkeys(missing.values()):
            say(f"left out, because {reason}: {', '.join(id for id, said in missing.items() if said == reason)}")
        if not results:
            raise DataError("nothing was measured, see above")
        say(f"report: {write_report(results, Path(self.page or self.out) / 'report.md', missing)}")
