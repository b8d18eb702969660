"""Networks of timm, of torchvision and of your own as branches."""

from __future__ import annotations

import math
import sys
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from difflib import get_close_matches
from types import FunctionType
from typing import Any, cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from augment.torchvision_compat import ensure_torchvision
from siamloc.errors import ConfigError, explained, hint, in_one_line
from siamloc.models.branch import IMAGENET_MEAN, IMAGENET_STD, Branch, channels_of
from siamloc.models.circular import circular as around
from siamloc.models.hub import timm

_EQUAL = 1e-5  # of the largest feature: what wraps around differs by rounding, 1e-6 at most
_AFTER = ("avgpool", "fc", "classifier", "head", "AuxLogits", "aux1", "aux2", "dropout", "flatten")


class Backbone(Branch):
    """A network that siamloc did not define, as a branch: (B, 3, H, W) in [0, 1] -> (B, C, h, w).

    Its features are its last map before pooling and classes. Of a transformer, the features are its patch tokens in
    their rows and columns; of a network that only gives (B, D), a map of one pixel. The images are normalized first,
    by default with the mean and deviation of the network's model card.

    Args:
        name: "timm/NAME", "torchvision/NAME" or "package.module:factory"; of a module that is handed in, its class.
        network: the network, in training mode; it is changed in place.
        image_size: (H, W) of the images in pixels.
        circular: whether convolutions and pools wrap around the azimuth.
        normalize: a name in `NORMALIZATIONS`.

    Raises:
        ConfigError: a network that does not take such images, whose columns cannot wrap around, or without a map.
    """

    def __init__(
        self, name: str, network: nn.Module, image_size: tuple[int, int], circular: bool, normalize: str
    ) -> None:
        super().__init__(name, circular, normalize, features=nn.Sequential())
        if channels_of(normalize) != 3:
            raise ConfigError(f"the first layer of {name} has three channels: leave normalize={normalize} out")
        self.normalize_with(*_card(name, network))
        network.eval()
        size = f"{image_size[0]} x {image_size[1]} pixels"
        with explained(f"{name} fails with images of {size}, in its own words"), torch.no_grad():
            example = torch.zeros(1, 3, *image_size)
            features = _features(network, example)
            self.features = features if isinstance(features, nn.Sequential) else nn.Sequential(features)
            self._shapes = [(one.shape[1], one.shape[2], one.shape[3]) for one in self._maps(example)]
            if circular:
                self._wrap(image_size)
        network.train()

    def shapes(self, image_size: tuple[int, int]) -> list[tuple[int, int, int]]:
        """Return channels, rows and columns of the network's maps, the last of which are the features."""
        return self._shapes

    @property
    def stages(self) -> list[list[nn.Module]]:
        """The whole branch as one stage, which `Optimizer.frozen_stages=1` keeps as it is."""
        return [[self.features]]

    def both(self, panorama: Tensor, level: int) -> tuple[Tensor, Tensor]:
        """Return two outputs of one pass: the map of number `level`, 0 for the image, and the features."""
        if level > 0 and isinstance(maps := self.features[0], _Timm):
            first, last = maps.maps(self.normalized(panorama), [level - 1, len(self._shapes) - 1])
            return first, last
        return super().both(panorama, level)

    def _maps(self, images: Tensor) -> list[Tensor]:
        if isinstance(timm_maps := self.features[0], _Timm):
            return timm_maps.maps(images)
        maps: list[Tensor] = []
        for layer in self.features:
            maps.append(layer(maps[-1] if maps else images))
        return maps

    def _wrap(self, image_size: tuple[int, int]) -> None:
        """Let convolutions and pools wrap around, and make sure that turned images give turned features.

        Raises:
            ConfigError: they do not.
        """
        around(self.features)
        tried, generator = deepcopy(self.features).eval(), torch.Generator().manual_seed(0)
        for weight in tried.parameters():
            if weight.numel() == max(weight.shape, default=1):  # scales at 0 would hide whole layers
                weight.data.uniform_(0.5, 1.5, generator=generator)
                continue
            empty = weight.requires_grad and not weight.any()  # zeros that stay zeros hide nothing
            if weight.ndim == 2 or empty:  # small weights would hide the positions of a transformer
                weight.data.normal_(0, weight.shape[1] ** -0.5, generator=generator)
        columns = self._shapes[-1][2]
        stride = math.ceil(image_size[1] / columns)
        images = torch.rand(1, 3, image_size[0], stride * columns, generator=generator)
        try:
            straight, turned = tried(images), tried(images.roll(stride, dims=3))
            apart = (straight.roll(1, dims=3) - turned).abs().max()
            wraps = straight.shape[3] > 1 and bool(apart <= _EQUAL * straight.abs().max())
        except Exception:  # a network of fixed size may raise anything
            wraps = False
        if not wraps:
            raise ConfigError(
                f"the columns cannot wrap around in {self.name}, whose features depend on the side at which a panorama "
                "begins (by its positions, windows or padding): set model.circular=false (from Python circular=False)"
            )


