"""`siamloc train` and `siamloc pretrain`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from foundation.settings import Count, Positive, Probability, Size, defaults_of
from foundation.words import as_words
from siamloc.data.pairs import PairSettings
from siamloc.data.places import PlaceSettings
from siamloc.errors import ConfigError
from siamloc.jobs.choices import Augment, Folder, Loader, Loss, Model, TrainerKeys
from siamloc.jobs.job import Given, Job, Say, quiet
from siamloc.jobs.run_job import OF_NETWORKS, DataJob
from siamloc.jobs.stored import with_settings_of_the_run
from siamloc.jobs.sweep import sweep_suffix
from siamloc.models.registry import LOSSES, Optimizer
from siamloc.pretraining.settings import RECIPE, ViewSettings
from siamloc.runs import Run
from siamloc.training.settings import Learning, Training


@dataclass(frozen=True, kw_only=True)
class _Training(Learning, Job):
    """Base of the two jobs that train a network.

    Attributes:
        folder: the run's folder.
        model: the network.
        loss: the loss.
        augment: how training images are augmented.
        trainer: arguments of Lightning's Trainer.
        loader: how images are loaded.
        resume: continue from the last checkpoint of the run.
        overwrite: replace the run in the folder.
    """

    folder: Folder | None = None
    pairs: PairSettings | PlaceSettings
    optimizer: Optimizer
    model: Model
    loss: Loss
    augment: Augment
    trainer: TrainerKeys = field(default_factory=TrainerKeys)
    loader: Loader = field(default_factory=Loader)
    resume: bool = False
    overwrite: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        _ = self.training

    @classmethod
    def completed(cls, values: dict[str, Any], given: Given) -> dict[str, Any]:
        """Return values together with the settings of the run, if it is resumed."""
        values = super().completed(values, given)
        if values["resume"] is True and values["run"] is not None:
            if isinstance(values["run"], str) and values["run"].strip() and not sweep_suffix():
                Run(Path(values["run"])).check_resumable()
            return with_settings_of_the_run(values, given, cls.key_names(), resumed=True)
        return values

    @property
    def training(self) -> Training:
        """The settings of the training."""
        margin = self.loss.parameters if self.loss.name == "contrastive" else {}
        own = {**vars(self.narrowed(Learning)), **margin}
        return Training(**own, workers=self.loader.workers, augment_where=self.augment.where)

    def make_loss(self) -> Any:
        """Make the loss over batches of places; None for the contrastive loss, whose margin is a setting.

        Raises:
            ConfigError: a loss that does not fit the way batches are drawn.
        """
        from siamloc.models.batch_losses import make_loss

        contrastive = self.loss.name == "contrastive"
        if contrastive == isinstance(self.pairs, PlaceSettings):
            raise ConfigError(
                f"loss={self.loss.name} does not go with these pairs: pairs=in_batch goes with "
                f"loss={'|'.join(LOSSES)}, other pairs with loss=contrastive"
            )
        return None if contrastive else make_loss(self.loss.name, **self.loss.parameters)

    def target(self, data: str) -> Path:
        """Return the folder that the training writes into."""
        branch = re.sub("[/:]", "-", self.model.branch.name)
        names = [data, branch, self.model.head.name, f"seed{self.seed}"]
        folder = Path("runs") / "-".join(names) if self.folder is None else Path(self.folder)
        return folder / sweep_suffix() if sweep_suffix() else folder

    def common(self, data: str) -> dict[str, Any]:
        """Return the arguments that the calls of both trainings have; `data` begins the name of the run's folder."""
        folder = self.target(data)
        own = {"trainer": self.trainer.plain(), "overwrite": self.overwrite, "settings": self.training}
        made = {"loss": self.make_loss(), "augmentation": self.augment.policy}
        resume = self.resume and (not sweep_suffix() or Run(folder).record.is_file())  # a new run of a sweep is started
        return {"run": folder, "resume": resume, **made, **own}


