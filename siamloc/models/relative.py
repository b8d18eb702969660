"""Estimate displacement and turn of a robot relative to a map frame, from the orientation parts of both."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from siamloc.models.alignment import CHANNELS, GROUPS, Alignment
from siamloc.models.origins import Origins

REACH = 8.0
"""Largest distance between two images for a comparison, in the unit of the positions."""
SHARED = 0.04
"""Smallest visual overlap of two images for a comparison, where it is known: walls may stand between near images."""
FREEDOM = 4.0
"""Degrees of freedom of the t-distribution of errors; `siamloc.maps.refine`, which joins answers, assumes the same."""
_SHIFTS, _WIDTH = 5, 128
_TURN = 10.0  # turns count in tenths of a radian, about the size of displacements
_PRIOR = 0.5  # information of each coordinate before any column is considered: a deviation of 1.4 m
_GAIN = 10.0
_MOST = 6.0  # largest logarithm of the factor on the summed information
_RANKS = (0, 4, 10)  # an image is compared with these of its nearest ones in a batch
_ELSEWHERE = (1.0, 3.0, REACH)  # and, beyond each of these distances, with the most similar one
_SUREST = 8.0  # largest log probability, and difference of two, that counts
_ALIKE = 0.8  # cosine of aligned parts above which it counts: few pairs of two drives reach it
_ALIGNED = 2.0  # columns: a query whose turn is off by more cannot be compared
_AHEAD = 0.5  # rad: two images of an ordinary camera that are turned by more share too little
_FIELD = math.pi / 2  # assumed field of view of an ordinary camera, whose lens is unknown


class Relative(NamedTuple):
    """Estimated poses of B query images relative to B map frames.

    Attributes:
        pose: (B, 3) displacement ahead and to the left, seen from the map frame's robot, in the unit of the positions,
            and how far the query's robot has turned left, in rad in [-pi, pi].
        information: (B, 3, 3) inverse of the scale matrix of a t-distribution with 4 degrees of freedom; turns are in
            rad.
        match: (B,) log odds that the images were taken within `REACH` of each other, show some of the same surfaces,
            and are turned alike.
        turns: (B, K) log probability of each turn of the query, by whole columns, to bring it to the map frame's
            direction; (B, 1), of the only one, if the columns are not a full turn.
    """

    pose: Tensor
    information: Tensor
    match: Tensor
    turns: Tensor

    @property
    def steps(self) -> Tensor:
        """Number of columns (B,) by which each query was turned to be compared."""
        return self.turns.argmax(dim=1)


class RelativePose(nn.Module):
    """Compare the orientation parts of a query and a map frame.

    The query's columns are first turned to the map frame's direction, by whole columns; see `Alignment`. Then each
    column of the map frame is compared with its surroundings in the query, and with all of it by the alignment's
    features: from another position, things appear shifted, by an angle that shows the movement across the line of
    sight. From that, each column votes for a displacement along and across its own line of sight and for the rest of
    the turn, with an information matrix. The votes are rotated into the map frame's axes and summed like independent
    measurements. Together they may carry less information than that, for example if two places look alike: a factor
    estimated from all columns accounts for it. The factor also depends on how certain the turn is, and on how alike
    the aligned parts are (their cosine, as far as it is above 0.8), since columns show movement, and two images of one
    spot show none. By construction, turning a panorama turns the answer, whatever was learned.

    Images of an ordinary camera, which looks ahead, are not turned first, and nothing is next to their outer columns.
    A column's line of sight is that of a field of view of 90 degrees: whatever the lens, the order of the columns and
    the middle are right, and the rest is learned.

    Args:
        columns: number of columns K of the orientation parts.
        values: numbers per column F of the orientation parts.
        circular: whether the columns are a full turn.

    Example:
        >>> from siamloc.models import build
        >>> network = build("panoresnet", "magnitudes", (64, 256), circular=True, relative=True).eval()
        >>> _, seen = network.with_orientation(torch.rand(2, 3, 64, 256))
        >>> found = network.relative(seen, seen.roll(8, dims=1))
        >>> found.pose.shape, found.information.shape, found.match.shape
        (torch.Size([2, 3]), torch.Size([2, 3, 3]), torch.Size([2]))
    """

    windows: Tensor
    axes: Tensor
    entries: Tensor
    scales: Tensor

    def __init__(self, columns: int, values: int, circular: bool = True) -> None:
        super().__init__()
        self.columns = columns
        self.circular = circular
        self.shifts = min(_SHIFTS, (columns - 1) // 2)
        inputs = 2 * values + GROUPS * (2 * self.shifts + 1)
        self.first = nn.Conv1d(inputs, _WIDTH, 3)
        self.more = nn.ModuleList(nn.Conv1d(_WIDTH, _WIDTH, 3) for _ in range(3))
        self.votes = nn.Conv1d(_WIDTH, 9, 1)
        self.whole = nn.Linear(_WIDTH, 2)
        self.alignment = Alignment(columns) if circular else None
        if circular:
            self.far = nn.Conv1d(CHANNELS * columns, _WIDTH, 1, bias=False)
            self.sure = nn.Linear(3, 2, bias=False)
        windows = torch.empty(2 * self.shifts + 1, columns, dtype=torch.int64)
        self.register_buffer("windows", windows, persistent=False)
        self.register_buffer("axes", torch.empty(columns, 3, 3), persistent=False)
        self.register_buffer("entries", torch.empty(9, dtype=torch.int64), persistent=False)
        self.register_buffer("scales", torch.empty(3, 3), persistent=False)

    def reset(self) -> None:
        """Fill in the buffers, whose values are never learned, and let all votes start small."""
        column = torch.arange(self.columns)
        field = 2 * math.pi if self.circular else _FIELD
        azimuth = -(column + 0.5 - self.columns / 2).double() * (field / self.columns)
        with torch.no_grad():
            shift = torch.arange(len(self.windows))[:, None] - self.shifts
            beside = column + shift
            self.windows.copy_(beside % self.columns if self.circular else beside + self.shifts)
            self.axes.zero_()
            self.axes[:, 0, 0] = self.axes[:, 1, 1] = azimuth.cos().float()
            self.axes[:, 1, 0] = azimuth.sin().float()
            self.axes[:, 0, 1] = -azimuth.sin().float()
            self.axes[:, 2, 2] = 1.0
            self.entries.copy_(torch.tensor([0, 6, 6, 1, 2, 6, 3, 4, 5]))
            units = torch.tensor([1.0, 1.0, _TURN])
            self.scales.copy_(units[:, None] * units * _GAIN)
            for layer in (self.votes, self.whole):
                layer.weight *= 0.1
            if self.alignment is not None:
                self.alignment.reset()
                for layer in (self.far, self.sure):
                    layer.weight.zero_()

    def forward(self, query: Tensor, known: Tensor) -> Relative:
        """Estimate the poses of queries relative to map frames.

        Args:
            query: orientation parts (B, K, F).
            known: orientation parts of the map frames (B, K, F), one for each query.
        """
        if self.alignment is None:
            features, turns = None, torch.zeros_like(query[:, :1, 0])
        else:
            features, turns = self.alignment(query, known)
        steps = turns.argmax(dim=1)
        features = None if features is None else _turned(features, -steps, dim=3)
        seen = _turned(query, steps)
        votes, whole = self._votes(seen, known, features)
        if self.alignment is not None:
            best, second = turns.topk(2, dim=1).values.unbind(dim=1)
            alike = F.relu(_cosine(seen, known) - _ALIKE)
            sure = torch.stack([best, best - second, alike], dim=1)
            whole = whole + self.sure(sure.clamp(-_SUREST, _SUREST))
        vector = (self.axes @ votes[:, :3].permute(0, 2, 1)[..., None])[..., 0].sum(dim=1)
        lower = F.pad(votes[:, 3:], (0, 0, 0, 1)).index_select(1, self.entries)  # triangular: the seventh row is zero
        factors = self.axes @ lower.transpose(1, 2).unflatten(2, (3, 3))
        prior = _PRIOR / _GAIN * torch.eye(3, dtype=votes.dtype, device=votes.device)
        information = (factors @ factors.mT).sum(dim=1) + prior
        pose = (_inverse(information) @ vector[..., None])[..., 0]
        turn = _wrap(pose[:, 2] / _TURN - steps * (2 * math.pi / self.columns))
        known_together = whole[:, 1].clamp(-_MOST, _MOST).exp()[:, None, None]
        pose = torch.cat([pose[:, :2], turn[:, None]], dim=1)
        return Relative(pose, information * known_together * self.scales, whole[:, 0], turns)

    def _votes(self, seen: Tensor, known: Tensor, features: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return the votes (B, 9, K); and from all columns the odds of a match and their joint information (B, 2).

        Args:
            seen: orientation parts of the queries (B, K, F), turned to the map frames' direction.
            known: orientation parts of the map frames (B, K, F).
            features: the alignment's features (B, C, K, K), by map column and turn from that direction.
        """
        padded = seen if self.circular else F.pad(seen, (0, 0, self.shifts, self.shifts))
        around = padded.index_select(1, self.windows.flatten()).unflatten(1, self.windows.shape)  # (B, S, K, F)
        compared = (known[:, None] * around).unflatten(3, (GROUPS, -1)).mean(dim=4)  # (B, S, K, G)
        compared = compared.transpose(2, 3).flatten(1, 2)
        both = torch.cat([known, seen], dim=2).transpose(1, 2)
        found = self.first(self._padded(torch.cat([compared, both], dim=1)))
        if features is not None:
            found = found + self.far(features.transpose(2, 3).flatten(1, 2))
        found = F.relu(found)
        for layer in self.more:
            found = found + F.relu(layer(self._padded(found)))
        return self.votes(found), self.whole(found.mean(dim=2))

    def _padded(self, values: Tensor) -> Tensor:
        """Pad values (..., K) by a column at each end: from the other end of a full turn, else with zeros."""
        if not self.circular:
            return F.pad(values, (1, 1))
        return torch.cat([values[..., -1:], values, values[..., :1]], dim=-1)


