"""Kinds of experiments: each makes one or two calls of the library and returns records.

Nothing here uses published numbers: measured numbers come from images only.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isfinite, prod
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from analytic import Description, descriptor, disturb
from foundation.files import content_key
from siamloc import evaluation, maps
from siamloc.data import DataSettings, FrameTable, PanoramaLibrary, Role, room_sizes
from siamloc.errors import ConfigError, DataError
from siamloc.evaluation.absolute import evaluate_absolute
from siamloc.evaluation.result import Result
from siamloc.maps import CoarseLayer, VectorIndex, VisualMap, headings, match
from siamloc.reproduce.published import Record
from siamloc.reproduce.study_book import Job, data_named, folder_of
from siamloc.stopwatch import Stopwatch

_REMEMBERED = 4


@dataclass
class Data:
    """A data set for experiments, opened on demand.

    Attributes:
        name: a name in `study_book.yaml`.
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
        about = data_named(self.name)
        if not self.root.is_dir():
            raise DataError(f"{about['title']} needs the folder {self.root}, which does not exist: {about['how']}")
        size = list(self.image_size)
        self._settings = DataSettings.of(
            {"kind": "cold", "name": self.name, "root": str(self.root), "image_size": size}
        )

    @cached_property
    def frames(self) -> FrameTable:
        """All frames of the data set."""
        return self._settings.read()

    @cached_property
    def images(self) -> PanoramaLibrary:
        """The panoramas of all frames."""
        return self._settings.library(self.frames, data_named(self.name)["unwrap"])

    @cached_property
    def other(self) -> Data:
        """The data set of another building, in a folder next to this one."""
        about = data_named(self.name)["other"]
        root = folder_of(about["name"], self.root.parent / about["folder"])
        return Data(about["name"], root, self.image_size, self.work)

    def described(self, options: Mapping[str, Any], role: Mapping[str, Any], noise: float = 0.0) -> VisualMap:
        """Return the map of the frames of a role by a descriptor; the last few maps are cached.

        Args:
            options: the descriptor's name and parameters.
            role: role whose frames form the map.
            noise: variance of noise in the map's images, for an analytic descriptor.
        """
        key = content_key([options, role, noise])
        if key not in self._described:
            if len(self._described) == _REMEMBERED:
                del self._described[next(iter(self._described))]
            by = "pretrained" if options["name"] == "pretrained" else descriptor(**options)
            known = maps.build(by, self.images, self.role(role), distance="euclidean", progress=False)
            if noise:
                rng = np.random.default_rng(0)
                batches = (disturb.noise(batch, noise, rng) for batch in self.images.batches(known.frames))
                noisy = Description.concatenate([known.descriptor.describe(batch) for batch in batches])
                known = replace(known, descriptors=noisy.position, orientation=noisy.orientation)
            self._described[key] = known
        return self._described[key]

    def role(self, role: Mapping[str, Any]) -> FrameTable:
        """Return the frames of a role; with `one_in`, only every n-th of the selected frames.

        Raises:
            DataError: a drive that does not exist.
        """
        about, options = data_named(self.name), dict(role)
        options["sequences"] = [about["runs"][run] for run in options.pop("runs")]
        one_in = options.pop("one_in", 1)
        try:
            found = Role.of(options).select(self.frames)
        except ConfigError as error:
            raise DataError(f"{self.root} lacks a drive that the study needs ({error}): {about['how']}") from error
        return self.images.readable(found.every(one_in))


Measured = Iterator[Record]


def retrieval(job: Job, data: Data) -> Measured:
    """Measure the search for the nearest map frame by distance ([T] 3.5.1-3.5.2): hit rate, error, time, size."""
    frames, clock = data.role(job.roles["query"]), Stopwatch()
    own = data.described(job.options["descriptor"], job.roles["map"])
    list(maps.describe(own, data.images, frames.take([0])))  # keeps one-time setup out of the query times
    queries = Description.concatenate(list(maps.describe(own, data.images, frames, clock=clock)))
    described = clock.ms("describe") or 0.0
    for place, settings in _compared(own, job):
        search = Stopwatch()
        with search.of("search", len(frames)):
            found = match(place, queries, min(20, len(own)))
        turned = headings(place, queries, found)[:, 0]
        overall = evaluate_absolute(place, frames, found, (0.5, 1.0), (1,), turned).measures
        near, nearer = (rate["rate"] for rate in overall["hit_rate"][:2])
        yield from _records(settings, hit_rate=near, hit_rate_0_5_m=nearer)
        for lighting, group in {"overall": overall, **overall["lighting"]}.items():
            yield from _records({**settings, "lighting": lighting}, error=group["error"]["mean"])
        seconds = (described + (search.ms("search") or 0.0)) / 1000
        yield from _records(settings, floor=overall["floor"]["mean"], seconds=seconds, descriptor_size=place.width)


