"""Read and combine the result files of runs for a report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foundation.files import real_path
from foundation.ordering import by_numbers
from foundation.words import as_words
from siamloc.errors import ConfigError, DataError, FormatError
from siamloc.report.page.surveyed import Surveyed, read_survey
from siamloc.results import FINEST, Columns, read_results, read_rows, truth
from siamloc.runs import Run, run_with, runs_in
from siamloc.summaries import methods_of

_KINDS = ("localization", "room retrieval", "hierarchical", "robustness", "mapping", "compact", "buildings")
_TABLES = ("queries", "map", "rooms", "frames", "nodes")


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The results of one descriptor, as read from its result folder.

    Attributes:
        name: name of the results, used for their row in the tables.
        kind: what was measured: "localization" (including rooms), "room retrieval" alone, "hierarchical",
            "robustness", or another task.
        results: content of `results.json`.
        tables: columns of the existing tables among "queries", "map", "rooms", "frames" and "nodes".
        of_survey: whether the run is of a survey.
    """

    name: str
    kind: str
    results: dict[str, Any]
    tables: dict[str, Columns]
    of_survey: bool = False

    @property
    def truth(self) -> str:
        """What the errors refer to: "surveyed" poses or "true" ones."""
        return "surveyed" if self.of_survey else truth(self.tables.get("queries", {}))

    @property
    def queries(self) -> Columns | None:
        """Columns of `queries.csv`; None if nothing was localized."""
        return self.tables.get("queries") if self.absolute is not None and "map" in self.tables else None

    @property
    def positions(self) -> NDArray[np.float64] | None:
        """Positions of the frames of the map (n, 2); None if they are in no table."""
        table = self.tables.get("map", self.tables.get("frames"))
        return None if table is None else np.column_stack([table["x"], table["y"]])

    @property
    def title(self) -> str:
        """The name, with the kind of task unless it is localization, for headings."""
        if self.kind == "localization":
            return self.name
        build, coarse = ((self.results.get(key) or {}).get("name") for key in ("layer", "coarse_descriptor"))
        if build is None or self.kind != "hierarchical":
            return f"{self.name}, {self.kind}"
        own = (self.results.get("descriptor") or {}).get("name")
        of = f" of {coarse}" if coarse not in (None, own) else ""
        by = ((self.results["config"].get("task") or {}).get("coarse") or {}).get("by")
        nodes = "rooms" if build == "rooms" else f"{build} nodes"
        return f"{self.name}, {self.kind} over {nodes}{of}{' by vote' if by == 'vote' else ''}"

    @property
    def methods(self) -> dict[str, Any]:
        """The measures by name: of the descriptor, of its further estimates and of its baselines."""
        return dict(methods_of(self.name, self.results["measures"], self.results.get("baselines", {})))

    @property
    def absolute(self) -> dict[str, Any] | None:
        """The measures of localization, in the whole map or hierarchical, if any."""
        measures = self.results["measures"]
        return measures.get("absolute") or measures.get("hierarchical")

    @property
    def finest(self) -> tuple[dict[str, Any] | None, str | None]:
        """The measures of the finest estimates, and the estimates' name; `absolute` and None if there are none."""
        measures = self.results["measures"]
        name = next((name for name in FINEST if measures.get(f"absolute_{name}")), None)
        return (self.absolute, None) if name is None else (measures[f"absolute_{name}"], name)

    @property
    def measured(self) -> bool:
        """Whether queries were localized or their rooms retrieved."""
        return self.absolute is not None or self.rooms is not None

    @property
    def rooms(self) -> dict[str, Any] | None:
        """The measures of room retrieval, if any."""
        return self.results["measures"].get("room_retrieval")

    @property
    def unit(self) -> str:
        """Unit of positions and errors."""
        return str((self.absolute or self.results["measures"].get("mapping") or {}).get("unit", "m"))


@dataclass(frozen=True, eq=False)
class RunFiles:
    """A run as shown in the report.

    Attributes:
        title: a name that is unique in the report.
        evaluations: at least one.
        curves: columns of `metrics.csv`; None if nothing was trained.
        settings: settings of the training; None if nothing was trained.
        survey: what is said of the survey of its frames; None if they were not surveyed, or their survey is gone.
    """

    title: str
    evaluations: tuple[Evaluation, ...]
    curves: dict[str, NDArray[np.float64]] | None
    settings: dict[str, Any] | None
    survey: Surveyed | None = None


