"""A map in one file: npz without pickles, with a header in JSON."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Description, Descriptor
from analytic.descriptors.registry import DESCRIPTORS, descriptor
from analytic.errors import AnalyticError
from analytic.mapper.growth import State
from analytic.mapper.node import Gallery, Mode, Node
from analytic.mapper.parameters import Parameters
from foundation.arrays import DAMAGE, read_arrays
from foundation.files import write_bytes

FORMAT = "analytic.mapper"
VERSION = 2

Arrays = Mapping[str, NDArray[Any]]

_PARTS = ("frames", "held", "points", "centre", "mean", "scatter")  # of a mode; the scatter may be missing


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
    arrays: dict[str, NDArray[Any]] = {"header": _text(json.dumps(head, default=str)), "log": _text("\n".join(lines))}
    arrays |= {"labels": state.labels, "matches": state.matches}
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
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    write_bytes(path, buffer.getvalue())


def load(path: str | Path) -> tuple[State, list[Any], dict[str, Any], list[str]]:
    """Read a map.

    Returns:
        The map, the pose that was given with each frame, the identity of the descriptor, and the lines of the log.

    Raises:
        AnalyticError: a path that cannot be read, or a file that is cut short, not a map, or of another version.
    """
    try:
        arrays = read_arrays(path)
        head = json.loads(_string(arrays["header"]))
        if (head["format"], head["version"]) != (FORMAT, VERSION):
            raise AnalyticError(
                f"{path} has the format {head['format']!r} in version {head['version']}, and this program reads "
                f"{FORMAT!r} in version {VERSION}: build the map again"
            )
        lines = _string(arrays["log"]).split("\n")
        return _state(head, arrays, len(lines) - 1), head["poses"], head["descriptor"], lines
    except AnalyticError:
        raise
    except DAMAGE as error:
        raise AnalyticError(
            f"{path} cannot be read, is not a map, or is damaged or cut short ({error!r}): give a whole file that "
            "`save` wrote"
        ) from error


def descriptor_of(identity: Mapping[str, Any], path: str | Path) -> Descriptor:
    """Make the descriptor that a map was built with, if it belongs to this package.

    Raises:
        AnalyticError: a descriptor that is not part of this package.
    """
    if identity.get("name") not in DESCRIPTORS:
        raise AnalyticError(
            f"the map {path} was made with the descriptor {identity.get('name')!r}, which is not one of "
            f"{', '.join(DESCRIPTORS)}: give it as `descriptor`"
        )
    # JSON has only lists, where a parameter may be a tuple.
    params = {key: tuple(v) if isinstance(v, list) else v for key, v in identity.items() if key != "name"}
    return descriptor(identity["name"], **params)


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


def _text(text: str) -> NDArray[np.uint8]:
    return np.frombuffer(text.encode(), dtype=np.uint8)


def _string(array: NDArray[Any]) -> str:
    return array.tobytes().decode()
