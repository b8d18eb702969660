"""Localization in compact maps as a function of the number of nodes ([C] 5.2-5.4)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

import analytic
from analytic import Description
from foundation.calls import OF_FIELDS, takes
from foundation.settings import Seed, Settings
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.protocol import Protocol
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation.layers import silhouette
from siamloc.evaluation.metrics import error_floor, localization_error, summarize
from siamloc.evaluation.result import Result
from siamloc.evaluation.session import Counts, Session, cost, several
from siamloc.maps import HierarchicalSearch, LayerSearch, NodeRanking, Retrieval, VectorIndex, VisualMap, group, match
from siamloc.maps.checked_arrays import check_means
from siamloc.maps.coarse import CoarseLayer
from siamloc.progress import track
from siamloc.results import Columns, rows_by_label
from siamloc.stopwatch import Stopwatch

_REPEATED, _SHORT = 9, 0.2  # largest number of repeated searches, and the seconds after which no more follow

Way = Literal["spectral", "som", "sample"]


@dataclass(frozen=True)
class Compact(Settings):
    """Which compact maps are built.

    Attributes:
        nodes: number of nodes of each map; a self-organizing map has a grid with about as many units.
        ways: how frames become nodes: "spectral" clustering, a self-organizing map ("som"), or plain sampling
            ("sample"), which keeps one frame of each run of frames unchanged.
    """

    WHERE = "task"

    nodes: Counts = (10, 20, 30, 40, 50, 60, 70, 80, 90, 100)
    ways: Annotated[tuple[Way, ...], several("of spectral, som and sample")] = ("spectral", "sample")


@takes(Compact)
def compact(
    known: VisualMap,
    images: PanoramaLibrary,
    queries: FrameTable,
    *,
    clusters: VisualMap | None = None,
    protocol: Protocol | Mapping[str, Any] | str = "cross_run",
    name: str | None = None,
    seed: Seed = 0,
    settings: Compact = OF_FIELDS,
    **fields: Any,
) -> Result:
    """Locate queries in maps with different numbers of nodes, each of which is represented by one descriptor.

    A query has two errors: the distance to the position of the node with the most similar representative, as in [C],
    and the distance to the most similar frame inside that node, for a robot that keeps the frames as well.

    Args:
        known: the map whose descriptors form the representatives; frames without a position are left out.
        images: panoramas of the queries.
        queries: frames to locate; those without a position are left out.
        clusters: a map of the same frames with the descriptors to be clustered ([C] 5.3: nodes by gist, representatives
            by another descriptor); `known` if None.
        protocol: which map frames a query may be compared with; see `localization`.
        name: names the result folder and the rows in comparisons; the name of the descriptor if None.
        seed: seed of the clusterings.
        settings: all settings in one object, instead of one keyword each.

    Returns:
        A result with the tables "compact", with a row for each way, number of nodes and lighting, and "answers", with a
        row for each query as well.

    Raises:
        ConfigError: more nodes than frames, or descriptors that have to be turned first, whose means are meaningless.
        DataError: `clusters` has other frames, or no map frame or no query has a position.

    Example:
        >>> import siamloc
        >>> images = siamloc.data.example()
        >>> monday, tuesday = (images.frames.select(sequence=day) for day in ("monday", "tuesday"))
        >>> known = siamloc.maps.build("hog", images, monday, progress=False)
        >>> result = compact(known, images, tuesday, nodes=(2, 6), ways=("sample",))
        >>> [round(one["error"]["mean"], 3) for one in result.measures["curves"]]
        [1.75, 1.25]
    """
    session = Session(known, images, queries, protocol=protocol, name=name, seed=seed)
    session.refuse_exclusion("localization in compact maps")
    if clusters is not None and clusters.frames.identities() != known.frames.identities():
        raise DataError("the map whose descriptors are clustered must hold the map's frames in the same order")
    placed = known.frames.has_position
    known, clusters = known.placed(), (known if clusters is None else clusters).take(placed)
    scored = session.queries.take(session.queries.has_position)
    for has, what in ((placed, "map frames"), (session.queries.has_position, "queries")):
        session.leave_out(has, f"{what} have no position", f"compact, {what}", ": give x and y in a manifest")
    if max(settings.nodes) > len(known):
        raise ConfigError(f"task.nodes asks for {max(settings.nodes)} nodes, and the map has {len(known)} frames")
    for one in (known, clusters) if set(settings.ways) != {"sample"} else ():
        check_means(one, "use task.ways=[sample], or another descriptor")
    clock = Stopwatch()
    described = Description.concatenate(list(session.parts_of(known, scored, f"the queries, {session.name}", clock)))
    asked = [(way, nodes) for way in settings.ways for nodes in settings.nodes]
    made = [
        _located(known, clusters, scored, described, way, nodes, seed)
        for way, nodes in track(asked, len(asked), "compact maps")
    ]
    groups = {"all": np.arange(len(scored)), **rows_by_label(scored.lighting)}
    curves = {
        label: [{**measures, **_errors(label, answers, rows)} for answers, measures in made]
        for label, rows in groups.items()
    }
    rows = [_flat(one) for of_map in zip(*curves.values(), strict=True) for one in of_map]
    result = Result(
        name=session.name,
        parts={
            "compact": {
                "unit": known.unit,
                "queries": len(scored),
                "map_frames": len(known),
                "clustered": clusters.descriptor.name,
                "distance": known.distance,
                "curves": curves.pop("all"),
                "lighting": curves,
            }
        },
        tables={
            "compact": {key: np.array([row[key] for row in rows]) for key in rows[0]},
            "answers": {key: np.concatenate([answers[key] for answers, _ in made]) for key in made[0][0]},
        },
        denominators={"queries": len(scored), "map_frames": len(known), "maps": len(made)},
        cost=cost(known, clock),
    )
    return session.finished(result, settings, clustered_descriptor=clusters.descriptor.identity)


def _errors(lighting: str, answers: Columns, rows: NDArray[np.int64]) -> dict[str, Any]:
    """Return the errors of some queries in one compact map."""
    error, in_frames = (summarize(answers[name][rows]) for name in ("error", "error_frames"))
    return {
        "lighting": lighting,
        "queries": len(rows),
        "floor": float(answers["floor"][rows].mean()),
        "error": {key: error[key] for key in ("mean", "median", "p95")},
        "error_frames": {key: in_frames[key] for key in ("mean", "median")},
    }


def _flat(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return the measures of a map as one row of the table "compact", without nested dictionaries."""
    frames = {f"{key}_frames": value for key, value in row["error_frames"].items()}
    plain = {key: value for key, value in row.items() if key not in ("error", "error_frames", "floor")}
    return {**plain, **row["error"], "floor": row["floor"], **frames}


