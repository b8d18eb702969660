"""A Lightning trainer that writes and prints nothing."""

from __future__ import annotations

from augment.torchvision_compat import ensure_torchvision

ensure_torchvision()
from lightning.pytorch import Trainer  # noqa: E402


def trainer(**options):
    """Make a trainer of one epoch on the CPU."""
    silent = ("logger", "enable_checkpointing", "enable_progress_bar", "enable_model_summary")
    quiet = {"accelerator": "cpu", "max_epochs": 1, "log_every_n_steps": 1, **dict.fromkeys(silent, False)}
    return Trainer(**(quiet | options))