def disturbed(job: Job, data: Data) -> Measured:
    """Measure errors for disturbed queries ([T] 3.5.2-3.5.4), of positions and of headings at the nearest map frame.

    [T] 3.5.2 plots them over "information": numbers in the position part as a share of the number of pixels.
    """
    options, frames = job.options, data.role(job.roles["query"])
    known = data.described(options["descriptor"], job.roles["map"], options.get("map_noise", 0.0))
    seed = options.get("seed", 0)
    size = {}
    if options["descriptor"]["name"] != "pretrained":
        position, _ = descriptor(**options["descriptor"]).sizes(*data.image_size)
        size = {"information": prod(position) / prod(data.image_size)}
    levels: dict[str, Any] = {name: tuple(options.get(name, ())) for name in ("noise", "occlusion")}
    levels |= {name: options[name] for name in ("bars", "bar_colour") if name in options}
    for place, settings in _compared(known, job):
        result = evaluation.robustness(
            place, data.images, frames, every=1, turn=(), name="measured", seed=seed, **levels
        )
        for name, curve in result.measures["methods"]["measured"].items():
            for one in curve:
                level = {name: one["level"]} if one["level"] else {"noise": 0, "occlusion": 0}
                errors = {"error": one["mean"], "heading_error": one["heading_nearest"]}
                yield from _records({**settings, **level, **size}, **errors)
        if result.cost["heading_ms"] is not None:
            yield from _records({**settings, **size}, heading_seconds=result.cost["heading_ms"] / 1000)


def mapping(job: Job, data: Data) -> Measured:
    """Group a drive into nodes ([T] 4.5-4.6, [I] 6): silhouette, number of nodes, frames in no node, time."""
    known = _grouping_map(job, data)
    yield from _grouped(known, {"seed": job.options.get("seed", 0), **job.options["build"]}, job.settings)
    yield from _records(job.settings, frames=len(known))


def matched(job: Job, data: Data) -> Measured:
    """Group a drive by the incremental mapper, and into the same number of nodes by clustering ([T] table 4.3)."""
    known = _grouping_map(job, data)
    incremental = list(_grouped(known, job.options["build"], {**job.settings, "method": "incremental"}))
    nodes = next(int(one.value) for one in incremental if one.measure == "nodes")
    spectral = _grouped(known, {"name": "spectral", "nodes": nodes}, {**job.settings, "method": "spectral"})
    yield from _records(job.settings, nodes=nodes)
    yield from (one for one in (*incremental, *spectral) if one.measure != "nodes")


def _grouping_map(job: Job, data: Data) -> VisualMap:
    known = data.described(job.options["descriptor"], job.roles["map"])
    return known.with_distance(known.descriptor.default_distance)


def _grouped(known: VisualMap, build: Mapping[str, Any], settings: Mapping[str, Any]) -> Measured:
    options = dict(build)
    built = maps.group(known, options.pop("name"), progress=False, **options)
    measures = evaluation.mapping(known, built).parts["mapping"]
    silhouette, unassigned = measures["silhouette"], measures["unassigned"]["share"]
    yield from _records(settings, silhouette=silhouette["with_unassigned"], silhouette_by_node=silhouette["by_node"])
    yield from _records(settings, silhouette_assigned=silhouette["nearest"], silhouette_pooled=silhouette["pooled"])
    seconds = built.seconds.sum()
    yield from _records(settings, nodes=measures["nodes"], unassigned=unassigned, clustering_seconds=seconds)


def growing(job: Job, data: Data) -> Measured:
    """Measure nodes, frames in no node and time as a map grows ([T] figures 4.13-4.15, [I] figures S1-S2)."""
    from analytic.mapper import IncrementalMapper

    known, steps = data.described(job.options["descriptor"], job.roles["map"]), job.options["steps"]
    options = {key: value for key, value in job.options["build"].items() if key != "name"}
    mapper, start = IncrementalMapper(known.descriptor, **options), perf_counter()
    marks = {round(share * len(known) / steps) for share in range(1, steps + 1)}
    poses = np.column_stack([known.frames.xy, known.frames.theta])
    for row in range(len(known)):
        mapper.add(known.description.take(slice(row, row + 1)), poses[row].tolist())
        if row + 1 in marks:
            settings, unassigned = {**job.settings, "frames_seen": row + 1}, (mapper.labels() < 0).mean()
            seconds = perf_counter() - start
            yield from _records(settings, nodes=len(mapper.nodes), unassigned=unassigned, clustering_seconds=seconds)


