"""Choose the building of a query: the one with the nearest map ([C] 5.3.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description
from foundation.calls import typed
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.protocol import Protocol
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation.columns import confusions, query_columns, right_share
from siamloc.evaluation.result import Result
from siamloc.evaluation.session import Session, as_protocol, cost
from siamloc.maps import CoarseLayer, Retrieval, VectorIndex, VisualMap, match
from siamloc.maps.checked_arrays import check_means
from siamloc.results import Columns, by_label
from siamloc.stopwatch import Stopwatch


@typed
def buildings(
    known: VisualMap | Sequence[VisualMap],
    images: PanoramaLibrary,
    queries: FrameTable,
    *,
    layers: Mapping[str, CoarseLayer] | None = None,
    protocol: Protocol | Mapping[str, Any] | str = "cross_run",
    name: str | None = None,
) -> Result:
    """Choose the building of each query by the map with the nearest frame or the nearest node.

    Args:
        known: maps of one building each, or a single map that is split by building.
        images: panoramas of the queries.
        queries: frames with a building; those without are left out.
        layers: coarse layer for the map of each building, by the building's name; map frames are compared if None.
        protocol: which map frames a query may be compared with; see `localization`.
        name: names the result folder and the rows in comparisons; the name of the descriptor if None.

    Raises:
        ConfigError: fewer than two buildings, maps with different descriptors or distances, a building without its
            layer, or layers with descriptors whose means are meaningless.
        DataError: map frames without a building, queries in a building without a map, or a layer of another map.

    Example:
        >>> import siamloc
        >>> images = siamloc.data.example()
        >>> frames = images.frames.with_columns(building=["north"] * 6 + ["south"] * 6 + ["north"] * 6 + ["south"] * 6)
        >>> monday, tuesday = (frames.select(sequence=day) for day in ("monday", "tuesday"))
        >>> known = siamloc.maps.build("hog", images, monday, progress=False)
        >>> buildings(known, images, tuesday).measures["confusion"]["labels"]
        ['north', 'south']
    """
    candidates = by_building([known] if isinstance(known, VisualMap) else known)
    first = next(iter(candidates.values()))
    if layers is not None:
        check_means(first, "leave the layers out, or use another descriptor")
    session = Session(first, images, queries, protocol="same_run", name=name)
    session.skipped.pop("buildings", None)  # that they overlap matters to distances alone
    session.protocol = as_protocol(protocol)
    session.refuse_exclusion("the choice of a building")
    wanted = _known_buildings(session, list(candidates))
    for building in wanted.rows_by("building"):
        Session(candidates[building], images, wanted.take(wanted.building == building), protocol=protocol)
    _check_one_distance(candidates)
    chosen = {} if layers is None else _layers_of(candidates, layers)
    nodes = [VectorIndex(one.representatives, first.distance) for one in chosen.values()]
    searched: Sequence[VisualMap | VectorIndex] = nodes or list(candidates.values())
    names = [one.names for one in chosen.values()] or [one.frames.path for one in candidates.values()]
    apart, rows, clock = [], [], Stopwatch()
    for part in session.parts_of(first, wanted, f"the queries, {session.name}", clock):
        with clock.of("search", len(part)):
            found = [_nearest(one, part) for one in searched]
        apart.append(np.concatenate([near.distances for near in found], axis=1))
        rows.append(np.concatenate([near.indices for near in found], axis=1))
    result = evaluate_buildings(wanted, list(candidates), np.concatenate(apart), np.concatenate(rows), names)
    result.parts["buildings"] |= {
        "maps": {
            building: {"frames": len(one), "representatives": len(own)}
            for (building, one), own in zip(candidates.items(), searched, strict=True)
        },
        "distance": first.distance,
        "build": next(iter(chosen.values())).made.get("name", "layer") if chosen else "none",
    }
    return replace(
        result,
        name=session.name,
        denominators={**result.denominators, "queries_of_the_role": len(session.queries)},
        skipped=session.skipped,
        cost={**cost(first, clock), "map_frames": sum(map(len, candidates.values()))},
        about=session.about(),
        settings={"task": {}, "protocol": session.protocol.plain(), "data": images.settings()},
    )


@typed
def by_building(known: Sequence[VisualMap]) -> dict[str, VisualMap]:
    """Split maps by building: return one map per building, by the building's name.

    Raises:
        ConfigError: fewer than two buildings, two maps of the same building, or maps with different descriptors.
        DataError: frames without a building.
    """
    found: dict[str, VisualMap] = {}
    for one in known:
        unknown = int((one.frames.building == "").sum())
        if unknown:
            raise DataError(
                f"{unknown} of the {len(one)} map frames have no building: give the manifest a column `building`, or "
                "lay the images out as COLD's, and make the map again"
            )
        one.check_descriptor({"images": {}, **known[0].identity})
        for building in sorted(set(one.frames.building.tolist())):
            if building in found:
                raise ConfigError(f"two of the maps are of building {building!r}: give one of each")
            found[building] = one.take(one.frames.building == building)
    if len(found) < 2:
        raise ConfigError(
            f"choosing a building needs maps of at least two, and all map frames are of building {', '.join(found)!r}: "
            "give the maps of several (task.maps=[runs/a,runs/b])"
        )
    return found


def _check_one_distance(candidates: Mapping[str, VisualMap]) -> None:
    """Refuse maps whose distances cannot be compared with each other."""
    used = {building: one.distance for building, one in candidates.items()}
    if len(set(used.values())) > 1:
        listed = ", ".join(f"{distance} in {building}" for building, distance in used.items())
        raise ConfigError(
            f"the maps compare descriptors by different distances ({listed}): give them all the same, by "
            "distance=... or known.with_distance(...)"
        )


def _layers_of(candidates: Mapping[str, VisualMap], layers: Mapping[str, CoarseLayer]) -> dict[str, CoarseLayer]:
    """Return the layer of each building's map."""
    for building, one in candidates.items():
        if building not in layers:
            raise ConfigError(
                f"building {building!r} has no layer: give one for each of {', '.join(candidates)}, or none"
            )
        if len(layers[building].labels) != len(one):
            raise DataError(
                f"the layer of building {building!r} has labels for {len(layers[building].labels)} frames and its map "
                f"has {len(one)}: build it over this map"
            )
    return {building: layers[building] for building in candidates}


