"""Compare evaluations: the settings that differ, the measures of each, and which one is the best."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from foundation.calls import typed
from foundation.files import real_path
from foundation.settings import leaves, shortened, within
from siamloc.comparable import doubts
from siamloc.comparison import NAMED, Comparison, differing, files_named, flat, without_own
from siamloc.errors import ConfigError, FormatError, hint
from siamloc.results import FURTHER, read_results
from siamloc.runs import Run, run_with

_CHOSEN_BY = ("error", "room", "mapping.silhouette.with_unassigned", "buildings.overall.accuracy")
_LOCALIZED = ("absolute", "hierarchical")
# Parts of names of measures of which the highest is the best; of all others it is the lowest.
_HIGHEST = (
    *("recall", "recall_at_one_percent", "hit_rate", "room", "top", "mean_average_precision", "accuracy", "auc"),
    *("silhouette", "descriptor_silhouette", "purity", "precision", "f1"),
)
_PROTOCOL = ("protocol",)
_LENGTHS = frozenset({"error", "floor", "excess"})
_ALWAYS = ("descriptor", "distance", "heading", "build")
# Keys that only say where files are or what else was measured, or that follow from the others.
_LEFT_OUT = ("baselines", "data.cache", "data.name", "model.image_size", "frames", "data.unit")


@typed
def compare(folders: str | Path | Iterable[str | Path | Run], by: str | None = None) -> Comparison:
    """Compare the measures of evaluations, of a sweep or any others.

    A row holds the settings that differ between the evaluations, swept settings first; then, if measured, the mean
    error of all queries as "error" and by lighting as "error.night", "hit_rate", "recall@1_0.5" for the recall within
    0.5 m, and the share of rooms found as "room"; and finally `queries`, their number, and `folder`.

    Args:
        folders: the folder of a sweep, a run or an evaluation, or several of them, also as `Run`; all evaluations
            inside are used.
        by: the measure to rank by: one of the columns, another recall such as "recall@5_0.5", "recall@1" for its first
            radius, or any number in `results.json` by its path, such as "absolute.overall.error.median". If None,
            "error", or else "room". For recalls, rates, accuracies and the like the highest value is the best, for all
            others the lowest.

    Raises:
        ConfigError: no evaluations, or none with this measure.
        FormatError: incomplete results.

    Example:
        >>> print(siamloc.evaluation.compare("runs/robot", by="recall@1"))  # doctest: +SKIP
        descriptor.bins  distance     error   error.night  hit_rate  recall@1_0.5  room    queries  folder
        16               correlation  0.2411  0.2411       0.76      0.84          0.9231  120      runs/robot/...
        8                euclidean    0.2633  0.2633       0.74      0.81          0.9231  120      runs/robot/...
    """
    folders = folders if isinstance(folders, str | Path) else list(folders)
    paths = files_named(folders, "results.json")
    if not paths:
        where = folders if isinstance(folders, str | Path) else ", ".join(map(str, folders))
        raise ConfigError(f"{where} holds no evaluation: measure something first with `siamloc evaluate run=FOLDER`")
    results = [read_results(path.parent) for path in paths]
    measures = [_measures(path, one) for path, one in zip(paths, results, strict=True)]
    known = dict.fromkeys(name for found in measures for name in found)
    by = _chosen(by, list(known), {part for one in results for part in one["measures"]})
    settings, keys = _settings(paths, results, [by in found for found in measures])
    shown = [name for name in _columns(known) if name != by]
    rows = [
        {
            **{key: said.get(key) for key in keys},
            **{name: found.get(name, math.nan) for name in (by, *shown)},
            "queries": one.get("denominators", {}).get("queries"),
            "folder": path.parent.as_posix(),
        }
        for path, one, said, found in zip(paths, results, settings, measures, strict=True)
    ]
    columns, highest = (by, *shown, "queries", "folder"), highest_is_best(by)
    found = Comparison(by, tuple(keys), columns, tuple(rows), highest, _unit(by, results)).in_order()
    read = {path.parent.as_posix(): one for path, one in zip(paths, results, strict=True)}
    ranked = [row["folder"] for row in found.rows if not math.isnan(row[by])]
    notes = doubts({folder: (read[folder], {}) for folder in ranked}) if ranked else ()
    holding = {above for path in paths for above in real_path(path).parents}
    runs = [record.parent for record in files_named(folders, "run.json")]
    lacking = ", ".join(run.as_posix() for run in runs if real_path(run) not in holding)
    unmeasured = [f"runs that hold no evaluation: {shortened(lacking, NAMED)}"] if lacking else []
    return replace(found, notes=(*notes, *unmeasured))


def highest_is_best(measure: str) -> bool:
    """Whether the highest value of a measure is the best; otherwise it is the lowest.

    Example:
        >>> highest_is_best("recall@1_0.5"), highest_is_best("error.night")
        (True, False)
    """
    return any(part.partition("@")[0] in _HIGHEST for part in measure.split("."))


def _unit(measure: str, results: Iterable[Mapping[str, Any]]) -> str:
    """Return the unit of a measure that is a length, if all evaluations share it; "" otherwise."""
    units = {part["unit"] for one in results for part in one["measures"].values() if part and "unit" in part}
    names = measure.split(".")
    length = not _LENGTHS.isdisjoint(names) and names[-1] != "count"
    return units.pop() if len(units) == 1 and length else ""


def _chosen(by: str | None, known: Sequence[str], parts: Container[str]) -> str:
    """Return the full name of the measure to rank by."""
    if by is None:
        by = next((name for name in _CHOSEN_BY if name in known), None)
    first = [name for name in known if name.startswith("recall@1_")][:1]
    if by == "recall@1" and first:
        by = first[0]
    if by is not None and by in known:
        return by
    short = sorted(name for name in known if name.partition(".")[0] not in parts)
    if by is None:
        places = [name for name in known if name not in short]
        raise ConfigError(
            f"these evaluations measured neither errors nor rooms: choose a measure, such as by={places[0]}"
        )
    placed = by.partition(".")[0] in parts
    near = get_close_matches(by, known, 5, 0.5) if placed else []
    raise ConfigError(f"no evaluation has the measure {by!r}: {hint(by, near or [*['recall@1'] * len(first), *short])}")


def _measures(path: Path, results: Mapping[str, Any]) -> dict[str, float]:
    """Return the measures of an evaluation by name: first by short names, then each number by its path."""
    try:
        parts = results["measures"]
        found = {name: math.nan if value is None else float(value) for name, value in _named(parts)}
        cost = (results.get("cost") or {}).get(results.get("name"), {})
        return found | {
            name: float(value)
            for name, value in leaves({"cost": cost, **parts})
            if "." in name and isinstance(value, int | float) and not isinstance(value, bool)
        }
    except (KeyError, TypeError, AttributeError, IndexError, ValueError) as error:
        raise FormatError(f"{path} is not whole ({error!r}): evaluate again") from error


def _named(parts: Mapping[str, Any]) -> Iterator[tuple[str, float | None]]:
    main = next((parts[name] for name in _LOCALIZED if name in parts), None)
    for before, part in {"": main, **{f"{name}.": parts.get(f"absolute_{name}") for name in FURTHER}}.items():
        for label, group in _groups(part):
            yield f"{before}error{label}", group["error"]["mean"]
    if main is not None:
        overall = main["overall"]
        if overall.get("hit_rate"):
            yield "hit_rate", overall["hit_rate"][0]["rate"]
        for one in overall["recall"]:
            yield f"recall@{one['k']}_{one['radius']:g}", one["recall"]
        if "heading_error" in overall:
            yield "heading_error", overall["heading_error"]["mean"]
    for label, group in _groups(parts.get("room_retrieval")):
        yield f"room{label}", group["accuracy"]


def _groups(part: Mapping[str, Any] | None) -> Iterator[tuple[str, Any]]:
    """Yield the measures of all queries as "", and the measures of each lighting under a name such as ".night"."""
    if part is not None:
        yield "", part["overall"]
        yield from ((f".{lighting}", group) for lighting, group in part.get("lighting", {}).items())


def _columns(known: Iterable[str]) -> list[str]:
    """Return the names of the measures that a comparison always shows, from all measured names."""
    names = list(known)
    errors = sorted(name for name in names if name.split(".")[0] == "error" and name.count(".") < 2)
    recalls = [name for name in names if name.startswith("recall@1_")]
    others = [*(f"{name}.error" for name in FURTHER), "hit_rate", *recalls, "room"]
    return [*errors, *(name for name in others if name in names)]


def _settings(
    paths: Sequence[Path], results: Sequence[Mapping[str, Any]], ranked: Sequence[bool]
) -> tuple[list[dict[str, Any]], list[str]]:
    """Return the settings of each evaluation by key, and the keys whose values differ, swept settings first.

    If sweeps record what they swept, or runs what they were trained with, only those settings and the protocol of each
    evaluation count: the rest follows. Otherwise it is the settings that all evaluations with the measure to rank by
    have, and in which these differ.
    """
    swept = [dict(one.get("swept") or {}) for one in results]
    trained = [_of_training(path) for path in paths]
    own = [_of_evaluation(one) for one in results]
    first = list(dict.fromkeys(key for said in swept for key in said))
    of_runs = differing([found for found in trained if found])
    if all(found.get("model.seed") == found.get("seed") for found in trained):  # as set by the commands
        of_runs = [key for key in of_runs if key != "model.seed"]
    settings = []
    for training, found, said in zip(trained, own, swept, strict=True):
        of_run = {
            key: training[key] for key in of_runs if key in training and not (key in found and within(key, _PROTOCOL))
        }
        settings.append({**found, **of_run, **{key: value for key, value in said.items() if value is not None}})
    compared = [found for found, has in zip(settings, ranked, strict=True) if has]
    keys = [*differing(settings, [*first, "task"]), *differing(compared, _ALWAYS), *differing(settings, of_runs)]
    alone = not all(swept) and not of_runs
    keys += [
        key
        for key in differing(compared)
        if (alone or within(key, _PROTOCOL))
        and (within(key, ("descriptor", "build")) or all(key in found for found in compared))
    ]
    return settings, without_own(dict.fromkeys(keys), settings, first)


def _of_evaluation(results: Mapping[str, Any]) -> dict[str, Any]:
    task = next(iter(results["measures"]), None)
    described, layer = dict(results.get("descriptor") or {}), dict(results.get("layer") or {})
    name, build = described.pop("name", None), layer.pop("name", None)
    parameters = {} if "weights" in described else flat(described, prefix="descriptor.")
    return {
        **flat(results["config"], _LEFT_OUT),
        "task": "localization" if task == "absolute" else task,
        "descriptor": name,
        **parameters,
        "distance": results.get("distance"),
        "heading": (results.get("heading") or {}).get("name"),
        "build": build,
        **flat(layer, prefix="build."),
    }


def _of_training(path: Path) -> dict[str, Any]:
    run = run_with(path.parent)
    return flat(run.settings, _LEFT_OUT) if run is not None and run.record.is_file() else {}
