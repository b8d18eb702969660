"""Recipes: all settings of a training under one name. Loads no torch."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from foundation.calls import typed
from foundation.errors import known
from siamloc.data.frames import FrameTable
from siamloc.data.library import PanoramaLibrary
from siamloc.errors import ConfigError, check_known
from siamloc.runs import Run

if TYPE_CHECKING:
    from siamloc.models.network import Network


@dataclass(frozen=True)
class Recipe:
    """A network, a loss, an augmentation and the settings of the training, as plain values.

    Attributes:
        image_size: rows and columns of the panoramas.
        model: arguments of `siamloc.models.build`.
        loss: name and parameters of a loss over batches of places; None for the contrastive loss of pairs.
        augmentation: augmentation of the training images: a policy's name, or plain values as in a policy file.
        training: fields of `siamloc.training.Training`.
        trainer: arguments of Lightning's trainer.
        summary: what the recipe is for, in one line.

    Example:
        >>> recipe("modern").training["pairs"]["near"]
        0.5
    """

    image_size: tuple[int, int]
    model: Mapping[str, Any]
    training: Mapping[str, Any]
    loss: Mapping[str, Any] | None = None
    augmentation: Mapping[str, Any] = field(default_factory=lambda: {"name": "none"})
    trainer: Mapping[str, Any] = field(default_factory=dict)
    summary: str = ""

    def build(self, image_size: Sequence[int] | None = None, seed: int = 0, **changes: Any) -> Network:
        """Make the network, optionally for panoramas of another size; see `siamloc.models.build`.

        Raises:
            ConfigError: as `siamloc.models.build`; also arguments that it does not have.
        """
        from siamloc.models import build

        arguments = {**self.model, "image_size": image_size or self.image_size, "seed": seed, **changes}
        check_known(arguments, inspect.signature(build).parameters, "model")
        return build(**arguments)

    def fit(
        self,
        network: Any,
        images: PanoramaLibrary,
        frames: FrameTable,
        *,
        run: str | Path | Run,
        validation: FrameTable | None = None,
        **changes: Any,
    ) -> Run:
        """Train a network with the recipe; further arguments replace settings of the recipe.

        `pairs`, `optimizer` and `trainer` are changed key by key. See `siamloc.training.fit` for the arguments and the
        exceptions.
        """
        from siamloc.training.fitting import fit

        if images.circular and not self.model.get("circular"):  # easily forgotten; `fit` refuses the opposite
            raise ConfigError(
                "this recipe is for images whose columns do not wrap around, and the library has circular=True: make "
                "it with circular=False, or take the recipe modern"
            )

        return fit(network, images, frames, run=run, validation=validation, **self.options(changes))

    def options(self, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return the training arguments of the recipe, some of them replaced by `changes`; see `fit`."""
        from siamloc.models.batch_losses import make_loss

        options = {"augmentation": dict(self.augmentation), "trainer": dict(self.trainer), **self.training}
        if self.loss is not None:
            options["loss"] = make_loss(**self.loss)
        for key, value in changes.items():
            nested = key in ("pairs", "optimizer", "trainer") and isinstance(value, Mapping)
            options[key] = {**options.get(key, {}), **value} if nested else value
        return options


_PHOTOGRAPHS = Recipe(
    image_size=(96, 128),
    model={"branch": "panoresnet", "head": "flat", "normalize": "local_brightness", "colours": True},
    loss={"name": "soft_contrastive", "sigma": 1.0},
    augmentation={
        "name": "photographs",
        "all_of": [  # colours are left nearly as they are: they distinguish walls and doors
            {"one_of": [{"effect": "bulb"}, {"effect": "shadow"}], "probability": 0.4},
            {"effect": "exposure", "probability": 0.6},
            {"effect": "gamma", "probability": 0.3},
            {"effect": "white_balance", "temperature": [-0.2, 0.2], "tint": [-0.05, 0.05], "probability": 0.5},
            {"effect": "view"},
        ],
    },
    training={
        "epochs": 6,
        "pairs": {"by": "sequence", "radius": 1.0, "near": 0.5, "reach": 10.0, "epoch_batches": 50},
        "optimizer": {"name": "adamw", "learning_rate": 0.001, "weight_decay": 0.01, "schedule": "one_cycle"},
        "clip": 1.0,
        "average": 0.98,
    },
    trainer={"precision": "auto"},
    summary="Images of an ordinary camera in the order in which they were taken; needs neither positions nor rooms.",
)

