"""Kinds of experiments: each makes one or two calls of the library and returns records.

Nothing here uses published numbers: measured numbers come from images only.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from analytic import Description, descriptor
from foundation.files import content_key
from siamloc import evaluation, maps
from siamloc.data import DataSettings, FrameTable, PanoramaLibrary, Role, room_sizes
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation.absolute import evaluate_absolute
from siamloc.evaluation.result import Result
from siamloc.maps import CoarseLayer, VectorIndex, VisualMap, headings, match
from siamloc.reproduce.published import Record
from siamloc.reproduce.recipe_book import Job, data_named
from siamloc.stopwatch import Stopwatch

_REMEMBERED = 3


@dataclass
class Data:
    """A data set, opened on demand.

    Attributes:
        name: a name in `recipe_book.yaml`.
        root: folder of the data set.
        image_size: rows and columns of a panorama.
        work: folder for training runs in progress.
    """

    name: str
    root: Path
    image_size: tuple[int, int]
    work: Path
    _described: dict[str, VisualMap] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        if not self.root.is_dir():
            raise DataError(
                f"{data_named(self.name)['title']} is expected in {self.root}, which does not exist: {self._how}"
            )

    @property
    def _how(self) -> str:
        return str(data_named(self.name)["how"])

    @cached_property
    def settings(self) -> DataSettings:
        """How to read it."""
        size = self.image_size
        return DataSettings.of({"kind": "cold", "name": self.name, "root": str(self.root), "image_size": list(size)})

    @cached_property
    def frames(self) -> FrameTable:
        """All frames."""
        return self.settings.read()

    @cached_property
    def images(self) -> PanoramaLibrary:
        """Their panoramas."""
        return self.settings.library(self.frames, data_named(self.name)["unwrap"])

    @cached_property
    def other(self) -> Data:
        """Another building, in a folder next to it."""
        about = data_named(self.name)["other"]
        return Data(about["name"], self.root.parent / about["folder"], self.image_size, self.work)

    def described(self, options: Mapping[str, Any], role: Mapping[str, Any]) -> VisualMap:
        """Return the map of a role's frames by a descriptor; the last few are cached.

        Args:
            options: the descriptor's name and parameters.
            role: the frames.
        """
        key = content_key([dict(options), dict(role)])
        if key not in self._described:
            for oldest in list(self._described)[:-_REMEMBERED]:
                del self._described[oldest]
            by = "pretrained" if options["name"] == "pretrained" else descriptor(**options)
            self._described[key] = maps.build(by, self.images, self.role(role), distance="euclidean", progress=False)
        return self._described[key]

    def role(self, role: Mapping[str, Any]) -> FrameTable:
        """Return the frames of a role; with `one_in`, only every n-th of the selected frames.

        Raises:
            DataError: a run that does not exist.
        """
        names, chosen = data_named(self.name)["runs"], dict(role)
        runs, one_in = chosen.pop("runs"), chosen.pop("one_in", 1)
        missing = [run for run in runs if run not in names]
        if missing:
            raise DataError(f"{data_named(self.name)['title']} has no run {missing[0]}: {self._how}")
        patterns = tuple(names[run] for run in runs)
        try:
            found = Role.of({**chosen, "sequences": list(patterns)}).select(self.frames)
        except ConfigError as error:
            raise DataError(f"{self.root} lacks a drive that the recipe needs ({error}): {self._how}") from error
        return self.images.readable(found.every(one_in))


Measured = Iterator[Record]


def retrieval(job: Job, data: Data) -> Measured:
    """Find the nearest map frame with each distance ([T] 3.5.1-3.5.2): hit rate, error, time and size."""
    frames, clock = data.role(job.roles["query"]), Stopwatch()
    own = _described(job.options["descriptor"], job, data)
    list(maps.describe(own, data.images, frames.take([0])))  # keeps one-time setup out of the query times
    queries = Description.concatenate(list(maps.describe(own, data.images, frames, clock=clock)))
    described = clock.ms("describe") or 0.0
    for place in _compared(own, job.options):
        distance, search = place.distance, Stopwatch()
        with search.of("search", len(frames)):
            found = match(place, queries, min(20, len(own)))
        turned = headings(place, queries, found)[:, 0]
        result = evaluate_absolute(place, None, frames, (0.5, 1.0), (1,), found, turned)
        overall, settings = result.measures, {**job.settings, "distance": distance}
        yield Record("hit_rate", overall["hit_rate"][0]["rate"], settings)
        yield Record("hit_rate_0_5_m", overall["hit_rate"][1]["rate"], settings)
        yield Record("error", overall["error"]["mean"], {**settings, "lighting": "overall"})
        for lighting, group in overall["lighting"].items():
            yield Record("error", group["error"]["mean"], {**settings, "lighting": lighting})
        yield Record("floor", overall["floor"]["mean"], settings)
        yield Record("seconds", (described + (search.ms("search") or 0.0)) / 1000, settings)
        yield Record("descriptor_size", place.width, settings)


def disturbed(job: Job, data: Data) -> Measured:
    """Disturb the queries ([T] 3.5.2-3.5.4): errors of the position, and of the heading at the nearest frame."""
    frames, options = data.role(job.roles["query"]), job.options
    own = _described(options["descriptor"], job, data)
    for place in _compared(own, options):
        distance = place.distance
        result = evaluation.robustness(
            place,
            data.images,
            frames,
            every=1,
            noise=tuple(options.get("noise", ())),
            occlusion=tuple(options.get("occlusion", ())),
            turn=(),
            name="measured",
        )
        cost = result.cost
        for name, curve in result.measures["methods"]["measured"].items():
            for one in curve:
                level = {name: one["level"]} if one["level"] else {"noise": 0, "occlusion": 0}
                settings = {**job.settings, "distance": distance, **level}
                yield Record("error", one["mean"], settings)
                if one["heading_nearest"] == one["heading_nearest"]:
                    yield Record("heading_error", one["heading_nearest"], settings)
        if cost["heading_ms"] is not None:
            yield Record("heading_seconds", cost["heading_ms"] / 1000, {**job.settings, "distance": distance})


def mapping(job: Job, data: Data) -> Measured:
    """Group a drive into nodes ([T] 4.5-4.6, [I] 6): silhouette, number of nodes, frames in no node, time."""
    known = next(_compared(_described(job.options["descriptor"], job, data), {}))
    yield from _grouped(known, job.options["build"], job.settings)
    yield Record("frames", len(known), job.settings)


def matched(job: Job, data: Data) -> Measured:
    """Group a drive with the incremental mapper, then into as many nodes by spectral clustering ([T] table 4.3)."""
    known = next(_compared(_described(job.options["descriptor"], job, data), {}))
    incremental = list(_grouped(known, job.options["build"], {**job.settings, "method": "incremental"}))
    nodes = next(int(one.value) for one in incremental if one.measure == "nodes")
    spectral = _grouped(known, {"name": "spectral", "nodes": nodes}, {**job.settings, "method": "spectral"})
    yield Record("nodes", nodes, job.settings)
    yield from (one for one in (*incremental, *spectral) if one.measure != "nodes")


def _grouped(known: VisualMap, build: Mapping[str, Any], settings: Mapping[str, Any]) -> Measured:
    way = dict(build)
    built = maps.group(known, way.pop("name"), progress=False, **way)
    measures = evaluation.mapping(known, built).parts["mapping"]
    yield Record("silhouette", measures["silhouette"]["pooled"], settings)
    yield Record("silhouette_nearest", measures["silhouette"]["nearest"], settings)
    yield Record("nodes", measures["nodes"], settings)
    yield Record("unassigned", measures["unassigned"]["share"], settings)
    yield Record("clustering_seconds", float(built.seconds.sum()), settings)


def growing(job: Job, data: Data) -> Measured:
    """Count the nodes as a map grows ([T] figures 4.13-4.15)."""
    from analytic.mapper import IncrementalMapper

    known = _described(job.options["descriptor"], job, data)
    way = {key: value for key, value in job.options["build"].items() if key != "name"}
    mapper = IncrementalMapper(known.descriptor, **way)
    marks = {round(share * len(known) / job.options["steps"]) for share in range(1, job.options["steps"] + 1)}
    poses = np.column_stack([known.frames.xy, known.frames.theta])
    for row in range(len(known)):
        mapper.add(known.description.take(slice(row, row + 1)), poses[row].tolist())
        if row + 1 in marks:
            yield Record("nodes", len(mapper.nodes), {**job.settings, "frames_seen": row + 1})


def compact(job: Job, data: Data) -> Measured:
    """Locate in compact maps ([C] 5.2-5.4): errors at node positions and inside nodes, compactness, times."""
    frames, options = data.role(job.roles["query"]), job.options
    own = _described(options["descriptor"], job, data)
    clusters = None
    if "clusters" in options:
        clusters = _described(options["clusters"], job, data)
    nodes = tuple(n for n in options["nodes"] if n <= len(own))
    for place in _compared(own, options):
        distance = place.distance
        result = evaluation.compact(
            place,
            data.images,
            frames,
            clusters=clusters,
            protocol="same_run" if job.same_run else "cross_run",
            nodes=nodes,
            ways=tuple(options["ways"]),
        )
        asked = [(way, n) for way in options["ways"] for n in nodes]
        for (way, n), one in zip(asked, result.measures["curves"], strict=True):
            method = {"method": {"sample": "sampling"}.get(way, way), "clusters": n}
            settings = {**job.settings, "distance": distance, **method}
            yield Record("error", one["error"]["mean"], settings)
            yield Record("error_frames", one["error_frames"]["mean"], settings)
            yield Record("floor", one["floor"], settings)
            yield Record("seconds", (result.cost["describe_ms"] + one["search_ms"]) / 1000, settings)
            if way != "sample":
                yield Record("silhouette", one["silhouette"], settings)
                yield Record("descriptor_silhouette", one["descriptor_silhouette"], settings)
                yield Record("inertia", one["inertia"], settings)
                yield Record("clustering_seconds", one["build_seconds"], settings)


def buildings(job: Job, data: Data) -> Measured:
    """Choose between two buildings by the nearest node of their compact maps ([C] 5.3.3)."""
    options, distance = job.options, job.options["distance"]
    both = (data, data.other)
    own = [_described(options["descriptor"], job, one).with_distance(distance) for one in both]
    clusters = [_described(options["clusters"], job, one) for one in both]
    asked = [
        Description.concatenate(list(maps.describe(own[0], one.images, one.role(job.roles["query"])))) for one in both
    ]
    for nodes in options["nodes"]:
        if nodes > min(map(len, own)):
            continue
        labels = [maps.group(one, "spectral", nodes=nodes, progress=False).layer.labels for one in clusters]
        layers = [CoarseLayer.of_labels(known, label) for known, label in zip(own, labels, strict=True)]
        indices = [VectorIndex(layer.representatives, distance) for layer in layers]
        right = [
            np.argmin([index.search(queries.position, 1).distances[:, 0] for index in indices], axis=0) == place
            for place, queries in enumerate(asked)
        ]
        settings = {**job.settings, "distance": distance, "clusters": nodes}
        yield Record("building_accuracy", float(np.concatenate(right).mean()), settings)


def rooms(job: Job, data: Data) -> Measured:
    """Measure the size of rooms ([T] table 5.5)."""
    for room, (frames, largest) in room_sizes(data.role(job.roles["map"])).items():
        code = room.rpartition("/")[2]
        yield Record("room_diameter", largest, {**job.settings, "room": code})
        yield Record("frames", frames, {**job.settings, "room": code})


def trained(job: Job, data: Data) -> Measured:
    """Train a siamese network, then use it to distinguish rooms ([T] 5.4.1) or to locate ([T] 5.4.2-5.4.3)."""
    options = job.options
    pairs = dict(options["pairs"])
    told = {key: options[key] for key in ("branch", "head", "epochs", "batch_size")}
    told |= {"same_share": pairs["same_room_share"], **job.settings}
    if pairs["epoch_pairs"] is not None:
        pairs["epoch_pairs"] = max(4, round(pairs["epoch_pairs"] * options.get("share_of_pairs", 1)))
    with _learned(job, data, batch_size=options["batch_size"], pairs=pairs) as own:
        queries = data.role(job.roles["query"])
        if pairs["label"] == "room":
            yield from _judged_pairs(own, job, data, queries, told)
        else:
            yield from _located(evaluation.localization(own, data.images, queries, names=("absolute",)), own, told)
        if options.get("in_rooms"):
            yield from _inside_rooms(own, data, queries, told)


def named_rooms(job: Job, data: Data) -> Measured:
    """Train a network to classify the room, then locate inside that room ([T] table 5.19, single network)."""
    from siamloc.models import CrossEntropyLoss

    told = {key: job.options[key] for key in ("branch", "head", "epochs")} | dict(job.settings)
    with _learned(job, data, loss=CrossEntropyLoss(), pairs=job.options["pairs"]) as own:
        layer = maps.group(own, "rooms", progress=False)
        queries = data.role(job.roles["query"])
        result = evaluation.hierarchical(own, data.images, queries, layer, candidates=1, coarse={"by": "classifier"})
        yield from _located(result, own, told)


@contextmanager
def _learned(job: Job, data: Data, **training_options: Any) -> Iterator[VisualMap]:
    """Train the network of a job and describe the job's map with it; the run is deleted once its records are made."""
    from siamloc import models, training

    options = job.options
    network = models.build(
        options["branch"], options["head"], image_size=data.image_size, weights=options.get("weights"), seed=0
    )
    folder = data.work / content_key(job.plain())
    training.fit(
        network,
        data.images,
        data.role(job.roles["train"]),
        run=folder,
        augmentation=options.get("augment"),
        resume=(folder / "run.json").is_file(),  # continues an interrupted run
        epochs=options["epochs"],
        optimizer=options["optimizer"],
        **training_options,
    )
    yield maps.build(models.as_descriptor(network), data.images, data.role(job.roles["map"]), progress=False)
    shutil.rmtree(folder)


