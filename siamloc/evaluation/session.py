"""`Session`: what all evaluation tasks share: a map, images, queries, and what may be compared with what."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from analytic import Description, Descriptor
from foundation.calls import typed
from foundation.columns import Rows
from foundation.extras import need
from foundation.settings import Count, NotNegative, Rule, Settings
from siamloc import maps
from siamloc.data.frames import FrameTable, check_units
from siamloc.data.library import PanoramaLibrary
from siamloc.data.protocol import Protocol
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation.offsets import overlapping_buildings
from siamloc.evaluation.result import Result
from siamloc.maps import RefinedPoses, Refinement, Retrieval, VisualMap, frame_distances, headings, match
from siamloc.maps.describing import descriptor_from
from siamloc.results import RESERVED
from siamloc.stopwatch import Stopwatch

Baselines = Mapping[str, Descriptor] | Sequence[str | Descriptor] | str | Descriptor


def several(words: str) -> Rule:
    """Return the rule that a list has at least one value and no value twice."""
    return Rule(f"a list of one or more {words} that differ", lambda values: 0 < len(values) == len(set(values)))


Radii = Annotated[tuple[NotNegative, ...], several("numbers from 0")]
Counts = Annotated[tuple[Count, ...], several("whole numbers from 1")]


@dataclass(frozen=True, eq=False)
class Found(Rows):
    """Results of a search in a map for n frames.

    Attributes:
        retrieval: the nearest map frames.
        heading: headings in rad (n,), from the nearest map frame's heading and the turn since then; NaN if unknown.
        distances: distances to all map frames (n, m), infinite where excluded; None unless requested.
        refined: poses finer than the map; None unless requested.
    """

    retrieval: Retrieval
    heading: NDArray[np.float64]
    distances: NDArray[np.float64]
    refined: RefinedPoses


@dataclass
class Search:
    """A search in a map for frames that arrive batch by batch, with the results of the batches so far.

    Attributes:
        known: the map, with only those frames that have the positions or rooms that the task needs.
        rows: rows of the frames to search for (n,), increasing: those with the positions or rooms that the task needs.
        k: number of neighbours to find.
        refinement: how poses finer than the map are made; None to make none.
        with_distances: whether the distances to all map frames are kept, n x m float64; infinite where excluded.
        excluded: (n, m) map frames that a frame is not compared with; None if there are none.
    """

    known: VisualMap
    rows: NDArray[np.int64]
    k: int
    refinement: Refinement | None = None
    with_distances: bool = False
    excluded: NDArray[np.bool_] | None = None
    _parts: list[Found] = field(default_factory=list)

    def take_in(self, queries: Description, clock: Stopwatch) -> None:
        """Search the map for the next batch of described frames, and add their results."""
        start = sum(map(len, self._parts))
        barred = None if self.excluded is None else self.excluded[start : start + len(queries)]
        with clock.of("search", len(queries)):
            found = match(self.known, queries, self.k, excluded=barred)
        with clock.of("heading", len(queries)):
            turned = headings(self.known, queries, found)[:, 0]
        refined = None if self.refinement is None else self.refinement.poses(self.known, queries, found)
        apart = frame_distances(self.known, queries, excluded=barred) if self.with_distances else None
        self._parts.append(Found(found, turned, apart, refined))  # type: ignore[arg-type]

    @cached_property
    def found(self) -> Found:
        """The results for all frames; valid after the last batch."""
        return Found.concatenate(self._parts)


class Session:
    """A map, images, queries and a protocol, checked against each other once for all tasks.

    Args:
        known: the map; `known.descriptor` describes the queries.
        images: panoramas of the queries, and of the map's frames if they have to be described again.
        queries: frames to locate.
        validation: frames for what must not be learned from the queries: settings of the filter and expected errors;
            from other sequences than the queries and the map.
        protocol: which map frames a query may be compared with: a `Protocol` such as Protocol(leave_one_out=True), its
            fields as a mapping, or its kind, "cross_run" or "same_run".
        baselines: descriptors to measure on the same frames: one or several, as names or objects, or a mapping of names
            to descriptors.
        name: names the result folder and the rows in comparisons; the name of the descriptor if None.
        seed: seed of all random draws.

    Raises:
        ConfigError: arguments of the wrong type, queries that the protocol forbids in this map, validation frames from
            the map's or the queries' sequences, panoramas made in another way than those of the map, or an unknown
            baseline.
        DataError: no image of the queries can be read, positions in different units, or a query whose lighting or room
            has a name in `siamloc.results.RESERVED`.
    """

    @typed
    def __init__(
        self,
        known: VisualMap,
        images: PanoramaLibrary,
        queries: FrameTable,
        *,
        validation: FrameTable | None = None,
        protocol: Protocol | Mapping[str, Any] | str = "cross_run",
        baselines: Baselines = (),
        name: str | None = None,
        seed: int = 0,
    ) -> None:
        need("scipy")
        self.known, self.images, self.seed = known, images, seed
        self.protocol = as_protocol(protocol)
        self.name = name or known.descriptor.name
        self.queries = _readable(images, queries, "queries")
        self.validation = None if validation is None else _readable(images, validation, "validation frames")
        self.baselines = _named(baselines, images.circular)
        self.skipped: dict[str, str] = {}
        known.check_images(images.preprocessing.parameters(), images.preprocessing.size)
        for what in ("lighting", "room"):
            if taken := RESERVED.intersection(getattr(self.queries, what).tolist()):
                raise DataError(f"queries have the {what} {min(taken)!r}, which names a row of the tables: rename it")
        tables = known.frames, self.queries, self.validation
        check_units(one for one in tables if one is not None and one.has_position.any())
        if text := overlapping_buildings(known.frames, self.queries):
            self.skipped["buildings"] = text
        self._check_apart()

    def __repr__(self) -> str:
        return f"Session({self.name}: {len(self.queries)} queries in {self.known!r}, {self.protocol.kind})"

    def refuse_exclusion(self, task: str) -> None:
        """Refuse a protocol that excludes map frames, for a task that compares queries with all of them.

        Raises:
            ConfigError: the protocol excludes map frames.
        """
        if self.protocol.excludes:
            raise ConfigError(
                f"{task} compares queries with all frames of the map: leave protocol.leave_one_out, apart_seconds and "
                "apart_metres out, and query another sequence"
            )

    def map_by(self, other: Descriptor) -> VisualMap:
        """Return a map of the same frames by another descriptor."""
        if other is self.known.descriptor:
            return self.known
        return maps.build(other, self.images, self.known.frames)

    def parts_of(self, known: VisualMap, frames: FrameTable, what: str, clock: Stopwatch) -> Iterable[Description]:
        """Yield the descriptions of frames: all at once, or batch by batch if the descriptor compares after turning.

        Descriptions by such descriptors are large, so only one batch at a time is in memory.

        Args:
            known: the map whose descriptor describes the frames.
            frames: frames among those of the session's images.
            what: noun for the frames in the progress line, such as "queries".
            clock: takes the time of describing.
        """
        parts = maps.describe(known, self.images, frames, progress=f"describing {what}", clock=clock)
        return parts if known.aligned else [Description.concatenate(list(parts))]

    def run(
        self, known: VisualMap, frames: FrameTable, searches: Iterable[Search], what: str, clock: Stopwatch
    ) -> NDArray[np.float32] | None:
        """Describe frames and run several searches on them; return the position parts, None if too large to keep.

        Args:
            known: the map whose descriptor describes the frames.
            frames: frames among those of the session's images.
            searches: the searches, each of which takes the frames in its `rows`.
            what: noun for the frames in the progress line, such as "queries".
            clock: takes the times of describing and searching.
        """
        start, vectors, searches = 0, None, list(searches)
        for part in self.parts_of(known, frames, what, clock):
            for search in searches:
                inside = search.rows[(search.rows >= start) & (search.rows < start + len(part))] - start
                if len(inside):
                    search.take_in(part if len(inside) == len(part) else part.take(inside), clock)
            start += len(part)
            vectors = None if known.aligned else part.position
        return vectors

    def lacking(self, has: NDArray[np.bool_], what: str) -> str:
        """Return a text with the number of frames that lack a property, such as a position; empty if all have it.

        Args:
            has: (n,) True for frames that have the property.
            what: the frames and what they lack, such as "queries have no position", which follows the numbers.

        Raises:
            DataError: some frames lack the property, others have it, and the images' `on_error` is "raise".
        """
        if has.all():
            return ""
        text = f"{int((~has).sum())} of {len(has)} {what}"
        if has.any() and self.images.settings()["on_error"] == "raise":
            raise DataError(f"{text}: on_error=skip leaves them out")
        return text

    def leave_out(self, has: NDArray[np.bool_], what: str, key: str, remedy: str) -> None:
        """Record in `skipped` how many frames are left out because they lack a property.

        Args:
            has: which frames have the property.
            what: what is missing, and of which frames, such as "queries have no position".
            key: key of the sentence in `skipped`, such as "validation".
            remedy: what to do if all frames lack it.

        Raises:
            DataError: all frames lack the property, or some of them and the images' `on_error` is "raise".
        """
        if text := self.lacking(has, what):
            if not has.any():
                raise DataError(f"{text}{remedy}")
            self.skipped[key] = text

    def comparable(self) -> tuple[NDArray[np.bool_], NDArray[np.bool_], bool]:
        """Return which map frames (m,) and queries (n,) can be judged, and whether they are judged by room.

        Queries are judged by position, or by room if the map or the queries have no positions at all. `skipped` gets
        the number of frames without a position or a room.

        Raises:
            DataError: the map and the queries share neither positions nor rooms, or some frames lack them and
                `on_error` is "raise".
        """
        tables = {"map frames": self.known.frames, "queries": self.queries}
        by_room = any(not frames.has_position.any() for frames in tables.values())
        masks = {what: frames.room != "" if by_room else frames.has_position for what, frames in tables.items()}
        for what, has in masks.items():
            remedy = ", and not all tables have positions: give x and y, or rooms, in a manifest"
            lacks = f"{what} have no {'room label' if by_room else 'position'}"
            self.leave_out(has, lacks, f"{self.name}, {what}", remedy)
        return masks["map frames"], masks["queries"], by_room

    def about(self) -> dict[str, Any]:
        """Return what is evaluated (data, protocol and descriptor) as plain values."""
        known = self.known.made.get("data", {})
        return {
            "data": {
                "queries": {**self.queries.source, "sequences": list(self.queries.rows_by("sequence"))},
                "map": {**known, "sequences": list(self.known.frames.rows_by("sequence"))},
            },
            "protocol": self.protocol.kind,
            "descriptor": self.known.descriptor.identity,
            "distance": self.known.distance,
            **({} if self.known.heading is None else {"heading": self.known.heading}),
        }

    def finished(self, result: Result, task: Settings, **about: Any) -> Result:
        """Return a result with the name, the settings and the remarks of the session.

        Args:
            result: the result of a task.
            task: settings of the task.
            **about: what else was evaluated, as plain values.
        """
        settings = {
            "task": task.plain(),
            "protocol": self.protocol.plain(),
            "data": {**self.queries.source, **self.images.settings()},
            "baselines": list(self.baselines),
            "seed": self.seed,
        }
        return replace(
            result,
            name=self.name,
            about={**self.about(), **result.about, **about},
            settings=settings,
            skipped={**result.skipped, **self.skipped},
        )

    def _check_apart(self) -> None:
        """Refuse queries and validation frames from the map's own run, unless the protocol allows them."""
        for where, frames, why in (
            ("in the map", self.known.frames, "nothing could be learned of the errors on another day"),
            ("among the queries", self.queries, "the result would not be honest"),
        ):
            if self.validation is not None and (what := shared_with(frames, self.validation)):
                raise ConfigError(
                    f"{what} is {where} and in the validation, so that {why}: validate on another sequence"
                )
        if self.protocol.kind == "same_run" or self.protocol.excludes:
            return
        if what := shared_with(self.known.frames, self.queries):
            raise ConfigError(
                f"{what} is in the map and among the queries, so that the result would not be honest: query another "
                "sequence, leave out map frames near the query by protocol.leave_one_out=true, "
                "protocol.apart_seconds=T or protocol.apart_metres=D (in Python protocol=Protocol(apart_metres=D)), or "
                "say protocol.kind=same_run (protocol='same_run')"
            )