def gather(folders: Sequence[str | Path]) -> list[RunFiles]:
    """Read the result files of runs.

    Args:
        folders: folders of runs, of sweeps (which stand for their runs), or of evaluations, one or several in a folder;
            duplicates count once.

    Raises:
        ConfigError: no folders, or one that is missing or holds no evaluation.
        FormatError: incomplete files.
    """
    named = [(one, folder) for folder in map(Path, folders) for one in _members(folder)]
    chosen = dict({real_path(one): (one, folder) for one, folder in named}.values())
    if not chosen:
        raise ConfigError("a report needs at least one run: name it with run=FOLDER, or several with runs=[A,B]")
    return [_gather(one, title, chosen[one]) for one, title in zip(chosen, _titles(list(chosen)), strict=True)]


def _members(folder: Path) -> list[Path]:
    """Return a run or an evaluation itself, or else the runs and the other evaluations that a folder holds."""
    runs = {run.folder for run in runs_in(folder)}
    if not runs and (run_with(real_path(folder)) or _results(folder, folder / "evaluation")):
        return [folder]
    held = runs.union(*({path.parent for path in folder.glob(each)} for each in ("*/evaluation", "*/*/evaluation")))
    alone = {path.parent for path in _results(folder, folder) if not held.intersection(path.parents)}
    return sorted(held | alone, key=by_numbers) or [folder]


def _results(folder: Path, above: Path) -> list[Path]:
    """Return `results.json` of a folder, or else those below another one: in sweeps, they are one level deeper."""
    own = folder / "results.json"
    return [own] if own.is_file() else [*above.glob("*/results.json"), *above.glob("*/*/results.json")]


def _gather(folder: Path, title: str, named: Path) -> RunFiles:
    """Read a run or an evaluation, which the folder `named` is or holds."""
    if not folder.is_dir():
        raise ConfigError(f"there is no folder {folder}: name the folder of a run")
    within = run_with(real_path(folder))
    run, top = (Run(folder), folder / "evaluation") if within is None else (within, folder)
    if not (found := _results(folder, top)):
        how = f"with `siamloc evaluate {as_words({'run': named})}`"
        if run.record.is_file() and "class" in run.settings.get("model", {}):  # which only Python can load
            how = "in Python, and save the result in run.evaluation('network')"
        raise ConfigError(f"{folder} holds no evaluation: measure it first {how}")
    folders = sorted((path.parent for path in found), key=lambda path: (path.name != "network", by_numbers(path)))
    own = read_survey(run.folder)
    evaluations = [_evaluation(one, own is not None) for one in folders]
    # The survey of a walk is in its run; one by `siamloc survey` is where the manifest of its frames is.
    manifests = [Path((one.results["config"].get("data") or {}).get("manifest") or "") for one in evaluations]
    other = (read_survey(manifest.parent) for manifest in manifests if manifest.name == "surveyed.csv")
    return RunFiles(
        title,
        tuple(sorted(evaluations, key=lambda one: (*_KINDS, one.kind).index(one.kind))),
        run.curves() if run.metrics.is_file() else None,
        run.settings if run.record.is_file() else None,
        own or next(filter(None, other), None),
    )


def _evaluation(folder: Path, of_survey: bool) -> Evaluation:
    results = read_results(folder)
    tables, measures = results.get("tables", {}), results.get("measures")
    if not isinstance(measures, dict) or not (any(measures.values()) or "located" in tables):
        raise DataError(f"{folder / 'results.json'} holds no measures: evaluate again")
    kind = _kind(folder, results)
    found = {name: read_rows(folder, name) for name in _TABLES if name in tables}
    if {"queries", "map"} <= set(found):
        match, frames = found["queries"]["match"], len(found["map"]["x"])
        if len(match) and not (match.min() >= 0 and match.max() < frames):
            raise FormatError(f"{folder / 'queries.csv'} names map frames that map.csv lacks: evaluate again")
    return Evaluation(str(results.get("name") or folder.name), kind, results, found, of_survey)


def _kind(folder: Path, results: dict[str, Any]) -> str:
    measures = results["measures"]
    if not measures:
        return "hierarchical" if folder.name.startswith("hierarchical-") else "localization"
    if measures.keys() & {"absolute", "room_retrieval"}:
        names = (results["config"].get("task") or {}).get("names")
        return "room retrieval" if names == ["room_retrieval"] else "localization"
    return next((kind for kind in _KINDS if kind in measures), str(next(iter(measures))).replace("_", " "))


def _titles(folders: list[Path]) -> list[str]:
    """Return the shortest path endings that are all different."""
    parts = [real_path(folder).parts for folder in folders]
    for depth in range(1, max(map(len, parts)) + 1):
        titles = ["/".join(part[-depth:]) for part in parts]
        if len(set(titles)) == len(titles):
            break
    return titles