@dataclass(frozen=True, kw_only=True)
class Train(_Training, DataJob):
    """Train a siamese network.

    Writes a run folder with checkpoints (best on the validation sequence, last), training curves, and the settings,
    which the other commands read from there.

        run=FOLDER                        where the run is written
        protocol.train.sequences=[...]    training sequences; names or patterns
        protocol.validation.sequences=[...]  sequences for choosing the best checkpoint
        experiment=modern|fine_tuning|adapt|photographs|rooms
                                          our recipes: modern for panoramas with positions, from random weights;
                                          fine_tuning for the same, shorter, from the shipped weights; adapt for the
                                          panoramas of one drive without any labels, from the shipped weights;
                                          photographs for images of an ordinary camera; rooms for such images with
                                          room labels. You can still change any key
        model/branch=vgg16                the convolutional part of the network; all groups are listed below
        model/branch=timm/NAME            a network of timm; or torchvision/NAME; or package.module:factory, a function
                                          or class of your own that gives a network
        model/head=fc500_500_5            what makes a descriptor of its features
        model.circular=true               the network wraps around the azimuth
        model.branch.weights=siamloc      start from pretrained weights; or imagenet, or the path of a run or a file;
                                          cached or download for the published weights of timm and torchvision
        model.normalize=local             remove lighting from the image first; or channels, image, local_brightness,
                                          local_and_colours
        pairs=room|distance|in_batch      pairs with binary labels (room) or metric labels (distance); in_batch uses all
                                          pairs of a batch and needs a loss of batches, such as loss=triplet
        pairs=frames loss=cross_entropy   learn to name the room of a frame, as experiment=rooms_classifier does
        loss.miner=batch_hard loss.distance=cosine
                                          for triplet and similar losses: which pairs count and how they are compared
        pairs.by=sequence pairs.radius=1    batches without positions; loss.room=0.5 to learn from rooms as well
        pairs.same_room_share=0.4 pairs.epoch_pairs=10000
        augment=thesis                    augmentation of training images; augment.where=cpu|gpu sets the device
        epochs=30 batch_size=16 optimizer.learning_rate=0.001 seed=0
        monitor=error|recall|room|accuracy|loss
                                          validation figure that picks the best checkpoint; recall_radius=0.5
        compile=auto|true|false           let torch compile the network for training; auto does so on a GPU
        patience=5                        stop after this many epochs without a better validation
        resume=true                       continue from the last checkpoint; checkpoint_every=200 writes it within
                                          epochs, too
        -m model/branch=vgg11,vgg13       a sweep, each run in its own folder inside run=runs/sweep; `siamloc map`,
                                          `evaluate` and `report` take that folder, `siamloc compare` makes a table;
                                          with resume=true, an interrupted sweep goes on

    Example:
        $ siamloc train experiment=modern data=cold data.root=/data/COLD protocol=freiburg run=runs/freiburg
    """

    GROUPS: ClassVar[Mapping[str, str]] = {
        **DataJob.GROUPS,
        **{"pairs": "default", "loss": "contrastive", "augment": "none"},
        **OF_NETWORKS,
        "optimizer": "sgd",
    }
    MORE: ClassVar[Mapping[str, Any]] = {"augment": {"where": "auto"}}
    SHARED = True

    def run(self, say: Say = quiet) -> Run:
        """Train the network."""
        from siamloc import models, training
        from siamloc.training.fitting import process_rank
        from siamloc.training.run_folder import check_folder
        from siamloc.training.trainer import check_trainer

        validated = self.protocol.validation.sequences is not None
        common = self.common(self.data.name or "data")
        check_trainer(common["trainer"])  # before any image is decoded
        if process_rank() == 0:
            check_folder(Run(common["run"]), common["resume"], self.overwrite)
        network = models.build(**self.model.arguments(), image_size=self.data.image_size, seed=self.seed)
        images, roles = self.open_roles("train", *(["validation"] if validated else []))
        drives: dict[str, Any] = {"validation": roles.get("validation"), "protocol": self.protocol.plain()}
        run = training.fit(network, images, roles["train"], **drives, **common)
        if process_rank() == 0:
            say(f"next: siamloc map {as_words({'run': str(run.folder), **self.own_camera, **self.model.branch.own})}")
        return run


@dataclass(frozen=True, kw_only=True)
class Pretrain(_Training):
    """Train a network on random buildings, before it sees any data.

    Draws, furnishes, lights and renders one building after another while the network learns from those already
    there. Everything follows from the seed. `siamloc train` can start from the resulting weights.

        run=runs/pretrained         where the run is written
        epochs=14                   of 500 batches each; a new building every views.batches=10
        views.processes=1           number of processes that render alongside the training
        views.worlds=any|offices    also homes, workshops and halls, with surfaces that reflect; or offices alone
        views.imaging=drawn|plain   each camera with its own response and flaws; or all like a data set's camera
        loss.beyond=[1.0,2.5]       metres from which images are told apart by the surfaces they share, too; [] for none
        seed=0 resume=true
        trainer.devices=2 trainer.strategy=ddp   each process has its own buildings

    Example:
        $ siamloc pretrain run=runs/pretrained
    """

    GROUPS: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("pairs", "loss", "augment", "optimizer"), "pretraining"),
        "model/branch": RECIPE.model["branch"],
        "model/head": RECIPE.model["head"],
    }
    MORE: ClassVar[Mapping[str, Any]] = {
        "augment": {"where": "auto"},
        "trainer": RECIPE.trainer,
        "model": {key: RECIPE.model[key] for key in defaults_of(Model)},
    }

    folder: Folder = "runs/pretrained"
    views: ViewSettings = field(default_factory=ViewSettings)
    image_size: Size = RECIPE.image_size
    epochs: Count = RECIPE.training["epochs"]
    clip: Positive | None = RECIPE.training["clip"]
    average: Probability | None = RECIPE.training["average"]

    def run(self, say: Say = quiet) -> Run:
        """Train the network on random buildings."""
        from siamloc import models, pretraining
        from siamloc.training.fitting import process_rank

        network = models.build(**self.model.arguments(), image_size=self.image_size, seed=self.seed)
        run = pretraining.pretrain(network, views=self.views, **self.common("pretrained"))
        if process_rank() == 0:
            say(f"next: siamloc train experiment=fine_tuning {as_words({'model.branch.weights': run.weights})}")
        return run