def compared(origins: Origins, descriptors: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Choose pairs of a batch's images from which to learn displacements.

    Each image is compared with some of the nearest images, near and farther ones, and with the most similar image
    beyond each of several distances, the last of which is out of reach: such images are what a search returns. The
    number of pairs P follows from N alone, so that no step waits for its device; where an image has no partner of a
    kind, the pair does not count.

    Args:
        origins: origins of the images (N); pairs of those without a heading or a position do not count.
        descriptors: (N, D).

    Returns:
        Rows of the queries (P,) and of the map frames (P,), and whether each pair counts (P,).
    """
    assert origins.theta is not None
    apart = origins.distances()
    usable = torch.isfinite(origins.theta) & torch.isfinite(origins.xy).all(dim=1)
    itself = torch.eye(len(apart), dtype=torch.bool, device=apart.device)
    barred = itself | ~usable[:, None] | ~usable
    order = apart.masked_fill(barred, math.inf).argsort(dim=1)
    nearest = [order[:, one : one + 1] for one in _RANKS if one < len(apart)]
    likeness = (descriptors @ descriptors.mT).masked_fill(barred, -math.inf)
    mistaken = [likeness.masked_fill(apart <= least, -math.inf).max(dim=1) for least in _ELSEWHERE]
    known = torch.cat([*nearest, *(one.indices[:, None] for one in mistaken)], dim=1)
    query = torch.arange(len(apart), device=apart.device)[:, None].expand_as(known)
    counts = ~barred[query, known]
    counts[:, len(nearest) :] &= torch.stack([one.values for one in mistaken], dim=1) > -math.inf
    return query.flatten(), known.flatten(), counts.flatten()


def relative_loss(
    relative: RelativePose,
    orientation: Tensor,
    origins: Origins,
    descriptors: Tensor,
    compare: Callable[..., Relative] | None = None,
) -> tuple[Tensor, Tensor]:
    """Return the loss of comparing pairs of a batch, and the mean error of the displacements within reach.

    The loss is the negative log likelihood: of a t-distribution for the pose, which a few large errors do not dominate,
    and of whether the images can be compared, that is, were taken within reach of each other, have a visual overlap of
    `SHARED` or more where it is known, and are turned alike: by their alignment, or, if the columns are not a full
    turn, by their headings. Where poses have deviations, their variance is added to that of the estimate: uncertain
    poses teach less, and the network does not take their errors for its own. The turns of the pairs within reach are
    learned by cross entropy. The error is NaN if no two images can be compared.

    Args:
        relative: the module that compares orientation parts.
        orientation: orientation parts of the images (N, K, F).
        origins: origins of the images (N), with headings.
        descriptors: (N, D), to find similar images.
        compare: computes what `relative` does, such as a compiled form of it; `relative` itself if None.
    """
    assert origins.theta is not None
    query, known, counts = compared(origins, descriptors)
    # Pairs without a heading or a position do not count, but NaN times 0 is NaN.
    theta, xy = (torch.nan_to_num(one, posinf=0, neginf=0) for one in (origins.theta, origins.xy))
    apart = xy[query] - xy[known]
    near = counts & (torch.linalg.vector_norm(apart, dim=1) <= REACH)
    near &= origins.building[query] == origins.building[known]
    if origins.overlap is not None:
        near &= ~(origins.overlap[query, known] < SHARED)
    cosine, sine = theta[known].cos(), theta[known].sin()
    ahead = cosine * apart[:, 0] + sine * apart[:, 1]
    left = cosine * apart[:, 1] - sine * apart[:, 0]
    turn = theta[query] - theta[known]
    column = 2 * math.pi / relative.columns
    found = (compare or relative)(orientation[query], orientation[known])
    turned = (
        (_turn_loss(found.turns, -turn / column) * near).sum() / near.sum().clamp(min=1) if relative.circular else 0
    )
    most = _ALIGNED if relative.circular else _AHEAD / column
    near = near & ((_wrap(turn + found.steps * column) / column).abs() <= most)
    information = found.information
    if origins.deviation is not None:
        information = _blurred(information, ahead, left, *(origins.deviation[one].square() for one in (query, known)))
    error = torch.stack([ahead, left, turn], dim=1) - found.pose
    error = torch.cat([error[:, :2], _wrap(error[:, 2:])], dim=1)
    squared = (error[:, None] @ information @ error[..., None])[:, 0, 0]
    pose = 0.5 * (FREEDOM + 3) * torch.log1p(squared / FREEDOM) - 0.5 * torch.logdet(information)
    count = near.sum()
    weight, target = (each.to(found.match.dtype) for each in (counts, near))
    match = F.binary_cross_entropy_with_logits(found.match, target, weight, reduction="sum")
    off_by = torch.linalg.vector_norm(error[:, :2].detach(), dim=1)
    loss = (pose * near).sum() / count.clamp(min=1) + match / counts.sum().clamp(min=1) + turned
    return loss, (off_by * near).sum() / count


def _turn_loss(turns: Tensor, steps: Tensor) -> Tensor:
    """Return the cross entropy (P,) of log probabilities of turns (P, K), if a turn (P,) lies between two columns."""
    before = steps.floor()
    share = steps - before
    first, second = ((before.long() + more) % turns.shape[1] for more in (0, 1))
    one, other = (turns.gather(1, column[:, None])[:, 0] for column in (first, second))
    return -(1 - share) * one - share * other


def _blurred(information: Tensor, ahead: Tensor, left: Tensor, query: Tensor, known: Tensor) -> Tensor:
    """Return the information (P, 3, 3) about errors of estimates against poses that are themselves uncertain.

    Args:
        information: inverse of the scale matrix of the estimated poses.
        ahead: true displacements ahead (P,), as seen from the map frames.
        left: true displacements to the left (P,), as seen from the map frames.
        query: variances of each coordinate of the queries' positions, and of their headings (P, 2).
        known: the same variances of the map frames (P, 2).
    """
    position = query[:, 0] + known[:, 0]
    turned = torch.stack([left, -ahead, -torch.ones_like(left)], dim=1)  # derivative by the map frame's heading
    covariance = torch.diag_embed(torch.stack([position, position, query[:, 1]], dim=1))
    covariance = covariance + known[:, 1, None, None] * turned[:, :, None] * turned[:, None]
    scale = covariance * ((FREEDOM - 2) / FREEDOM)
    both = torch.linalg.solve(torch.eye(3, device=scale.device) + information @ scale, information)
    return (both + both.mT) / 2


def _wrap(angle: Tensor) -> Tensor:
    """Wrap angles to [-pi, pi]."""
    return angle - 2 * math.pi * (angle / (2 * math.pi)).round()


def _turned(values: Tensor, steps: Tensor, dim: int = 1) -> Tensor:
    """Return values (B, ...) turned along a dimension of K columns (B,): column j holds what was column j - step."""
    column = torch.arange(values.shape[dim], device=values.device)
    source = (column - steps[:, None]) % values.shape[dim]
    shape = [-1 if one == 0 else len(column) if one == dim else 1 for one in range(values.ndim)]
    return values.gather(dim, source.view(shape).expand_as(values))


def _cosine(one: Tensor, other: Tensor) -> Tensor:
    """Return the cosine (B,) between values (B, K, F)."""
    size = (one.square().sum(dim=(1, 2)) * other.square().sum(dim=(1, 2))).clamp(min=1e-12).sqrt()
    return (one * other).sum(dim=(1, 2)) / size


def _inverse(matrix: Tensor) -> Tensor:
    """Return the inverses of symmetric matrices (B, 3, 3) from cofactors, which every runtime supports."""
    upper, lower = matrix.roll(-1, 1), matrix.roll(1, 1)  # a cofactor is of the next two rows and columns
    cofactor = upper.roll(-1, 2) * lower.roll(1, 2) - upper.roll(1, 2) * lower.roll(-1, 2)
    determinant = (matrix[:, 0] * cofactor[:, 0]).sum(dim=1)
    return cofactor / determinant[:, None, None]
