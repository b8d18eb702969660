"""The thresholds of the mapper, by name, with their published defaults."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor
from typing import Annotated, Literal

from analytic.distances import distance as distance_named
from analytic.errors import AnalyticError
from foundation.settings import Count, Natural, NotNegative, Positive, Probability, Rule, Settings

CLOSE = 1e-9  # a product such as 0.2 * 15 may be off by rounding, and must not fall below the whole number
_SMALLEST_GAUSSIAN = 2  # frames that a standard deviation needs


@dataclass(frozen=True, kw_only=True)
class Parameters(Settings):
    """The thresholds that decide how a map grows.

    Attributes:
        version: 1 is [I] 4 and [T] 4.3; 2 is the improved version of [T] 4.6.
        omega: the smallest x of eq. 4, once there are many nodes.
        y: width of the merging condition, eq. 11; the larger, the more merging.
        gamma: how many times the mean prominence the best image must reach, eq. 8; version 1 only.
        x_start: x is max(omega, x_start - x_slope * nodes).
        x_slope: decrease of x, eq. 4, with each node; see `x_start`.
        two_sided: eq. 4 and 11 as published, |distance - mean| <= x * std; False drops the lower side, so that a frame
            nearer to a node than its own frames also closes.
        merge: "changed" checks whether the node that a frame has joined or created merges with another ([T] 4.5.2),
            "created" only a node that has just been created ([I] 4.6), "never" none.
        distance: distance between position descriptors at image level, eq. 5; None is the descriptor's own.
        orientation: whether the aligned orientation parts are compared too, where the descriptor has them.
        shrinkage: "ledoit_wolf", or a fixed share of the identity in (0, 1].
        held_out: share of a node's frames that form the Gaussian of eq. 4 instead of its mean and covariance.
        first_node: number of consecutive frames that form the first node.
        new_node: consecutive frames without a node that form the next one; version 1.
        parked_nodes: the largest number of candidates that wait; of more, the oldest is forgotten; version 1.
        checked_unassigned: frames without a node, of the last `checked_window`, that call for a new one; version 2.
        checked_window: number of last frames in which `checked_unassigned` counts.
        forced_unassigned: frames without a node, of the last `forced_window`, that force a new one; version 2.
        forced_window: number of last frames in which `forced_unassigned` counts.
        node_changes: changes of node in the last `changes_window` frames that call for a new one; version 2.
        changes_window: number of last frames in which `node_changes` counts.
        window: frames before a new node that are evaluated again with the node's frames; version 2.
        smallest_node: the fewest frames that a node keeps when others leave it, and that a mode needs.
        exemplars: largest number of frames of a mode kept for comparing images, and of held-out frames; None keeps all.

    Raises:
        AnalyticError: a value out of its range.

    Examples:
        >>> Parameters(version=2, omega=2.0).x(nodes=40)
        2.0
    """

    ERROR = AnalyticError

    version: Literal[1, 2] = 1
    omega: Positive = 1.85
    y: Positive = 1.5
    gamma: Positive = 5.0
    x_start: Positive = 3.05
    x_slope: NotNegative = 0.15
    two_sided: bool = True
    merge: Literal["changed", "created", "never"] = "changed"
    distance: str | None = "euclidean"
    orientation: bool = True
    shrinkage: Literal["ledoit_wolf"] | Annotated[float, Rule("a share above 0, up to 1", lambda v: 0 < v <= 1)] = (
        "ledoit_wolf"
    )
    held_out: Probability = 0.2
    first_node: Count = 20
    new_node: Count = 15
    parked_nodes: Natural = 8
    checked_unassigned: Count = 15
    checked_window: Count = 20
    forced_unassigned: Count = 28
    forced_window: Count = 30
    node_changes: Count = 9
    changes_window: Count = 20
    window: Natural = 40
    smallest_node: Count = 10
    exemplars: Annotated[int, Rule("a whole number from 2 to 10 million", lambda v: 2 <= v <= 10**7)] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.distance is not None:
            distance_named(self.distance)
        for part, whole in (("checked_unassigned", "checked_window"), ("forced_unassigned", "forced_window")):
            if getattr(self, part) > getattr(self, whole):
                raise AnalyticError(
                    f"{self._key(part)}={getattr(self, part)} is more than {self._key(whole)}={getattr(self, whole)}, "
                    "the frames that it is counted in: lower the one or raise the other"
                )
        least = f"{self._key('smallest_node')}={self.smallest_node}"
        for name in ("first_node", "new_node", "checked_unassigned", "forced_unassigned", "changes_window"):
            if getattr(self, name) < self.smallest_node:
                raise AnalyticError(
                    f"{self._key(name)}={getattr(self, name)} is less than {least}, so nodes would have too few "
                    "frames: raise the one or lower the other"
                )
        held = floor(self.held_out * self.smallest_node + CLOSE)
        if not _SMALLEST_GAUSSIAN <= held <= self.smallest_node - _SMALLEST_GAUSSIAN:
            raise AnalyticError(
                f"{self._key('held_out')}={self.held_out:g} of {least} frames holds out {held}: at least two must be "
                "held out, and two must be left to model the node"
            )

    def x(self, nodes: int) -> float:
        """Return the x of eq. 4 for a map with this number of nodes ([I] 6.2); a smaller x is stricter."""
        return max(self.omega, self.x_start - self.x_slope * nodes)

    def holds_out(self, held: int, frames: int) -> bool:
        """Decide whether a node's next frame is held out, so that the share `held_out` is kept."""
        return held < floor(self.held_out * (frames + 1) + CLOSE)

    @property
    def memory(self) -> int:
        """Number of last frames to remember, as they may form a node or be evaluated again."""
        return max(self.first_node, self.new_node, self.checked_window, self.forced_window, self.changes_window) + (
            self.window
        )
