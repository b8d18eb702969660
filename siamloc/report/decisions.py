"""The numbers behind one decision of the incremental mapper: its similarity curve, computed anew."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from siamloc.errors import FormatError
from siamloc.report.growth import Story

if TYPE_CHECKING:
    from analytic import Descriptor
    from analytic.descriptors.base import Description
    from analytic.mapper import IncrementalMapper
    from analytic.mapper.closure import Similarity

_TRIED = 60  # decisions whose curves are computed in search of an instructive one
_BRIDGED = 30  # frames between an image and its match from which on a loop closes
_MOST_CANDIDATES = 6
_TOLERANCE = 1e-3  # relative; the log has six digits


@dataclass(frozen=True, eq=False)
class Explained:
    """A decision with the numbers behind it.

    Attributes:
        frame: the number of the image that was placed.
        scores: what the log says of it.
        frames: (n,) numbers of the frames compared, in capture order.
        node: (n,) the mapper's name of the node of each at the time.
        position: (n,) normalized similarity of the position descriptors.
        orientation: (n,) of the orientation descriptors; None if they were not compared.
        values: (n,) their product, on which the decision rests.
        labels: (frame,) the node of every earlier frame at the time, -1 for none.
    """

    frame: int
    scores: dict[str, Any]
    frames: NDArray[np.int64]
    node: NDArray[np.int64]
    position: NDArray[np.float64]
    orientation: NDArray[np.float64] | None
    values: NDArray[np.float64]
    labels: NDArray[np.int64]

    @property
    def best(self) -> int:
        """The frame compared that is the most similar one."""
        return int(self.frames[self.values.argmax()])

    @property
    def best_lies_elsewhere(self) -> bool:
        """Whether the most similar image lies in another node than the one chosen."""
        return int(self.node[self.values.argmax()]) != self.scores["node"]


def instructive(story: Story, mapper_file: str | Path) -> Explained | None:
    """Choose a decision that shows how the mapper thinks, and compute its curve anew; the same one every time.

    It is a loop closure among several candidate nodes: in version 1 the one whose peak stands out most, in version 2
    one where the most similar image lies in another node than the one chosen, if there is any. What is computed has to
    agree with the log; None if no decision does, or none chose a node.

    Args:
        story: of the map.
        mapper_file: `mapper.npz` of the layer.

    Raises:
        FormatError: a file that is missing, or not whole.
    """
    mapper = _loaded(mapper_file, story.descriptor)
    known = _descriptions(mapper)
    version = story.parameters["version"]
    found = None
    ranked = sorted(_closing(story), key=lambda event: _rank(story.events[event], version))
    for event in ranked[:_TRIED]:
        explained = _explained(story, event, mapper, known)
        if explained is None:
            continue
        if version == 1 or explained.best_lies_elsewhere:
            return explained
        found = found or explained
    return found


def _closing(story: Story) -> list[int]:
    """Return the events that put a single frame into a node."""
    return [
        number
        for number, event in enumerate(story.events)
        if event["reason"] == "ASSIGNED" and len(event["frames"]) == 1 and event["scores"].get("match", -1) >= 0
    ]


def _rank(event: Mapping[str, Any], version: int) -> tuple[Any, ...]:
    """Return what sorts instructive decisions first, as far as the log tells."""
    scores = event["scores"]
    candidates = len(scores["candidates"])
    closes = event["frames"][0] - scores["match"] >= _BRIDGED
    best = -scores["prominence"] / max(scores["least_prominence"], 1e-12) if version == 1 else -candidates
    return (not closes, not 2 <= candidates <= _MOST_CANDIDATES, best, event["frames"][0])


def _explained(
    story: Story, event: int, mapper: IncrementalMapper, known: Mapping[int, Description]
) -> Explained | None:
    """Compare an image anew with the frames that its candidates had; None if the result is not the log's."""
    from analytic.descriptors.base import Description

    frame, scores = story.events[event]["frames"][0], story.events[event]["scores"]
    labels = story.labels(event)
    frames = np.flatnonzero(np.isin(labels, scores["candidates"]))
    if frame not in known or not all(int(other) in known for other in frames):
        return None
    others = Description.concatenate([known[int(other)] for other in frames])
    turns = mapper.parameters.orientation and getattr(mapper.descriptor, "circular", True)
    position = _similarity(mapper, known[frame], others, frames, labels, orientation=False)
    if turns and others.orientation is not None:
        both = _similarity(mapper, known[frame], others, frames, labels, orientation=True)
        orientation = both.values / position.values
        values = both.values
    else:
        both, orientation, values = position, None, position.values
    explained = Explained(frame, scores, frames, labels[frames], position.values, orientation, values, labels)
    logged, node = scores["similarity"], scores["node"]
    same = abs(float(values[both.best(node)]) - logged) <= _TOLERANCE * logged
    return explained if same and int(frames[both.best(node)]) == scores["match"] else None


def _similarity(
    mapper: IncrementalMapper,
    query: Description,
    others: Description,
    frames: NDArray[np.int64],
    labels: NDArray[np.int64],
    orientation: bool,
) -> Similarity:
    """Return the mapper's own similarity to frames, by nodes as they were at the time."""
    from analytic.mapper.closure import Similarity as Compared
    from analytic.mapper.closure import image_level

    class Gallery(SimpleNamespace):
        def __len__(self) -> int:
            return len(self.frames)

    nodes = []
    for node in np.unique(labels[frames]).tolist():
        rows = np.flatnonzero(labels[frames] == node)
        gallery = Gallery(frames=frames[rows], blocks=(others.take(rows),))
        nodes.append(SimpleNamespace(id=node, modes=(SimpleNamespace(gallery=gallery),)))
    distance = mapper.parameters.distance
    found = image_level(mapper.descriptor, query, cast(Any, nodes), distance, orientation)
    order = np.argsort(found.frames, kind="stable")
    return Compared(found.frames[order], found.values[order], found.nodes[order], found.modes[order])


def _descriptions(mapper: IncrementalMapper) -> dict[int, Description]:
    """Return what the map has kept of its frames."""
    return {
        int(frame): mode.gallery.row(row)
        for node in mapper.nodes
        for mode in node.modes
        for row, frame in enumerate(mode.gallery.frames)
    }


def _loaded(path: str | Path, identity: dict[str, Any]) -> IncrementalMapper:
    from analytic import DESCRIPTORS, AnalyticError
    from analytic.mapper import IncrementalMapper

    descriptor = None if identity.get("name") in DESCRIPTORS else _vectors(identity)
    try:
        return IncrementalMapper.load(path, descriptor)
    except AnalyticError as error:
        raise FormatError(str(error)) from error


def _vectors(made_by: dict[str, Any]) -> Descriptor:
    """Return a descriptor that compares vectors as they were made elsewhere, such as by a network."""
    from analytic import Descriptor

    class Vectors(Descriptor):
        """Vectors of a descriptor that is not at hand."""

        name = "vectors"
        circular = made_by.get("circular", True)

        @property
        def identity(self) -> dict[str, Any]:
            """Of the descriptor that made them."""
            return made_by

        def describe(self, batch: Any) -> Description:
            """Raise: there is nothing that could describe."""
            raise NotImplementedError

    return Vectors()