def make_backbone(
    source: str | nn.Module,
    image_size: tuple[int, int],
    circular: bool,
    normalize: str,
    seed: int,
    state: Mapping[str, Tensor] | None,
) -> Backbone:
    """Make a branch of a network by its name, or of a module.

    Args:
        source: "timm/NAME", "torchvision/NAME", "package.module:factory" of an imported module, or a module.
        image_size: (H, W) of the images in pixels.
        circular: whether convolutions and pools wrap around the azimuth.
        normalize: a name in `NORMALIZATIONS`.
        seed: seed of the random weights of a network by name.
        state: weights of the network by its own names for them; random ones if None.

    Raises:
        ConfigError: as `check_backbone` and `Backbone`, or weights that do not fit.
    """
    if isinstance(source, nn.Module):
        name, network = type(source).__qualname__, source
    else:
        name = source
        failed = f"{name} cannot be made for images of {image_size[0]} x {image_size[1]} pixels, in its own words"
        with torch.random.fork_rng(devices=[]), explained(failed):
            torch.manual_seed(seed)
            network = _made(name, image_size, state)
    if state is not None and not name.startswith("timm/"):
        weights = OrderedDict(state)
        if _of_torchvision(network):  # a few of its classes ask for it
            weights._metadata = {"": {"version": network._version}}  # type: ignore[attr-defined]
        try:
            network.load_state_dict(weights)
        except RuntimeError as error:
            raise ConfigError(f"the weights are of another architecture than {name}: {in_one_line(error)}") from error
    return Backbone(name, network.train(), image_size, circular, normalize)


def check_backbone(name: str) -> None:
    """Make sure that a name is that of a network of timm or torchvision, or has the form of a factory of one's own.

    Raises:
        ConfigError: another name, or timm is missing.
    """
    source, _, own = name.partition("/")
    if ":" in name:
        return
    if source == "timm":
        if not timm().is_model(own):
            near = get_close_matches(own.partition(".")[0], timm().list_models(), 5)
            raise ConfigError(f"timm has no network {own!r}: {', '.join(near) or 'timm.list_models()'} exist")
    elif source == "torchvision":
        ensure_torchvision()
        from torchvision import models

        if own not in (known := models.list_models(module=models)):
            raise ConfigError(f"torchvision has no network {own!r} for classes: {hint(own, known)}")
    else:
        raise ConfigError(
            f"unknown branch {name!r}: give timm/NAME, torchvision/NAME, package.module:factory, or a name of siamloc's"
        )


def _made(name: str, image_size: tuple[int, int], state: Mapping[str, Tensor] | None) -> nn.Module:
    check_backbone(name)
    source, _, own = name.partition("/")
    if ":" in name:
        network: Any = _factory(name)()
        if not isinstance(network, nn.Module):
            raise ConfigError(f"{name} must give a torch module, got {type(network).__name__}")
        return network
    if source == "timm":
        fixed = {"img_size": image_size} if timm().get_pretrained_cfg(own).fixed_input_size else {}
        loaded = {} if state is None else {"pretrained": True, "pretrained_cfg_overlay": {"state_dict": dict(state)}}
        return cast(nn.Module, timm().create_model(own, **fixed, **loaded))
    from torchvision import models

    # As the library makes these two: its weights for them are for inputs in [-1, 1].
    inputs = {"transform_input": state is not None, "init_weights": True}
    return models.get_model(own, weights=None, **(inputs if own in ("googlenet", "inception_v3") else {}))


def _factory(name: str) -> Callable[[], Any]:
    """Return a factory of one's own: a class of torch modules, or a function of a module that is imported already.

    Files name factories, too, so that nothing is imported for them, and no function of Python's own is called.

    Raises:
        ConfigError: the module is not imported, or has no such function or class.
    """
    module, _, function = name.partition(":")
    found: Any = getattr(sys.modules.get(module), function, None)
    is_class = isinstance(found, type) and issubclass(found, nn.Module)
    is_function = isinstance(found, FunctionType) and found.__module__.partition(".")[0] not in sys.stdlib_module_names
    if not (is_class or is_function):
        wrong = f"the module {module} is not imported: import it first (on the command line give model/branch={name})"
        if module in sys.modules:
            wrong = f"the module {module} has no function or torch module {function!r}"
        raise ConfigError(f"the branch {name} must be a function or class of your own that takes no arguments; {wrong}")
    return cast("Callable[[], Any]", found)


def _of_torchvision(network: nn.Module) -> bool:
    return type(network).__module__.startswith("torchvision.models.")


def _card(name: str, network: nn.Module) -> tuple[Sequence[float], Sequence[float]]:
    """Return the mean and deviation of the images that a network is for: its model card's, or ImageNet's."""
    card = getattr(network, "pretrained_cfg", None)
    if isinstance(card, Mapping) and "mean" in card:
        return card["mean"], card["std"]
    if _of_torchvision(network) and getattr(network, "transform_input", False):
        # It turns ImageNet's normalization into this one.
        return (0.5,) * 3, (0.5,) * 3
    if name.startswith("torchvision/"):
        from torchvision import models

        preset = models.get_model_weights(name.partition("/")[2]).DEFAULT.transforms()
        return preset.mean, preset.std
    return IMAGENET_MEAN, IMAGENET_STD


