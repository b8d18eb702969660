"""Loop closure at node level and at image level, as functions of a frame and the nodes ([I] 4.1-4.3)."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analytic.descriptors.base import Description, Descriptor
from analytic.mapper.node import Mode, Node

_NEAREST = 1e-6  # of the largest distance: what an equal image counts as, since its similarity would be infinite


@dataclass(frozen=True)
class Closure:
    """How a frame stands to a node, by the mode that it fits best.

    Attributes:
        node: id.
        mode: index of that mode.
        distance: squared Mahalanobis distance to its mean.
        mean: of the distances of its held-out frames.
        std: of them.
        deviation: |distance - mean|, or how much the distance exceeds the mean if only that counts.
    """

    node: int
    mode: int
    distance: float
    mean: float
    std: float
    deviation: float

    def closes(self, x: float) -> bool:
        """Return whether |distance - mean| <= |x std| (eq. 4, and eq. 11 with y)."""
        return self.deviation <= x * self.std

    @property
    def ratio(self) -> float:
        """Return the x with which the node would just close."""
        if self.std == 0:
            return 0.0 if self.deviation == 0 else float("inf")
        return self.deviation / self.std


def node_level(point: NDArray[np.float64], node: Node, two_sided: bool) -> Closure:
    """Return how a position descriptor (D,) stands to a node (eq. 3); of equal modes, the older counts."""
    closures = [_to_mode(point, node.id, index, mode, two_sided) for index, mode in enumerate(node.modes)]
    return min(closures, key=lambda closure: (closure.ratio, closure.mode))


def _to_mode(point: NDArray[np.float64], node: int, index: int, mode: Mode, two_sided: bool) -> Closure:
    distance = float(mode.model.distances(point[None])[0])
    gaussian = mode.gaussian
    above = distance - gaussian.mean
    deviation = abs(above) if two_sided else max(above, 0.0)
    return Closure(node, index, distance, gaussian.mean, gaussian.std, deviation)


@dataclass(frozen=True)
class Similarity:
    """The similarity of a frame to the frames of some nodes, in one row for all.

    Attributes:
        frames: (n,) numbers of the frames compared.
        values: (n,) products of the normalized inverse distances.
        nodes: (n,) the node of each.
        modes: (n,) the mode of each within its node.
    """

    frames: NDArray[np.int64]
    values: NDArray[np.float64]
    nodes: NDArray[np.int64]
    modes: NDArray[np.int64]

    def best(self, node: int | None = None) -> int:
        """Return the row of the most similar frame, of one node or of all (eq. 7); of equals the oldest frame's."""
        values = self.values if node is None else np.where(self.nodes == node, self.values, -1.0)
        rows = np.flatnonzero(values == values.max())
        return int(rows[self.frames[rows].argmin()])

    def means(self) -> dict[int, float]:
        """Return the mean similarity of each node ([T] 4.6): that of its best mode."""
        means: dict[int, float] = {}
        for node in np.unique(self.nodes):
            modes = [self.values[(self.nodes == node) & (self.modes == mode)] for mode in self._modes(node)]
            means[int(node)] = max(float(values.mean()) for values in modes)
        return means

    def _modes(self, node: int) -> NDArray[np.int64]:
        return np.unique(self.modes[self.nodes == node])


def image_level(
    descriptor: Descriptor,
    query: Description,
    nodes: Iterable[Node],
    distance: str | None,
    orientation: bool,
    leave_out: int | None = None,
) -> Similarity:
    """Return the similarity of a frame to the frames of nodes (eq. 5-6), position times aligned orientation.

    Each of the two is the inverse distance, normalized to sum 1. A frame at distance 0 counts as one at a millionth of
    the largest distance.

    Args:
        descriptor: which tells distances.
        query: one frame.
        nodes: the candidates.
        distance: between position descriptors; None is the descriptor's own.
        orientation: whether orientation parts are compared; otherwise position alone counts.
        leave_out: a frame that is not compared, the query itself.
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
    """Return the topographic prominence (n,) of each sample of a curve that is 0 before and after; 0 off the peaks.

    It is the height above the higher of the two lowest points that lie between the peak and something higher, or the
    end, on either side. Of a flat peak the first sample counts.
    """
    from scipy.signal import peak_prominences

    padded = np.concatenate([[0.0], curve, [0.0]])
    # A flat run is a peak if it falls on both sides: compare with the next sample that differs.
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
    """Return the similarities in capture order with a zero wherever frames of other nodes lie between ([I] fig. 6c).

    Args:
        similarity: to the frames of the candidates.
        labels: (n,) node of every frame of the map, -1 for none.
        candidates: ids of the candidate nodes.

    Returns:
        The curve, and where in it each frame of `similarity` stands.
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


def mean_distance(point: NDArray[np.float64], representatives: Sequence[Sequence[NDArray[np.float64]]]) -> float:
    """Return the mean Euclidean distance of a point (D,) to places, each the nearest of its representatives."""
    return float(np.mean([min(np.linalg.norm(point - other) for other in place) for place in representatives]))


def mean_distance_among(representatives: Sequence[Sequence[NDArray[np.float64]]]) -> float:
    """Return the mean Euclidean distance between places, by the nearest pair of representatives; 0 for fewer than 2."""
    apart = [
        min(np.linalg.norm(a - b) for a in first for b in second)
        for index, first in enumerate(representatives)
        for second in representatives[index + 1 :]
    ]
    return float(np.mean(apart)) if apart else 0.0
