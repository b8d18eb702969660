"""Find how far two panoramas are turned against each other, although they were taken metres apart."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

GROUPS = 8
"""Groups of numbers of a column, each of which gives one similarity of two columns."""
CHANNELS = 16
"""Features of each pair of columns."""
_DILATIONS = 1, 1, 2, 4
_GAIN = 20.0  # on the correlation of all columns, to be a log probability


class Alignment(nn.Module):
    """Estimate the turn between a query and a map frame from the orientation parts of both.

    From the same position, the turn is that by which all columns correlate best. From another position each thing is
    seen in another direction, by up to half a turn, and no turn brings all columns together. The similarities of all
    columns of the map frame with all columns of the query, ordered by map column and by turn, form an image in which a
    displacement leaves a pattern: the match of a column wanders to one side ahead and to the other side behind.
    Convolutions that wrap around in both directions find that pattern. The score of a turn is the correlation of all
    columns at that turn, with what is learned from the pattern added. By construction, turning the query by whole
    columns shifts the scores, whatever was learned.

    Args:
        columns: number of columns K of the orientation parts, at least 4.

    Shape:
        query, known: (B, K, F), where F is a multiple of 8. Returns features (B, 16, K, K) of map columns and turns,
        and the log probability of each turn (B, K): turn s moves column j of the query to column j + s.

    Example:
        >>> known = torch.randn(2, 32, 64, generator=torch.Generator().manual_seed(0))
        >>> alignment = Alignment(32)
        >>> alignment.reset()
        >>> _, turns = alignment(known.roll(-3, dims=1), known)
        >>> turns.argmax(dim=1)
        tensor([3, 3])
    """

    places: Tensor

    def __init__(self, columns: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(GROUPS, CHANNELS, 3)
        self.more = nn.ModuleList(nn.Conv2d(CHANNELS, CHANNELS, 3, dilation=one) for one in _DILATIONS)
        self.score = nn.Linear(2 * CHANNELS, 1)
        self.gain = nn.Parameter(torch.empty(()))
        self.register_buffer("places", torch.empty(columns, columns, dtype=torch.int64), persistent=False)

    def reset(self) -> None:
        """Fill in the buffer, and let the correlation decide at first."""
        column = torch.arange(len(self.places))
        with torch.no_grad():
            self.places.copy_((column[:, None] - column) % len(column))
            self.score.weight *= 0.1
            self.score.bias.zero_()
            self.gain.fill_(_GAIN)

    def forward(self, query: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
        """Return features (B, 16, K, K) of map columns and turns, and log probabilities of the turns (B, K)."""
        similar = self._similarities(query, known)
        found = F.relu(self.first(F.pad(similar, (1,) * 4, mode="circular")))
        for layer, dilation in zip(self.more, _DILATIONS, strict=True):
            found = found + F.relu(layer(F.pad(found, (dilation,) * 4, mode="circular")))
        seen = torch.cat([found.mean(dim=2), found.amax(dim=2)], dim=1)
        scores = self.score(seen.transpose(1, 2))[..., 0] + self.gain * similar.mean(dim=(1, 2))
        return found, scores.log_softmax(dim=1)

    def _similarities(self, query: Tensor, known: Tensor) -> Tensor:
        """Return the similarity (B, 8, K, K) of map column j with the query's column that turn s moves there."""
        one, other = (part.unflatten(2, (GROUPS, -1)).transpose(1, 2) for part in (known, query))
        products = one @ other.mT / one.shape[3]  # (B, 8, K, K): column of the map frame, column of the query
        return products.gather(3, self.places.expand_as(products))
