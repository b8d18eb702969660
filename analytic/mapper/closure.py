"""Loop closure at node level and at image level, as functions of a frame and the nodes ([I] 4.1-4.3)."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np

from analytic.arrays import Floats, Integers
from analytic.descriptors.base import Description, Descriptor
from analytic.mapper.node import Node, every_few

_NEAREST = 1e-6  # of the largest distance: the distance of an equal image, whose similarity would otherwise be infinite
_ROUNDING = 1e-9  # of the mean: a deviation that counts as none; otherwise a robot that stands still would not close
_MARGIN = 1e-6  # far above the rounding of the distances


@dataclass(frozen=True)
class NodeLevel:
    """The comparison of a point with n nodes, each represented by the mode that the point fits best.

    Attributes:
        nodes: (n,) ids of the nodes.
        modes: (n,) the mode of each node.
        distances: (n,) squared Mahalanobis distances to the mean of that mode (eq. 3).
        means: (n,) mean of these distances over the mode's held-out frames.
        stds: (n,) standard deviation of these distances.
        deviations: (n,) |distance - mean|, or how much the distance exceeds the mean if only that counts; 0 within
            rounding.
        ratios: (n,) deviation / std: the x with which the node would just close.
    """

    nodes: Integers
    modes: Integers
    distances: Floats
    means: Floats
    stds: Floats
    deviations: Floats
    ratios: Floats

    def closing(self, x: float) -> Integers:
        """Return the rows of the nodes that close the loop: |distance - mean| <= |x std| (eq. 4, and eq. 11 with y)."""
        return np.flatnonzero(self.deviations <= x * self.stds)

    def best(self, rows: Integers | slice) -> int:
        """Return that row among some whose node would close with the smallest x; ties go to the first row."""
        return int(np.arange(len(self.nodes))[rows][np.argmin(self.ratios[rows])])

    def scores(self) -> dict[str, list[float]]:
        """Return distance, mean and std of each node, by id."""
        values = np.column_stack([self.distances, self.means, self.stds]).tolist()
        return dict(zip(map(str, self.nodes.tolist()), values, strict=True))


def point_of(description: Description) -> Floats:
    """Return the position descriptor (D,) of one frame."""
    return description.position[0].astype(np.float64)


def node_level(point: Floats, nodes: Sequence[Node], two_sided: bool, most: float = np.inf) -> NodeLevel:
    """Compare a position descriptor (D,) with nodes (eq. 3); ties between modes go to the older.

    With a limit, modes that cannot close with it are left out, except the one that seems nearest: few remain in a large
    map. The Mahalanobis distance of some numbers of a descriptor, which takes little time, is at most that of all.

    Args:
        point: (D,) position descriptor of a frame.
        nodes: the nodes to compare with, at least one.
        two_sided: whether a distance below the usual one is a deviation, too.
        most: the largest x of eq. 4 for which nodes close; infinite for no limit.
    """
    places = [(node.id, index, mode) for node in nodes for index, mode in enumerate(node.modes)]
    means, stds = np.array([mode.usual for *_, mode in places]).T
    if np.isfinite(most):
        bounds = np.array([mode.metric.bound for *_, mode in places])
        least = np.square(bounds @ np.append(point[every_few(len(point))], 1.0)).sum(axis=1)
        possible = least <= (means + most * stds) * (1 + _MARGIN) + _MARGIN
        possible[np.argmin(least)] = True
        places, means, stds = list(compress(places, possible)), means[possible], stds[possible]
    distances = np.array([mode.metric.distances(point[None])[0] for *_, mode in places])
    deviations = np.abs(distances - means) if two_sided else np.maximum(distances - means, 0.0)
    deviations[deviations <= _ROUNDING * means] = 0.0
    ratios = np.divide(deviations, stds, out=np.where(deviations == 0, 0.0, np.inf), where=stds > 0)
    ids, modes = np.array([place[:2] for place in places]).T
    # The rows of a node are consecutive: sorted by ratio within each node, its first row is its best mode.
    _, first, number = np.unique(ids, return_index=True, return_inverse=True)
    best = np.lexsort((ratios, first[number]))[np.sort(first)]
    return NodeLevel(*(part[best] for part in (ids, modes, distances, means, stds, deviations, ratios)))


@dataclass(frozen=True)
class Similarity:
    """The similarity of a frame to the frames of several nodes, in one array for all nodes.

    Attributes:
        frames: (n,) numbers of the frames compared.
        values: (n,) products of the normalized inverse distances.
        nodes: (n,) the node of each frame.
        modes: (n,) the mode of each frame within its node.
    """

    frames: Integers
    values: Floats
    nodes: Integers
    modes: Integers

    def best(self, node: int | None = None) -> int:
        """Return the row of the most similar frame, of a node or of all nodes (eq. 7); ties go to the oldest frame."""
        values = self.values if node is None else np.where(self.nodes == node, self.values, -1.0)
        rows = np.flatnonzero(values == values.max())
        return int(rows[self.frames[rows].argmin()])

    def means(self) -> dict[int, float]:
        """Return the mean similarity of each node, by id ([T] 4.6): that of its most similar mode."""
        means: dict[int, float] = {}
        for node in np.unique(self.nodes).tolist():
            own = self.nodes == node
            modes = np.unique(self.modes[own])
            means[node] = max(float(self.values[own & (self.modes == mode)].mean()) for mode in modes)
        return means


def image_level(
    descriptor: Descriptor,
    query: Description,
    nodes: Sequence[Node],
    distance: str | None,
    leave_out: int | None = None,
) -> Similarity:
    """Compute the similarity of a frame to frames of nodes: of the positions (eq. 5) times of the orientations (eq. 6).

    Each of the two is the inverse distance, normalized to a sum of 1; orientations are aligned first. A frame at
    distance 0 counts as a frame at a millionth of the largest one. Without orientation parts, only positions count.

    Args:
        descriptor: the descriptor that measures distances.
        query: description of one frame.
        nodes: the nodes with whose frames the query is compared.
        distance: name of the distance between position descriptors; None is the descriptor's own.
        leave_out: number of a frame that is not compared: the query itself.
    """
    galleries = [
        (node.id, mode, node.modes[mode].gallery)
        for node in sorted(nodes, key=lambda node: node.id)
        for mode in range(len(node.modes))
    ]
    frames = np.concatenate([gallery.frames for *_, gallery in galleries])
    owners, modes = np.repeat([place[:2] for place in galleries], [len(place[2]) for place in galleries], axis=0).T
    shown = [gallery.shown for *_, gallery in galleries]
    distances = [np.concatenate([descriptor.pairwise(query, part, distance)[0] for part in shown])]
    if query.orientation is not None:
        distances.append(np.concatenate([descriptor.align(query, part).distance[0] for part in shown]))
    kept = np.ones(len(frames), dtype=bool) if leave_out is None else frames != leave_out
    values = np.ones(int(kept.sum()))
    for apart in distances:
        values = values * _normalized_inverse(apart[kept])
    return Similarity(frames[kept], values, owners[kept], modes[kept])


def _normalized_inverse(distances: Floats) -> Floats:
    """Return the inverse of distances (n,), normalized to a sum of 1 (eq. 5 for positions, eq. 6 for orientations)."""
    if not len(distances):
        return distances
    largest = float(distances.max())
    inverse = np.ones(len(distances)) if largest == 0 else 1 / np.maximum(distances, _NEAREST * largest)
    return inverse / inverse.sum()


def prominences(curve: Floats) -> Floats:
    """Compute the topographic prominence (n,) of each sample of a curve that is 0 before and after; 0 off the peaks.

    It is the height above the higher of the two lowest points that lie between the peak and something higher, or the
    end, on either side. For a flat peak, the first sample counts.
    """
    from scipy.signal import find_peaks, peak_prominences

    padded = np.concatenate([[0.0], curve, [0.0]])
    peaks, shape = find_peaks(padded, plateau_size=1)
    heights = np.zeros(len(padded))
    heights[shape["left_edges"]] = peak_prominences(padded, peaks)[0]
    return heights[1:-1]


def prominences_of(similarity: Similarity, labels: Integers, candidates: Collection[int]) -> Floats:
    """Compute the prominence (n,) of each frame compared, in the similarity curve in capture order ([I] fig. 6c).

    The curve falls to zero wherever frames of other nodes, or without a node, lie in between.

    Args:
        similarity: similarity of a query to the n frames of the candidate nodes.
        labels: (N,) node of every frame of the map, -1 for none.
        candidates: ids of the candidate nodes.
    """
    curve, heights = np.zeros(len(labels)), np.zeros(len(labels))
    curve[similarity.frames] = similarity.values
    shown = ~np.isin(labels, list(candidates))
    shown[similarity.frames] = True
    heights[shown] = prominences(curve[shown])
    return heights[similarity.frames]
