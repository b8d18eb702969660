"""`pretrain`: train a network on an endless supply of random buildings, before it sees any data set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import augment
from foundation.calls import typed
from siamloc.data.places import PlaceSettings
from siamloc.errors import ConfigError
from siamloc.models.checkpoint import save_weights, without_layer
from siamloc.models.cross_entropy import CrossEntropyLoss
from siamloc.models.network import Network
from siamloc.models.places import BatchLoss, PlaceModule
from siamloc.models.registry import PRETRAINED_ELEVATIONS
from siamloc.pretraining.settings import RECIPE, ViewSettings
from siamloc.pretraining.view_batches import ViewDataModule
from siamloc.runs import Run
from siamloc.simulate.mesh import embree
from siamloc.training.checks import check_loss, check_network
from siamloc.training.fitting import augmentation_of, learn, process_rank
from siamloc.training.run_folder import check_folder, check_script
from siamloc.training.settings import Monitor, Training


@typed
def pretrain(
    network: Network,
    *,
    run: str | Path | Run,
    views: ViewSettings | Mapping[str, Any] | None = None,
    loss: BatchLoss | None = None,
    augmentation: augment.Effect | Mapping[str, Any] | str | None = None,
    trainer: Mapping[str, Any] | None = None,
    resume: bool = False,
    overwrite: bool = False,
    settings: Training | None = None,
    **changes: Any,
) -> Run:
    """Train a network in place on random buildings, which are drawn and rendered while the network learns.

    Everything follows from the seed: the n-th building, and the batch of each step, however fast buildings are
    rendered. If several processes train together, each renders its own buildings. After every epoch the network is
    validated in buildings that it never learns from. With `views.processes` above 0, processes are spawned: scripts
    must call this under `if __name__ == "__main__":`.

    Args:
        network: from `siamloc.models.build`; images are rendered at its image size.
        run: folder of the run, a new or empty one.
        views: how many random buildings, drives, lights and poses are rendered, and by which cameras; the defaults of
            `ViewSettings` if None.
        loss: (descriptors (N, D), `Origins`) -> scalar; the loss of `RECIPE` if None.
        augmentation: augmentation of the images, as for `siamloc.training.fit`; the augmentation of `RECIPE` if None.
        trainer: further arguments of `lightning.Trainer`, as for `siamloc.training.fit`.
        resume: continue from the last checkpoint of the run.
        overwrite: replace a run: files that siamloc wrote into the folder are removed, all other files stay.
        settings: all fields of `siamloc.training.Training` together; the settings of `RECIPE` if None.
        changes: single fields of the settings to replace; `pairs` and `optimizer` are changed key by key.

    Returns:
        The run; the network then holds the same weights as `siamloc.models.load(run)`, the best by the validation.
        `run.weights` is a file with them for `siamloc.models.load` and `build(weights=...)`. For a network with the
        head `fourier` this file holds the network with the head `magnitudes` instead: the same Fourier magnitudes,
        without the final layer of `fourier`, which fits the training buildings only.

    Raises:
        ConfigError: settings that are invalid or contradict each other, a folder that holds a run or other files, a run
            with other settings to resume, or a loss that is not finite.
        DataError: a rendering process died.
        SiamlocError: embreex is not installed.
        KeyboardInterrupt: the user stopped the training; the run can be resumed.

    Example:
        >>> from siamloc.pretraining import RECIPE, pretrain
        >>> pretrain(RECIPE.build(), run="runs/pretrained", epochs=10)  # doctest: +SKIP
    """
    check_script()
    embree()
    run = run if isinstance(run, Run) else Run(run)  # type: ignore[arg-type]
    views = views if isinstance(views, ViewSettings) else ViewSettings.of(views or {})
    options = RECIPE.options({"trainer": trainer or {}, **changes})
    of_recipe, trainer = {key: options.pop(key) for key in ("loss", "augmentation")}, options.pop("trainer")
    loss = of_recipe["loss"] if loss is None else loss
    augmentation = of_recipe["augmentation"] if augmentation is None else augmentation
    if settings is None:
        settings = Training.of(options)
    elif changes:
        raise ConfigError(f"settings= has all fields: give {', '.join(changes)} in it, or leave it out")
    places = _check(settings, views, network)
    network.settings["elevations"] = list(PRETRAINED_ELEVATIONS)
    if isinstance(loss, CrossEntropyLoss):
        raise ConfigError(
            "loss=cross_entropy learns the rooms of one building by name, and pretraining takes one building after "
            "another: choose another loss, or train on data (siamloc train)"
        )
    if process_rank() == 0:
        check_folder(run, resume, overwrite)
    usual: Monitor = "recall" if network.relative is None else "refined"
    monitor = usual if settings.monitor == "auto" else settings.monitor
    settings = replace(settings, monitor=monitor)
    check_loss(loss, 2)
    change, augmented = augmentation_of(augmentation, bool(network.settings["circular"]), settings, trainer)
    data = ViewDataModule(network.image_size, views, places, change, settings.seed)
    module = PlaceModule(network, loss, settings.optimizer, settings.recall_radius)
    noise = np.random.default_rng(0).integers(0, 256, (1, 3, *network.image_size), dtype=np.uint8)
    without_layer(network)  # fails before the training, not after it
    check_network(network, noise, circular=True, unit=getattr(module.loss, "unit_length", False))
    frames = {"train": None, "validation": None}
    about = {"data": {}, "views": views.plain(), "protocol": {}, "augment": augmented, "frames": frames}
    what = f"random buildings, a new one every {views.batches} batches, {places.epoch_batches} batches per epoch"
    learn(module, data, run, about, settings, trainer, monitor=monitor, what=what, resume=resume, overwrite=overwrite)
    if process_rank() == 0:
        save_weights(without_layer(network), run.weights)
        run.record_written([run.weights])
    return run


def _check(settings: Training, views: ViewSettings, network: Network) -> PlaceSettings:
    """Return how batches are drawn.

    Raises:
        ConfigError: settings that are meaningless for random buildings, or cameras that do not suit the network.
    """
    places, most = settings.pairs, views.drives * views.lights * views.poses
    ordinary, circular = views.cameras == "ordinary", bool(network.settings["circular"])
    if not isinstance(places, PlaceSettings) or places.epoch_batches is None:
        raise ConfigError("pretraining learns from batches of places: give pairs a number of epoch_batches")
    wrong = {
        f"draws places by their positions: leave out pairs.by={places.by}": places.by != "position",
        f"draws pairs.places={places.places} images of a building, which has {most}: set views.poses larger": (
            places.places > most
        ),
        f"renders its images: leave out workers={settings.workers}, and set views.processes": settings.workers > 0,
        f"is judged by the places found: monitor={settings.monitor} has no meaning here": (
            settings.monitor not in ("auto", "recall", "error", "refined")
        ),
        "shows images whose columns do not wrap around with views.cameras=ordinary: set model.circular=false (and "
        "model.canonical=false)": ordinary and circular,
        f"teaches a network with model.circular=false to compare images with views.cameras=ordinary only, and it is "
        f"{views.cameras}": network.relative is not None and not circular and not ordinary,
    }
    for text in (text for text, holds in wrong.items() if holds):
        raise ConfigError(f"pretraining {text}")
    return places
