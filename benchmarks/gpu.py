"""Measure siamloc on a GPU in about nine minutes, and say which targets are met.

Each part can be left out, and what goes wrong in one is recorded without stopping the others:

- core: what one CPU core delivers: panoramas from the store, augmentation, views of random buildings. Needs no GPU.
- networks: training vgg16, alexnet, densenet121 and `modern` on 128 pairs of panoramas of 128 x 512 pixels, eager and
  compiled: images/s, times of the parts of a step, memory, share of the rate at which the GPU multiplies matrices.
- data: the same with augmentation, with panoramas in the memory of the GPU, in the store, and from workers.
- recipe: `modern` with its own batches; with `--data`, also from start to end in a building.
- resume: whether a resumed training gives the same weights bit for bit, and what that costs.
- description, refinement, export: what networks do once they are trained.
- tests: the tests that need a GPU.
- pretraining: with 1, 4 and 16 processes that render.

    python -m benchmarks.gpu
    python -m benchmarks.gpu --parts networks data
    python -m benchmarks.gpu --data data/freiburg_like       # after `siamloc simulate camera=panorama out=data`
    python -m benchmarks.gpu --smoke --device cpu --out /tmp/try  # a trial of everything in tiny sizes
"""

from __future__ import annotations

import argparse
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import torch

from benchmarks.gpu_bench import POLICIES, TINY, Bench, Figures, Sizes, attempt
from benchmarks.gpu_describing import description, export, refinement
from benchmarks.gpu_training import core, data, networks, pretraining, recipe, resume
from benchmarks.report import Report, parser
from siamloc.data import example
from siamloc.runtime.exporting import TOLERANCE


def tests(bench: Bench) -> Figures:
    """Run the tests that need a GPU."""
    command = [sys.executable, "-m", "pytest", "-q", "-m", "gpu", "-p", "no:cacheprovider"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=Path(__file__).parents[1])
    summary = (ran.stdout.strip().splitlines() or [ran.stderr.strip()])[-1]
    return {"passed": ran.returncode == 0 and " passed" in summary, "summary": summary}


PARTS: dict[str, Callable[[Bench], Figures]] = {
    part.__name__: part
    for part in (core, networks, data, recipe, resume, description, refinement, export, tests, pretraining)
}


class Target(NamedTuple):
    """A target: its sentence, the figure that decides, and the least or the most that it may be."""

    text: str
    figure: Callable[[Figures], float]
    least: float = -math.inf
    most: float = math.inf


def _share(rows: Figures, good: Callable[[Figures], bool]) -> float:
    """Return the share of the rows that are good; a row that ended in an error is not."""
    return sum("error" not in row and good(row) for row in rows.values()) / len(rows)


TARGETS = (
    Target(
        "training `vgg16`, compiled: at least 35 % of the rate at which the GPU multiplies matrices",
        lambda found: found["networks"]["vgg16"]["compiled"]["share_of_matrix_rate"],
        least=0.35,
    ),
    *(
        Target(
            f"training `vgg16` with the policy `{policy}`: at most 5 % of the time spent waiting for data",
            lambda found, row=f"vgg16, {policy}, memory": found["data"][row]["waiting"],  # type: ignore[misc]
            most=0.05,
        )
        for policy in POLICIES
    ),
    Target(
        "the recipe `modern` in `freiburg_like`: at most a minute from start to end",
        lambda found: found["recipe"]["from start to end"]["minutes"],
        most=1,
    ),
    Target(
        "pretraining with 16 renderers: at most 5 % of the time spent waiting for data",
        lambda found: found["pretraining"]["16"]["waiting"],
        most=0.05,
    ),
    Target(
        "a resumed training with deterministic kernels: the same weights, bit for bit",
        lambda found: _share(found["resume"], lambda row: row["same"]),
        least=1,
    ),
    Target(
        "networks that map on the GPU and are exported: the robot's descriptors within 1e-4 of the map's",
        lambda found: _share(found["export"], lambda row: row["apart"] <= TOLERANCE),
        least=1,
    ),
    Target("the tests that need a GPU: all pass", lambda found: found["tests"]["passed"], least=1),
)


def judge(report: Report, found: Figures) -> None:
    """Record which targets were met, and print which ones were not measured."""
    for target in TARGETS:
        try:
            figure = target.figure(found)
        except KeyError:
            print(f"target {target.text}: not measured")
        else:
            report.target(f"{target.text} ({figure:.3g})", target.least <= figure <= target.most)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print and write the file."""
    options = _options().parse_args(arguments)
    device, parts, begin = torch.device(options.device), list(options.parts), time.monotonic()
    if device.type == "cuda" and not torch.cuda.is_available():
        print("torch finds no GPU here: only the part core is measured (--smoke --device cpu tries all of them)")
        parts = [part for part in parts if part == "core"]
    elif device.type != "cuda":
        parts = [part for part in parts if part != "tests"]
    report, sizes = Report("gpu", options.out, ("torchvision", "lightning")), TINY if options.smoke else Sizes()

    def timely(name: str) -> Figures:
        spent = (time.monotonic() - begin) / 60
        print(f"{name}, after {spent:.1f} minutes", flush=True)
        return PARTS[name](bench) if spent < options.minutes else {"error": f"left out after {spent:.1f} minutes"}

    with tempfile.TemporaryDirectory(prefix="siamloc-gpu-") as folder:
        bench = Bench(
            device=device,
            trainer=partial(trainer_on, device),
            sizes=sizes,
            images=example(sizes.frames, sizes.image),
            workers=1 if options.smoke else options.workers,
            renderers=[0] if options.smoke else options.renderers,
            folder=Path(folder),
            building=options.data,
        )
        found = {name: attempt(partial(timely, name)) for name in parts}
    for name, part in found.items():
        if "error" in part:
            print(f"{name}: {part['error']}")
    judge(report, found)
    report.write({"gpu": card(device), "sizes": asdict(sizes), "minutes": (time.monotonic() - begin) / 60, **found})


def _options() -> argparse.ArgumentParser:
    arguments = parser(__doc__)
    arguments.add_argument("--parts", nargs="+", default=list(PARTS), choices=list(PARTS), help="what to measure")
    arguments.add_argument("--device", default="cuda", help="torch device (default cuda)")
    arguments.add_argument("--smoke", action="store_true", help="tiny sizes, as a trial")
    arguments.add_argument("--data", type=Path, help="folder of a rendered building, for the whole recipe")
    arguments.add_argument("--workers", type=int, default=8, help="processes that gather batches (default 8)")
    arguments.add_argument("--renderers", type=int, nargs="+", default=[1, 4, 16], help="processes that render")
    arguments.add_argument("--minutes", type=float, default=7, help="begin no part later than this (default 7)")
    return arguments


def trainer_on(device: torch.device) -> dict[str, Any]:
    """Return the arguments of Lightning's trainer for a training on a device."""
    if device.type != "cuda":
        return {"accelerator": device.type, "precision": "auto"}
    return {"accelerator": "gpu", "devices": [device.index or 0], "precision": "auto"}


def card(device: torch.device) -> dict[str, Any] | None:
    """Return the name and the memory of a GPU and the version of its software; None for another device."""
    if device.type != "cuda" or not torch.cuda.is_available():
        return None
    about = torch.cuda.get_device_properties(device)
    return {"name": about.name, "gib": about.total_memory / 2**30, "cuda": torch.version.cuda}


if __name__ == "__main__":
    main()