def compact(job: Job, data: Data) -> Measured:
    """Locate in compact maps ([C] 5.2-5.4): errors at node positions and inside nodes, compactness, times."""
    frames, options = data.role(job.roles["query"]), job.options
    own = data.described(options["descriptor"], job.roles["map"])
    clusters = data.described(options["clusters"], job.roles["map"]) if "clusters" in options else None
    nodes, protocol = tuple(n for n in options["nodes"] if n <= len(own)), "same_run" if job.same_run else "cross_run"
    asked: dict[str, Any] = {"seed": options.get("seed", 0), "ways": tuple(options["ways"]), "clusters": clusters}
    for place, settings in _compared(own, job):
        result = evaluation.compact(place, data.images, frames, nodes=nodes, protocol=protocol, **asked)
        for one in result.measures["curves"]:
            plain = one["way"] == "sample"
            method = {"method": "sampling" if plain else one["way"], "clusters": one["nodes"]}
            values = {"error": one["error"]["mean"], "error_frames": one["error_frames"]["mean"], "floor": one["floor"]}
            values["seconds"] = (result.cost["describe_ms"] + one["search_ms"]) / 1000
            if not plain:
                values |= {name: one[name] for name in ("silhouette", "descriptor_silhouette", "inertia")}
                values["clustering_seconds"] = one["build_seconds"]
            yield from _records({**settings, **method}, **values)


def buildings(job: Job, data: Data) -> Measured:
    """Choose between two buildings by the nearest node of their compact maps ([C] 5.3.3)."""
    options, distance, role = job.options, job.options["distance"], job.roles["map"]
    own, clusters, asked = [], [], []
    for one in (data, data.other):
        own.append(one.described(options["descriptor"], role).with_distance(distance))
        clusters.append(one.described(options["clusters"], role))
        described = maps.describe(own[0], one.images, one.role(job.roles["query"]))
        asked.append(Description.concatenate(list(described)))
    for nodes in (n for n in options["nodes"] if n <= min(map(len, own))):
        indices = []
        for known, clustered in zip(own, clusters, strict=True):
            labels = maps.group(clustered, "spectral", nodes=nodes, progress=False).layer.labels
            indices.append(VectorIndex(CoarseLayer.of_labels(known, labels).representatives, distance))
        right = [
            np.argmin([index.search(queries.position, 1).distances[:, 0] for index in indices], axis=0) == place
            for place, queries in enumerate(asked)
        ]
        settings = {**job.settings, "distance": distance, "clusters": nodes}
        yield from _records(settings, building_accuracy=np.concatenate(right).mean())


def rooms(job: Job, data: Data) -> Measured:
    """Measure the number of frames and the extent of each room ([T] table 5.5)."""
    for room, (frames, largest) in room_sizes(data.role(job.roles["map"])).items():
        yield from _records({**job.settings, "room": room.rpartition("/")[2]}, room_diameter=largest, frames=frames)


def trained(job: Job, data: Data) -> Measured:
    """Train a siamese network, then use it to distinguish rooms ([T] 5.4.1) or to locate ([T] 5.4.2-5.4.3)."""
    options, pairs = job.options, dict(job.options["pairs"])
    shared = {key: options[key] for key in ("branch", "head", "epochs", "batch_size")}
    shared |= {"same_share": pairs["same_room_share"], **job.settings}
    if pairs["epoch_pairs"] is not None:
        pairs["epoch_pairs"] = max(4, round(pairs["epoch_pairs"] * options.get("share_of_pairs", 1)))
    with _learned(job, data, batch_size=options["batch_size"], pairs=pairs) as own:
        queries = data.role(job.roles["query"])
        if pairs["label"] == "room":
            yield from _judged_pairs(own, job, data, queries, shared)
        else:
            yield from _located(evaluation.localization(own, data.images, queries, names=("absolute",)), own, shared)
        if options.get("in_rooms"):
            yield from _inside_rooms(own, data, queries, shared)


def named_rooms(job: Job, data: Data) -> Measured:
    """Train a network to classify the room, then locate inside that room ([T] table 5.19, single network)."""
    from siamloc.models import CrossEntropyLoss

    shared = {key: job.options[key] for key in ("branch", "head", "epochs")} | dict(job.settings)
    with _learned(job, data, loss=CrossEntropyLoss(), pairs=job.options["pairs"]) as own:
        layer = maps.group(own, "rooms", progress=False)
        queries = data.role(job.roles["query"])
        result = evaluation.hierarchical(own, data.images, queries, layer, candidates=1, coarse={"by": "classifier"})
        yield from _located(result, own, shared)


