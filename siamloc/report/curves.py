"""The curves of a report: shares of queries by error, and how the training went."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from siamloc.evaluation.absolute import baseline_names
from siamloc.report.gathered import Evaluation
from siamloc.report.markup import Markup, count, number, tag
from siamloc.report.svg import DASHES, Axis, Line, chart, series_1_2_5
from siamloc.results import rows_by_label

_LIGHTINGS = {"cloudy": "k0", "night": "k1", "sunny": "k2"}
_MOST_POINTS = 240
_METRIC_NAMES = {
    "accuracy_same": "accuracy, pairs of one room",
    "accuracy_different": "accuracy, pairs of two rooms",
    "distance_same": "distance of pairs of one room",
    "distance_different": "distance of pairs of two rooms",
    "spread": "spread of the descriptors",
}
_SHARES = ("accuracy", "accuracy_same", "accuracy_different")


def error_curves(evaluation: Evaluation) -> Markup:
    """Return a chart by lighting, and where there are baselines a chart by method for each lighting."""
    assert evaluation.queries is not None
    columns, unit = evaluation.queries, evaluation.unit
    groups = evaluation.rows_by_lighting
    every = np.arange(len(columns["error"]))
    axis = error_axis([columns["error"], columns["floor"]], unit)
    lines = []
    if len(groups) != 1:
        lines.append(_cumulative("all queries", columns["error"], unit, "ink"))
    for label, colour in zip(groups, lighting_colours(groups), strict=True):
        lines.append(_cumulative(label, columns["error"][groups[label]], unit, colour))
        lines.append(_cumulative(f"{label}, floor", columns["floor"][groups[label]], unit, colour, DASHES[2]))
    if not groups:
        lines.append(_cumulative("floor", columns["floor"], unit, "soft", DASHES[2]))
    charts = [chart(f"{evaluation.name} by lighting" if groups else evaluation.name, lines, axis, _SHARE)]
    names = baseline_names(columns)
    for label, rows in (groups or {"all queries": every}).items():
        if not names:
            break
        errors = {evaluation.name: columns["error"], **{name: columns[f"baseline_{name}"] for name in names}}
        lines = [
            _cumulative(name, error[rows], unit, *method_look(i)) for i, (name, error) in enumerate(errors.items())
        ]
        lines.append(_cumulative("floor", columns["floor"][rows], unit, "soft", DASHES[2]))
        axis = error_axis([*errors.values(), columns["floor"]], unit)
        charts.append(chart(f"methods, {label}", lines, axis, _SHARE))
    return tag("div.panels", *charts)


def estimate_curves(evaluation: Evaluation, name: str) -> Markup:
    """Return a chart for each lighting: the single-frame errors, and those of another estimate of the same queries.

    Args:
        evaluation: with queries.
        name: of the estimate, such as "filtered".
    """
    assert evaluation.queries is not None
    columns, unit = evaluation.queries, evaluation.unit
    groups = evaluation.rows_by_lighting or {"all queries": np.arange(len(columns["error"]))}
    axis = error_axis([columns["error"], columns[f"{name}_error"], columns["floor"]], unit)
    charts = []
    for label, rows in groups.items():
        lines = [
            _cumulative(name, columns[f"{name}_error"][rows], unit, "ink"),
            _cumulative("single frame", columns["error"][rows], unit, "k5", DASHES[1]),
            _cumulative("floor", columns["floor"][rows], unit, "soft", DASHES[2]),
        ]
        charts.append(chart(label, lines, axis, _SHARE, 340, 240))
    return tag("div.panels.three", *charts)


def compared_curves(evaluations: Mapping[str, Evaluation]) -> Markup | None:
    """Return the curves of several evaluations in one chart per unit; None where none was localized."""
    by_unit: dict[str, dict[str, Mapping[str, NDArray]]] = {}
    for title, evaluation in evaluations.items():
        if evaluation.queries is not None and len(evaluation.queries["error"]):
            by_unit.setdefault(evaluation.unit, {})[title] = evaluation.queries
    charts = []
    for unit, tables in by_unit.items():
        charts.append(_compared("all queries of each", tables, unit))
        groups = {title: rows_by_label(columns["lighting"]) for title, columns in tables.items()}
        labels = list(dict.fromkeys(label for rows in groups.values() for label in rows))
        for label in labels if len(labels) > 1 else []:
            chosen = {
                title: {name: columns[name][groups[title][label]] for name in ("error", "floor")}
                for title, columns in tables.items()
                if label in groups[title]
            }
            charts.append(_compared(label, chosen, unit))
    return tag("div.panels", *charts) if charts else None


def training_curves(columns: Mapping[str, NDArray[np.float64]]) -> Markup:
    """Return a chart for each figure that was logged: what was trained on and what validated, loss and accuracy first.

    Args:
        columns: of `metrics.csv`: epoch, and names such as "train/loss" and "val/loss".
    """
    epoch = columns["epoch"] + 1  # people count epochs from one
    metrics: dict[str, dict[str, NDArray[np.float64]]] = {}
    for name, values in columns.items():
        part, slash, metric = name.partition("/")
        if slash and np.isfinite(values).any():
            metrics.setdefault(metric, {})[part] = values
    order = sorted(metrics, key=lambda name: (name != "loss", name != "accuracy", name))
    x = Axis("epoch", float(epoch.min()), float(max(epoch.max(), epoch.min() + 1)))
    charts = []
    for metric in order:
        lines = []
        for i, part in enumerate(sorted(metrics[metric], key=lambda name: (name != "train", name != "val", name))):
            values = metrics[metric][part]
            last = values[np.isfinite(values)][-1]
            what = {"train": "training", "val": "validation"}.get(part, part)
            colour = {"train": "k0", "val": "k2"}.get(part, f"k{3 + i % 5}")
            lines.append(Line(what, epoch, values, colour, DASHES[1] if part == "train" else None, f"last {last:.3g}"))
        finite = np.concatenate([line.y[np.isfinite(line.y)] for line in lines])
        top = 1.0 if metric in _SHARES else _above(float(finite.max()))
        y = Axis("share" if metric in _SHARES else metric.replace("_", " "), min(0.0, float(finite.min())), top)
        charts.append(chart(_METRIC_NAMES.get(metric, metric.replace("_", " ")), lines, x, y, 340, 230))
    return tag("div.panels.three", *charts)


def lighting_colours(labels: Sequence[str] | Mapping[str, object]) -> list[str]:
    """Return the name of a colour for each label, the same one for a lighting everywhere."""
    others = [label for label in labels if label not in _LIGHTINGS]
    return [_LIGHTINGS.get(label) or f"k{3 + others.index(label) % 5}" for label in labels]


def method_look(rank: int) -> tuple[str, str | None]:
    """Return colour and dash of a method: the measured one stands out, baselines differ in both."""
    return ("ink", None) if rank == 0 else (f"k{(rank + 2) % 8}", DASHES[rank % len(DASHES)])


def error_axis(errors: Sequence[ArrayLike], unit: str, lowest: float = 5) -> Axis:
    """Return a logarithmic axis from where the first queries are right to the largest error.

    Args:
        errors: of each line.
        unit: of the errors.
        lowest: percentile of a line's errors that is still shown.
    """
    columns = [np.asarray(error, dtype=np.float64) for error in errors]
    largest = max(float(error.max()) for error in columns)
    if largest <= 0:
        return Axis(f"error [{unit}]", 0, 1)
    low = min(float(np.percentile(error, lowest)) for error in columns)
    high = _above(largest)
    # Errors of nothing have no place on the axis: their share shows where the curve begins.
    low = min(max(low, largest / 1000), largest / 10)
    below = [value for value in series_1_2_5(low / 10, low) if value <= low * (1 + 1e-9)]
    return Axis(f"error [{unit}], logarithmic", below[-1], high, log=True)


_SHARE = Axis("queries with at most this error [%]", 0, 100)


def _compared(name: str, tables: Mapping[str, Mapping[str, NDArray]], unit: str) -> Markup:
    """Return the curves of several evaluations in one chart."""
    lines = [
        _cumulative(title, columns["error"], unit, f"k{(0, 5, 3, 2, 1, 4, 6, 7)[i % 8]}", DASHES[i % len(DASHES)])
        for i, (title, columns) in enumerate(tables.items())
    ]
    floors = [columns["floor"] for columns in tables.values()]
    if all(np.array_equal(floors[0], floor) for floor in floors):
        lines.append(_cumulative("floor", floors[0], unit, "soft", DASHES[2]))
    axis = error_axis([*(columns["error"] for columns in tables.values()), *floors], unit)
    return chart(name, lines, axis, _SHARE)


def _cumulative(label: str, error: NDArray, unit: str, colour: str, dash: str | None = None) -> Line:
    ordered = np.sort(error)
    # The share is exact at each point that is kept; between them the eye sees no difference.
    keep = np.unique(np.linspace(0, len(ordered) - 1, min(len(ordered), _MOST_POINTS)).round().astype(np.int64))
    share = 100 * (keep + 1) / len(ordered)
    if len(keep) == len(ordered):
        x, y = np.repeat(ordered, 2), np.concatenate([[0], np.repeat(share, 2)[:-1]])
    else:
        x, y = np.concatenate([ordered[:1], ordered[keep]]), np.concatenate([[0], share])
    note = f"{number(float(ordered.mean()))} {unit}, n = {count(len(ordered))}"
    return Line(label, np.append(x, np.inf), np.append(y, 100.0), colour, dash, note)


def _above(value: float) -> float:
    return series_1_2_5(value, value)[-1] if value > 0 else 1.0
