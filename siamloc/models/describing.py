"""Describe images with a network: `as_descriptor` gives any module the interface of the analytic descriptors."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from operator import attrgetter
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from analytic.descriptors.base import Description, Descriptor
from analytic.descriptors.between_columns import BetweenColumns
from foundation.calls import typed
from foundation.threads import restored
from siamloc.errors import ConfigError, DataError
from siamloc.full_precision import full_precision
from siamloc.models.branch import Branch
from siamloc.models.descriptor_checks import check_repeatable, checked_descriptors
from siamloc.models.losses import ContrastiveLoss
from siamloc.models.network import Network
from siamloc.models.relative import RelativePose
from siamloc.models.room_classifier import NamedRooms, RoomClassifier
from siamloc.models.weights import state_hash

CHUNK = 64
_ROUNDING = 1e-3


class NetworkDescriptor(BetweenColumns):
    """Describe images with a network, in evaluation mode and full precision.

    A network of `siamloc.models.build` with the head `fourier` or `magnitudes` and circular=True also finds headings:
    its features move along the azimuth as the robot turns, and are compared at all turns; see
    `siamloc.models.orientation`. One with relative=True also compares images, see `siamloc.models.relative`.

    Attributes:
        module: the network, (B, 3, H, W) floating point in [0, 1] -> (B, D). Its weights are read at each call, and
            its mode and the random state are left unchanged.
    """

    name = "network"
    default_distance = "euclidean"

    def __init__(self, module: nn.Module) -> None:
        self.module = module
        network = network_of(module)
        # A network that siamloc did not define may depend on more than the image.
        self._repeatable = type(network) is Network and type(network.branch) is Branch

    def __repr__(self) -> str:
        return f"NetworkDescriptor({type(self.module).__name__})"

    @property
    def tells_heading(self) -> bool:
        """Whether the network finds headings: with the head `fourier` or `magnitudes` and circular=True."""
        network = orienting(self.module)
        return network is not None and network.branch.circular

    @property
    def margin(self) -> float | None:
        """Margin of the loss that the network was trained with; None if unknown."""
        return getattr(self.module, "trained_margin", None)

    @property
    def rooms(self) -> RoomClassifier | None:
        """Classifier that names the room from a descriptor; None unless trained with `CrossEntropyLoss`."""
        found = getattr(network_of(self.module), "rooms", None)
        return found if isinstance(found, RoomClassifier) else None

    @property
    def elevations(self) -> tuple[float, float] | None:
        """Elevations in degrees of the edges of the panoramas that the network was trained on; None if unknown."""
        found: tuple[float, float] | None = getattr(network_of(self.module), "view", {}).get("elevations")
        return found

    def classify(self, batch: Any, chunk: int = CHUNK) -> NamedRooms:
        """Name the rooms that images show.

        Args:
            batch: as for `describe`.
            chunk: images per pass.

        Raises:
            ConfigError: the network was not trained to name rooms.
            DataError: as `describe`.
        """
        if (rooms := self.rooms) is None:
            raise ConfigError(
                "this network does not name rooms: train one with loss=cross_entropy (from Python "
                "siamloc.models.CrossEntropyLoss)"
            )
        return rooms.named(self.describe(batch, chunk).position)

    @property
    def identity(self) -> dict[str, Any]:
        """What determines the descriptors: the network's names and settings, and a hash of its weights.

        Reads every weight, which takes about a second for the largest networks: keep the result.
        """
        return identity_of(self.module)

    def describe(self, batch: Any, chunk: int = CHUNK) -> Description:
        """Describe images: array or tensor, uint8 or floating point in [0, 1], one image or a batch.

        Args:
            batch: (B, 3, H, W), (3, H, W), (B, H, W) or (H, W); grey images are repeated over the three channels.
                Three grey images are (3, 1, H, W).
            chunk: images per pass; bounds the memory and changes results only by rounding.

        Raises:
            DataError: another shape or type, values that are not finite or outside [0, 1], or a network that returns
                anything but a descriptor for each image, or one that depends on chance or on the other images, which
                the first call checks for networks that siamloc does not define.
        """
        describes, images, like, parts = describing(self.module), _as_images(batch), _like(self.module), []
        with evaluating(self.module):
            for part in images.split(chunk):
                ready = as_float(_uploaded(part, like)).expand(-1, 3, -1, -1)
                if not self._repeatable:
                    check_repeatable(describes, ready[:1].to(like.dtype))
                    self._repeatable = True
                position, *orientation = describes(ready.to(like.dtype))
                given = [one.float() for one in (checked_descriptors(position, len(part)), *orientation)]
                # With the descriptors, since reading anything waits for a GPU; 8-bit numbers cannot be out of range.
                limits = [] if part.dtype == torch.uint8 else [torch.stack(ready.aminmax()).float()]
                found = _fetched([*given, *limits])
                for low, high in found[len(given) :]:
                    if not (low >= -_ROUNDING and high <= 1 + _ROUNDING):  # written so that NaN fails, too
                        raise DataError(
                            "floating point images must lie in [0, 1]: divide them by 255, or clean them of NaN"
                        )
                parts.append(found[: len(given)])
        whole = [torch.cat(given).numpy() for given in zip(*parts, strict=True)]
        return Description(whole[0], whole[1] if len(whole) > 1 else None)

    @property
    def compares(self) -> bool:
        """Whether the network estimates where one image was taken relative to another: built with relative=True."""
        return comparing(self.module) is not None

    def compare(
        self, queries: NDArray[np.float32], known: NDArray[np.float32], chunk: int = CHUNK
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Estimate where queries were taken relative to map frames, from the orientation parts of the two images.

        Args:
            queries: orientation parts of the queries (n, K, F).
            known: orientation parts of the map frames (n, K, F), one for each query.
            chunk: pairs per pass.

        Returns:
            Pose (n, 3), information (n, 3, 3) and match (n,); see `siamloc.models.relative.Relative`.

        Raises:
            ConfigError: the network does not compare images.
        """
        relative = required_comparing(self.module)
        like = next(relative.parameters())
        pairs = zip(*(torch.tensor(one).split(chunk) for one in (queries, known)), strict=True)
        with evaluating(relative):
            parts = [relative(*(_uploaded(one, like).to(like.dtype) for one in pair)) for pair in pairs]
            pose, information, match, _ = _fetched([torch.cat(one) for one in zip(*parts, strict=True)])
        return pose.double().numpy(), information.double().numpy(), match.double().numpy()


