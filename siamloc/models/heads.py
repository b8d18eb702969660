"""The head: three fully connected layers that scale the features down to a descriptor ([T] 5.3.1, table 5.2)."""

from __future__ import annotations

from torch import Tensor, nn

from siamloc.models.registry import head_widths


class Head(nn.Module):
    """Three fully connected layers with a ReLU between them: (B, C, h, w) -> (B, D).

    Nothing follows the last layer, and there is no softmax before it: a softmax would press the descriptors of all
    places together, and the published code of the thesis has none.

    Args:
        name: a name in `HEADS`.
        inputs: C * h * w.

    Raises:
        ConfigError: an unknown name.
    """

    def __init__(self, name: str, inputs: int) -> None:
        super().__init__()
        self.name = name
        first, second, self.outputs = head_widths(name)
        self.layers = nn.Sequential(
            nn.Flatten(),
            nn.Linear(inputs, first),
            nn.ReLU(inplace=True),
            nn.Linear(first, second),
            nn.ReLU(inplace=True),
            nn.Linear(second, self.outputs),
        )

    def forward(self, features: Tensor) -> Tensor:
        """Return the descriptors of features (B, C, h, w)."""
        return self.layers(features)