@contextmanager
def _learned(job: Job, data: Data, **training_options: Any) -> Iterator[VisualMap]:
    """Train the network of a job and describe the job's map with it; the run is deleted once its records are made."""
    from siamloc import models, training

    options, folder = job.options, data.work / content_key(job.plain())
    weights, seed = options.get("weights"), options.get("seed", 0)
    network = models.build(options["branch"], options["head"], image_size=data.image_size, weights=weights, seed=seed)
    training.fit(
        network,
        data.images,
        data.role(job.roles["train"]),
        run=folder,
        augmentation=options.get("augment"),
        resume=(folder / "run.json").is_file(),  # continues an interrupted run
        seed=seed,
        epochs=options["epochs"],
        optimizer=options["optimizer"],
        **training_options,
    )
    yield maps.build(models.as_descriptor(network), data.images, data.role(job.roles["map"]), progress=False)
    shutil.rmtree(folder)


def _judged_pairs(own: VisualMap, job: Job, data: Data, queries: FrameTable, shared: Mapping[str, Any]) -> Measured:
    """Distinguish pairs of one room from pairs of two, among the training frames and among the queries."""
    asked: dict[str, Any] = {"pairs": {"count": job.options["judged"], "same_room_share": 0.5}, "protocol": "same_run"}
    for phase, frames in (("train", data.role(job.roles["train"])), ("test", queries)):
        result = evaluation.localization(own, data.images, frames, names=("room_retrieval",), **asked)
        judged = result.parts["room_pairs"]["overall"]
        for pairs in ("overall", "same", "different"):
            yield from _records({**shared, "phase": phase, "pairs": pairs}, accuracy=judged[pairs])


def _located(result: Result, own: VisualMap, shared: Mapping[str, Any]) -> Measured:
    """Yield the errors of a localization by lighting, their floors, and the size of the descriptor."""
    for lighting, group in {"overall": result.measures, **result.measures["lighting"]}.items():
        means = {"error": group["error"]["mean"], "floor": group["floor"]["mean"]}
        yield from _records({**shared, "lighting": lighting}, **means)
    yield from _records(shared, descriptor_size=own.width)


def _inside_rooms(own: VisualMap, data: Data, queries: FrameTable, shared: Mapping[str, Any]) -> Measured:
    """Locate each query only inside its true room ([T] table 5.15)."""
    layer = maps.group(own, "rooms", progress=False)
    columns = evaluation.hierarchical(own, data.images, queries, layer, candidates=1).tables["queries"]
    for room, lighting in sorted(set(zip(columns["room"].tolist(), columns["lighting"].tolist(), strict=True))):
        rows = (columns["room"] == room) & (columns["lighting"] == lighting)
        settings = {**shared, "room": room.rpartition("/")[2], "lighting": lighting}
        yield from _records(settings, error=columns["error_perfect_coarse"][rows].mean())


KINDS: dict[str, Callable[[Job, Data], Measured]] = {
    kind.__name__: kind
    for kind in (retrieval, disturbed, mapping, matched, growing, compact, buildings, rooms, trained, named_rooms)
}


def measured(job: Job, data: Data) -> list[Record]:
    """Run a job and return its records.

    Raises:
        SiamlocError: the data lack what the job needs.
    """
    return list(KINDS[job.kind](job, data))


def _records(settings: Mapping[str, Any], **values: Any) -> Measured:
    """Yield a record for each measure whose value is known and finite."""
    for measure, value in values.items():
        if value is not None and isfinite(value):
            yield Record(measure, float(value), settings)


def _compared(own: VisualMap, job: Job) -> Iterator[tuple[VisualMap, dict[str, Any]]]:
    """Yield the map with each distance of a job, and the settings of its records.

    Distances that are meaningless for so few numbers are left out.
    """
    for distance in job.options.get("distances") or [own.descriptor.default_distance]:
        with suppress(ConfigError):
            yield own.with_distance(distance), {**job.settings, "distance": distance}


def image_size(job: Job) -> tuple[int, int]:
    """Return the rows and columns of a job's panoramas: the published size unless it sets another."""
    from siamloc.models.registry import PRETRAINED_SIZE

    if "image_size" in job.options:
        rows, columns = job.options["image_size"]
        return rows, columns
    named = job.options.get("descriptor", {}).get("name")
    return PRETRAINED_SIZE if named == "pretrained" else (128, 512)