_MODERN = Recipe(
    image_size=(64, 256),
    model={"branch": "panoresnet", "head": "fourier", "circular": True, "normalize": "local"},
    loss={"name": "soft_contrastive", "kernel": "exponential", "sigma": 0.2},
    augmentation={"name": "modern", "policy": "any_light", "rotate": 1.0},
    training={
        "epochs": 5,
        "pairs": {"near": 0.5, "reach": 1.5, "epoch_batches": 140},
        "optimizer": {"name": "adamw", "learning_rate": 0.002, "weight_decay": 0.01, "schedule": "one_cycle"},
        "clip": 1.0,
        "average": 0.98,
    },
    trainer={"precision": "auto"},
    summary="Panoramas with positions in metres, a small network from random weights, about five minutes on two cores.",
)

_FINE_TUNING = replace(
    _MODERN,
    model={
        **_MODERN.model,
        "branch": "panoresnet_wide",
        "head": "magnitudes",
        "normalize": "local_and_colours",
        "canonical": True,
        "relative": True,
        "colours": True,
        "weights": "siamloc",
    },
    training={
        **_MODERN.training,
        "epochs": 2,
        "pairs": {**_MODERN.training["pairs"], "epoch_batches": 30},
        "optimizer": {**_MODERN.training["optimizer"], "learning_rate": 0.0002},
        "average": 0.95,
    },
    summary="As modern, but from the weights that ship with siamloc, with 60 batches instead of 700.",
)

_ADAPT = replace(
    _FINE_TUNING,
    loss={"name": "soft_contrastive", "kernel": "exponential", "sigma": 3.0, "temperature": 0.05},
    training={
        **_FINE_TUNING.training,
        "epochs": 1,
        "pairs": {"by": "steps", "images": 3, "radius": 0.7, "near": 0.5, "reach": 8.0, "epoch_batches": 200},
        # All but the last resolution: a drive is too few images for more, and headings are found below it.
        "optimizer": {**_MODERN.training["optimizer"], "learning_rate": 0.001, "frozen_stages": 3},
    },
    summary="One drive of your own without any labels, from the weights that ship with siamloc, a few minutes.",
)

RECIPES: dict[str, Recipe] = {
    "modern": _MODERN,
    "fine_tuning": _FINE_TUNING,
    "adapt": _ADAPT,
    "photographs": _PHOTOGRAPHS,
    "rooms": replace(
        _PHOTOGRAPHS,
        model={**_PHOTOGRAPHS.model, "head": "bands"},
        loss={"name": "soft_contrastive", "sigma": 1.0, "room": 0.8},
        training={
            **_PHOTOGRAPHS.training,
            # Places from everywhere: neighbours in the drive are in the same room, and need not be distinguished.
            "pairs": {**_PHOTOGRAPHS.training["pairs"], "near": 0.0, "epoch_batches": 100},
            "monitor": "room",
        },
        summary="Images of an ordinary camera with room labels, if you only need the room.",
    ),
}
"""Our recipes by name; each is an experiment of the command line.

`modern`: panoramas with positions in metres. A small residual network that wraps around the azimuth, trained from
random weights on batches of places, about five minutes on two processor cores.

`fine_tuning`: the same from the weights that ship with siamloc, with 60 batches instead of 700, the head `magnitudes`,
the canonical direction and the comparison of images, which needs headings.

`adapt`: panoramas of one drive, without positions or rooms, from the weights that ship with siamloc. The order of the
frames determines what is near, see `siamloc.training.adapting`; the weights from before are kept unless a check on the
drive finds the trained ones better.

`photographs`: images of an ordinary or a fisheye camera, in the order in which the robot took them; a single drive that
visits no place twice needs neither positions nor rooms. The same network without wrapping, trained half as long. If
drives share places, give positions and `pairs.by="position"`, or rooms and `loss.room` above 0.

`rooms`: photographs with room labels, of one drive or several, if you only need the room. A room looks different from
every place and in every direction, so the network learns to recognize it by the things in it: most of the target comes
from the labels (`loss.room`), and the head ignores the direction in which something was seen.
"""


@typed
def recipe(name: str) -> Recipe:
    """Look up a recipe by its name.

    Raises:
        ConfigError: an unknown name.

    Example:
        >>> recipe = siamloc.training.recipe("modern")  # doctest: +SKIP
        >>> network = recipe.build()  # doctest: +SKIP
        >>> recipe.fit(network, images, monday, run="runs/robot", validation=wednesday)  # doctest: +SKIP
    """
    return RECIPES[known(name, RECIPES, "recipe")]
