"""The thresholds of the mapper, by name, with their published defaults."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import floor
from typing import Any

from analytic.distances import distance as distance_named
from analytic.errors import AnalyticError, hint

_CLOSE = 1e-9  # a product such as 0.2 * 15 may be off by rounding, and must not fall below the whole number
_MOST = 10_000_000
_SMALLEST_GAUSSIAN = 2  # frames that a standard deviation needs


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """The thresholds that decide how a map grows.

    Args:
        version: 1 is [I] 4 and [T] 4.3; 2 is the improved version of [T] 4.6.
        omega: the smallest x of eq. 4, once there are many nodes.
        y: width of the merging condition, eq. 11; the larger, the more merging.
        gamma: how many times the mean prominence the best image must reach, eq. 8; version 1 only.
        x_start: x is max(omega, x_start - x_slope * nodes).
        x_slope: see `x_start`.
        two_sided: eq. 4 and 11 as published, |distance - mean| <= x * std; False drops the lower side, so that a frame
            nearer to a node than its own frames also closes.
        merge: "changed" checks for merging whenever the contents of a node change ([T] 4.5.2), "created" only for a
            node that has just been created ([I] 4.6), "never" not at all.
        distance: distance between position descriptors at image level, eq. 5; None is the descriptor's own.
        orientation: whether the aligned orientation parts are compared too, where the descriptor has them.
        shrinkage: "ledoit_wolf", or a fixed share of the identity in (0, 1].
        held_out: share of a node's frames that form the Gaussian of eq. 4 instead of its mean and covariance.
        first_node: frames that form the first node.
        new_node: consecutive frames without a node that form the next one; version 1.
        parked_nodes: the most candidates that may wait; beyond that, the oldest is forgotten; version 1.
        checked_unassigned: frames without a node, of the last `checked_window`, that call for a new one; version 2.
        checked_window: see `checked_unassigned`.
        forced_unassigned: frames without a node, of the last `forced_window`, that force a new one; version 2.
        forced_window: see `forced_unassigned`.
        node_changes: changes of node in the last `changes_window` frames that call for a new one; version 2.
        changes_window: see `node_changes`.
        window: frames before a new node that are evaluated again with its own; version 2.
        smallest_node: the fewest frames that a node keeps when others leave it, and that a mode needs.
        exemplars: frames of each mode that are kept for comparing images, and of those held out; None keeps all.

    Raises:
        AnalyticError: a value out of its range.

    Examples:
        >>> Parameters(version=2, omega=2.0).x(nodes=40)
        2.0
    """

    version: int = 1
    omega: float = 1.85
    y: float = 1.5
    gamma: float = 5.0
    x_start: float = 3.05
    x_slope: float = 0.15
    two_sided: bool = True
    merge: str = "changed"
    distance: str | None = "euclidean"
    orientation: bool = True
    shrinkage: str | float = "ledoit_wolf"
    held_out: float = 0.2
    first_node: int = 20
    new_node: int = 15
    parked_nodes: int = 8
    checked_unassigned: int = 15
    checked_window: int = 20
    forced_unassigned: int = 28
    forced_window: int = 30
    node_changes: int = 9
    changes_window: int = 20
    window: int = 40
    smallest_node: int = 10
    exemplars: int | None = None

    def __post_init__(self) -> None:
        if type(self.version) is not int or self.version not in (1, 2):
            raise AnalyticError(f"the mapper has versions 1 and 2, got version {self.version!r}")
        for name in ("omega", "y", "gamma", "x_start"):
            _positive(name, getattr(self, name))
        if not (_number(self.x_slope) and self.x_slope >= 0):
            raise AnalyticError(f"x_slope must be a number that is not negative, got {self.x_slope!r}")
        for name in ("two_sided", "orientation"):
            if not isinstance(getattr(self, name), bool):
                raise AnalyticError(f"{name} must be true or false, got {getattr(self, name)!r}")
        if self.merge not in ("changed", "created", "never"):
            raise AnalyticError(f"merge must be 'changed', 'created' or 'never', got {self.merge!r}")
        if self.distance is not None:
            distance_named(self.distance)
        if self.shrinkage != "ledoit_wolf" and not (_number(self.shrinkage) and 0 < float(self.shrinkage) <= 1):
            raise AnalyticError(f"shrinkage must be 'ledoit_wolf' or a share in (0, 1], got {self.shrinkage!r}")
        if not (_number(self.held_out) and 0 < self.held_out < 1):
            raise AnalyticError(f"held_out must be a share between 0 and 1, got {self.held_out!r}")
        self._check_counts()

    def x(self, nodes: int) -> float:
        """Return the x of eq. 4 for a map of that many nodes ([I] 6.2); the smaller, the stricter."""
        return max(self.omega, self.x_start - self.x_slope * nodes)

    def holds_out(self, held: int, frames: int) -> bool:
        """Decide whether the next frame of a node is held out, so that the share is kept."""
        return held < floor(self.held_out * (frames + 1) + _CLOSE)

    @property
    def memory(self) -> int:
        """The number of last frames that may still be needed to form a node or to be evaluated again."""
        return max(self.first_node, self.new_node, self.checked_window, self.forced_window, self.changes_window) + (
            self.window
        )

    def _check_counts(self) -> None:
        counts = (
            "first_node new_node parked_nodes checked_unassigned checked_window forced_unassigned forced_window "
            "node_changes changes_window window smallest_node"
        )
        for name in counts.split():
            least = 0 if name in ("parked_nodes", "window") else 1
            _whole(name, getattr(self, name), least)
        if self.exemplars is not None:
            _whole("exemplars", self.exemplars, _SMALLEST_GAUSSIAN)
        for part, whole in (("checked_unassigned", "checked_window"), ("forced_unassigned", "forced_window")):
            if getattr(self, part) > getattr(self, whole):
                raise AnalyticError(
                    f"{part} counts frames of the last {whole}: {getattr(self, part)} of {getattr(self, whole)} "
                    "is impossible"
                )
        for name in ("first_node", "new_node", "checked_unassigned", "forced_unassigned", "changes_window"):
            if getattr(self, name) < self.smallest_node:
                raise AnalyticError(
                    f"{name}={getattr(self, name)} would form nodes of fewer than smallest_node={self.smallest_node} "
                    "frames: raise the one or lower the other"
                )
        held = floor(self.held_out * self.smallest_node + _CLOSE)
        if not _SMALLEST_GAUSSIAN <= held <= self.smallest_node - _SMALLEST_GAUSSIAN:
            raise AnalyticError(
                f"held_out={self.held_out:g} of smallest_node={self.smallest_node} frames holds out {held}: at "
                "least two must be held out, and two must be left to model the node"
            )


def parameters(values: dict[str, Any]) -> Parameters:
    """Check parameters given by name and return them.

    Raises:
        AnalyticError: an unknown name, or a value out of its range.
    """
    valid = [field.name for field in fields(Parameters)]
    for name in values:
        if name not in valid:
            raise AnalyticError(f"the mapper has no parameter {name!r}: {hint(name, valid)}")
    return Parameters(**values)


def _number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= _MOST


def _positive(name: str, value: Any) -> None:
    if not (_number(value) and value > 0):
        raise AnalyticError(f"{name} must be a positive number, got {value!r}")


def _whole(name: str, value: Any, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= _MOST:
        raise AnalyticError(f"{name} must be a whole number from {least} to {_MOST:,}, got {value!r}")
