"""Estimate the pose and the room of a query from the most similar map frame ([T] 5.3.4-5.3.5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from foundation.calls import OF_FIELDS, takes, typed
from foundation.settings import Count, Seed, Settings, Share
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.data.pairs import PairSampler, PairSettings
from siamloc.data.protocol import Protocol
from siamloc.errors import ConfigError, DataError, SiamlocError
from siamloc.evaluation import room_retrieval
from siamloc.evaluation.absolute import evaluate_absolute, most_neighbours, neighbours, with_baseline
from siamloc.evaluation.columns import located_columns, missing_rooms
from siamloc.evaluation.estimates import (
    ESTIMATES,
    Estimates,
    learn,
    learned_errors,
    prepared,
    search_validation,
    with_estimates,
)
from siamloc.evaluation.metrics import fitted_margin
from siamloc.evaluation.result import Result
from siamloc.evaluation.session import Baselines, Counts, Radii, Search, Session, cost, several
from siamloc.maps import VisualMap, motions
from siamloc.maps.error_model import ErrorModel
from siamloc.results import DEPTH
from siamloc.stopwatch import Stopwatch

Name = Literal["absolute", "room_retrieval"]


@dataclass(frozen=True)
class JudgedPairs(Settings):
    """Pairs of queries for which the descriptor distance decides whether both show the same room.

    Attributes:
        count: number of pairs.
        same_room_share: share of pairs from the same room.
    """

    WHERE = "task.pairs"

    count: Count = 7000
    same_room_share: Share = 0.5


@dataclass(frozen=True)
class Localization(Estimates):
    """Settings of `localization`, in addition to those of further estimates in `Estimates`.

    Attributes:
        names: what is measured: "absolute" for poses, "room_retrieval" for rooms.
        radii: radii of the recall: a retrieved map frame within such a radius is right, in the unit of the positions.
        ks: numbers of retrieved frames for the recall.
        pairs: pairs of queries to judge as from one room or two, if the descriptor is a network.
    """

    WHERE = "task"

    names: Annotated[tuple[Name, ...], several("of absolute and room_retrieval")] = ("absolute", "room_retrieval")
    radii: Radii = (0.25, 0.5, 1.0)
    ks: Counts = (1, 5, 10, 20)
    pairs: JudgedPairs = field(default_factory=JudgedPairs)

    def __post_init__(self) -> None:
        super().__post_init__()
        asked = [name for name in ("filter", "error_model") if getattr(self, name)]
        asked += ["refine"] if self.refine != "none" else []
        if asked and "absolute" not in self.names:
            raise ConfigError(
                f"task.{asked[0]} goes with absolute localization, which {', '.join(self.names)} leaves out: "
                f"use task=absolute, or leave task.{asked[0]} out"
            )


@takes(Localization)
def localization(
    known: VisualMap,
    images: PanoramaLibrary,
    queries: FrameTable,
    *,
    validation: FrameTable | None = None,
    protocol: Protocol | Mapping[str, Any] | str = "cross_run",
    baselines: Baselines = (),
    name: str | None = None,
    seed: Seed = 0,
    settings: Localization = OF_FIELDS,
    **fields: Any,
) -> Result:
    """Locate queries in a map and compare the results with their true poses and rooms.

    Queries without a pose are located as well, in the table "located", but not scored.

    Args:
        known: the map, from `siamloc.maps.build`.
        images: panoramas of the queries (and of the map's frames for baselines).
        queries: frames to locate.
        validation: frames from which the filter's settings and expected errors are learned.
        protocol: "cross_run": no query comes from a drive in the map; "same_run"; or a `Protocol`.
        baselines: descriptors measured on the same frames: names such as "hog", or a mapping of names to descriptors.
        name: names the result folder and the rows in comparisons; the name of the descriptor if None.
        seed: seed of the draw of the pairs of queries that are judged.
        settings: all settings in one object, instead of one keyword each.

    Returns:
        A result with the parts "absolute" and "room_retrieval", if the data have poses and rooms; "room_pairs" for
        networks; "absolute_filtered", "absolute_interpolated", "absolute_refined" and "calibration" if requested.

    Raises:
        ConfigError: settings that contradict each other, or queries that the protocol forbids.
        DataError: nothing can be measured.

    Example:
        >>> import siamloc
        >>> images = siamloc.data.example()
        >>> monday, tuesday = (images.frames.select(sequence=day) for day in ("monday", "tuesday"))
        >>> known = siamloc.maps.build("hog", images, monday, progress=False)
        >>> result = localization(known, images, tuesday, radii=(0.5,), baselines=["thumbnail"])
        >>> result
        Result(hog: absolute, room_retrieval; 12 queries, 12 map, 12 rooms)
        >>> result.measures["queries"], result.measures["floor"]["mean"], list(result.baselines)
        (12, 0.0, ['thumbnail'])
    """
    session = Session(
        known, images, queries, validation=validation, protocol=protocol, baselines=baselines, name=name, seed=seed
    )
    result = _measured(session, settings, session.name, known)
    # If no query can be scored, there is nothing to compare a baseline with.
    for label, other in session.baselines.items() if result.parts else ():
        alone = replace(settings, filter=False, filter_tune=False, refine="none", error_model=False)
        baseline = _measured(session, alone, label, session.map_by(other), main=False)
        if "absolute" in result.parts and "absolute" in baseline.parts:
            result = with_baseline(result, label, baseline)
        else:
            result = replace(result, baselines={**result.baselines, label: baseline})
    return session.finished(result, settings)


@typed
def rooms(known: VisualMap, images: PanoramaLibrary, queries: FrameTable, **options: Any) -> Result:
    """Predict the room of each query from the most similar map frame; options as for `localization`.

    Poses are not needed.

    Example:
        >>> import siamloc
        >>> images = siamloc.data.example()
        >>> monday, tuesday = (images.frames.select(sequence=day) for day in ("monday", "tuesday"))
        >>> known = siamloc.maps.build("hog", images, monday, progress=False)
        >>> rooms(known, images, tuesday).measures["chance"]
        0.3333333333333333
    """
    return localization(known, images, queries, names=("room_retrieval",), **options)


@typed
def error_model(known: VisualMap, images: PanoramaLibrary, validation: FrameTable, **options: Any) -> ErrorModel:
    """Learn from validation frames to predict the error of an estimate in a map.

    Args:
        known: the map; frames without a position are left out.
        images: panoramas of the validation frames.
        validation: frames of another drive than the map's, with positions.
        **options: settings of `localization`: `lost_above`, `place_radius`.

    Raises:
        DataError: fewer than 10 validation frames with positions.

    Example:
        >>> import siamloc
        >>> images = siamloc.data.example()
        >>> monday, tuesday = (images.frames.select(sequence=day) for day in ("monday", "tuesday"))
        >>> known = siamloc.maps.build("hog", images, monday, progress=False)
        >>> error_model(known, images, tuesday, lost_above=2.0).lost_above
        2.0
    """
    settings, placed = Localization.of({**options, "error_model": True}), known.placed()
    session = Session(known, images, validation)
    searched = search_validation(session, session.queries, settings, placed)
    return learned_errors(settings, placed, searched, session.skipped)[0]


def _measured(session: Session, settings: Localization, name: str, known: VisualMap, main: bool = True) -> Result:
    """Measure one descriptor; for the map's own (`main`), also make further estimates and locate unscored queries."""
    queries, unfiltered = session.queries, replace(settings, filter=False, filter_tune=False)
    if settings.filter:
        motions(queries)  # fails before anything is described if the odometry cannot be right
    skipped: dict[str, str] = {}
    searches: dict[str, Search] = {}
    if "absolute" in settings.names:
        at_least = neighbours(settings.ks, len(known))
        if search := _search(session, "position", "absolute", known, at_least, skipped):
            searches["absolute"] = prepared(settings, search)
            if main and len(search.known) < len(known) and not session.protocol.excludes:
                searches["robot"] = Search(known, search.rows, 1)
    if "room_retrieval" in settings.names and (
        search := _search(session, "room label", "room_retrieval", known, DEPTH, skipped)
    ):
        searches["room_retrieval"] = search
    bare = np.flatnonzero(~queries.has_position)
    if main and len(bare) and known.frames.has_position.any():
        along = settings if "absolute" in searches else unfiltered
        try:
            inside = known.placed()
            excluded = session.protocol.excluded(queries.take(bare), inside.frames)
            searches["located"] = prepared(along, Search(inside, bare, 1, excluded=excluded))
        except DataError as error:  # without positions along the drive, near frames cannot be left out
            skipped["located"] = f"{error}{'; the filter is without them, too' * along.filter}"
    if not searches:
        raise DataError(f"nothing could be measured: {'; '.join(skipped.values())}")
    clock = Stopwatch()
    vectors = session.run(known, queries, searches.values(), f"the queries, {name}", clock)
    result, learned = Result(name, {}, {}, skipped=skipped), None
    if search := searches.get("robot"):
        without = int((~known.frames.has_position[search.found.retrieval.indices[:, 0]]).sum())
        if without:
            skipped["absolute, map frames"] += (
                "; a robot without a tracker gives no position where the frame most like its image is one of them, as "
                f"for {without} of the {len(search.rows)} queries: track it, or make the map without them "
                "(known.placed() in Python, or a manifest without their rows), which loses their rooms"
            )
    if search := searches.get("absolute"):
        placed = queries.take(search.rows)
        own, recalls = search.found, (settings.radii, settings.ks)
        found = evaluate_absolute(search.known, placed, own.retrieval, *recalls, own.heading, search.excluded)
        if main:
            learned = learn(session, settings, search)
            found = with_estimates(found, settings, search, queries, learned, searches.get("located"))
        result = result.joined(found)
    if search := searches.get("room_retrieval"):
        labelled = queries.take(search.rows)
        found = room_retrieval.evaluate_rooms(search.known, labelled, search.found.retrieval, search.excluded)
        result = result.joined(found)
        if vectors is not None:
            result = _with_pairs(result, session, settings, known, vectors[search.rows], labelled, skipped)
        if main and (text := missing_rooms(search.known.frames, labelled, search.excluded)):
            skipped["rooms"] = text
    if search := searches.get("located"):
        if learned is None:
            learned = learn(session, unfiltered, search)
            about = {**result.about, **({"estimates": learned.about} if learned.about else {})}
            result = replace(result, about=about, error_model=learned.errors, refinement=learned.refinement)
        poses = None if search.refinement is None else (ESTIMATES[search.refinement.method], search.found.refined)
        columns = located_columns(
            search.known, queries.take(bare), search.found.retrieval, search.found.heading, learned.errors, poses
        )
        result = replace(result, tables={**result.tables, "located": columns})
    return replace(result, name=name, skipped={**result.skipped, **skipped}, cost=cost(known, clock))


def _search(session: Session, what: str, task: str, known: VisualMap, k: int, skipped: dict[str, str]) -> Search | None:
    """Return the search among frames with a position or a room label, and record in `skipped` how many have none."""
    in_map, in_queries = (
        table.has_position if what == "position" else table.room != "" for table in (known.frames, session.queries)
    )
    for where, has in (("queries", in_queries), ("map frames", in_map)):
        text = session.lacking(has, f"{where} have no {what}")
        if not has.any():
            skipped[task] = f"{text}: give {'x and y in a manifest' if what == 'position' else 'rooms'}"
            return None
        if text:
            skipped[f"{task}, {where}"] = text
    inside, rows = (known if in_map.all() else known.take(in_map)), np.flatnonzero(in_queries)
    excluded = session.protocol.excluded(session.queries.take(rows), inside.frames)
    depth = most_neighbours(k, len(inside), excluded)
    keys = [
        f"protocol.{key}" for key in ("apart_seconds", "apart_metres") if getattr(session.protocol, key) is not None
    ]
    if excluded is not None and keys and depth < min(k, int((~excluded).sum(axis=1).max())):
        skipped[f"{task}, ranks"] = (
            f"one of the queries may find only {depth} map frame{'s' * (depth > 1)} ({' and '.join(keys)}), so that "
            f"measures of {task} that are named for more count the first {depth} alone: exclude less, or leave out "
            "queries that find so few"
        )
    return Search(inside, rows, depth, excluded=excluded)


def _with_pairs(
    result: Result,
    session: Session,
    settings: Localization,
    known: VisualMap,
    vectors: NDArray[np.float32],
    queries: FrameTable,
    skipped: dict[str, str],
) -> Result:
    """Return the result with pairs of queries judged by the distance of their descriptors, if they are a network's.

    The limit is half the margin of the loss that the network was trained with; without a margin, as after training on
    batches of places, it is the limit that best separates pairs of map frames. Colours, which the light changes, do not
    count.
    """
    if not hasattr(known.descriptor, "margin"):
        skipped["room_pairs"] = f"{known.descriptor.name} has no margin by which to judge pairs"
        return result
    wanted = settings.pairs
    asked = PairSettings(label="room", same_room_share=wanted.same_room_share, epoch_pairs=wanted.count)
    try:
        pairs = PairSampler(queries, asked, seed=session.seed).epoch(0)
        margin, learned = known.descriptor.margin, {}
        if margin is None:
            margin = _margin_of_map(known, replace(asked, same_room_share=None), session.seed)
            learned = {"pairs": {"margin": f"{margin:.4g}, learned from {wanted.count} pairs of map frames"}}
    except SiamlocError as error:
        skipped["room_pairs"] = str(error).rsplit(": ", 1)[0]  # the advice that follows is for training
        return result
    first, second = np.sort([queries.lighting[pairs.first], queries.lighting[pairs.second]], axis=0)
    lighting = np.where(first == second, first, np.char.add(np.char.add(first, " and "), second))
    labels = {"first": queries.path[pairs.first], "second": queries.path[pairs.second]}
    vectors = vectors[:, : known.learned.shape[1]]
    judged = room_retrieval.evaluate_pairs(
        vectors[pairs.first], vectors[pairs.second], pairs.same, margin, 0.5, lighting, labels
    )
    return result.joined(replace(judged, about=learned))


def _margin_of_map(known: VisualMap, wanted: PairSettings, seed: int) -> float:
    """Learn a margin from pairs of map frames, half of them from the same room.

    Raises:
        SiamlocError: the map frames have no such pairs.
    """
    labelled = known.frames.room != ""
    frames, vectors = known.frames.take(labelled), known.learned[labelled].astype(np.float64)
    pairs = PairSampler(frames, wanted, seed=seed).epoch(0)
    return fitted_margin(np.linalg.norm(vectors[pairs.first] - vectors[pairs.second], axis=1), pairs.same)
