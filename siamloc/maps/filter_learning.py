"""What the sequence filter learns before it runs: from the map itself, or from a validation sequence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from analytic import Descriptor
from siamloc.errors import ConfigError, DataError
from siamloc.maps.motion import MotionModel
from siamloc.maps.sequence_filter import SequenceFilter, frame_distances
from siamloc.maps.visual_map import VisualMap

_SAMPLE = 500  # map frames by which a temperature is learned


@dataclass(frozen=True)
class FilterSettings:
    """What a sequence filter runs with.

    Attributes:
        temperature: of the softmax, in units of the descriptor distance.
        kidnapping: probability that the robot is anywhere.
        error: mean error on the validation sequence.
    """

    temperature: float
    kidnapping: float
    error: float


def learn_temperature(distances: ArrayLike, true: ArrayLike) -> float:
    """Return the temperature that makes the true frames likeliest under softmax(-d / temperature).

    There, the distance expected under the softmax is on average that of the true frame.

    Args:
        distances: (n, m) of queries to the map; infinite where a frame is left out.
        true: (n,) the geometrically nearest map frame of each.

    Raises:
        DataError: no queries, or arrays that do not fit each other.
    """
    apart, rows = np.asarray(distances, dtype=np.float64), np.asarray(true)
    if apart.ndim != 2 or not apart.size or rows.shape != apart.shape[:1] or rows.dtype.kind not in "iu":
        raise DataError(f"a temperature needs distances (n, m) and true frames (n,), got {apart.shape}, {rows.shape}")
    apart = apart - apart.min(axis=1, keepdims=True)
    wanted = apart[np.arange(len(apart)), rows]
    finite = apart[np.isfinite(apart)]
    if not np.isfinite(wanted).all():
        raise DataError("a true frame is at no finite distance from its query: leave that query out")
    scale = float(np.median(finite[finite > 0])) if (finite > 0).any() else 1.0
    values = np.where(np.isfinite(apart), apart, 0.0)
    low, high = -12.0, 5.0  # logarithms of the temperature over the scale
    for _ in range(50):
        middle = (low + high) / 2
        weight = np.exp(-apart / (scale * np.exp(middle)))
        expected = (weight * values).sum(axis=1) / weight.sum(axis=1)
        # The expected distance grows with the temperature.
        if expected.mean() < wanted.mean():
            low = middle
        else:
            high = middle
    return scale * float(np.exp((low + high) / 2))


def temperature_of_map(known: VisualMap, descriptor: Descriptor | None = None) -> float:
    """Return the temperature learned from the map itself: each frame is looked for among the others.

    A large map is sampled. A map of one frame, or of frames that all look alike, gives a temperature all the same: any
    will do there.

    Raises:
        DataError: a map frame without a position.
    """
    if not known.frames.has_position.all():
        raise DataError("a temperature is learned from a map whose frames all have positions")
    if len(known) == 1:
        return 1.0
    chosen = np.unique(np.linspace(0, len(known) - 1, min(len(known), _SAMPLE)).astype(np.int64))
    apart = frame_distances(known, known.description.take(chosen), descriptor)
    away = np.hypot(*(known.frames.xy[chosen, None] - known.frames.xy[None]).transpose(2, 0, 1))
    own = np.arange(len(chosen))
    apart[own, chosen] = away[own, chosen] = np.inf
    return learn_temperature(apart, away.argmin(axis=1))


def tune_filter(
    motion: MotionModel,
    distances: ArrayLike,
    true_xy: ArrayLike,
    sequence: ArrayLike,
    temperature: float,
    softer: Sequence[float] = (1, 2, 3, 4),
    kidnapping: Sequence[float] = (1e-3, 1e-5, 1e-7),
) -> list[FilterSettings]:
    """Return settings tried on a validation sequence, the one of the smallest mean error first.

    The temperature that suits single queries takes each for news. Consecutive queries see nearly the same, their
    mistakes last, and a softer one keeps a filter from trusting such a mistake the more the longer it lasts. How much
    softer depends on how densely the map is sampled, hence on trial.

    Args:
        motion: of a robot in the map (m frames).
        distances: (n, m) of the validation queries to the map.
        true_xy: (n, 2) their true positions.
        sequence: (n,) their sequences.
        temperature: the one that suits single queries.
        softer: factors of it to try, positive.
        kidnapping: probabilities to try, in (0, 1).

    Raises:
        ConfigError: nothing to try, or values out of range.
        DataError: arrays that do not fit each other.
    """
    if not len(softer) or not len(kidnapping):
        raise ConfigError("tuning a sequence filter needs at least one factor and one probability to try")
    true = np.asarray(true_xy, dtype=np.float64)
    if true.shape != (len(np.asarray(sequence)), 2) or not np.isfinite(true).all():
        raise DataError(f"validation queries need true positions of shape (n, 2), all known, got {true.shape}")
    tried = []
    for factor, probability in product(softer, kidnapping):
        track = SequenceFilter(motion, temperature * factor, probability).run(distances, sequence)
        error = np.hypot(*(motion.xy[track.frame] - true).T)
        tried.append(FilterSettings(float(temperature * factor), float(probability), float(error.mean())))
    return sorted(tried, key=lambda settings: settings.error)