def _features(network: nn.Module, example: Tensor) -> nn.Module:
    """Return the part of a network that gives its features: (B, 3, H, W) -> (B, C, h, w)."""
    ensure_torchvision()
    from torchvision.models import DenseNet, SwinTransformer, VisionTransformer

    if hasattr(network, "forward_intermediates"):
        return _timm_features(network, example)
    if isinstance(network, VisionTransformer):
        return _Tokens(network, (example.shape[2], example.shape[3]))
    if _of_torchvision(network):
        parts = [part for name, part in network.named_children() if name not in _AFTER]
        parts += [nn.ReLU(inplace=True)] if isinstance(network, DenseNet) else []  # no module of the library's class
        flat = [one for part in parts for one in (part if isinstance(part, nn.ModuleList) else [part])]
        layers = nn.Sequential(*(one for part in flat for one in (part if isinstance(part, nn.Sequential) else [part])))
        return nn.Sequential(layers) if isinstance(network, SwinTransformer) else layers
    found = network(example)
    if isinstance(found, Tensor) and found.ndim == 4:
        return network
    if isinstance(found, Tensor) and found.ndim == 2:
        return _one_pixel(network)
    shape = tuple(found.shape) if isinstance(found, Tensor) else type(found).__name__
    raise ConfigError(f"{type(network).__qualname__} must give (B, C, h, w) or (B, D) for (B, 3, H, W), got {shape}")


def _timm_features(network: Any, example: Tensor) -> nn.Module:
    embed = getattr(network, "patch_embed", None)
    patch, made_by = getattr(embed, "patch_size", None), getattr(embed, "proj", None)
    if patch and isinstance(made_by, nn.Conv2d) and made_by.kernel_size == made_by.stride:  # others overlap
        _check_patches(example, *made_by.kernel_size)
    for norm in (True, False):
        try:
            made = _Timm(network, norm)
            if all(one.ndim == 4 for one in made.maps(example)):
                network.prune_intermediate_layers(1, prune_norm=False, prune_head=True)
                return made
        except Exception:  # no norm layer for maps, or no maps; each network says so by another error
            continue
    network.reset_classifier(0)
    return _one_pixel(network)


def _one_pixel(network: nn.Module) -> nn.Module:
    """Return a network that gives (B, D) as one that gives a map of one pixel, (B, D, 1, 1)."""
    return nn.Sequential(nn.Sequential(network, nn.Unflatten(1, (-1, 1, 1))))


class _Timm(nn.Module):
    """The last map of a network of timm."""

    def __init__(self, network: nn.Module, norm: bool) -> None:
        super().__init__()
        self.network, self.norm = network, norm

    def forward(self, images: Tensor) -> Tensor:
        return self.maps(images, 1)[-1]

    def maps(self, images: Tensor, indices: int | list[int] | None = None) -> list[Tensor]:
        """Return the maps (B, C, h, w) of these numbers, all if None, or the last ones if it is one number."""
        intermediates: Any = self.network.forward_intermediates
        found: list[Tensor] = intermediates(
            images, indices=indices, norm=self.norm, output_fmt="NCHW", intermediates_only=True
        )
        return found


class _Tokens(nn.Module):
    """The patch tokens of torchvision's vision transformer, with positions interpolated to the size of the images."""

    def __init__(self, network: Any, image_size: tuple[int, int]) -> None:
        super().__init__()
        patch, positions = network.patch_size, network.encoder.pos_embedding
        _check_patches(torch.empty(1, 3, *image_size, device="meta"), patch, patch)
        self.grid = image_size[0] // patch, image_size[1] // patch
        side = network.image_size // patch
        square = positions[:, 1:].transpose(1, 2).unflatten(2, (side, side))
        if self.grid != (side, side):
            square = F.interpolate(square, self.grid, mode="bicubic", antialias=True)
        both = torch.cat([positions[:, :1], square.flatten(2).transpose(1, 2)], dim=1)
        network.encoder.pos_embedding = nn.Parameter(both.detach().clone())
        network.heads = nn.Identity()
        self.network = network

    def forward(self, images: Tensor) -> Tensor:
        tokens = self.network.conv_proj(images).flatten(2).transpose(1, 2)
        first = self.network.class_token.expand(tokens.shape[0], -1, -1)
        tokens = self.network.encoder(torch.cat([first, tokens], dim=1))[:, 1:]
        return tokens.transpose(1, 2).unflatten(2, self.grid)


def _check_patches(example: Tensor, rows: int, columns: int) -> None:
    height, width = example.shape[2:]
    if height % rows or width % columns:
        size = [max(round(side / patch), 1) * patch for side, patch in ((height, rows), (width, columns))]
        raise ConfigError(
            f"images of {height} x {width} pixels do not divide into the network's patches of {rows} x {columns}: take "
            f"data.image_size=[{size[0]},{size[1]}] (from Python image_size=({size[0]}, {size[1]}))"
        )