@typed
def as_descriptor(network: nn.Module | Descriptor, device: str | torch.device | None = "auto") -> Descriptor:
    """Make a descriptor from a network; a descriptor is returned as it is.

    Args:
        network: a module (B, 3, H, W) floating point in [0, 1] -> (B, D), or a descriptor of `analytic`.
        device: where to move a module first, such as "cpu" or "cuda:1"; "auto" moves one that is on the CPU to the GPU
            if torch finds one; it stays where it is if None.

    Raises:
        ConfigError: something else, or a device that this machine does not have.

    Example:
        >>> import numpy as np
        >>> from siamloc.models import build
        >>> descriptor = as_descriptor(build("simple1", "fc500_500_5", (32, 64)))
        >>> descriptor.describe(np.zeros((2, 3, 32, 64), np.uint8)).position.shape
        (2, 5)
    """
    if isinstance(network, Descriptor):
        return network
    if device is None or (device == "auto" and _like(network).device.type != "cpu"):
        return NetworkDescriptor(network)
    return NetworkDescriptor(network.to(chosen_device(device)))


def chosen_device(device: str | torch.device) -> str:
    """Return the name of a torch device, after checking that torch can compute there.

    Args:
        device: name such as "cpu", "cuda" or "cuda:1"; "auto" is the GPU if torch finds one, else the CPU.

    Raises:
        ConfigError: another name, or a device that this machine does not have.
    """
    gpus = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if device == "auto":
        return "cuda" if gpus else "cpu"
    try:
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        here = ", ".join(["auto", "cpu", *(f"cuda:{number}" for number in range(gpus))])
        raise ConfigError(f"torch cannot compute on device={str(device)!r} here: use one of {here}") from error
    return str(device)


def identity_of(network: nn.Module) -> dict[str, Any]:
    """Return plain values that determine a network's descriptors: its attribute `identity`, or class and weights."""
    network = network_of(network)
    own = getattr(network, "identity", None)
    if isinstance(own, dict):
        return own
    return {"name": "network", "class": type(network).__qualname__, "weights": state_hash(network.state_dict())}


