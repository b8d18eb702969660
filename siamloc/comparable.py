"""Whether the errors of evaluations may be compared: by their protocols, queries and map frames."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import numpy as np

from siamloc.results import Columns
from siamloc.tables import count

_MOST = 3  # names in a sentence


def doubts(evaluations: Mapping[str, tuple[Mapping[str, Any], Mapping[str, Columns]]]) -> list[str]:
    """Return a warning if protocols differ, and one for evaluations with other frames than the first evaluation.

    Evaluations that differ from it in the same way share a warning. Frames are the same if the ends of their paths,
    their sequences and their positions are. The folder of the data set, the order of the frames and the descriptor do
    not matter.

    Args:
        evaluations: the content of `results.json` and the tables among "queries", "map" and "rooms" of each evaluation,
            by the title that the sentences use.
    """
    found: dict[str, list[str]] = {}
    (first, (results, tables)), *others = evaluations.items()
    for title, (own, columns) in others:
        name = "queries" if "queries" in tables and "queries" in columns else "rooms"
        queries = _difference("queries", tables.get(name), columns.get(name))
        maps = _difference("map frames", tables.get("map"), columns.get("map"))
        if name not in tables or name not in columns:
            asked = [
                one["denominators"]["queries"] for one in (own, results) if "queries" in one.get("denominators", {})
            ]
            queries = f"queries ({' and '.join(map(count, asked))})" if len(set(asked)) > 1 else ""
        if "map" not in tables or "map" not in columns:  # their settings still say which frames were selected
            chosen = [((one.get("config") or {}).get("protocol") or {}).get("map") for one in (results, own)]
            maps = "map frames (protocol.map)" if None not in chosen and chosen[0] != chosen[1] else ""
        if queries or maps:
            found.setdefault(" and ".join(filter(None, [queries, maps])), []).append(title)
    protocols = {one["protocol"] for one, _ in evaluations.values() if one.get("protocol")}
    text = "These evaluations follow different protocols: their errors must not be compared with each other."
    return [text] * (len(protocols) > 1) + [
        f"Take care when comparing {_listed(titles)} with {first}: they differ in their {what}."
        for what, titles in found.items()
    ]


def _listed(titles: list[str]) -> str:
    more = f" and {len(titles) - _MOST} more" if len(titles) > _MOST else ""
    return ", ".join(titles[:_MOST]) + more


def _difference(what: str, one: Columns | None, other: Columns | None) -> str:
    """Return how the frames of two tables differ; "" if they are the same, or if a table is missing."""
    if one is None or other is None or (first := _frames(one)) == (second := _frames(other)):
        return ""
    return f"{what} ({count(len(second))} and {count(len(first))}, {count(len(first & second))} of them in common)"


def _frames(columns: Columns) -> set[tuple[Any, ...]]:
    """Return what identifies each frame: folder and file name, sequence, and position, infinite where unknown."""
    ends = [PurePath(path).parts[-2:] for path in columns["path"].tolist()]
    unknown = np.full(len(ends), np.nan)
    x, y = (np.nan_to_num(np.round(columns.get(axis, unknown), 6), nan=np.inf).tolist() for axis in "xy")
    return set(zip(ends, columns.get("sequence", unknown).astype(str).tolist(), x, y, strict=True))
