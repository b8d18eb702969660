"""`siamloc train`: train a siamese network."""

from __future__ import annotations

import logging
import os
import sys
import warnings
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

import augment
from augment.torchvision_compat import ensure_torchvision
from siamloc.cli.compose import plain, task_overrides
from siamloc.cli.steps import Roles, image_size, train_run, usable
from siamloc.data.frames import FrameTable
from siamloc.errors import ConfigError
from siamloc.runs import Run

ensure_torchvision()
from lightning.pytorch import Trainer  # noqa: E402
from lightning.pytorch.loggers import TensorBoardLogger  # noqa: E402
from lightning.pytorch.utilities.exceptions import MisconfigurationException  # noqa: E402

from siamloc.data.datamodule import PairAugmentation, PairDataModule  # noqa: E402
from siamloc.models import SiameseModule  # noqa: E402
from siamloc.models.training import AtomicCheckpoints, Curves, checkpoint_callbacks, remove_leftovers  # noqa: E402


def main(config: DictConfig) -> None:
    """Train, from the start or from the run's last checkpoint.

    Everything that can be wrong is built and checked before the folder of the run is touched.
    """
    run = train_run(config)
    first_process = process_rank() == 0
    start = _starting_point(run, config) if first_process else _last_checkpoint(run, config)
    validated = config.protocol.validation.sequences is not None
    roles = Roles(config, ("train", "validation") if validated else ("train",))
    train, validation = (_frames(config, roles, name) for name in ("train", "validation"))
    assert train is not None
    data = PairDataModule(
        roles.library,
        train,
        validation,
        pairs={**plain(config.pairs), "seed": config.seed},
        batch_size=config.batch_size,
        workers=config.loader.workers,
        augmentation=_augmentation(config),
    )
    module = SiameseModule(
        branch=config.model.branch.name,
        head=config.model.head.name,
        image_size=image_size(config),
        weights=config.model.branch.weights,
        margin=config.loss.margin,
        optimizer=config.optimizer.name,
        learning_rate=config.optimizer.learning_rate,
        momentum=config.optimizer.momentum,
        weight_decay=config.optimizer.weight_decay,
        seed=config.seed,
    )
    trainer = make_trainer(config, run, validated=validated)
    if first_process:
        if start is None:
            run.clear()
        remove_leftovers(run.checkpoints)
        cache = f"data.cache='{Path(config.data.cache).resolve()}'"
        run.save_record([*task_overrides(), cache], plain(config))
        sampler = data.sampler
        print(
            f"training {config.model.branch.name} + {config.model.head.name} on {len(train)} frames, "
            f"{len(sampler)} {sampler.label} pairs per epoch, epochs: {config.epochs}, into {run.folder}"
        )
    trainer.fit(module, datamodule=data, ckpt_path=start, weights_only=True)
    if first_process:
        print(f"checkpoint: {run.checkpoint('best')}; next: siamloc map run={run.folder}")


def make_trainer(config: DictConfig, run: Run, *, validated: bool) -> Trainer:
    """Return the trainer of a run: checkpoints, curves and TensorBoard lie in the run's folder.

    Raises:
        ConfigError: settings that Lightning refuses.
    """
    _quieten()
    own: dict[str, Any] = {
        "max_epochs": config.epochs,
        "default_root_dir": run.folder,
        "logger": TensorBoardLogger(run.folder, name="tensorboard", version=""),
        "callbacks": [Curves(run.metrics), *checkpoint_callbacks(run.checkpoints, validated=validated)],
        "plugins": [AtomicCheckpoints()],
        "reload_dataloaders_every_n_epochs": 1,
        "use_distributed_sampler": False,
        "num_sanity_val_steps": 0,
        "limit_val_batches": 1.0 if validated else 0,
        "enable_model_summary": False,
        "enable_progress_bar": sys.stderr.isatty(),
    }
    options = plain(config.trainer)
    taken = sorted(set(options) & set(own))
    if taken:
        raise ConfigError(f"trainer.{taken[0]} is set by siamloc itself: leave it out")
    try:
        return Trainer(**options, **own)
    except (MisconfigurationException, TypeError, ValueError, RuntimeError) as error:
        first_line = str(error).strip().splitlines()[0]
        raise ConfigError(f"the trainer cannot be set up with these trainer keys: {first_line}") from error


