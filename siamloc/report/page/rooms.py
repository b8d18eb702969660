"""Sections about rooms and buildings: confusion matrices, and pairs judged by their distance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from siamloc.report.page import tables
from siamloc.report.page.markup import Markup, count, number, percent, plural, section, tag
from siamloc.report.page.parts import Part

_MOST_CELLS = 40  # rooms; a larger matrix would be unreadable


def confusion(part: Part) -> Markup | None:
    """Return the confusion matrices of rooms, of all queries and by lighting; None if rooms were not retrieved."""
    rooms = part.evaluation.rooms
    if rooms is None:
        return None
    labels, counts = rooms["confusion"]["labels"], rooms["confusion"]["counts"]
    right, total = int(np.trace(counts)), int(np.sum(counts))
    text = (
        f"{count(right)} of {count(total)} queries ({percent(right / total if total else None)}) in the right room. "
        "Rows are true rooms, columns are retrieved rooms; shares are of the queries in a row."
    )
    title = "Confusion of rooms"
    if len(labels) > _MOST_CELLS:
        return section(title, _mistakes(labels, counts), tag("p.caption", text), name="rooms")
    return section(title, _matrices(part, "rooms"), tag("p.caption", text), name="rooms")


def buildings(part: Part) -> Markup | None:
    """Return how often the right building was chosen; None if there was no choice."""
    found = part.evaluation.results["measures"].get("buildings")
    if found is None:
        return None
    labels = found["confusion"]["labels"]
    rows = []
    for label in tables.labels_of(found):
        group = tables.group_of(found, label)
        shares = [percent((group["building"].get(name) or {}).get("accuracy")) for name in labels]
        rows.append((label, [percent(group["accuracy"]), *shares, count(group["queries"])]))
    maps = found.get("maps", {})
    text = "; ".join(
        f"{name}: {plural(one['frames'], 'map frame')}, {plural(one['representatives'], 'representative')}"
        for name, one in maps.items()
    )
    return section(
        "Choosing the building",
        tables.grid(["lighting", "right", *labels, "queries"], rows, "buildings"),
        tag("p.caption", f"A query is assigned to the building whose map holds the most similar image. {text}"),
        _matrices(part, "buildings"),
        name="buildings",
    )


def pairs(part: Part) -> Markup | None:
    """Return how well pairs of one room are distinguished from pairs of two; None if pairs were not judged."""
    found = part.evaluation.results["measures"].get("room_pairs")
    if found is None:
        return None
    rows = []
    for label in tables.labels_of(found):
        group = tables.group_of(found, label)
        shares = [percent(group[name]) for name in ("same", "different", "overall")]
        counts = [count(group["n_same"]), count(group["n_different"])]
        rows.append((label, [*shares, number(group.get("auc")), *counts]))
    heads = ["lighting", "one room", "two rooms", "all pairs", "AUC", "pairs of one room", "of two rooms"]
    text = (
        f"The dissimilarity of a pair is its distance divided by {found['margin']:g}, limited to 1; a pair below "
        f"{found['threshold']:g} (vertical lines) counts as one room. The AUC needs no threshold: if a pair of one "
        "room is compared with a pair of two rooms, it is how often the former is less dissimilar."
    )
    return section(
        "Pairs of images: one room or two",
        tables.grid(heads, rows, "pair-shares"),
        tag("p.caption", text),
        part.figure("pairs", "pairs judged correctly at each threshold"),
        name="pair-curves",
    )


def _matrices(part: Part, what: str) -> Markup:
    """Return the confusion matrix of all queries, and one for each lighting if there are several."""
    every = part.figure("confusion", f"confusion of {what}")
    return tag("div.side", every, part.figure("confusion_by_lighting", f"confusion of {what} by lighting"))


def _mistakes(labels: Sequence[str], counts: Sequence[Sequence[int]]) -> Markup:
    """Return the most frequent mistakes among very many rooms."""
    wrong = [
        (value, labels[i], labels[j]) for i, row in enumerate(counts) for j, value in enumerate(row) if i != j and value
    ]
    wrong.sort(key=lambda item: (-item[0], item[1], item[2]))
    rows = [(f"{true} taken for {taken}", plural(value, "query", "queries")) for value, true, taken in wrong[:30]]
    return tables.key_values(rows or [(f"{len(labels)} rooms", "no mistakes")])
