"""How well a network locates a validation drive: its queries are searched in a map by their descriptors."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor

from siamloc.models.origins import required
from siamloc.models.relative import RelativePose

ELSEWHERE = 100.0
"""Error assigned to a query that is found in another building, in the unit of the positions."""

RECALL_RADIUS = 0.5
"""A query is found if the map frame with the nearest descriptor is this near, in the unit of the positions."""

_COLUMNS = ("xy", "building", "room", "known")
_AT_ONCE = 256  # pairs to compare


class DriveFigures:
    """Gather the descriptors of map frames and queries, and compute the errors of the queries.

    Args:
        radius: radius of the recall, in the unit of the positions: a query counts if the map frame with the nearest
            descriptor is within it.

    Example:
        >>> figures = DriveFigures(radius=0.5)
        >>> xy = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.2, 0.0], [0.4, 0.0]])
        >>> known = torch.tensor([True, True, False, False])
        >>> rows = {"xy": xy, "known": known, "building": torch.zeros(4), "room": torch.full((4,), -1)}
        >>> figures.add(rows, descriptors=torch.tensor([[0.0], [1.0], [0.1], [0.8]]))
        >>> {name: round(float(value), 2) for name, value in figures.compute().items()}
        {'error': 0.4, 'median': 0.4, 'recall': 0.5}
    """

    def __init__(self, radius: float = RECALL_RADIUS) -> None:
        self.radius = radius
        self._parts: list[dict[str, Tensor]] = []

    def add(self, batch: Mapping[str, Tensor], descriptors: Tensor, orientation: Tensor | None = None) -> None:
        """Add a batch of described map frames and queries.

        Args:
            batch: `known` (B,) bool, True for map frames; `xy` (B, 2), NaN if unknown; `building` (B,); `room` (B,),
                negative if unknown.
            descriptors: (B, D).
            orientation: parts (B, K, F) of a network that compares images; then the batch also has `theta` (B,), the
                headings in rad, NaN if unknown.

        Raises:
            DataError: a batch without one of these keys.
        """
        columns = _COLUMNS if orientation is None else (*_COLUMNS, "theta")
        required(batch, columns, "map frames and queries")
        # In the training's precision, which is faster: these figures only choose among its own checkpoints, and an
        # evaluation describes in full precision.
        held = {} if orientation is None else {"orientation": orientation.float()}
        self._parts.append({"descriptors": descriptors.float(), **held, **{name: batch[name] for name in columns}})

    def compute(
        self, relative: RelativePose | None = None, naming: Callable[[Tensor, Tensor], Tensor] | None = None
    ) -> dict[str, Tensor]:
        """Search the queries in the map, compute the figures, and forget all frames.

        Args:
            relative: the module that compares the orientation parts.
            naming: (descriptors (B, D), room (B,)) -> the share whose room is named correctly.

        Returns:
            `error`, the mean distance from the map frame with the nearest descriptor, `median` and `recall`, if there
            are positions; `refined`, the mean error of the pose by comparison with that frame, if orientation parts
            and headings are available; `room`, the share of queries with the same room as that frame, if the map has
            two or more rooms; `accuracy`, the share whose room is named correctly. Empty if nothing was added.

        Raises:
            FloatingPointError: descriptors are not finite.
        """
        parts, self._parts = self._parts, []
        if not parts:
            return {}
        whole = {name: torch.cat([part[name] for part in parts]) for name in parts[0]}
        if not bool(torch.isfinite(whole["descriptors"]).all()):
            raise FloatingPointError("descriptors of the validation are not finite")
        known, query = whole["known"], ~whole["known"]
        apart = torch.cdist(whole["descriptors"][query], whole["descriptors"][known])
        placed = torch.isfinite(whole["xy"][known]).all(dim=1)  # the others cannot locate a query
        match = apart.masked_fill(~placed, torch.inf).argmin(dim=1)
        # A frame in another building is wrong, whatever the distance.
        there = whole["building"][query] == whole["building"][known][match]
        error = torch.linalg.vector_norm(whole["xy"][query] - whole["xy"][known][match], dim=1)
        found = there & (error <= self.radius)
        error = torch.where(there, error, ELSEWHERE)
        figures: dict[str, Tensor] = {}
        if bool((usable := torch.isfinite(error)).any()):
            figures = {"error": error[usable].mean(), "median": error[usable].quantile(0.5)}
            figures["recall"] = found[usable].float().mean()
        if relative is not None and "orientation" in whole:
            about = whole["theta"][known][match]
            rows = torch.isfinite(whole["xy"][query]).all(dim=1) & torch.isfinite(about) & placed[match]
            if bool(rows.any()):
                asked, answers = whole["orientation"][query][rows], whole["orientation"][known]
                pairs = zip(asked.split(_AT_ONCE), match[rows].split(_AT_ONCE), strict=True)  # bounds the memory
                pose = torch.cat([relative(query_part, answers[at]).pose for query_part, at in pairs])
                turned = _turned(pose[:, :2], about[rows])
                off = whole["xy"][known][match][rows] + turned - whole["xy"][query][rows]
                away = torch.linalg.vector_norm(off, dim=1)
                figures["refined"] = torch.where(there[rows], away, ELSEWHERE).mean()
        rooms, asked = whole["room"][known], whole["room"][query]
        if len(rooms[rooms >= 0].unique()) >= 2 and bool((asked >= 0).any()):
            figures["room"] = (rooms[apart.argmin(dim=1)] == asked)[asked >= 0].float().mean()
        if naming is not None and bool((asked >= 0).any()):
            figures["accuracy"] = naming(whole["descriptors"][query], asked)
        return figures


def _turned(xy: Tensor, theta: Tensor) -> Tensor:
    """Rotate vectors (n, 2) from the axes of robots with these headings (n,) to those of the building."""
    cosine, sine = theta.cos(), theta.sin()
    return torch.stack([cosine * xy[:, 0] - sine * xy[:, 1], sine * xy[:, 0] + cosine * xy[:, 1]], dim=1)