def cost(known: VisualMap, clock: Stopwatch) -> dict[str, Any]:
    """Return time and memory of a method ([T] figures 3.17-3.47, table 5.19), for "cost" in `results.json`.

    Returns:
        describe_ms, search_ms, heading_ms: time per image, in batches as processed, without decoding. None for a step
        that was not run.
        numbers: numbers in the position part of a descriptor.
        bytes: bytes of a map frame, including its orientation part.
        map_frames: number of frames searched.
    """
    return {
        **{f"{step}_ms": clock.ms(step) for step in ("describe", "search", "heading")},
        "numbers": known.width,
        "bytes": known.bytes // len(known),
        "map_frames": len(known),
    }


def shared_with(known: FrameTable, frames: FrameTable) -> str:
    """Return a text with the first sequence or image that two tables share; empty if there is none."""
    sequences = sorted(set(known.sequence.tolist()) & set(frames.sequence.tolist()))
    copies = np.flatnonzero(np.isin(frames.path, known.path))
    if sequences:
        return f"sequence {sequences[0]!r}"
    return f"image {frames.path[copies[0]]}" if len(copies) else ""


def _readable(images: PanoramaLibrary, frames: FrameTable, what: str) -> FrameTable:
    found = images.readable(frames)
    if not len(found):
        raise DataError(f"none of the images of the {len(frames)} {what} could be read")
    return found


def as_protocol(protocol: Protocol | Mapping[str, Any] | str) -> Protocol:
    """Return a protocol that is given as an object, by its fields, or by its kind.

    Raises:
        ConfigError: an unknown kind or field.
    """
    if isinstance(protocol, Protocol):
        return protocol
    return Protocol.of({"kind": protocol} if isinstance(protocol, str) else protocol)


def _named(baselines: Baselines, circular: bool) -> dict[str, Descriptor]:
    """Return the baselines' descriptors by name; a descriptor given by its name has its default parameters."""
    if isinstance(baselines, Mapping):
        return dict(baselines)
    baselines = [baselines] if isinstance(baselines, str | Descriptor) else baselines
    return {one if isinstance(one, str) else one.name: descriptor_from(one, circular=circular) for one in baselines}
