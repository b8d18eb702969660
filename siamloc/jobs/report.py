"""`siamloc report` and `siamloc compare`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from foundation.settings import Rule, Text
from foundation.words import as_words
from siamloc.comparison import files_named
from siamloc.errors import ConfigError, DataError, SiamlocError
from siamloc.jobs.job import Job, Say, quiet
from siamloc.jobs.sweep import sweep_suffix
from siamloc.runs import Run, newest_run

Several = Annotated[tuple[Text, ...], Rule("a list of one name or more", lambda value: len(value) > 0)]


@dataclass(frozen=True)
class Report(Job):
    """Write one HTML page with a run's results.

    Writes a page that opens from disk, without a network connection: tables, a floor plan with every error and the
    images behind it, error curves, the worst queries, confusion matrix, training curves, configuration.

        run=FOLDER       the run; the newest one if not given. For a folder of runs or evaluations, all side by side
        runs=[a,b,c]     several runs side by side; also sweeps and single evaluations
        out=FILE         output file; report.html in the run's folder if not given
        plan=map.yaml    the building, from a map server, to draw behind floor plans

    Example:
        $ siamloc report runs=[runs/vgg16,runs/hog] out=comparison.html
    """

    folder: Text | None = None
    runs: Several | Text | None = None
    out: Text | None = None
    plan: Path | None = None

    def run(self, say: Say = quiet) -> Path:
        """Write the page, and return its path."""
        from siamloc.report import write_report

        several = [self.runs] if isinstance(self.runs, str) else list(self.runs or [])
        if several and self.folder is not None:
            raise ConfigError(f"give run={self.folder} or runs=[...], not both")
        folders = list(map(Path, several)) or [Path(self.folder or newest_run(trained=False).folder)]
        default = folders[0] / "report.html" if len(folders) == 1 else Path("report.html")
        out = Path(self.out or default)
        if self.out is not None and sweep_suffix():
            out = out.with_stem(f"{out.stem}-{sweep_suffix()}")
        path = write_report(folders, out, self.plan)
        say(f"report: {path}, {path.stat().st_size / 1e6:.1f} MB; open it in a browser")
        return path


@dataclass(frozen=True)
class Compare(Job):
    """Tabulate and plot a sweep, best first.

    Prints a row for each run of a sweep: the settings in which the runs differ, the best validation figure and its
    epoch, and the number of finished epochs. For evaluations: the swept settings, the mean error, overall and by
    lighting, the hit rate, recall@1 and the share of rooms found. Names the best one, and runs that are
    unfinished, ended early, or not measured. Writes the table as CSV, and a plot of the figure against the first swept
    numeric setting, with a line for each combination of the others.

        runs=FOLDER      the folder of a sweep, or any folder with runs or evaluations in it
        runs=[a,b,c]     several of them
        by=val/error     the figure to rank trainings by; the one that picks checkpoints if not given
        by=recall@1      or evaluations: error, error.night, hit_rate, room, recall@5_0.5 within 0.5 m, cost.bytes,
                         or any number in results.json by its path, such as absolute.overall.error.median
        out=FILE.csv     output file, with FILE.png; trainings.csv or evaluations.csv in the folder if not given

    Example:
        $ siamloc compare runs=runs/sweep by=error out=sweep.csv
    """

    MORE: ClassVar[Mapping[str, Any]] = {"runs": "???"}

    runs: Several | Text
    by: Text | None = None
    out: Text | None = None

    def run(self, say: Say = quiet) -> Any:
        """Print the table, write it with its picture, and return the comparison."""
        from siamloc import evaluation, training

        folders = self.runs if isinstance(self.runs, str) else list(self.runs)
        measured = evaluates(folders, self.by)
        found = (evaluation if measured else training).compare(folders, by=self.by)
        say(found.table())
        say(found.verdict())
        if not measured and files_named(folders, "results.json"):
            with suppress(SiamlocError):  # which measured nothing that all evaluations have
                words = as_words({"runs": folders, "by": evaluation.compare(folders).by})
                say(f"to compare the evaluations of these runs: siamloc compare {words}")
        name = "evaluations.csv" if measured else "trainings.csv"
        inside = Path(folders) / name if isinstance(folders, str) else None
        out = inside if self.out is None else Path(self.out)
        if out is None:
            return found
        written = [found.save(out.with_suffix(".csv") if out.suffix == ".png" else out)]
        say(f"table: {written[0]}")
        try:
            written.append(found.save_picture(out.with_suffix(".png")))
            say(f"picture: {written[1]}")
        except DataError as error:
            say(f"no picture: {error}")
        if out == inside:
            Run(out.parent).record_written(written)
        return found


def evaluates(folders: str | Sequence[str], by: str | None) -> bool:
    """Whether to compare the evaluations in folders instead of the trainings.

    Args:
        folders: folder of a sweep, or folders of runs or evaluations.
        by: name of the figure or measure to rank by. Figures of trainings have a slash in their names, such as
            "val/error". If None, several trainings are compared rather than their evaluations.

    Raises:
        ConfigError: missing folders, or folders with neither.
    """
    runs, results = (files_named(folders, name) for name in ("run.json", "results.json"))
    if not runs and not results:
        where = folders if isinstance(folders, str) else ", ".join(folders)
        raise ConfigError(f"{where} holds neither runs nor evaluations: name the folder of a sweep, such as runs/sweep")
    if not results:
        return False
    return "/" not in by if by is not None else len(runs) < 2
