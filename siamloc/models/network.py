"""The network that both images of a pair share: a branch, then a head ([T] 5.3, figure 5.2)."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from math import prod
from os import PathLike
from typing import Any

import torch
from torch import Tensor, nn

from siamloc.errors import ConfigError, DataError
from siamloc.models.branches import IMAGENET_MEAN, IMAGENET_STD, Branch, feature_shape
from siamloc.models.heads import Head
from siamloc.models.registry import branch_spec, head_widths
from siamloc.models.weights import load_weights


def build(
    branch: str,
    head: str,
    image_size: Sequence[int] = (128, 512),
    weights: str | PathLike[str] | None = None,
    seed: int = 0,
) -> Network:
    """Return a fresh network (B, 3, H, W) in [0, 1] -> (B, D), in training mode on the CPU.

    The weights are drawn from `seed` alone; no global random generator is read or moved. Convolutions and fully
    connected layers get He initialization (normal, variance 2 / inputs; [He 2015]) and zero biases, which keeps
    the size of the signal through any depth of ReLU layers, so that also the deep branches without batch
    normalization learn from scratch. The last layer, which no ReLU follows, has variance 1 / (inputs * D): the
    descriptors begin with a length of about 1, so that distances begin on the scale of the margin whatever D is.

    Args:
        branch: a name in `BRANCHES`.
        head: a name in `HEADS`.
        image_size: (H, W) of the panoramas in pixels.
        weights: None for random weights; "imagenet" or the name of a torchvision weight enum such as
            "IMAGENET1K_V1" for a pre-trained branch; or the path of a state dict (.pth, .ckpt, .safetensors) of
            this network, of a torchvision network with this branch, or of a checkpoint of `SiameseModule`.
        seed: of the random weights; any integer from 0 to 2**63 - 1.

    Raises:
        ConfigError: unknown names, an image too small for the branch, weights that cannot be had or do not fit.
    """
    size = checked_image_size(image_size)
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**63:
        raise ConfigError(f"the seed must be an integer from 0 to 2**63 - 1, got {seed!r}")
    branch_spec(branch)
    head_widths(head)
    with torch.device("meta"):
        network = Network(branch, head, size)
    network.to_empty(device="cpu")
    _initialize(network, seed)
    if weights is not None:
        load_weights(network, weights)
    return network


class Network(nn.Module):
    """Branch and head; made by `build`.

    Args:
        branch: a name in `BRANCHES`.
        head: a name in `HEADS`.
        image_size: (H, W) in pixels.

    Attributes:
        branch: the `Branch`, which also normalizes.
        head: the `Head`.
        image_size: (H, W) in pixels.
        grid: rows and columns of the features that the head sees.
    """

    def __init__(self, branch: str, head: str, image_size: tuple[int, int]) -> None:
        super().__init__()
        shape = feature_shape(branch, image_size)
        self.image_size = image_size
        self.grid = shape[1:]
        self.branch = Branch(branch)
        self.head = Head(head, prod(shape))

    @property
    def outputs(self) -> int:
        """Length D of a descriptor."""
        return self.head.outputs

    @property
    def identity(self) -> dict[str, Any]:
        """Names, image size and a hash of all weights: descriptors may be compared if these agree.

        Reads every weight, about a second for the largest networks: keep it, do not ask for it in a loop.
        """
        return {
            "name": "siamese",
            "branch": self.branch.name,
            "head": self.head.name,
            "image_size": list(self.image_size),
            "weights": state_hash(self.state_dict()),
        }

    def forward(self, panorama: Tensor) -> Tensor:
        """Return descriptors (B, D) of panoramas (B, 3, H, W), floating point in [0, 1].

        Raises:
            DataError: another shape or integers (not looked at while a compiler or an exporter traces).
        """
        if not (torch.compiler.is_compiling() or torch.jit.is_tracing()):
            self._check(panorama)
        return self.head(self.branch(panorama))

    def _check(self, panorama: Tensor) -> None:
        rows, columns = self.image_size
        if panorama.ndim != 4 or panorama.shape[1:] != (3, rows, columns):
            raise DataError(
                f"the network was built for panoramas of shape (B, 3, {rows}, {columns}), got {tuple(panorama.shape)}"
            )
        if not panorama.is_floating_point():
            raise DataError(f"the network needs floating point in [0, 1], got {panorama.dtype}: divide by 255 first")


def checked_image_size(image_size: Sequence[int]) -> tuple[int, int]:
    """Return (H, W) as plain integers.

    Raises:
        ConfigError: anything but two positive integers.
    """
    values = list(image_size) if isinstance(image_size, Sequence) and not isinstance(image_size, str) else []
    if len(values) != 2 or not all(isinstance(side, int) and side > 0 for side in values):
        raise ConfigError(f"image_size must be two positive integers (height, width), got {image_size!r}")
    return int(values[0]), int(values[1])


def state_hash(state: dict[str, Tensor], length: int = 16) -> str:
    """Return a short hash of a state dict: of names, types, shapes and values, the same on every device."""
    digest = hashlib.sha256()
    for name in sorted(state):
        tensor = state[name].detach().cpu().contiguous()
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.reshape(-1).view(torch.uint8).numpy().data)
    return digest.hexdigest()[:length]


def _initialize(network: Network, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    network.branch.normalize_with(IMAGENET_MEAN, IMAGENET_STD)
    last = [module for module in network.modules() if isinstance(module, nn.Linear)][-1]
    for module in network.modules():
        if isinstance(module, nn.BatchNorm2d):
            module.reset_parameters()
        elif isinstance(module, (nn.Conv2d, nn.Linear)):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu", generator=generator)
            if module is last:
                with torch.no_grad():
                    module.weight /= (2 * network.outputs) ** 0.5
            if module.bias is not None:
                nn.init.zeros_(module.bias)
        elif next(module.parameters(recurse=False), None) is not None:
            raise TypeError(f"no initialization is known for {type(module).__name__}")
