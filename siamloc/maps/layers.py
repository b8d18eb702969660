"""Building the coarse layer of a map: by rooms, by clustering, or frame by frame."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from analytic import Descriptor
from siamloc.errors import ConfigError, DataError, hint
from siamloc.maps.coarse import CoarseLayer
from siamloc.maps.visual_map import VisualMap

if TYPE_CHECKING:
    from analytic.mapper import Decision, IncrementalMapper

BUILDS = ("rooms", "sample", "spectral", "som", "incremental")
Progress = Callable[[Iterable[Any], int, str], Iterable[Any]]


@dataclass(frozen=True)
class Built:
    """A coarse layer and how it came about.

    Attributes:
        layer: nodes over the frames of the map.
        seconds: what each frame took (n,) where frames came one by one; what all of them took (1,) otherwise.
        mapper: the incremental map; None for the other ways.
        decisions: of the incremental mapper, one for each frame, as they were made at the time.
    """

    layer: CoarseLayer
    seconds: NDArray[np.float64]
    mapper: IncrementalMapper | None = None
    decisions: tuple[Decision, ...] = ()


def build_layer(
    known: VisualMap,
    descriptor: Descriptor,
    options: Mapping[str, Any],
    seed: int = 0,
    progress: Progress | None = None,
) -> Built:
    """Build the coarse layer of a map.

    Args:
        known: n frames in capture order, described by `descriptor`.
        descriptor: what made the map.
        options: `name`, one of BUILDS, and its parameters: `nodes` of sample and spectral; `sigma`, `neighbours` and
            `assign` of spectral; `grid` of som; those of `analytic.mapper.Parameters`.
        seed: of clusterings.
        progress: called with (items, total, what), yields the items; for a bar.

    Raises:
        ConfigError: an unknown way.
        DataError: no frame has a room label, or no frame came into a node.
        AnalyticError: an unknown parameter, one out of range, or descriptors that cannot be clustered.
    """
    options = dict(options)
    name = options.pop("name")
    if name not in BUILDS:
        raise ConfigError(f"unknown build {name!r}: {hint(str(name), BUILDS)}")
    if name == "incremental":
        return _grown(known, descriptor, options, progress)
    start = time.perf_counter()
    if name == "rooms":
        layer = CoarseLayer.of_rooms(known)
    else:
        labels = _clustered(known, descriptor, name, options, seed)
        layer = CoarseLayer.of_labels(known, labels, made={"name": name, **options, "seed": seed})
    return Built(layer, np.array([time.perf_counter() - start]))


def _clustered(
    known: VisualMap, descriptor: Descriptor, name: str, options: dict[str, Any], seed: int
) -> NDArray[np.int64]:
    from analytic import clustering

    if name == "sample":
        return clustering.sample(len(known), options["nodes"])
    if descriptor.aligned:
        raise ConfigError(
            f"build={name} needs descriptors that a turn leaves as they are, and those of {descriptor.name} have to be "
            "aligned first: use build=incremental, sample or rooms, or another descriptor"
        )
    if name == "som":
        return clustering.som(known.descriptors, options["grid"], seed=seed)
    return clustering.spectral(
        known.descriptors,
        options["nodes"],
        sigma=options["sigma"],
        neighbours=options["neighbours"],
        seed=seed,
        assign=options["assign"],
    )


def _grown(known: VisualMap, descriptor: Descriptor, options: dict[str, Any], progress: Progress | None) -> Built:
    from analytic.mapper import IncrementalMapper

    mapper = IncrementalMapper(descriptor, **options)
    seconds, decisions = np.zeros(len(known)), []
    poses = np.column_stack([known.frames.xy, known.frames.theta])
    rows: Iterable[int] = range(len(known))
    for row in progress(rows, len(known), "mapping") if progress else rows:
        one = known.description.take(slice(row, row + 1))
        start = time.perf_counter()
        decisions.append(mapper.add(one, _pose(poses[row])))
        seconds[row] = time.perf_counter() - start
    labels = mapper.labels()
    ids = [node.id for node in mapper.nodes]
    if not ids:
        raise DataError(
            f"the mapper made no node of {len(known)} frames: give it more frames, or lower build.first_node"
        )
    numbered = np.full(len(labels), -1, dtype=np.int64)
    for number, node in enumerate(ids):
        numbered[labels == node] = number
    made = {"name": "incremental", **options, "ids": ids}
    return Built(CoarseLayer.of_labels(known, numbered, made=made), seconds, mapper, tuple(decisions))


def _pose(values: NDArray[np.float64]) -> list[float] | None:
    return values.tolist() if np.isfinite(values).all() else None
