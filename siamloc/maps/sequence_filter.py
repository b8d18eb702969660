"""A discrete Bayes filter over the frames of a map, so that a moving robot's estimate uses its last frames.

Only the forward pass: an estimate rests on the queries up to its own. What a query says of a map frame is the softmax
of its descriptor distances, exp(-d / temperature) ([T] 5.3.5 takes the smallest distance alone).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description, Descriptor
from analytic.distances import distance as distance_named
from siamloc.errors import ConfigError, DataError
from siamloc.maps.coarse import UNASSIGNED
from siamloc.maps.motion import MotionModel
from siamloc.maps.visual_map import VisualMap

_PAIRS = 1 << 20  # distances held at once


@dataclass(frozen=True, eq=False)
class Track:
    """What the filter said after each query.

    Attributes:
        frame: (n,) the most probable map frame, the smallest row of equally probable ones.
        probability: (n,) of that frame.
        spread: (n,) root mean square distance of where the robot may be from that frame, in units of x and y.
        node: (n,) the most probable node, -1 for being in none; None without nodes.
        node_probability: (n,) of that node; None without nodes.
    """

    frame: NDArray[np.int64]
    probability: NDArray[np.float64]
    spread: NDArray[np.float64]
    node: NDArray[np.int64] | None = None
    node_probability: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.frame)


class SequenceFilter:
    """Where in a map a robot is, given its queries one by one.

    A share of the belief, `kidnapping`, is spread over the whole map at each step. A robot that was carried away is
    found again within 1 + log(m / kidnapping) / log(r w) queries, where each makes its new place r times as likely as
    any other, and the motion model gives its steps the probability w: a tenth of it, say, and r = 100 take 7 queries
    in a map of 1000 frames at the default kidnapping.

    Args:
        motion: of a robot in this map (m frames).
        temperature: of the softmax, in units of the descriptor distance; see `siamloc.maps.filter_learning`.
        kidnapping: probability that the robot is anywhere, in (0, 1).
        labels: (m,) the node of each frame, -1 for none, to report nodes as well.

    Attributes:
        belief: (m,) probability of each map frame after the last query; uniform at first.

    Raises:
        ConfigError: a temperature or probability out of range.
        DataError: not one label for each map frame.
    """

    def __init__(
        self, motion: MotionModel, temperature: float, kidnapping: float = 1e-3, labels: ArrayLike | None = None
    ) -> None:
        if not 0 < temperature < np.inf:
            raise ConfigError(f"the temperature of the sequence filter must be positive, got {temperature}")
        if not 0 < kidnapping < 1:
            raise ConfigError(f"the probability of kidnapping lies in (0, 1), got {kidnapping}")
        self.motion, self.temperature, self.kidnapping = motion, float(temperature), float(kidnapping)
        self._labels = None if labels is None else np.asarray(labels, dtype=np.int64)
        if self._labels is not None and self._labels.shape != (len(motion),):
            raise DataError(f"{len(motion)} map frames need as many labels, got shape {self._labels.shape}")
        self.reset()

    def reset(self) -> None:
        """Forget all queries: the robot may be anywhere."""
        self.belief = np.full(len(self.motion), 1 / len(self.motion))

    def step(self, distances: ArrayLike) -> NDArray[np.float64]:
        """Take in one query and return the belief (m,).

        Args:
            distances: (m,) of its descriptor to those of the map.

        Raises:
            DataError: not one finite distance for each map frame.
        """
        apart = np.asarray(distances, dtype=np.float64)
        if apart.shape != (len(self.motion),) or not np.isfinite(apart).all():
            raise DataError(f"a query needs {len(self.motion)} finite distances to the map, got shape {apart.shape}")
        expected = (1 - self.kidnapping) * self.motion.predict(self.belief) + self.kidnapping / len(apart)
        # The likeliest frame has likelihood 1, so that the sum cannot vanish.
        belief = expected * np.exp((apart.min() - apart) / self.temperature)
        self.belief = belief / belief.sum()
        return self.belief

    def run(self, distances: ArrayLike, sequence: ArrayLike) -> Track:
        """Follow robots through whole sequences, beginning each one anew.

        Args:
            distances: (n, m) of each query to the map, in capture order inside each sequence.
            sequence: (n,) names.

        Raises:
            DataError: arrays that do not fit each other or the map.
        """
        apart, names = np.asarray(distances), np.asarray(sequence)
        if apart.shape != (len(names), len(self.motion)):
            raise DataError(
                f"{len(names)} queries need distances of shape ({len(names)}, {len(self.motion)}), got {apart.shape}"
            )
        frame, node = np.zeros(len(names), dtype=np.int64), np.zeros(len(names), dtype=np.int64)
        probability, spread, in_node = np.zeros(len(names)), np.zeros(len(names)), np.zeros(len(names))
        for name in dict.fromkeys(names.tolist()):
            self.reset()
            for row in np.flatnonzero(names == name).tolist():
                belief = self.step(apart[row])
                frame[row] = best = int(belief.argmax())
                probability[row], spread[row] = belief[best], self._spread(best)
                if self._labels is not None:
                    mass = np.bincount(self._labels - UNASSIGNED, belief)
                    node[row], in_node[row] = mass.argmax() + UNASSIGNED, mass.max()
        self.reset()
        if self._labels is None:
            return Track(frame, probability, spread)
        return Track(frame, probability, spread, node, in_node)

    def _spread(self, frame: int) -> float:
        squared = np.square(self.motion.xy - self.motion.xy[frame]).sum(axis=1)
        return float(np.sqrt(self.belief @ squared))


def frame_distances(
    known: VisualMap, queries: Description, descriptor: Descriptor | None = None
) -> NDArray[np.float64]:
    """Return the distances (n, m) of queries to all map frames, by the map's distance.

    Args:
        known: m frames.
        queries: n descriptions.
        descriptor: what described both; needed only if it compares after turning.

    Raises:
        AnalyticError: descriptions that cannot be compared.
    """
    if descriptor is None or not descriptor.aligned:
        return distance_named(known.distance)(queries.position, known.descriptors)
    rows = max(1, _PAIRS // len(known))
    parts = [slice(start, start + rows) for start in range(0, len(queries), rows)]
    return np.concatenate(
        [np.empty((0, len(known)))]
        + [descriptor.pairwise(queries.take(part), known.description, known.distance) for part in parts]
    )