def _judged_pairs(own: VisualMap, job: Job, data: Data, queries: FrameTable, told: Mapping[str, Any]) -> Measured:
    """Distinguish pairs of one room from pairs of two, among the training frames and among the queries."""
    asked = {"count": job.options["judged"], "same_room_share": 0.5}
    for phase, frames in (("train", data.role(job.roles["train"])), ("test", queries)):
        judged = evaluation.localization(
            own, data.images, frames, names=("room_retrieval",), pairs=asked, protocol="same_run"
        ).parts["room_pairs"]["overall"]
        for pairs in ("overall", "same", "different"):
            yield Record("accuracy", judged[pairs], {**told, "phase": phase, "pairs": pairs})


def _located(result: Result, own: VisualMap, told: Mapping[str, Any]) -> Measured:
    """Yield the errors of a localization by lighting, their floors, and the size of the descriptor."""
    for lighting, group in {"overall": result.measures, **result.measures["lighting"]}.items():
        yield Record("error", group["error"]["mean"], {**told, "lighting": lighting})
        yield Record("floor", group["floor"]["mean"], {**told, "lighting": lighting})
    yield Record("descriptor_size", own.width, told)


def _inside_rooms(own: VisualMap, data: Data, queries: FrameTable, told: Mapping[str, Any]) -> Measured:
    """Locate each query only inside its true room ([T] table 5.15)."""
    layer = maps.group(own, "rooms", progress=False)
    columns = evaluation.hierarchical(own, data.images, queries, layer, candidates=1).tables["queries"]
    for room in np.unique(columns["room"]).tolist():
        for lighting in np.unique(columns["lighting"]).tolist():
            rows = (columns["room"] == room) & (columns["lighting"] == lighting)
            if rows.any():
                settings = {**told, "room": room.rpartition("/")[2], "lighting": lighting}
                yield Record("error", float(columns["error_perfect_coarse"][rows].mean()), settings)


