"""Printing and timing for debugging a training."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field

import torch


def say(text: str) -> None:
    """Print a line to stderr."""
    print(text, file=sys.stderr, flush=True)


def milliseconds(seconds: float) -> str:
    """Return a time as text."""
    return f"{1000 * seconds:.1f} ms"


@dataclass
class Clock:
    """Clock that waits for the device before reading the time."""

    device: torch.device = field(default_factory=lambda: torch.device("cpu"))

    def __call__(self) -> float:
        """Return the time in seconds."""
        if self.device.type == "cuda":
            torch.cuda.synchronize(self.device)
        return time.perf_counter()
