"""Loop closure at node level and at image level, as functions of a frame and the nodes ([I] 4.1-4.3)."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Description, Descriptor
from analytic.mapper.node import Node

_NEAREST = 1e-6  # of the largest distance: the distance of an equal image, whose similarity would otherwise be infinite
_ROUNDING = 1e-9  # of the mean: a deviation that counts as none; otherwise a robot that stands still would not close


@dataclass(frozen=True)
class Closure:
    """The node-level comparison of a frame with a node, using the mode that it fits best.

    Attributes:
        node: id of the node.
        mode: index of that mode.
        distance: squared Mahalanobis distance to the mean of the mode.
        mean: mean distance of its held-out frames.
        std: standard deviation of these distances.
        deviation: |distance - mean|, or how much the distance exceeds the mean if only that counts; 0 within rounding.
    """

    node: int
    mode: int
    distance: float
    mean: float
    std: float
    deviation: float

    def closes(self, x: float) -> bool:
        """Test |distance - mean| <= |x std| (eq. 4, and eq. 11 with y)."""
        return self.deviation <= x * self.std

    @property
    def ratio(self) -> float:
        """The x with which the node would just close."""
        return _ratio(self.deviation, self.std)


@dataclass(frozen=True)
class Closures:
    """The node-level comparisons of a frame with several nodes, in the order of the nodes given.

    Attributes:
        nodes: (n,) ids.
        modes: (n,) mode indices; these and the other arrays are as in `Closure`.
    """

    nodes: NDArray[np.int64]
    modes: NDArray[np.int64]
    distances: NDArray[np.float64]
    means: NDArray[np.float64]
    stds: NDArray[np.float64]
    deviations: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.nodes)

    def row(self, row: int) -> Closure:
        """Return the comparison with one of the nodes."""
        parts = (self.nodes, self.modes, self.distances, self.means, self.stds, self.deviations)
        return Closure(*(part[row].item() for part in parts))

    def of(self, node: int) -> Closure:
        """Return the comparison with the node of that id."""
        return self.row(int(np.flatnonzero(self.nodes == node)[0]))

    def closing(self, x: float) -> NDArray[np.int64]:
        """Return the rows of the nodes that close, eq. 4."""
        return np.flatnonzero(self.deviations <= x * self.stds)

    def nearest(self) -> Closure:
        """Return the comparison with the node that would close with the smallest x; ties go to the oldest."""
        rows = [self.row(row) for row in range(len(self))]
        return min(rows, key=lambda closure: (closure.ratio, closure.node))

    def scores(self) -> dict[str, list[float]]:
        """Return distance, mean and std for each id."""
        values = np.column_stack([self.distances, self.means, self.stds]).tolist()
        return dict(zip(map(str, self.nodes.tolist()), values, strict=True))


def point_of(description: Description) -> NDArray[np.float64]:
    """Return the position descriptor (D,) of one frame."""
    return description.position[0].astype(np.float64)


def node_level(point: NDArray[np.float64], node: Node, two_sided: bool) -> Closure:
    """Compare a position descriptor (D,) with a node (eq. 3); ties go to the older mode."""
    return node_levels(point, [node], two_sided).row(0)


def node_levels(point: NDArray[np.float64], nodes: Sequence[Node], two_sided: bool) -> Closures:
    """Compare a position descriptor (D,) with each of several nodes (eq. 3).

    A mode keeps what it needs for this from frame to frame, so only a mode that has changed is prepared again. The
    distance to each mode is computed separately: it does not depend on the other nodes or their order.
    """
    distances = np.array([mode.metric.distance(point) for node in nodes for mode in node.modes])
    return _closures(distances, nodes, two_sided)


def node_levels_of(points: NDArray[np.float64], nodes: Sequence[Node], two_sided: bool) -> list[Closures]:
    """Compare each position descriptor (n, D) with each of several nodes (eq. 3), all frames at once."""
    distances = np.array([mode.metric.distances(points) for node in nodes for mode in node.modes])
    return [_closures(column, nodes, two_sided) for column in distances.T]


def _closures(distances: NDArray[np.float64], nodes: Sequence[Node], two_sided: bool) -> Closures:
    """Return the closures of nodes from the distances of all their modes, one mode after the other."""
    modes = [mode for node in nodes for mode in node.modes]
    means = np.array([mode.gaussian.mean for mode in modes])
    stds = np.array([mode.gaussian.std for mode in modes])
    deviations = distances - means
    deviations = np.abs(deviations) if two_sided else np.maximum(deviations, 0.0)
    deviations[deviations <= _ROUNDING * means] = 0.0
    ids = np.array([node.id for node in nodes])
    best = np.zeros(len(nodes), dtype=np.int64)
    if len(modes) > len(nodes):
        starts = np.cumsum([0, *(len(node.modes) for node in nodes)])
        ratios = [_ratio(*pair) for pair in zip(deviations.tolist(), stds.tolist(), strict=True)]
        best = np.array([int(np.argmin(ratios[start:end])) for start, end in pairwise(starts)])
        rows = starts[:-1] + best
        distances, means, stds, deviations = distances[rows], means[rows], stds[rows], deviations[rows]
    return Closures(ids, best, distances, means, stds, deviations)


def _ratio(deviation: float, std: float) -> float:
    if std == 0:
        return 0.0 if deviation == 0 else float("inf")
    return deviation / std


@dataclass(frozen=True)
class Similarity:
    """The similarity of a frame to the frames of several nodes, in one array for all nodes.

    Attributes:
        frames: (n,) numbers of the frames compared.
        values: (n,) products of the normalized inverse distances.
        nodes: (n,) the node of each frame.
        modes: (n,) the mode of each frame within its node.
    """

    frames: NDArray[np.int64]
    values: NDArray[np.float64]
    nodes: NDArray[np.int64]
    modes: NDArray[np.int64]

    def best(self, node: int | None = None) -> int:
        """Return the row of the most similar frame, of one node or of all (eq. 7); ties go to the oldest frame."""
        values = self.values if node is None else np.where(self.nodes == node, self.values, -1.0)
        rows = np.flatnonzero(values == values.max())
        return int(rows[self.frames[rows].argmin()])

    def means(self) -> dict[int, float]:
        """Return the mean similarity of each node ([T] 4.6): that of its best mode."""
        order = np.lexsort((self.modes, self.nodes))  # keeps the order of the frames within each mode
        nodes, modes, values = self.nodes[order], self.modes[order], self.values[order]
        starts = np.flatnonzero((np.diff(nodes, prepend=-1) != 0) | (np.diff(modes, prepend=-1) != 0))
        means: dict[int, float] = {}
        for start, end in pairwise([*starts.tolist(), len(nodes)]):
            node, mean = int(nodes[start]), float(values[start:end].mean())
            means[node] = max(means.get(node, mean), mean)
        return means


def image_level(
    descriptor: Descriptor,
    query: Description,
    nodes: Iterable[Node],
    distance: str | None,
    orientation: bool,
    leave_out: int | None = None,
) -> Similarity:
    """Compute the similarity of a frame to the frames of nodes (eq. 5-6), position times aligned orientation.

    Each of the two is the inverse distance, normalized to a sum of 1. A frame at distance 0 counts as one at a
    millionth of the largest distance.

    Args:
        descriptor: the descriptor that measures distances.
        query: one frame.
        nodes: the candidates.
        distance: name of the distance between position descriptors; None is the descriptor's own.
        orientation: whether orientation parts are compared; otherwise position alone counts.
        leave_out: a frame that is not compared: the query itself.
    """
    galleries = [
        (node.id, index, mode.gallery)
        for node in sorted(nodes, key=lambda node: node.id)
        for index, mode in enumerate(node.modes)
    ]
    frames = np.concatenate([gallery.frames for _, _, gallery in galleries])
    counts = [len(gallery) for _, _, gallery in galleries]
    owners = np.repeat([node for node, _, _ in galleries], counts)
    modes = np.repeat([index for _, index, _ in galleries], counts)
    blocks = [block for _, _, gallery in galleries for block in gallery.blocks]
    distances = [np.concatenate([descriptor.pairwise(query, block, distance)[0] for block in blocks])]
    if orientation:
        distances.append(np.concatenate([descriptor.align(query, block).distance[0] for block in blocks]))
    kept = np.ones(len(frames), dtype=bool) if leave_out is None else frames != leave_out
    values = np.ones(int(kept.sum()))
    for apart in distances:
        values = values * _normalized_inverse(apart[kept])
    return Similarity(frames[kept], values, owners[kept], modes[kept])


def _normalized_inverse(distances: NDArray[np.float64]) -> NDArray[np.float64]:
    if not len(distances):
        return distances
    largest = float(distances.max())
    inverse = np.ones(len(distances)) if largest == 0 else 1 / np.maximum(distances, _NEAREST * largest)
    return inverse / inverse.sum()


def prominences(curve: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the topographic prominence (n,) of each sample of a curve that is 0 before and after; 0 off the peaks.

    It is the height above the higher of the two lowest points that lie between the peak and something higher, or the
    end, on either side. For a flat peak, the first sample counts.
    """
    from scipy.signal import peak_prominences

    padded = np.concatenate([[0.0], curve, [0.0]])
    # A flat run is a peak if the curve falls on both sides: compare with the next sample that differs.
    starts = np.flatnonzero(np.diff(padded, prepend=np.nan) != 0)
    levels = padded[starts]
    peaks = starts[1:-1][(levels[1:-1] > levels[:-2]) & (levels[1:-1] > levels[2:])]
    found = np.zeros(len(padded))
    if len(peaks):
        found[peaks] = peak_prominences(padded, peaks)[0]
    return found[1:-1]


def similarity_curve(
    similarity: Similarity, labels: NDArray[np.int64], candidates: Collection[int]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Arrange similarities in capture order, with a zero wherever frames of other nodes lie in between ([I] fig. 6c).

    Args:
        similarity: to the frames of the candidates.
        labels: (n,) node of every frame of the map, -1 for none.
        candidates: ids of the candidate nodes.

    Returns:
        The curve, and the place of each frame of `similarity` in it.
    """
    order = np.argsort(similarity.frames, kind="stable")
    frames = similarity.frames[order]
    strangers = np.cumsum(~np.isin(labels, list(candidates)))
    gaps = np.diff(strangers[frames]) > 0
    places = np.arange(len(frames)) + np.concatenate([[0], np.cumsum(gaps)])
    curve = np.zeros(places[-1] + 1)
    curve[places] = similarity.values[order]
    where = np.empty(len(frames), dtype=np.int64)
    where[order] = places
    return curve, where