def _known_buildings(session: Session, labels: list[str]) -> FrameTable:
    """Return the queries whose building is known, and record how many have none."""
    queries = session.queries
    has = queries.building != ""
    if text := session.lacking(has, "queries have no building"):
        if not has.any():
            raise DataError(f"{text}: give the manifest a column `building`, or lay the images out as COLD's")
        session.skipped["queries"] = f"{text}: left out"
    strange = sorted(set(queries.building[has].tolist()) - set(labels))
    if strange:
        count = int(np.isin(queries.building, strange).sum())
        raise DataError(
            f"{count} of {len(queries)} queries are in a building that has no map ({', '.join(strange)}; the maps are "
            f"of {', '.join(labels)}): add its map, or choose other queries"
        )
    return queries.take(has)


def _nearest(known: VisualMap | VectorIndex, queries: Description) -> Retrieval:
    """Return the nearest map frame or representative of each query, without colours."""
    if isinstance(known, VisualMap) and known.aligned:
        return match(known, queries)
    index = known.learned_index if isinstance(known, VisualMap) else known
    return index.search(queries.position[:, : index.width])


def evaluate_buildings(
    frames: FrameTable,
    labels: Sequence[str],
    apart: NDArray[np.float64],
    nearest: NDArray[np.int64],
    names: Sequence[ArrayLike],
) -> Result:
    """Choose for each query the building with the nearest representative; of equally near buildings the first.

    Args:
        frames: n queries, each in one of the buildings.
        labels: names of B buildings, B at least 2.
        apart: distance of each query's descriptor to the nearest representative of each building (n, B).
        nearest: row of that representative in its map (n, B).
        names: names of the representatives of each building.
    """
    known, every, chosen = np.array(labels), np.arange(len(frames)), apart.argmin(axis=1)
    rows, others = nearest[every, chosen], apart.astype(np.float64)
    others[every, chosen] = np.inf
    match_names = [str(np.asarray(names[b])[row]) for b, row in zip(chosen, rows, strict=True)]
    columns: Columns = {
        **query_columns(frames, frames.room),
        "building": frames.building,
        "predicted_building": known[chosen],
        "correct": known[chosen] == frames.building,
        "match": rows,
        "match_name": np.array(match_names, dtype=np.str_),
        "descriptor_distance": apart[every, chosen],
        "next_distance": others.min(axis=1),
        **{f"distance_{label}": apart[:, number] for number, label in enumerate(labels)},
    }
    return Result(
        name="buildings",
        parts={"buildings": building_measures(columns, labels)},
        tables={"queries": columns},
        denominators={"queries": len(frames), "maps": len(labels)},
    )


def building_measures(columns: Columns, labels: Sequence[str]) -> dict[str, Any]:
    """Return the accuracies and the confusion of buildings, from the columns of `queries.csv`.

    Returns:
        The groups "overall" and "lighting" (by label), each with `accuracy`, `correct`, `queries` and the same by
        true `building`; and `confusion` with the `labels`, the `counts` of all queries (row = true building, column =
        building of the nearest map) and the counts by `lighting`.
    """
    true = columns["building"]

    def group(rows: NDArray[np.int64]) -> dict[str, Any]:
        parts = {label: rows[true[rows] == label] for label in labels}
        by_building = {label: right_share(columns, part) for label, part in parts.items() if len(part)}
        return {**right_share(columns, rows), "building": by_building}

    return {
        **by_label(columns, group, "lighting"),
        "confusion": {"labels": list(labels), **confusions(columns, "building", labels)},
    }
