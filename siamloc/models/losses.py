"""The contrastive loss with real-valued labels ([T] 5.3, eq. 5.1)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from foundation.calls import typed
from foundation.settings import Positive
from siamloc.errors import DataError


def pair_distance(d0: Tensor, d1: Tensor) -> Tensor:
    """Compute the Euclidean distance (B,) of each pair of descriptors (B, D), in float32 or better.

    Mixed precision is switched off here, since differences of close numbers need the precision. The gradient at
    distance 0, where the root has none, is 0.

    Example:
        >>> pair_distance(torch.tensor([[0.0, 0.0]]), torch.tensor([[3.0, 4.0]]))
        tensor([5.])
    """
    dtype = torch.promote_types(torch.promote_types(d0.dtype, d1.dtype), torch.float32)
    with torch.autocast(device_type=d0.device.type, enabled=False):
        return torch.linalg.vector_norm(d0.to(dtype) - d1.to(dtype), dim=1)


class ContrastiveLoss(nn.Module):
    """Pull similar images together and push dissimilar ones apart, up to a margin ([T] eq. 5.1).

    The mean over the pairs of (1 - y) d^2 + y max(margin - d, 0)^2.

    Args:
        margin: distance from which a dissimilar pair costs nothing; alpha in [T], where it is 2.

    Raises:
        ConfigError: a margin that is not positive.

    Example:
        >>> loss = ContrastiveLoss(margin=2.0)
        >>> first, second = torch.tensor([[0.0], [0.0]]), torch.tensor([[1.0], [1.5]])
        >>> loss(first, second, torch.tensor([0.0, 1.0]))  # the mean of 1 and 0.25
        tensor(0.6250)
    """

    @typed
    def __init__(self, margin: Positive = 2.0) -> None:
        super().__init__()
        self.margin = float(margin)

    def extra_repr(self) -> str:
        """Return the margin, for `repr`."""
        return f"margin={self.margin}"

    def forward(self, d0: Tensor, d1: Tensor, y: Tensor) -> Tensor:
        """Compute the loss of a batch of pairs, a scalar.

        Args:
            d0: (B, D), descriptors of the first images.
            d1: (B, D), descriptors of the second images.
            y: (B,), dissimilarity in [0, 1]: 0 similar, 1 dissimilar, or anything in between.

        Raises:
            DataError: other shapes, or labels outside [0, 1] (only checked on the CPU, where that is free).
        """
        if d0.ndim != 2 or d0.shape != d1.shape or 0 in d0.shape:
            raise DataError(
                f"the contrastive loss needs two sets of descriptors of one shape (B, D), "
                f"got {tuple(d0.shape)} and {tuple(d1.shape)}"
            )
        check_labels(y, len(d0))
        distance = pair_distance(d0, d1)
        y = y.to(distance.dtype)
        return ((1 - y) * distance**2 + y * (self.margin - distance).clamp(min=0) ** 2).mean()


def check_labels(y: Tensor, pairs: int) -> None:
    """Raise DataError unless the labels are (pairs,), and in [0, 1] if they are on the CPU."""
    if y.shape != (pairs,):
        hint = ": drop its last axis, or every label would meet every distance" if y.shape == (pairs, 1) else ""
        raise DataError(f"the contrastive loss needs one label per pair, shape ({pairs},), got {tuple(y.shape)}{hint}")
    if y.device.type == "cpu" and not bool(((y >= 0) & (y <= 1)).all()):
        raise DataError("labels of the contrastive loss must lie in [0, 1]: 0 similar, 1 dissimilar")
