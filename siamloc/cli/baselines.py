"""Descriptors that stand beside the one that is measured."""

from __future__ import annotations

from omegaconf import DictConfig

from analytic import Descriptor
from siamloc.cli.steps import descriptor_options, make_descriptor
from siamloc.runs import Run


def baseline_descriptors(config: DictConfig, run: Run, main: str, skipped: dict[str, str]) -> dict[str, Descriptor]:
    """Return the baselines of the configuration by name.

    Args:
        config: the configuration.
        run: the run that is measured; where it holds no trained network, what needs one is left out.
        main: label of the descriptor that is measured, which does not stand beside itself.
        skipped: what is left out is noted here, with the reason.

    Raises:
        ConfigError: an unknown name.
    """
    found: dict[str, Descriptor] = {}
    for name in config.task.baselines:
        options = descriptor_options(name)
        if name == main:
            continue
        if name in ("network", "untrained") and not run.record.is_file():
            skipped[f"baseline {name}"] = f"{run.folder} holds no trained network"
            continue
        found[name] = make_descriptor(config, run, options)
    return found