KINDS: dict[str, Callable[[Job, Data], Measured]] = {
    "retrieval": retrieval,
    "disturbed": disturbed,
    "mapping": mapping,
    "matched": matched,
    "growing": growing,
    "compact": compact,
    "buildings": buildings,
    "rooms": rooms,
    "trained": trained,
    "named_rooms": named_rooms,
}


def measured(job: Job, data: Data) -> Sequence[Record]:
    """Return the records of a job, without values that are not finite.

    Raises:
        SiamlocError: the data lack what the job needs.
    """
    return [replace(one, value=float(one.value)) for one in KINDS[job.kind](job, data) if np.isfinite(one.value)]


def _compared(own: VisualMap, options: Mapping[str, Any]) -> Iterator[VisualMap]:
    """Yield the map with each requested distance, without those that are meaningless for so few numbers."""
    for distance in options.get("distances") or [own.descriptor.default_distance]:
        try:
            yield own.with_distance(distance)
        except ConfigError:
            continue


def _described(options: Mapping[str, Any], job: Job, data: Data) -> VisualMap:
    """Return the map of a job by a descriptor."""
    return data.described(options, job.roles["map"])


def image_size(job: Job) -> tuple[int, int]:
    """Return the rows and columns of a job's panoramas: the published size unless it sets another."""
    from siamloc.models.registry import PRETRAINED_SIZE

    if "image_size" in job.options:
        rows, columns = job.options["image_size"]
        return rows, columns
    named = job.options.get("descriptor", {}).get("name")
    return PRETRAINED_SIZE if named == "pretrained" else (128, 512)


def information(job: Job) -> float:
    """Return the size of the position part of a job's descriptor, as a share of the number of pixels."""
    rows, columns = image_size(job)
    position, _ = descriptor(**job.options["descriptor"]).sizes(rows, columns)
    return prod(position) / (rows * columns)
