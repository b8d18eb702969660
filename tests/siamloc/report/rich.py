"""A run with every kind of measurement: further estimates, nodes first, disturbed queries, pairs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from siamloc.data.frames import FrameTable
from siamloc.evaluation import calibration, disturbed
from siamloc.evaluation.absolute import estimate_columns, estimate_measures, neighbours
from siamloc.evaluation.disturbed import Disturbance
from siamloc.evaluation.hierarchy import evaluate_hierarchical
from siamloc.evaluation.result import Result
from siamloc.evaluation.room_retrieval import evaluate_pairs
from siamloc.maps import VectorIndex, VisualMap
from siamloc.maps.coarse import CoarseLayer
from siamloc.maps.hierarchy import HierarchicalSearch
from siamloc.maps.ranking import rank_by_position, rank_by_representatives
from tests.siamloc.evaluation import scenes
from tests.siamloc.evaluation.scenes import evaluate_absolute, evaluate_rooms
from tests.siamloc.report import pages

DISTURBANCES = [
    Disturbance("noise", (0.0, 0.01, 0.05), "noise"),
    Disturbance("occlusion", (0.0, 0.05, 0.4), "occlusion"),
    Disturbance("turn", (0.0, 45.0, 180.0), "turn"),
    Disturbance("bulb", (0.0, 0.5, 1.0), "effect"),
]


def write_run(folder: Path, pictures: Path) -> Path:
    """Write a run with localization and all further estimates, hierarchical localization, and robustness."""
    queries, known = pages.drawn(pictures, scenes.frames(2, 60), 2), pages.drawn(pictures, scenes.frames(1, 40), 1)
    visual_map = VisualMap(scenes.describe(known, seed=1), known, {"name": "positions"})
    write_localization(folder / "evaluation" / "network", visual_map, queries)
    write_hierarchical(folder / "evaluation" / "hierarchical-network-rooms", visual_map, queries)
    write_robustness(folder / "evaluation" / "robustness-network", queries, known)
    return folder


def write_localization(folder: Path, known: VisualMap, queries: FrameTable) -> None:
    """Write localization with a filter, interpolation and expected errors, room retrieval, and pairs of rooms."""
    descriptors = scenes.describe(queries, noise=0.6)
    result = evaluate_absolute(known, descriptors, queries)
    found = {
        "filtered": queries.xy
        + 0.5 * (np.column_stack([result.columns["est_x"], result.columns["est_y"]]) - queries.xy),
        "interpolated": queries.xy + 0.1,
    }
    columns = dict(result.columns)
    for name, xy in found.items():
        columns |= estimate_columns(name, xy, queries)
    columns |= {"error_m": 0.1 + 0.8 * columns["error"], "lost": columns["error"] > 0.8}
    parts = dict(result.parts)
    for name in found:
        parts[f"absolute_{name}"] = estimate_measures(columns, name, parts["absolute"])
    parts["calibration"] = calibration.calibration_measures(columns, 1.0)
    result = replace(result, parts=parts, tables={**result.tables, "queries": columns})
    result = result.joined(evaluate_rooms(known, descriptors, queries)).joined(pairs(queries))
    details = {
        "filter": {"temperature": 0.02, "kidnapping": 0.001, "step": 0.5, "spacing": 0.8, "tuned": None},
        "interpolation": {"neighbours": 3, "radius": 1.0},
        "error_model": {"file": "error_model.json", "sequences": ["run3"], "queries": 10},
    }
    _save(folder, result, "network", estimates=details)


def write_refined(folder: Path) -> Path:
    """Write a run whose poses were refined: every error of 0.05 but of the first query, which is 0.5 off."""
    known, queries = scenes.frames(1, 40), scenes.frames(2, 60)
    visual_map = VisualMap(scenes.describe(known, seed=1), known, {"name": "positions"})
    result = evaluate_absolute(visual_map, scenes.describe(queries, noise=0.6), queries)
    off = np.where(np.arange(len(queries)) == 0, 0.5, 0.05)
    finer = estimate_columns("refined", queries.xy + np.column_stack([off, 0 * off]), queries)
    columns = {**result.columns, **finer, "refined_match": result.columns["match"]}
    found = estimate_measures(columns, "refined", result.parts["absolute"])
    result = replace(
        result, parts={**result.parts, "absolute_refined": found}, tables={**result.tables, "queries": columns}
    )
    _save(folder / "evaluation" / "network", result, "network")
    return folder


def pairs(queries: FrameTable) -> Result:
    rng = np.random.default_rng(5)
    first, second = rng.integers(0, len(queries), (2, 400))
    same = queries.room[first] == queries.room[second]
    lighting = rng.choice(["cloudy", "cloudy and night", "night"], 400)
    vectors = scenes.describe(queries, noise=0.4) / 3
    return evaluate_pairs(vectors[first], vectors[second], same, 2.0, 0.5, lighting)


def write_hierarchical(folder: Path, known: VisualMap, queries: FrameTable) -> None:
    labels = np.unique(np.floor(known.frames.xy / 1.5) @ [10, 1], return_inverse=True)[1].reshape(-1)
    layer = CoarseLayer.of_labels(known, labels)
    vectors = scenes.describe(queries, noise=0.8)
    search = HierarchicalSearch(known, layer)
    ranking = rank_by_representatives(vectors, VectorIndex(layer.representatives), 2)
    found = search.search(vectors, ranking, neighbours((1,), 40))
    perfect = search.search(vectors, rank_by_position(queries.xy, known.frames.xy, layer.labels))
    result = evaluate_hierarchical(known, layer, queries, found, perfect, known.search(vectors), (0.5, 1.0), (1,))
    more = {"layer": {"name": "spectral", "nodes": len(layer)}, "coarse_descriptor": {"name": "hog"}}
    settings = {**pages.SETTINGS, "task": {"candidates": 2}}
    _save(folder, replace(result, settings=settings), "network", descriptor={"name": "network"}, **more)


def write_robustness(folder: Path, queries: FrameTable, known: FrameTable) -> None:
    rng, none, tables = np.random.default_rng(7), np.full(len(queries), np.nan), []
    for i, method in enumerate(("network", "thumb_nail")):
        found = {}
        for one in DISTURBANCES:
            for rank, level in enumerate(one.levels):
                vectors = scenes.describe(queries, seed=3, noise=0.3 + rank + i) + 0.01 * rng.normal()
                distance = np.linalg.norm(vectors[:, None, :2] - known.xy[None], axis=2)
                found[one.name, level] = disturbed.Answer(distance.argmin(axis=1), none, none)
        tables.append(disturbed.curves(disturbed.answers(method, known, queries, found), 0.5, len(known)))
    table = disturbed.concatenated(tables)
    parts = {"robustness": disturbed.measures(table, [one.plain() for one in DISTURBANCES], "m", 5)}
    _save(folder, Result("network", parts, {"robustness": table}), "network")


def _save(folder: Path, result: Result, name: str, **about: Any) -> None:
    settings = {**pages.SETTINGS, **result.settings}
    about = {"protocol": "cross_run", **about}
    replace(result, name=name, settings=settings, about=about).save(folder, pictures=False)
