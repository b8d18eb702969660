"""The incremental mapper: one frame in, one decision out ([I] 4; [T] 4.3, 4.6)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from analytic.arrays import Integers
from analytic.descriptors import registry
from analytic.descriptors.base import Description, Descriptor, check_alike
from analytic.errors import AnalyticError
from analytic.linear_algebra import one_thread
from analytic.mapper import graph, storage
from analytic.mapper.decision import Decision, Location, Reason, header, line_of
from analytic.mapper.growth import State
from analytic.mapper.node import Node
from analytic.mapper.parameters import Parameters
from analytic.mapper.steps import locate, maintain, step
from foundation.files import plain

_READ_ONLY = "this map was loaded for queries and is read-only: load it with extend=True to add frames"
LARGEST_VALUE = 1e38
LARGEST_POSITION = 4096  # numbers: beyond, the covariance of a single node takes more than 128 MiB


class IncrementalMapper:
    """A topological map that grows while the robot drives.

    Args:
        descriptor: the descriptor that makes the descriptions, not one that is `aligned`, whose means are meaningless.
            If these have no orientation part, or it was made with `circular=False`, images are compared by position
            alone.
        version: 1 is [I] 4 and [T] 4.3; 2 the improved version of [T] 4.6.
        others: the thresholds of `analytic.mapper.Parameters`: omega=1.85, y=1.5, gamma=5, ...

    Attributes:
        descriptor: descriptor of the map.
        parameters: all thresholds.
        extendable: whether frames may be added; False for a map that was loaded for queries.

    Raises:
        AnalyticError: no descriptor, an unknown parameter, or a value out of its range.

    Examples:
        >>> import analytic
        >>> generator = np.random.default_rng(0)
        >>> view = generator.integers(0, 256, (16, 64))
        >>> images = np.clip(view + generator.normal(0, 5, (25, 16, 64)), 0, 255).astype(np.uint8)
        >>> hog = analytic.descriptor("hog")
        >>> mapper = IncrementalMapper(hog, version=2)
        >>> decisions = [mapper.add(hog.describe(image), [0.0, 0.0]) for image in images]
        >>> decisions[0].reason.name, decisions[19].reason.name, decisions[19].node
        ('FIRST_FRAMES', 'NEW_NODE', 0)
        >>> mapper.locate(hog.describe(images[3])).pose
        [0.0, 0.0]
    """

    def __init__(self, descriptor: Descriptor, version: int = 1, **others: Any) -> None:
        if not isinstance(descriptor, Descriptor):
            raise AnalyticError(f"the mapper takes a descriptor, like analytic.descriptor('hog'), got {descriptor!r}")
        self.descriptor = descriptor
        self.parameters = Parameters.of({"version": version, **others})
        self.extendable = True
        self._state = State(self.parameters)
        self._poses: list[Any] = []
        self._lines = [header(asdict(self.parameters), descriptor.identity)]

    def __len__(self) -> int:
        return len(self._state.labels)

    @property
    def nodes(self) -> tuple[Node, ...]:
        """The nodes, oldest first."""
        return tuple(self._state.ordered())

    @property
    def poses(self) -> tuple[Any, ...]:
        """The identifier or pose that was added with each frame."""
        return tuple(self._poses[: len(self)])

    @property
    def events(self) -> tuple[str, ...]:
        """The log: a header, then a line of JSON for each call of `add`, `maintain` or `forget`."""
        return tuple(self._lines[: 1 + self._state.calls])

    def labels(self) -> Integers:
        """Return the node of each frame (n,), -1 for none."""
        return self._state.labels.copy()

    def graph(self) -> graph.NodeGraph:
        """Return nodes, edges and loop closures, which can be written as JSON."""
        places = [graph.coordinates(pose) for pose in self.poses]
        nodes: dict[int, dict[str, float]] = {}
        for node in self.nodes:
            nodes[node.id] = {"frames": len(node), "modes": len(node.modes)}
            known = [place for frame in node.frames if (place := places[frame]) is not None]
            if known:
                x, y = np.mean(known, axis=0)
                nodes[node.id] |= {"x": float(x), "y": float(y)}
        labels = self._state.labels
        return graph.NodeGraph(nodes, graph.edges(labels), graph.loops(labels, self._state.matches))

    def add(self, description: Description, frame: Any = None) -> Decision:
        """Add one frame and decide where it belongs. If anything fails, the map is unchanged.

        Args:
            description: description of one image.
            frame: an identifier or a pose to store with it: a plain value, or a list or object of plain values. The
                first two numbers of a list, or the values "x" and "y", are coordinates in m.

        Raises:
            AnalyticError: a map that is read-only; a description of several images, of another descriptor, of another
                size or with values that are not finite; a frame that is not plain.
        """
        description = self._checked(description, 1, extending=True)
        pose, draft = _plain(frame), self._state.copy()
        with one_thread():
            decision = step(draft, self.descriptor, description)
        self._commit(draft, decision, [pose])
        return decision

    def maintain(self, node: int, descriptions: Description, frames: Sequence[Any] | None = None) -> Decision:
        """Teach a node another appearance of its place, from a revisit: a further mode with its own statistics.

        Args:
            node: id of the node.
            descriptions: descriptions of at least `smallest_node` images, in capture order.
            frames: an identifier or a pose for each; see `add`.

        Raises:
            AnalyticError: an unknown node, too few images, and what `add` raises.
        """
        descriptions = self._checked(descriptions, None, extending=True)
        if not isinstance(node, (int, np.integer)) or node not in self._state.nodes:
            raise AnalyticError(f"the map has no node {node!r}: it has {sorted(self._state.nodes)}")
        count, least = len(descriptions), self.parameters.smallest_node
        if count < least:
            raise AnalyticError(f"another appearance needs smallest_node={least} images or more, got {count}")
        poses = [_plain(frame) for frame in (frames if frames is not None else [None] * count)]
        if len(poses) != count:
            raise AnalyticError(f"{count} images need as many frames, got {len(poses)}")
        draft = self._state.copy()
        with one_thread():
            decision = maintain(draft, int(node), [descriptions.take(slice(row, row + 1)) for row in range(count)])
        self._commit(draft, decision, poses)
        return decision

    def forget(self, frames: Sequence[int]) -> list[int]:
        """Let frames leave their nodes, because their place does not look so any more; their numbers stay.

        Args:
            frames: numbers of frames.

        Returns:
            The frames that left. The frames of a node that would be left with fewer than `smallest_node` stay in it.

        Raises:
            AnalyticError: a frame that the map does not have, or a map that is read-only.
        """
        if not self.extendable:
            raise AnalyticError(_READ_ONLY)
        if unknown := [frame for frame in frames if not 0 <= frame < len(self)]:
            raise AnalyticError(f"the map has no frame {unknown[0]!r}: it has {len(self)}")
        if not len(frames):
            return []
        draft = self._state.copy()
        gone = draft.leave(frames)
        draft.note(Reason.FORGOTTEN, None, gone)
        self._commit(draft, Decision(None, Reason.FORGOTTEN, {}, len(self) - 1, draft.changes), [])
        return gone

    def locate(self, description: Description) -> Location:
        """Find the node and the most similar frame of one image. The map does not change.

        Nodes that pass the node-level condition compete; if none passes, the node that comes closest to passing wins.

        Raises:
            AnalyticError: a map without nodes, and what `add` raises for descriptions.
        """
        if not self._state.nodes:
            raise AnalyticError(f"the map has no node yet after {len(self)} frames: add more before querying it")
        with one_thread():
            return locate(self._state, self.descriptor, self._checked(description, 1), self._poses)

    def save(self, path: str | Path) -> None:
        """Save the map in a file of arrays without pickles, atomically.

        Raises:
            StorageError: a path that cannot be written.
        """
        storage.save(path, self._state, list(self.poses), self.descriptor.identity, list(self.events))

    @classmethod
    def load(cls, path: str | Path, descriptor: Descriptor | None = None, *, extend: bool = False) -> IncrementalMapper:
        """Load a map for queries only, or to extend it as if the run had never stopped.

        Args:
            path: file that `save` wrote.
            descriptor: descriptor of the map; may be left out if its name is in `analytic.DESCRIPTORS`.
            extend: whether frames may be added.

        Raises:
            FormatError: a file that cannot be read, is cut short or damaged, is no map, or a map of another version.
            AnalyticError: a descriptor other than the map's, or none for a map whose descriptor is not in
                `analytic.DESCRIPTORS`.
        """
        state, poses, identity, lines = storage.load(path)
        if descriptor is None and identity.get("name") in registry.DESCRIPTORS:
            descriptor = registry.descriptor(**identity)
        if descriptor is None or plain(descriptor.identity) != identity:
            raise AnalyticError(
                f"the map {path} was made with the descriptor {identity}: give that one as `descriptor`, got "
                f"{descriptor and descriptor.identity}"
            )
        mapper = cls(descriptor, **asdict(state.rules))
        mapper.extendable, mapper._state, mapper._poses, mapper._lines = extend, state, poses, lines
        return mapper

    def _commit(self, draft: State, decision: Decision, poses: list[Any]) -> None:
        """Replace the map by a draft. Until the last line does so, poses and events beyond the old map do not count."""
        draft.calls += 1
        self._lines[draft.calls :] = [line_of(decision, poses)]
        self._poses[len(self) :] = poses
        self._state = draft

    def _checked(self, description: Description, count: int | None, extending: bool = False) -> Description:
        """Check a description and return a copy that the map can keep, without an orientation part that is not used."""
        if extending and not self.extendable:
            raise AnalyticError(_READ_ONLY)
        if not isinstance(description, Description):
            raise AnalyticError(f"the mapper takes what describe() returns, got {type(description).__name__}")
        self.descriptor.check(description, description)
        shape = description.position.shape
        if len(shape) != 2 or not 0 < shape[1] <= LARGEST_POSITION:
            raise AnalyticError(
                f"a node keeps a covariance of its position descriptors, which must have 1 to {LARGEST_POSITION} "
                f"numbers for each image, got shape {shape}: use another descriptor, such as hog with rows=16, bins=16"
            )
        if count is not None and len(description) != count:
            raise AnalyticError(f"the mapper takes one image at a time, got a description of {len(description)}")
        if not (self.parameters.orientation and getattr(self.descriptor, "circular", True)):
            description = replace(description, orientation=None)
        for name, part in (("position", description.position), ("orientation", description.orientation)):
            # The fourth power of a larger value overflows.
            if part is not None and (
                len(part) != shape[0]
                or part.dtype.kind not in "fiub"
                or not (np.abs(part, dtype=np.float64) <= LARGEST_VALUE).all()
            ):
                raise AnalyticError(
                    f"the {name} part of a description of {shape[0]} images must hold as many rows of finite real "
                    f"numbers up to {LARGEST_VALUE:g}, and this one, of {part.dtype} in shape {part.shape}, does not: "
                    f"{'set orientation=false, or ' * (name == 'orientation')}use another descriptor, such as hog"
                )
        kept = description.take(np.arange(len(description)))
        if self._state.recent:
            check_alike(self._state.recent[-1][1], kept)
        return kept


def _plain(frame: Any) -> Any:
    """Return an identifier or a pose as it will be read back from JSON."""
    try:
        return json.loads(json.dumps(plain(frame)))
    except (TypeError, ValueError) as error:
        raise AnalyticError(f"a frame is named by plain values, lists or objects of them, got {frame!r}") from error
