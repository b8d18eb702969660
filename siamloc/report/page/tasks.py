"""The sections of a report page about what a task measured: its tables, its picture, and what they mean.

The list in `write.py` says which measure each of them needs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from siamloc.report.page.markup import Markup, grid, plural, section, tag
from siamloc.report.page.parts import Part
from siamloc.summaries import own_tables
from siamloc.summaries import pairs as pairs_table
from siamloc.summaries import robustness as robustness_tables
from siamloc.tables import count, percent

# The title of each estimate, and the key of its settings in `results.json`.
_ESTIMATES = {
    "filtered": ("Sequence filter", "filter"),
    "interpolated": ("Interpolation between map frames", "interpolation"),
    "refined": ("Compared with map frames", "refinement"),
    "tracked": ("Between map frames, followed along the sequence", "tracking"),
}


def further_estimate(part: Part, name: str) -> Markup:
    """Return the section on a further estimate of the queries, with its curve and how it is made.

    Args:
        part: the evaluation that the section is about.
        name: a key of `siamloc.results.FURTHER`: "filtered", "interpolated", "refined" or "tracked".
    """
    title, key = _ESTIMATES[name]
    settings = (part.evaluation.results.get("estimates") or {}).get(key) or {}
    return section(
        title,
        tag("p.caption", _how_made(name, settings, part.evaluation.unit)),
        part.figure(f"{name}_curve", f"cumulative errors, {name} and of single frames"),
        name=f"estimate {name}",
    )


def expected_errors(part: Part) -> Markup:
    """Return the section on how accurate expected errors are, with the calibration curve."""
    found = part.evaluation.results["measures"]["calibration"]
    sequences = ((part.evaluation.results.get("estimates") or {}).get("error_model") or {}).get("sequences", [])
    learned = f" The model was learned on {', '.join(sequences)}." if sequences else ""
    text = (
        "Each point is a tenth of the queries of its kind: their expected error and their true error. On the dotted "
        "line both are equal; the gap is the mean distance from it. A query is called lost if its expected error is "
        f"above {found['overall']['lost']['lost_above']:g} {part.evaluation.unit}, or if it shows nothing of what the "
        f"map shows; it is truly lost if its error is above that value.{learned}"
    )
    figure = tag("div.beside", part.figure("calibration", "calibration"), *_grids(part, "calibration"))
    return section("Expected errors", figure, tag("p.caption", text), name="expected")


def hierarchical(part: Part) -> Markup:
    """Return the section on hierarchical localization: errors by lighting, and their plot."""
    results = part.evaluation.results
    found = results["measures"]["hierarchical"]
    layer, settings = results.get("layer") or {}, (results.get("config") or {}).get("task") or {}
    nodes = results["denominators"].get("nodes")
    what = f"{nodes} {layer['name']} nodes" if nodes and "name" in layer else "The nodes"
    tried = f", the best {settings['candidates']} of them searched" if "candidates" in settings else ""
    text = (
        f"{what} over {count(found['map_frames'])} map frames{tried}. Errors are means. A node is found if the right "
        "one is among those searched: the node of the nearest map frame, or of the query's room where nodes are rooms. "
        "Perfect nodes means always searching the right one. The loss is relative to a search of the whole map; the "
        "last two columns are shares of its comparisons, without and with those of the nodes."
    )
    return section(
        "Nodes first, then the frames in them",
        *_grids(part, "hierarchical"),
        tag("p.caption", text),
        part.figure("node_errors", "mean errors with the right node and with a wrong one"),
        name="hierarchical",
    )


def mapping(part: Part) -> Markup:
    """Return the section on a compact map: its measures and its plan."""
    grids = (tag("div", one) for one in _grids(part, "mapping"))
    figure = part.figure("nodes", "the nodes on the floor plan")
    return section("Compact map", tag("div.beside", *grids), figure, name="mapping")


def compact(part: Part) -> Markup:
    """Return the section on compact maps: curves, and a table row for each map."""
    text = (
        "A query is located at the node whose mean descriptor is most similar to its own or, with the frames kept, at "
        "the most similar frame inside that node. With plain sampling, one frame stands for each run of frames."
    )
    figure = part.figure("compact", "error against the number of nodes")
    return section("Compact maps", tag("p.caption", text), figure, *_grids(part, "compact"), name="compact")


def robustness(part: Part) -> Markup:
    """Return the section on robustness: curves and a table for each disturbance."""
    tables = robustness_tables(part.evaluation.results["measures"]["robustness"])
    text = (
        "Queries with disturbed images, in a map of undisturbed frames. Solid lines are mean errors, dashed ones "
        "medians; for headings, solid lines refer to the retrieved frame, dashed ones to the geometrically nearest map "
        "frame."
    )
    figure = part.figure("robustness", "errors of disturbed queries")
    blocks = (tag("div", tag("h4", table.title), grid(table)) for table in tables)
    return section("Robustness", tag("p.caption", text), figure, tag("div.disturbances", *blocks), name="robustness")


def confusion(part: Part) -> Markup:
    """Return the section with the confusion matrices of rooms, overall and by lighting."""
    counts = part.evaluation.results["measures"]["room_retrieval"]["confusion"]["counts"]
    right, total = int(np.trace(counts)), int(np.sum(counts))
    text = (
        f"{count(right)} of {count(total)} queries ({percent(right / total if total else None)}) in the right room. "
        "Rows are true rooms, columns are retrieved rooms; shares are of the queries in a row."
    )
    return section("Confusion of rooms", _matrices(part, "rooms"), tag("p.caption", text), name="rooms")


def buildings(part: Part) -> Markup:
    """Return the section on how often the right building was chosen."""
    text = "A query is assigned to the building whose map holds the most similar image."
    grids, matrices = _grids(part, "buildings"), _matrices(part, "buildings")
    return section("Choosing the building", *grids, tag("p.caption", text), matrices, name="buildings")


def pairs(part: Part) -> Markup:
    """Return the section on how well pairs from one room and from two are told apart."""
    found = part.evaluation.results["measures"]["room_pairs"]
    text = (
        f"The dissimilarity of a pair is its distance divided by {found['margin']:g}, limited to 1; a pair below "
        f"{found['threshold']:g} (vertical lines) counts as one room. The AUC needs no threshold: if a pair of one "
        "room is compared with a pair of two rooms, it is how often the former is less dissimilar."
    )
    figure = part.figure("pairs", "pairs judged correctly at each threshold")
    grids = map(grid, pairs_table(part.evaluation.methods))
    return section("Pairs of images: one room or two", *grids, tag("p.caption", text), figure, name="pair-curves")


def _grids(part: Part, kind: str) -> list[Markup]:
    evaluation = part.evaluation
    return [grid(table) for table in own_tables(evaluation.name, evaluation.results["measures"])[kind]]


def _how_made(name: str, found: Mapping[str, Any], unit: str) -> str:
    """Return how a further estimate is made, from its settings."""
    several = plural(found["neighbours"], "map frame") if "neighbours" in found else "map frames"
    if name == "interpolated":
        return (
            f"The position is the mean of the {several} that look most similar and belong to one place, weighted by "
            "similarity; it can be closer than the nearest map frame, so errors below the floor are possible."
        )
    if name == "refined":
        return (
            f"The network compares the query with the {several} that look most similar, and estimates where it was "
            "taken relative to each. The position is the one on which the most certain answers agree; it can be closer "
            "than the nearest map frame, so errors below the floor are common."
        )
    if name == "tracked" and "radius" in found:
        return (
            "The position is the mean of where the robot may be according to the sequence filter, within "
            f"{found['radius']:g} {unit} of the most probable map frame."
        )
    if name == "tracked":
        moved = f", {found['step']:.2f} {unit} between two queries" if "step" in found else ""
        return (
            f"The poses are tracked along each sequence: the robot is assumed to keep moving as before{moved}, and a "
            "pose that does not fit must be confirmed by those that follow. Only earlier frames are used, never later "
            "ones."
        )
    text = (
        "The filter follows the robot through each sequence and weighs what it sees by where it can have driven; only "
        "earlier frames are used, never later ones."
    )
    if "temperature" in found:
        tuned = found.get("tuned")
        how = f"chosen on {plural(tuned['queries'], 'validation frame')}" if tuned else "learned from the map"
        text += (
            f" Temperature {found['temperature']:.3g} ({how}), probability of being anywhere "
            f"{found['kidnapping']:g}, {found['step']:.2f} {unit} driven between two queries."
        )
    return text


def _matrices(part: Part, what: str) -> Markup:
    """Return the confusion matrix of all queries, and one for each lighting if there are several."""
    every = part.figure("confusion", f"confusion of {what}")
    return tag("div.side", every, part.figure("confusion_by_lighting", f"confusion of {what} by lighting"))
