"""A map in one file: arrays without pickles, with a header in JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Description
from analytic.mapper.growth import State
from analytic.mapper.node import Gallery, Mode, Node
from analytic.mapper.parameters import Parameters
from foundation.arrays import DAMAGE, read_headed, write_arrays
from foundation.errors import FormatError

FORMAT = "topological map"
VERSION = 3

Arrays = Mapping[str, NDArray[Any]]

_PARTS = ("frames", "held", "points", "centre", "mean", "scatter")  # of a mode; the scatter may be missing
_AGAIN = "build the map again"


def save(path: str | Path, state: State, poses: list[Any], identity: Mapping[str, Any], lines: list[str]) -> None:
    """Write a map under a temporary name and rename it.

    Raises:
        StorageError: a path that cannot be written.
    """
    nodes = [*state.ordered(), *state.parked]
    head = {
        "format": FORMAT,
        "version": VERSION,
        "parameters": asdict(state.rules),
        "descriptor": identity,
        "nodes": [[node.id, len(node.modes)] for node in nodes],
        "parked": len(state.parked),
        "pending": state.pending,
        "next_id": state.next_id,
        "poses": poses,
    }
    log = np.frombuffer("\n".join(lines).encode(), dtype=np.uint8)
    arrays: dict[str, NDArray[Any]] = {"log": log, "labels": state.labels, "matches": state.matches}
    galleries = {"recent": Gallery.of(*zip(*state.recent, strict=True))} if state.recent else {}
    for node in nodes:
        for index, mode in enumerate(node.modes):
            name = f"node{node.id}.{index}"
            galleries[name] = mode.gallery
            arrays |= {f"{name}.{part}": getattr(mode, part) for part in _PARTS if getattr(mode, part) is not None}
    for name, gallery in galleries.items():
        arrays |= {f"{name}.shown": gallery.frames, f"{name}.position": gallery.shown.position}
        if gallery.shown.orientation is not None:
            arrays[f"{name}.orientation"] = gallery.shown.orientation
    write_arrays(path, head, arrays)


def load(path: str | Path) -> tuple[State, list[Any], dict[str, Any], list[str]]:
    """Read a map.

    Returns:
        The map, the pose that was given with each frame, the identity of the descriptor, and the lines of the log.

    Raises:
        FormatError: a file that cannot be read, is cut short or damaged, is no map, or a map of another version.
    """
    head, arrays = read_headed(path, FORMAT, VERSION, _AGAIN)
    try:
        lines = arrays["log"].tobytes().decode().split("\n")
        return _state(head, arrays, len(lines) - 1), head["poses"], head["descriptor"], lines
    except DAMAGE as error:
        raise FormatError(f"{path} is not a {FORMAT}, or not a whole one ({error}): {_AGAIN}") from error


def _state(head: Mapping[str, Any], arrays: Arrays, calls: int) -> State:
    rules = Parameters.of(head["parameters"])
    nodes = [
        Node(key, tuple(_mode(rules, arrays, f"node{key}.{index}") for index in range(modes)))
        for key, modes in head["nodes"]
    ]
    split = len(nodes) - head["parked"]
    labels, matches = arrays["labels"], arrays["matches"]
    if not len(labels) == len(matches) == len(head["poses"]):
        raise ValueError(f"{len(labels)} labels, {len(matches)} matches and {len(head['poses'])} poses")
    return State(
        rules,
        {node.id: node for node in nodes[:split]},
        tuple(nodes[split:]),
        labels,
        matches,
        tuple(zip(*_shown("recent", arrays), strict=True)) if len(labels) else (),
        tuple(head["pending"]),
        head["next_id"],
        calls=calls,
    )


def _mode(rules: Parameters, arrays: Arrays, name: str) -> Mode:
    parts = {part: arrays[f"{name}.{part}"] for part in _PARTS[:-1]}
    return Mode(rules, **parts, scatter=arrays.get(f"{name}.scatter"), gallery=Gallery.of(*_shown(name, arrays)))


def _shown(name: str, arrays: Arrays) -> tuple[list[int], list[Description]]:
    """Return the frames of a gallery, and the description of each."""
    whole = Description(arrays[f"{name}.position"], arrays.get(f"{name}.orientation"))
    return arrays[f"{name}.shown"].tolist(), [whole.take(slice(row, row + 1)) for row in range(len(whole))]