def _located(
    known: VisualMap, clusters: VisualMap, queries: FrameTable, described: Description, way: str, nodes: int, seed: int
) -> tuple[Columns, dict[str, Any]]:
    """Return the answers of the queries in one compact map, and the measures of that map."""
    clock = Stopwatch()
    with clock.of("build", len(known)):
        asked: dict[str, Any] = {"grid": grid_of(nodes)} if way == "som" else {"nodes": nodes}
        labels = group(clusters, way, seed=seed, progress=False, **asked).layer.labels
    layer = CoarseLayer.of_labels(known, labels)
    if way == "sample":  # the kept frames represent themselves
        standing = known.take(analytic.clustering.sample_rows(len(known), nodes))
        positions, numbers = standing.frames.xy, nodes * known.width
        nearest = _nearest(lambda: match(standing, described, 1), clock, len(described))
    else:
        positions, numbers = layer.positions, layer.representatives.size
        index = VectorIndex(layer.representatives, known.distance)
        nearest = _nearest(lambda: index.search(described.position[:, : index.width], 1), clock, len(described))
    with clock.of("descend", len(described)):
        ranking = NodeRanking(nearest[:, None], np.full(len(nearest), len(layer)))
        inside = HierarchicalSearch(known, layer, settings=LayerSearch(by="vote"))  # of given nodes: none is ranked
        frame = inside.search(described, ranking, 1).found.indices[:, 0]
    error = localization_error(positions[nearest], queries.xy)
    answers: Columns = {
        "way": np.full(len(queries), way),
        "nodes": np.full(len(queries), len(positions)),
        "path": queries.path,
        "lighting": queries.lighting,
        "room": queries.room,
        "node": nearest,
        "match_path": known.frames.path[frame],
        "error": error,
        "error_frames": localization_error(known.frames.xy[frame], queries.xy),
        # At most the error: rounding must not make it larger.
        "floor": np.minimum(error_floor(positions, queries.xy), error),
    }
    measures = {
        "way": way,
        "nodes": len(positions),
        "build_seconds": clock.batches["build"][0][0],
        "search_ms": clock.ms("search"),
        "descend_ms": clock.ms("descend"),
        "numbers": int(numbers),
        # How compact the nodes are, in position and in descriptor space ([C] eq. 7-11).
        "silhouette": silhouette(known.frames.xy, labels),
        "descriptor_silhouette": math.nan if clusters.aligned else silhouette(clusters.learned, labels),
        "inertia": analytic.measures.moment_of_inertia(known.frames.xy, labels),
    }
    return answers, measures


def _nearest(search: Callable[[], Retrieval], clock: Stopwatch, queries: int) -> NDArray[np.int64]:
    """Return the row of the nearest node of each query (n,); a short search is repeated to time it well."""
    start = time.perf_counter()
    for _ in range(_REPEATED):
        with clock.of("search", queries):
            found = search()
        if time.perf_counter() - start > _SHORT:
            break
    return found.indices[:, 0]


def grid_of(nodes: int) -> tuple[int, int]:
    """Return rows and columns, as equal as possible, of a self-organizing map with about this number of units.

    Example:
        >>> grid_of(40), grid_of(10), grid_of(7)
        ((7, 6), (3, 3), (4, 2))
    """
    rows = max(1, math.isqrt(nodes))
    columns = max(1, round(nodes / rows))
    return max(rows, columns), min(rows, columns)
