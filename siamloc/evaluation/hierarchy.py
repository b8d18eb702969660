"""Hierarchical localization: the coarse layer gives the nodes to search, the fine layer the frame ([T] 5.2.1)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description
from foundation.calls import OF_FIELDS, takes
from foundation.columns import Rows
from foundation.settings import Count, Natural, Settings, fields_of
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.protocol import Protocol
from siamloc.errors import DataError
from siamloc.evaluation.absolute import evaluate_absolute, neighbours, pose_measures
from siamloc.evaluation.columns import located_columns, missing_rooms
from siamloc.evaluation.metrics import localization_error, summarize
from siamloc.evaluation.result import Result
from siamloc.evaluation.session import Counts, Radii, Session, cost
from siamloc.maps import Built, Retrieval, VisualMap, headings, match
from siamloc.maps.coarse import UNASSIGNED, CoarseLayer, numbered
from siamloc.maps.hierarchy import CoarseRanking, HierarchicalRetrieval, HierarchicalSearch, LayerSearch
from siamloc.maps.ranking import NodeRanking, rank_by_position
from siamloc.results import Columns
from siamloc.stopwatch import Stopwatch


@dataclass(frozen=True)
class Hierarchical(Settings):
    """How the two layers are searched, and what is measured.

    Attributes:
        candidates: number of nodes searched for each query.
        coarse: how nodes are ranked.
        along: number of frames before and after the nearest one, in its drive, that are searched as well if they lie
            in another node.
        radii: radii of the recall: a retrieved map frame within such a radius is right, in the unit of the positions.
        ks: numbers of retrieved frames for the recall.
    """

    WHERE = "task"

    candidates: Count = 3
    coarse: CoarseRanking = field(default_factory=CoarseRanking)
    along: Natural = 0
    radii: Radii = (0.25, 0.5, 1.0)
    ks: Counts = (1, 5, 10, 20)

    @property
    def search(self) -> LayerSearch:
        """How a coarse layer is searched."""
        ranking = {key: getattr(self.coarse, key) for key in fields_of(CoarseRanking)}  # a task has further keys
        return LayerSearch(**ranking, candidates=self.candidates, along=self.along)


@takes(Hierarchical)
def hierarchical(
    known: VisualMap,
    images: PanoramaLibrary,
    queries: FrameTable,
    layer: CoarseLayer | Built,
    *,
    coarse_map: VisualMap | None = None,
    protocol: Protocol | Mapping[str, Any] | str = "cross_run",
    name: str | None = None,
    settings: Hierarchical = OF_FIELDS,
    **fields: Any,
) -> Result:
    """Locate queries by first ranking the nodes of a coarse layer and then searching the frames in the best of them.

    For comparison, the search in the whole map and the search in the true nodes are measured on the same queries.

    Args:
        known: the map; all its frames have positions.
        images: panoramas of the queries.
        queries: frames to locate; those without a position are located without a score, in the table "located".
        layer: nodes over the frames of the map, or of `coarse_map` if given, from `siamloc.maps.group`.
        coarse_map: a map of the same frames with another descriptor, which ranks the nodes; the map itself if None.
        protocol: which map frames a query may be compared with; see `localization`.
        name: names the result folder and the rows in comparisons; the name of the descriptor if None.
        settings: all settings in one object, instead of one keyword each.

    Raises:
        ConfigError: queries that the protocol forbids, or descriptors with which nodes cannot be ranked this way.
        DataError: a layer of another map, a coarse map of other frames, or map frames without a position.

    Example:
        >>> import siamloc
        >>> images = siamloc.data.example()
        >>> monday, tuesday = (images.frames.select(sequence=day) for day in ("monday", "tuesday"))
        >>> known = siamloc.maps.build("hog", images, monday, progress=False)
        >>> result = hierarchical(known, images, tuesday, siamloc.maps.group(known, "rooms"), candidates=1)
        >>> result.measures["comparisons"]["max"]
        7
    """
    session = Session(known, images, queries, protocol=protocol, name=name)
    session.refuse_exclusion("hierarchical localization")
    search = HierarchicalSearch(known, layer, coarse=coarse_map, settings=settings.search)
    layer = search.layer
    placed, scored = known.frames.has_position, session.queries.has_position
    if text := session.lacking(placed, "map frames have no position"):
        known.placed()  # says so if there are none
        raise DataError(f"{text}: build the layer over a map whose frames all have one (known.placed())")
    if text := session.lacking(scored, "queries have no position"):
        session.skipped["hierarchical, queries"] = f"{text}; located all the same in located.csv"
    if text := missing_rooms(known.frames, session.queries):
        session.skipped["rooms"] = text
    clock = Stopwatch()
    found, perfect = _run(session, search, settings, clock)
    result = Result(session.name, {}, {}, {"queries": 0, "nodes": len(layer)})
    if perfect is not None:
        own, frames = found.take(scored), session.queries.take(scored)
        result = evaluate_hierarchical(
            known, layer, frames, own.both, perfect, own.whole, settings.radii, settings.ks, own.heading
        )
    if not scored.all():
        own, frames = found.take(~scored), session.queries.take(~scored)
        located = located_columns(known, frames, own.both.found, own.heading)
        located |= {"node": own.both.node, "comparisons": own.both.compared}
        result = replace(result, tables={**result.tables, "located": located})
    taken = {**cost(known, clock), "rank_ms": clock.ms("rank"), "whole_search_ms": clock.ms("whole")}
    about = {"coarse_descriptor": search.coarse.descriptor.identity, "layer": layer.made}
    return session.finished(replace(result, cost=taken), settings, **about)


def evaluate_hierarchical(
    visual_map: VisualMap,
    layer: CoarseLayer,
    frames: FrameTable,
    found: HierarchicalRetrieval,
    perfect: HierarchicalRetrieval,
    whole: Retrieval,
    radii: Sequence[float] = (0.5, 1.0),
    ks: Sequence[int] = (1, 5, 10, 20),
    headings: ArrayLike | None = None,
) -> Result:
    """Compare the results of a hierarchical search with the queries' true poses.

    The table "queries" is that of `evaluate_absolute`, with further columns: `node` of the estimate and `true_node`,
    see `true_nodes` (-1 for none); `nodes_tried`, numbers in one string, the best first; `coarse_correct`, whether a
    true node was tried (frames in no node are always searched, so a query without a true node counts as correct);
    `frames_compared` and `comparisons`, which also counts the comparisons with the coarse layer; `error_perfect_coarse`
    and `error_absolute`, the errors of a search for the same query in the true nodes alone and in the whole map. The
    table "map" has the `node` of each frame, the table "nodes" a row for each node.

    Args:
        visual_map: a map of m frames, all with positions.
        layer: nodes over these frames.
        frames: the queries (n), all with positions.
        found: result of the search to measure, with `siamloc.evaluation.absolute.neighbours(ks, m)` neighbours.
        perfect: result with the nodes of `true_nodes`, a perfect coarse layer, with at least one neighbour.
        whole: result of the search in the whole map, with at least one neighbour.
        radii: radii of the recall, in units of x and y.
        ks: numbers of retrieved frames for the recall.
        headings: estimated headings of the queries (n,), rad; evaluated where the true heading is known.
    """
    base = evaluate_absolute(visual_map, frames, found.found, radii, ks, headings)
    known = visual_map.frames.xy
    true = perfect.tried[:, 0]
    right = (found.tried[:, :, None] == perfect.tried[:, None]) & (perfect.tried[:, None] != UNASSIGNED)
    columns: Columns = {
        **base.tables["queries"],
        "node": found.node,
        "true_node": true,
        "nodes_tried": np.array([" ".join(map(str, row[row != UNASSIGNED])) for row in found.tried], dtype=np.str_),
        "coarse_correct": right.any(axis=(1, 2)) | (true == UNASSIGNED),
        "frames_compared": found.frames_compared,
        "comparisons": found.compared,
        "error_perfect_coarse": localization_error(known[perfect.found.indices[:, 0]], frames.xy),
        "error_absolute": localization_error(known[whole.indices[:, 0]], frames.xy),
    }
    node_columns: Columns = {
        "node": np.arange(len(layer)),
        "name": layer.names,
        "x": layer.positions[:, 0],
        "y": layer.positions[:, 1],
        "frames": np.bincount(layer.labels[layer.labels != UNASSIGNED], minlength=len(layer)),
    }
    map_columns = {**base.tables["map"], "node": layer.labels}
    measures = node_measures(columns, base.parts["absolute"])
    return replace(
        base,
        name="hierarchical",
        parts={"hierarchical": measures},
        tables={"queries": columns, "map": map_columns, "nodes": node_columns},
        denominators={**base.denominators, "nodes": len(layer)},
    )


def true_nodes(visual_map: VisualMap, layer: CoarseLayer, frames: FrameTable) -> NodeRanking:
    """Return the true node of each query: the node of its room if nodes are rooms, so that labels decide.

    In other layers, and for queries without a room label or in a room that the map lacks, it is the node of the
    geometrically nearest map frame, or several nodes with equally near frames; see `rank_by_position`.

    Args:
        visual_map: a map of m frames, all with positions.
        layer: nodes over these frames.
        frames: the queries (n), all with positions.
    """
    nearest = rank_by_position(frames.xy, visual_map.frames.xy, layer.labels)
    if layer.made.get("name") != "rooms":
        return nearest
    labelled = numbered(frames.place, layer.names.tolist())[:, None]
    alone = np.full_like(nearest.nodes, UNASSIGNED)
    alone[:, :1] = labelled
    return replace(nearest, nodes=np.where(labelled == UNASSIGNED, nearest.nodes, alone))


def node_measures(columns: Mapping[str, NDArray], about: Mapping[str, Any]) -> dict[str, Any]:
    """Return all measures of hierarchical localization, pooled over queries, from the columns of `queries.csv`.

    Args:
        columns: columns of `queries.csv`.
        about: as for `siamloc.evaluation.absolute.pose_measures`.

    Returns:
        The measures of `siamloc.evaluation.absolute.pose_measures`. Each group also holds `coarse` (accuracy, correct,
        queries); `given_right`, `given_wrong`, `perfect_coarse` and `absolute`, each with `queries` and the summary
        `error`; `loss`, the share by which the mean error exceeds the mean error of a search in the whole map; and
        `comparisons` (mean, max, share of the map, frames_share without the comparisons with the coarse layer).
    """
    names = ("error", "coarse_correct", "comparisons", "frames_compared", "error_perfect_coarse", "error_absolute")

    def group(rows: NDArray[np.int64]) -> dict[str, Any]:
        error, right, compared, frames_compared, perfect, whole = (columns[name][rows] for name in names)
        parts = {"given_right": error[right], "given_wrong": error[~right], "perfect_coarse": perfect}
        base = float(whole.mean())
        return {
            "coarse": {"accuracy": float(right.mean()), "correct": int(right.sum()), "queries": len(rows)},
            **{
                name: {"queries": len(errors), "error": summarize(errors)}
                for name, errors in {**parts, "absolute": whole}.items()
            },
            "loss": float(error.mean()) / base - 1 if base > 0 else math.nan,
            "comparisons": {
                "mean": float(compared.mean()),
                "max": int(compared.max()),
                "share": float(compared.mean()) / about["map_frames"],
                "frames_share": float(frames_compared.mean()) / about["map_frames"],
            },
        }

    return pose_measures(columns, about, group)


@dataclass(frozen=True, eq=False)
class _Found(Rows):
    """Results of the queries: with both layers, in the whole map, and headings, NaN where unknown (n,)."""

    both: HierarchicalRetrieval
    whole: Retrieval
    heading: NDArray[np.float64]


def _run(
    session: Session, search: HierarchicalSearch, settings: Hierarchical, clock: Stopwatch
) -> tuple[_Found, HierarchicalRetrieval | None]:
    """Search for all queries, batch by batch if the descriptions are large.

    Returns:
        The results, and for the queries with positions the results of a search in the true nodes alone; None if no
        query has a position.
    """
    known, queries = session.known, session.queries
    scored, rankings = queries.has_position, None
    true, place = true_nodes(known, search.layer, queries.take(scored)), np.cumsum(scored) - 1

    def ranked(part: Description) -> NodeRanking:
        with clock.of("rank", len(part)):
            return search.rank(part)

    if search.coarse is not known:
        parts = session.parts_of(search.coarse, queries, f"the queries, {search.coarse.descriptor.name}", clock)
        rankings = NodeRanking.concatenate([ranked(part) for part in parts])
    k = neighbours(settings.ks, len(known))
    found, perfect, start = [], [], 0
    for part in session.parts_of(known, queries, f"the queries, {session.name}", clock):
        rows = np.arange(start, start + len(part))
        ranking = ranked(part) if rankings is None else rankings.take(rows)
        with clock.of("search", len(part)):
            both = search.search(part, ranking, k)
        with clock.of("whole", len(part)):
            whole = match(known, part, 1)
        found.append(_Found(both, whole, headings(known, part, both.found)[:, 0]))
        inside = np.flatnonzero(scored[rows])
        if len(inside):
            perfect.append(search.search(part.take(inside), true.take(place[rows[inside]]), 1))
        start += len(part)
    return _Found.concatenate(found), HierarchicalRetrieval.concatenate(perfect) if perfect else None
