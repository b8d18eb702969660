"""`siamloc simulate`: render a made-up office building."""

from __future__ import annotations

from omegaconf import DictConfig

from siamloc.cli.compose import plain
from siamloc.simulate import SimulateConfig, simulate


def main(config: DictConfig) -> None:
    """Render and say what was written."""
    summary = simulate(SimulateConfig.of(plain(config)))
    for path in summary.files:
        print(f"picture: {path}")
    for sequence, count in summary.sequences.items():
        print(f"{sequence}: {count} frames")
    if summary.sequences:
        rate = f", {summary.rendered / summary.seconds:.1f} frames/s" if summary.rendered else ""
        print(f"{summary.folder}: {summary.rendered} frames rendered in {summary.seconds:.0f} s{rate}")
