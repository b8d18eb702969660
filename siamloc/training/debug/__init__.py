"""`fit(debug=...)`: inspect a training before starting it: one batch, overfitting one batch, where the time goes."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any, Literal

import torch

from augment.torchvision_compat import ensure_torchvision
from siamloc.models.module import NetworkModule
from siamloc.runs import Run
from siamloc.training.batches import EpochDataModule
from siamloc.training.debug.one_batch import one_batch
from siamloc.training.debug.overfit import overfit
from siamloc.training.debug.profiling import profile_steps

ensure_torchvision()
from lightning.pytorch import Trainer  # noqa: E402

Debug = Literal["overfit", "one_batch", "profile"]


def debug_training(
    debug: Debug,
    module: NetworkModule,
    data: EpochDataModule,
    run: Run,
    used: Mapping[str, Any],
    make_trainer: Callable[..., Trainer],
) -> None:
    """Inspect a training, print the results, and leave the weights as they were.

    - "one_batch": a training step and a validation batch: shapes, figures and times. Nothing is written.
    - "overfit": the first batch over and over, without augmentation: whether the loss goes down as it should. Nothing
      is written.
    - "profile": some steps with the time of each part, then some under torch's profiler, whose trace is written into
      the run as `profile.json`.

    Args:
        debug: which of these.
        module: the training module.
        data: the batches.
        run: for the trace.
        used: the settings of the training, for the record of a run that has none yet.
        make_trainer: makes a trainer on the device of the training, with arguments of `lightning.Trainer`.

    Raises:
        ConfigError: the loss is not finite.
    """
    before = copy.deepcopy(module.state_dict())
    sigma = getattr(module.loss, "sigma", None)
    try:
        with torch.random.fork_rng(devices=[]):
            if debug == "profile":
                profile_steps(module, data, make_trainer, run, used)
            else:
                (one_batch if debug == "one_batch" else overfit)(module, data, make_trainer)
    finally:
        module.teardown("fit")  # Lightning skips this on failure
        module.load_state_dict(before)
        module.zero_grad(set_to_none=True)
        if sigma is not None:  # which may have changed
            module.loss.sigma = sigma
