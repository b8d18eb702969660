"""A map in one file: npz without pickles, with a header in JSON."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic.arrays_file import DAMAGE, read_arrays
from analytic.descriptors.base import Description, Descriptor
from analytic.descriptors.registry import DESCRIPTORS, descriptor
from analytic.errors import AnalyticError
from analytic.mapper.frames import Gallery, Rows
from analytic.mapper.graph import write
from analytic.mapper.node import Mode, Node
from analytic.mapper.parameters import Parameters, parameters
from analytic.mapper.state import State
from analytic.mapper.statistics import Model, Moments

FORMAT = "analytic.mapper"
VERSION = 1

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Stored:
    """The contents of a file.

    Attributes:
        state: the map.
        poses: the pose that was given with each frame.
        identity: identity of the descriptor.
        lines: lines of the log.
    """

    state: State
    poses: list[Any]
    identity: dict[str, Any]
    lines: list[str]


def save(path: str | Path, state: State, poses: list[Any], identity: Mapping[str, Any], lines: list[str]) -> None:
    """Write a map under a temporary name and rename it.

    Raises:
        AnalyticError: a path that cannot be written.
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
    arrays |= _descriptions("recent", [frame for frame, _ in state.recent], [d for _, d in state.recent])
    for node in nodes:
        for index, mode in enumerate(node.modes):
            arrays |= _mode_arrays(f"node{node.id}.{index}", mode)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    write(path, buffer.getvalue())


def load(path: str | Path) -> Stored:
    """Read a map.

    Raises:
        AnalyticError: a path that cannot be read, or a file that is cut short, not a map, or of a newer version.
    """
    try:
        arrays = read_arrays(path)
        head = json.loads(_string(arrays["header"]))
        if head["format"] != FORMAT:
            raise ValueError(f"format {head['format']!r}")
        if head["version"] > VERSION:
            raise AnalyticError(
                f"{path} has format version {head['version']}, and this program reads up to {VERSION}: use a newer one"
            )
        lines = _string(arrays["log"]).split("\n")
        return Stored(_state(head, arrays, len(lines) - 1), head["poses"], head["descriptor"], lines)
    except AnalyticError:
        raise
    except (FileNotFoundError, IsADirectoryError, PermissionError) as error:
        raise AnalyticError(
            f"the map {path} cannot be read ({error.strerror}): give a file that `save` wrote"
        ) from error
    except DAMAGE as error:
        raise AnalyticError(
            f"{path} is not a map, or it is damaged or cut short ({error!r}): give a whole file that `save` wrote"
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
    rules = parameters(head["parameters"])
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
        tuple(zip(arrays["recent.frames"].tolist(), _rows("recent", arrays), strict=True)),
        tuple(head["pending"]),
        head["next_id"],
        calls=calls,
    )


def _mode_arrays(name: str, mode: Mode) -> dict[str, NDArray[Any]]:
    moments = mode.model.moments
    return {
        f"{name}.frames": mode.frames,
        f"{name}.held": mode.held,
        f"{name}.rows": mode.rows.array,
        f"{name}.squares": mode.squares,
        f"{name}.centre": mode.centre,
        f"{name}.count": np.array(moments.count),
        f"{name}.mean": moments.mean,
        f"{name}.scatter": moments.scatter,
        f"{name}.third": moments.third,
        f"{name}.fourth": np.array(moments.fourth),
        **_descriptions(f"{name}.gallery", mode.gallery.frames.tolist(), mode.gallery.descriptions()),
    }


def _mode(rules: Parameters, arrays: Arrays, name: str) -> Mode:
    def of(part: str) -> NDArray[Any]:
        return arrays[f"{name}.{part}"]

    moments = Moments(int(of("count")), of("mean"), of("scatter"), of("third"), float(of("fourth")))
    gallery = Gallery.of(of("gallery.frames").tolist(), _rows(f"{name}.gallery", arrays), rules.exemplars)
    model = Model(moments, rules.shrinkage)
    return Mode(rules, of("frames"), of("held"), Rows.of(of("rows")), of("squares"), of("centre"), model, gallery)


def _descriptions(name: str, frames: Sequence[int], descriptions: Sequence[Description]) -> dict[str, NDArray[Any]]:
    arrays: dict[str, NDArray[Any]] = {f"{name}.frames": np.array(frames, dtype=np.int64)}
    if descriptions:
        whole = Description.concatenate(descriptions)
        arrays[f"{name}.position"] = whole.position
        if whole.orientation is not None:
            arrays[f"{name}.orientation"] = whole.orientation
    return arrays


def _rows(name: str, arrays: Arrays) -> list[Description]:
    count = len(arrays[f"{name}.frames"])
    if not count:
        return []
    orientation = arrays.get(f"{name}.orientation")
    whole = Description(arrays[f"{name}.position"], orientation)
    return [whole.take(slice(row, row + 1)) for row in range(count)]


def _text(text: str) -> NDArray[np.uint8]:
    return np.frombuffer(text.encode(), dtype=np.uint8)


def _string(array: NDArray[Any]) -> str:
    return array.tobytes().decode()