def process_rank() -> int:
    """Return the number of this process among those that train together; 0 when there is one."""
    for name in ("RANK", "SLURM_PROCID", "LOCAL_RANK"):
        if os.environ.get(name, "").isdigit():
            return int(os.environ[name])
    return 0


def _frames(config: DictConfig, roles: Roles, name: str) -> FrameTable | None:
    """Return the frames of a role; for metric labels those that have a position."""
    if name == "validation" and config.protocol.validation.sequences is None:
        return None
    frames = roles[name]
    alone = len(set(roles["train"].place.tolist())) == 1
    if config.pairs.label == "distance" or (config.pairs.label == "auto" and alone):
        frames = usable(config, frames, frames.has_position, "have no position, which distance labels need")
    return frames


def _augmentation(config: DictConfig) -> PairAugmentation | None:
    options = plain(config.augment)
    where = options.pop("where")
    policy = augment.policy_from_config({"circular": config.data.circular, **options})
    return PairAugmentation(policy, where, config.seed) if policy.slots else None


def _quieten() -> None:
    """Keep what Lightning says of itself off the screen; warnings that concern the user stay."""
    for name in ("lightning.pytorch", "lightning.fabric"):
        logging.getLogger(name).setLevel(logging.WARNING)
    expected = ("LeafSpec", "does not have many workers", "smaller than the logging interval", "is not empty")
    for text in expected:
        warnings.filterwarnings("ignore", message=f".*{text}")


def _starting_point(run: Run, config: DictConfig) -> Path | None:
    """Return the checkpoint to go on from; refuse to write over a run unless told to."""
    if config.resume and config.overwrite:
        raise ConfigError("resume=true goes on with a run, overwrite=true throws it away: choose one")
    if not config.resume:
        if run.record.is_file() and not config.overwrite:
            raise ConfigError(
                f"{run.folder} holds a run already: go on with it by resume=true, replace it by overwrite=true, "
                "or choose another run="
            )
        return None
    if not run.record.is_file():
        raise ConfigError(f"there is no run to resume in {run.folder}: leave out resume=true to start one")
    _check_same_training(run, config)
    last = _last_checkpoint(run, config)
    if last is None:
        print(f"{run.folder} holds no checkpoint yet: training starts from the beginning")
    return last


def _last_checkpoint(run: Run, config: DictConfig) -> Path | None:
    last = run.checkpoints / "last.ckpt"
    return last if config.resume and last.is_file() else None


def _check_same_training(run: Run, config: DictConfig) -> None:
    """Make sure that a run is resumed with the settings it began with; only the number of epochs may grow."""
    before, now = run.load_record()["config"], plain(config)
    fixed = ("model", "optimizer", "loss", "pairs", "augment", "batch_size", "seed", "protocol", "data", "unwrap")
    for section in fixed:
        old, new = _flat(section, before.get(section)), _flat(section, now.get(section))
        for key in sorted({*old, *new}):
            free = key.startswith(("augment.where", "protocol.map", "protocol.query", "data.cache", "data.manifest"))
            if old.get(key) != new.get(key) and not free and key != "data.root":
                raise ConfigError(
                    f"{run.folder} was trained with {key}={old.get(key)} and cannot be resumed with "
                    f"{key}={new.get(key)}: leave it out, or train another run"
                )


def _flat(prefix: str, value: Any) -> dict[str, Any]:
    if isinstance(value, dict):
        return {key: item for name, part in value.items() for key, item in _flat(f"{prefix}.{name}", part).items()}
    return {prefix: value}