def network_of(module: nn.Module) -> nn.Module:
    """Return the network that a training module of siamloc trains; any other module as it is."""
    return getattr(module, "trained_network", module)


def describing(module: nn.Module) -> Callable[[Tensor], tuple[Tensor, ...]]:
    """Return the function by which a module describes images: `Network.description`, or the call of any other module.

    A subclass of `Network` counts as any other, since it may describe images in other ways than by branch and head.
    """
    network = network_of(module)
    return network.description if type(network) is Network else lambda images: (module(images),)


def learned(module: nn.Module, position: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the learned part (n, D) of position parts that a module described, without colours if it has any."""
    network = network_of(module)
    return position[:, : network.outputs] if type(network) is Network and network.colours is not None else position


def orienting(module: nn.Module) -> Network | None:
    """Return the `Network` of a module if it gives orientation parts, else None.

    A subclass of `Network` does not count, since it may describe images in other ways than by branch and head.
    """
    network = network_of(module)
    return network if type(network) is Network and network.orientation is not None else None


def comparing(module: nn.Module) -> RelativePose | None:
    """Return the part of a module's network that compares two images; None if it has no such part."""
    network = orienting(module)
    return None if network is None else network.relative


def required_comparing(module: nn.Module) -> RelativePose:
    """Return the part of a module's network that compares images.

    Raises:
        ConfigError: the network does not compare images.
    """
    if (relative := comparing(module)) is None:
        raise ConfigError(
            "this network does not tell where images were taken relative to others: train one with "
            "model.relative=true (from Python relative=True)"
        )
    return relative


def margin_of(loss: object) -> float | None:
    """Return the margin of a contrastive loss, in Euclidean distance; None for any other loss."""
    return loss.margin if isinstance(loss, ContrastiveLoss) else None


@contextmanager
def evaluating(module: nn.Module) -> Iterator[None]:
    """Run a module without gradients in full precision inside a `with` block, and restore its modes afterwards."""
    with restored(module.modules(), attrgetter("training"), lambda part, mode: setattr(part, "training", mode)):
        module.eval()
        with torch.inference_mode(), full_precision(), torch.autocast(_like(module).device.type, enabled=False):
            yield


def as_float(images: Tensor) -> Tensor:
    """Convert images to floating point in [0, 1]: uint8 is divided by 255, floating point stays as it is.

    Raises:
        DataError: another type.
    """
    if images.dtype == torch.uint8:
        return images.float() / 255
    if not images.is_floating_point():
        raise DataError(f"images must be uint8 or floating point in [0, 1], got {images.dtype}")
    return images


def _as_images(batch: Any) -> Tensor:
    if not isinstance(batch, Tensor):
        batch = np.ascontiguousarray(batch)
        if batch.dtype.kind not in "buif":
            raise DataError(f"images must be arrays or tensors, uint8 or floating point in [0, 1], got {batch.dtype}")
        batch = torch.from_numpy(batch)
    images = batch.detach()
    if images.ndim == 3 and images.shape[0] != 3:
        if images.shape[2] == 3:
            raise DataError(
                f"a colour image must have its channels first, (3, H, W), got {tuple(images.shape)}: transpose it"
            )
        images = images.unsqueeze(1)
    while images.ndim < 4:
        images = images.unsqueeze(0)
    if images.ndim != 4 or images.shape[1] not in (1, 3) or 0 in images.shape:
        shape = tuple(np.shape(batch))
        raise DataError(f"images must have shape (H, W), (3, H, W), (B, H, W) or (B, 3, H, W), got {shape}")
    return images


def _like(network: nn.Module) -> Tensor:
    """Return a parameter, which says where a network computes, and in what type."""
    return next(network.parameters(), torch.empty(0))


def _uploaded(values: Tensor, like: Tensor) -> Tensor:
    """Return a tensor on the device of another, without waiting for the transfer from main memory to a GPU."""
    if like.is_cuda and not values.is_cuda:
        return values.pin_memory().to(like.device, non_blocking=True)
    return values.to(like.device)


def _fetched(values: Sequence[Tensor]) -> list[Tensor]:
    """Return tensors in main memory; a GPU is waited for once."""
    whole = torch.cat([one.flatten() for one in values]).cpu()
    parts = whole.split([one.numel() for one in values])
    return [part.view(one.shape) for part, one in zip(parts, values, strict=True)]
