"""The network shared by both images of a pair: a branch, then a head ([T] 5.3, figure 5.2)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from os import PathLike, fspath
from typing import Any

import torch
from torch import Tensor, nn

from foundation.calls import typed
from foundation.settings import Seed, Size, checked
from siamloc.errors import ConfigError, DataError
from siamloc.models.backbones import Backbone, make_backbone
from siamloc.models.branch import IMAGENET_MEAN, IMAGENET_STD, Branch, ResidualBlock, finer_features
from siamloc.models.colours import Colours
from siamloc.models.heads import Fourier, GeneralizedMean, Head, Magnitudes, make_head
from siamloc.models.orientation import VALUES, Canonical, Orientation
from siamloc.models.registry import Normalization, branch_spec, head_widths, is_backbone
from siamloc.models.relative import RelativePose
from siamloc.models.room_classifier import RoomClassifier
from siamloc.models.weights import Weights, fill, find_weights, state_hash
from siamloc.runs import Run

_BY_FREQUENCY = (Fourier, Magnitudes)  # heads that discard how far the robot has turned; `Orientation` keeps it
RESIDUAL = 0.1  # initial share of the two convolutions in the output of a residual block


@typed
def build(
    branch: str | nn.Module,
    head: str,
    image_size: Sequence[int] = (128, 512),
    weights: str | PathLike[str] | Run | None = None,
    seed: Seed = 0,
    *,
    outputs: int | None = None,
    circular: bool = False,
    normalize: Normalization | None = None,
    canonical: bool = False,
    relative: bool = False,
    colours: bool = False,
    elevations: Sequence[float] | None = None,
) -> Network:
    """Make a network that describes panoramas: (B, 3, H, W) in [0, 1] -> (B, D), in training mode on the CPU.

    The weights are drawn from `seed` alone; the global random generator is neither read nor advanced. Convolutions and
    fully connected layers get He initialization (normal, variance 2 / inputs; [He 2015]) and zero biases, which keeps
    the size of the signal through any depth of ReLU layers, so that even the deep branches without batch
    normalization learn from scratch. The last layer, which no ReLU follows, has variance 1 / (inputs * D):
    descriptors start with a length of about 1, so that distances start on the scale of the margin whatever D is.

    Args:
        branch: a name in `BRANCHES`; "timm/NAME" or "torchvision/NAME" for a network of these libraries;
            "package.module:factory" for a function or class of your own, of a module that is imported, which gives a
            network without arguments; or the network itself, a module (B, 3, H, W) -> features (B, C, h, w) or
            (B, C), which is changed in place. See `siamloc.models.backbones.Backbone`.
        head: a name in `HEADS`.
        image_size: (H, W) of the panoramas in pixels.
        weights: None for random weights; "imagenet" or the name of a torchvision weight enum such as
            "IMAGENET1K_V1" for a pre-trained branch; the path of a state dict (.pth, .safetensors) of this network or
            of a torchvision network with this branch; "siamloc" for the network that ships with siamloc, see
            `siamloc.models.pretrained`; or a run, its folder or a checkpoint. For a run, the best checkpoint is
            used: all of it if head and image size agree, otherwise only the branch, as a printed note says. For a
            network of timm or torchvision also "cached", its published weights in the cache of this machine, or
            "download", which fetches them first.
        seed: seed of the random weights.
        outputs: length D of a descriptor, for the heads "flat", "gem", "bands" and "fourier", 256 if None; and for
            "magnitudes", 2048 if None, or fewer if small images have fewer magnitudes.
        circular: let convolutions and pools wrap around the azimuth, for panoramas, whose columns are a full turn.
        normalize: "channels": subtract a mean and divide by a standard deviation for each channel, ImageNet's unless
            the weights say otherwise. "image": give each image zero mean and unit variance, whatever its exposure.
            "local": give the surroundings of each pixel zero mean and unit contrast, whatever light falls there;
            "local_brightness": the same, but colours stay. "local_and_colours": "local", and three channels in which
            the colours of large surfaces stay, for the branches of ours. If None, the default of the branch; of a
            network of timm or torchvision "channels", with the mean and deviation of its model card.
        canonical: first turn each panorama, by less than the width of one feature column, so that turning the robot by
            whole columns of the panorama changes nothing; see `siamloc.models.orientation`. For circular=True and a
            head that discards the direction: "fourier", "magnitudes", "gem" or "bands".
        relative: also learn to estimate where an image was taken relative to another one; see
            `siamloc.models.relative`. For the heads "fourier" and "magnitudes".
        colours: also describe the colours of images, which are not learned: `description` gives 800 more numbers than
            `forward`; see `siamloc.models.colours`.
        elevations: elevations in degrees of the upper and lower edge of the panoramas that the network is for; those of
            the first training if None.

    Raises:
        ConfigError: unknown names, an image too small for the branch, weights that are not available or do not fit.
        FormatError: a file of weights that is missing, cut short, altered or of another version.

    Example:
        >>> import torch
        >>> network = build("simple1", "fc500_500_5", image_size=(32, 64))
        >>> network(torch.rand(2, 3, 32, 64)).shape
        torch.Size([2, 5])
    """
    rows, columns = size = checked(image_size, Size, "image_size")
    name = branch if isinstance(branch, str) else type(branch).__qualname__
    ours = isinstance(branch, str) and not is_backbone(branch)
    usual = branch_spec(name).normalize if ours else "channels"
    norm = usual if normalize is None else normalize
    options: dict[str, Any] = {"circular": circular, "normalize": norm, "canonical": canonical, "relative": relative}
    part: str | Backbone = name
    found: Weights | None = None
    if not ours:  # the network itself loads its own weights
        found = None if weights is None else find_weights(name, weights)
        own = None if found is None or found.of_a_network else found.state
        part = make_backbone(branch, size, circular, norm, seed, own)
    with torch.device("meta"):
        network = Network(part, head, size, outputs, colours=colours, **options)
    for child in network.children():
        if child is not part:
            child.to_empty(device="cpu")
    _initialize(network, seed)
    if not isinstance(branch, str):
        network.settings = {"class": network.settings.pop("branch"), **network.settings}
    network.settings |= {
        "weights": None if weights is None else fspath(weights.folder if isinstance(weights, Run) else weights),
        "seed": seed,
        "outputs": network.outputs if len(head_widths(head)) == 1 else None,
        **options,
        **({"colours": True} if colours else {}),
        **({} if elevations is None else {"elevations": list(elevations)}),
    }
    if weights is not None and ours:
        found = find_weights(name, weights)
    if found is not None and (ours or found.of_a_network):
        fill(network, found, f"{name} + {head} at {rows} x {columns}")
        if found.mean is not None and found.std is not None:
            network.branch.normalize_with(found.mean, found.std)
    return network


class Network(nn.Module):
    """A network of a branch and a head; made by `build`.

    Args:
        branch: a name in `BRANCHES`, or a branch.
        head: a name in `HEADS`.
        image_size: (H, W) in pixels.
        outputs: length of a descriptor, for heads with a choice.
        circular: whether the branch wraps around the azimuth.
        normalize: a name in `NORMALIZATIONS`.
        canonical: whether panoramas are turned to a canonical direction first.
        relative: whether the network also compares images.
        colours: whether descriptions include colours.

    Attributes:
        branch: the `Branch`, which also normalizes.
        head: the `Head`.
        image_size: (H, W) in pixels.
        grid: rows and columns of the features that the head sees.
        orientation: the `Orientation` for finding headings, if the branch wraps around, and for comparing images; for
            the heads `fourier` and `magnitudes`. Else None.
        relative: the `RelativePose` that compares orientation parts; None for a network that does not.
        colours: the `Colours` that descriptions include; None without.
        rooms: the `RoomClassifier` that names the room from a descriptor, after a training with `CrossEntropyLoss`;
            else None.
        settings: the arguments of `build` that made the network, as plain values; for a branch that was handed in as a
            module `class`, the name of its class, instead of `branch`.
    """

    rooms: RoomClassifier | None = None

    @typed
    def __init__(
        self,
        branch: str | Branch,
        head: str,
        image_size: tuple[int, int],
        outputs: int | None = None,
        circular: bool = False,
        normalize: str = "channels",
        canonical: bool = False,
        relative: bool = False,
        colours: bool = False,
    ) -> None:
        super().__init__()
        self.image_size = image_size
        self.branch = Branch(branch, circular, normalize) if isinstance(branch, str) else branch
        self.settings: dict[str, Any] = {"branch": self.branch.name, "head": head, "image_size": list(image_size)}
        shape = self.branch.shapes(image_size)[-1]
        self.grid = shape[1:]
        self.head = make_head(head, shape, outputs)
        self.canonical = _canonical(self.branch, self.head, image_size) if canonical else None
        self.orientation: Orientation | None = None
        by_column = (circular or relative) and isinstance(self.head, _BY_FREQUENCY)
        finer = finer_features(self.branch, image_size) if by_column else None
        if finer is not None and shape[2] > 1:
            turned = image_size[1] if canonical else None
            self.orientation = Orientation(*finer, (2 * shape[1], 2 * shape[2]), turned, relative)
        if relative and self.orientation is None:
            raise ConfigError(
                "model.relative=true (from Python relative=True) needs the head fourier or magnitudes, and features of "
                f"two columns or more, but at most half as many as the image has: here the head is {head}, and an "
                f"image of {image_size[1]} columns has features of {shape[2]}"
            )
        self.relative = RelativePose(2 * shape[2], VALUES, circular) if relative else None
        self.colours = Colours(image_size) if colours else None

    @property
    def outputs(self) -> int:
        """Length D of what `forward` gives, without colours."""
        return self.head.outputs

    @property
    def view(self) -> dict[str, Any]:
        """The panoramas that the network is for: arguments of `PanoramaLibrary`, which makes them from any camera."""
        known = self.settings.get("elevations")
        return {"image_size": self.image_size, **({} if known is None else {"elevations": tuple(known)})}

    @property
    def stages(self) -> list[list[nn.Module]]:
        """The parts with weights, stage by stage: the layers of the branch by resolution, then the head."""
        above = [part for part in (self.head, self.orientation, self.relative) if part is not None]
        last: list[nn.Module] = [part for part in above if next(part.parameters(), None) is not None]
        return [*self.branch.stages, *([last] if last else [])]

    @property
    def identity(self) -> dict[str, Any]:
        """Everything that determines the descriptors: names, image size, a hash of all weights, non-default settings.

        Reads every weight, which takes about a second for the largest networks: keep the result.
        """
        return {
            "name": "network",
            "branch": self.branch.name,
            "head": self.head.name,
            "image_size": list(self.image_size),
            "weights": state_hash(self.state_dict()),
            **({"circular": True} if self.branch.circular else {}),
            **({"normalize": self.branch.normalize} if self.branch.normalize != "channels" else {}),
            **({"canonical": True} if self.canonical is not None else {}),
            **({"relative": True} if self.relative is not None else {}),
            **({"colours": True} if self.colours is not None else {}),
        }

    def forward(self, panorama: Tensor) -> Tensor:
        """Return descriptors (B, D) of panoramas (B, 3, H, W), floating point in [0, 1].

        Raises:
            DataError: another shape or integers (not checked while a compiler or an exporter traces).
        """
        panorama, _ = self._turned(panorama)
        return self.head(self.branch(panorama))

    def with_orientation(self, panorama: Tensor) -> tuple[Tensor, Tensor]:
        """Return descriptors (B, D) and orientation parts (B, K, F) of panoramas in one pass; see `Orientation`.

        Raises:
            ConfigError: the network does not find headings.
            DataError: as `forward`.
        """
        if self.orientation is None:
            raise ConfigError(
                "this network finds no headings: build one with the head 'fourier' or 'magnitudes' and circular=True"
            )
        panorama, turned = self._turned(panorama)
        finer, features = self.branch.both(panorama, self.orientation.level)
        return self.head(features), self.orientation(finer, turned)

    def description(self, panorama: Tensor) -> tuple[Tensor, ...]:
        """Return what maps and robots search by: learned descriptors (B, D), or (B, D + 800) with the colours.

        If the network finds headings, orientation parts (B, K, F) follow.

        Raises:
            DataError: as `forward`.
        """
        learned, *orientation = (self(panorama),) if self.orientation is None else self.with_orientation(panorama)
        if self.colours is not None:
            learned = torch.cat([learned, self.colours(panorama).to(learned.dtype)], dim=1)
        return learned, *orientation

    def _turned(self, panorama: Tensor) -> tuple[Tensor, Tensor | None]:
        """Check panoramas. A canonical network also turns them, and returns by how many columns; others None."""
        if not (torch.compiler.is_compiling() or torch.jit.is_tracing()):
            rows, columns = self.image_size
            if panorama.ndim != 4 or panorama.shape[1:] != (3, rows, columns):
                raise DataError(
                    f"the network was built for panoramas of shape (B, 3, {rows}, {columns}), got "
                    f"{tuple(panorama.shape)}: make the library with image_size=({rows}, {columns})"
                )
            if not panorama.is_floating_point():
                raise DataError(f"panoramas must be floating point in [0, 1], got {panorama.dtype}: divide them by 255")
        return (panorama, None) if self.canonical is None else self.canonical(panorama)


def _canonical(branch: Branch, head: Head, image_size: tuple[int, int]) -> Canonical:
    """Return the module that turns panoramas to their canonical direction.

    Raises:
        ConfigError: a head for which that is meaningless, or columns that the layers do not divide evenly.
    """
    if not branch.circular or not isinstance(head, (*_BY_FREQUENCY, GeneralizedMean)):
        raise ConfigError(
            "model.canonical=true (from Python canonical=True) needs model.circular=true and a head that forgets how "
            f"far the robot has turned, fourier, magnitudes, gem or bands: here circular={branch.circular}, and the "
            f"head is {head.name}; set model.canonical=false"
        )
    widths = [image_size[1], *(columns for _, _, columns in branch.shapes(image_size))]
    if any(wide % narrow for wide, narrow in pairwise(widths)):
        raise ConfigError(
            "model.canonical=true (from Python canonical=True) needs columns that all layers divide evenly, and the "
            f"{image_size[1]} of the panorama become {', '.join(map(str, dict.fromkeys(widths[1:])))} in "
            f"{branch.name}: take a power of 2, or set model.canonical=false"
        )
    return Canonical(image_size[1] // widths[-1])


def _initialize(network: Network, seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    parts = list(network.children())
    if isinstance(network.branch, Backbone):  # which has its own initialization
        parts.remove(network.branch)
    else:
        network.branch.normalize_with(IMAGENET_MEAN, IMAGENET_STD)
    last = [None, *(module for module in network.head.modules() if isinstance(module, nn.Linear))][-1]
    for module in nn.ModuleList(parts).modules():
        if isinstance(module, nn.BatchNorm2d):
            module.reset_parameters()
        elif isinstance(module, (nn.Conv1d, nn.Conv2d, nn.Linear)):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu", generator=generator)
            if module is last:
                with torch.no_grad():
                    module.weight /= (2 * network.outputs) ** 0.5
            if module.bias is not None:
                nn.init.zeros_(module.bias)
        elif hasattr(module, "reset") and not isinstance(module, RelativePose):
            module.reset()  # type: ignore[operator]
        elif next(module.parameters(recurse=False), None) is not None:
            raise TypeError(f"no initialization is known for {type(module).__name__}")
    if network.relative is not None:
        network.relative.reset()  # after its layers
    for module in network.modules():  # each block starts as little more than its shortcut
        if isinstance(module, ResidualBlock):
            nn.init.constant_(module.second[1].weight, RESIDUAL)  # type: ignore[arg-type]
