"""The parts of `benchmarks.gpu` that train networks, and what a single core delivers to them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from datetime import timedelta
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

import augment
import siamloc
from augment.torchvision_compat import ensure_torchvision
from benchmarks import recipes
from benchmarks.building import Building
from benchmarks.gpu_bench import MODERN, Bench, Figures, rows, shown
from benchmarks.report import milliseconds
from benchmarks.views import quick
from siamloc.pretraining import RECIPE, pretrain, view_batches
from siamloc.training.pace import Mark, images_in, mark, seconds_between

ensure_torchvision()
from lightning.pytorch import Callback  # noqa: E402

ENDLESS = 100_000  # batches of an epoch that ends earlier
NOMINAL = {
    "H200": 989.0,
    "H100 NVL": 835.0,
    "H100 PCIe": 756.0,
    "H100": 989.0,
    "A100": 312.0,
    "L40S": 362.0,
    "A10": 125.0,
    "L4": 121.0,
}
"""TFLOP/s of dense bfloat16 matrices by the data sheets; the first name that is a part of the GPU's own counts."""


class Parts(Callback):
    """Time the parts of each step: waiting for data, forward and backward, optimizer. No step waits for the times."""

    def __init__(self) -> None:
        self.begun: list[Mark] = []
        self.steps: list[list[Mark]] = []
        self.images = 0

    def on_train_batch_start(self, trainer: Any, pl_module: Any, batch: Any, batch_idx: int) -> None:
        self.begun = [mark(pl_module)]
        self.images = images_in(batch)

    def on_before_optimizer_step(self, trainer: Any, pl_module: Any, optimizer: Any) -> None:
        self.begun.append(mark(pl_module))

    def on_train_batch_end(self, trainer: Any, pl_module: Any, outputs: Any, batch: Any, batch_idx: int) -> None:
        self.steps.append([*self.begun, mark(pl_module)])

    def figures(self) -> Figures:
        """Return the speed and the mean time of each part in the second half of the steps, and the first step's."""
        half = len(self.steps) // 2
        moments = [[before[-1], *now] for before, now in zip(self.steps[half - 1 :], self.steps[half:], strict=False)]
        times = np.array([[seconds_between(*pair) for pair in pairwise(one)] for one in moments])
        data, network, optimizer = times.mean(axis=0).tolist()
        step = data + network + optimizer
        return {
            "images_per_second": self.images / step,
            "waiting": data / step,
            "ms": {"data": 1000 * data, "forward and backward": 1000 * network, "optimizer": 1000 * optimizer},
            "first_step_s": seconds_between(self.steps[0][0], self.steps[0][-1]),
            "steps": len(times),
        }


def trained(bench: Bench, fit: Callable[..., Any], **options: Any) -> Figures:
    """Train, and return the speed, the times of the parts of a step, and the peak memory in GiB.

    Args:
        bench: where and how much.
        fit: what trains, with a run and arguments of Lightning's trainer.
        options: further arguments of `fit`.
    """
    parts = Parts()
    if bench.on_cuda:
        torch.cuda.reset_peak_memory_stats(bench.device)
    trainer = {**bench.trainer(), "callbacks": [parts], **options.pop("trainer", {})}
    fit(**{"run": bench.fresh(), "epochs": 1, "trainer": trainer, **options})
    peak = torch.cuda.max_memory_allocated(bench.device) / 2**30 if bench.on_cuda else None
    return {**parts.figures(), "peak_gib": peak}


def on_pairs(bench: Bench, network: nn.Module, **options: Any) -> Figures:
    """Train a network on pairs of panoramas, which are augmented on the device unless told otherwise."""
    sizes, images = bench.sizes, bench.images
    pairs = {"label": "room", "same_room_share": 0.5, "epoch_pairs": sizes.pairs * sizes.steps}
    fit = partial(siamloc.training.fit, network, images, images.frames, batch_size=sizes.pairs, pairs=pairs)
    return trained(bench, fit, **{"augment_where": "gpu", **options})


def networks(bench: Bench) -> Figures:
    """Train each network on pairs, without augmentation, eager and compiled, and compare with products of matrices."""
    rates = {"matrix_rate": matrix_rate(bench)}
    card = torch.cuda.get_device_name(bench.device) if bench.on_cuda else ""
    nominal = [1e12 * rate for name, rate in NOMINAL.items() if name in card]
    if nominal:
        rates["nominal_rate"] = nominal[0]
    ways = {"eager": False, "compiled": True} if bench.on_cuda else {"eager": False}
    found = {
        name: rows({way: partial(_network, bench, name, wanted, rates) for way, wanted in ways.items()})
        for name in bench.sizes.networks
    }
    return {**rates, **found}


def _network(bench: Bench, name: str, compiles: bool, rates: dict[str, float]) -> Figures:
    found = on_pairs(bench, bench.build(name), compile=compiles)
    needed = found["images_per_second"] * flops(bench.build(name), bench.sizes.image)
    return {**found, **{f"share_of_{rate}": needed / value for rate, value in rates.items()}}


def flops(network: nn.Module, image_size: tuple[int, int]) -> float:
    """Return the floating point operations of a training step for each image, forward and backward, on the CPU."""
    with FlopCounterMode(display=False) as counter:
        network(torch.rand(2, 3, *image_size)).sum().backward()
    return counter.get_total_flops() / 2


def matrix_rate(bench: Bench) -> float:
    """Return the floating point operations per second in products of two large bfloat16 matrices."""
    side = bench.sizes.matrix
    left, right = (torch.randn(side, side).to(bench.device, torch.bfloat16) for _ in range(2))
    return 2 * side**3 / bench.median(lambda: left @ right)


def data(bench: Bench) -> Figures:
    """Train on pairs with each augmentation, and with panoramas from each source.

    "memory": held on the device; "store": gathered by the training process, or by workers. All of these are augmented
    on the device; with "workers augment", workers gather and augment.
    """
    works: dict[str, Callable[[], Figures]] = {}
    sources = {
        "memory": (True, 0, "gpu"),
        "store": (False, 0, "gpu"),
        "store, workers": (False, bench.workers, "gpu"),
        "workers augment": (False, bench.workers, "cpu"),
    }
    sizes = bench.sizes
    for policy in sizes.policies:
        for source, (held, workers, where) in sources.items():
            options = {"augmentation": policy, "augment_where": where, "workers": workers, "compile": False}
            for name in sizes.networks if source == "memory" else (sizes.quickest,):
                works[f"{name}, {policy}, {source}"] = partial(_from, bench, name, held, **options)
    return {"workers": bench.workers, **rows(works)}


def _from(bench: Bench, name: str, held: bool, **options: Any) -> Figures:
    place: AbstractContextManager[Any] = nullcontext()
    if not held:
        place = mock.patch("siamloc.training.batches.room_for", return_value=0)
    with place:
        return on_pairs(bench, bench.build(name), **options)


def recipe(bench: Bench) -> Figures:
    """Train the recipe `modern` with its own batches; and if there is a building, from start to end as users do."""
    images = bench.images
    network = MODERN.build(bench.sizes.image)
    fit = partial(MODERN.fit, network, images, images.frames, pairs={"epoch_batches": bench.sizes.steps})
    works: dict[str, Callable[[], Figures]] = {"its batches": partial(trained, bench, fit)}
    if bench.building is not None:
        works["from start to end"] = partial(_whole_recipe, bench.building, bench.fresh())
    return rows(works)


def _whole_recipe(folder: Path, run: Path) -> Figures:
    return recipes.trained(Building(folder, MODERN.image_size), "ours", 0, run)


def pretraining(bench: Bench) -> Figures:
    """Pretrain with each number of rendering processes."""
    return rows({str(processes): partial(_pretrained, bench, processes) for processes in bench.renderers})


def _pretrained(bench: Bench, processes: int) -> Figures:
    sizes = bench.sizes
    longest = {"max_time": timedelta(seconds=sizes.seconds), "min_steps": sizes.steps, "min_epochs": 0}
    views = replace(sizes.views, processes=processes)
    places = min(RECIPE.training["pairs"]["places"], views.drives * views.lights * views.poses)  # of one building
    settings = {"views": views, "pairs": {"epoch_batches": ENDLESS, "places": places}}
    # The validation at the end is not measured: a small building keeps it short.
    with mock.patch.multiple(view_batches, _VALIDATION_BUILDINGS=1, _VALIDATION_POSES=10):
        return trained(bench, partial(pretrain, RECIPE.build(sizes.rendered)), trainer=longest, **settings)


def resume(bench: Bench) -> Figures:
    """Train without a break, and stopped and resumed: whether the weights are the same, and what determinism costs."""
    names = set(bench.sizes.networks) & {"alexnet", "modern"}
    try:
        return rows({name: partial(_resumed, bench, name) for name in sorted(names)})
    finally:
        torch.use_deterministic_algorithms(False)


def _resumed(bench: Bench, name: str) -> Figures:
    def learned(network: nn.Module, epochs: int = 1, deterministic: bool = True, **options: Any) -> Figures:
        trainer = {"deterministic": deterministic}
        return on_pairs(bench, network, epochs=epochs, augmentation="any_light", trainer=trainer, **options)

    free = learned(bench.build(name), deterministic=False)
    whole, stopped, run = bench.build(name), bench.build(name), bench.fresh()
    learned(whole, epochs=2)
    found = learned(stopped, run=run)
    learned(stopped, epochs=2, run=run, resume=True)
    pairs = zip(whole.state_dict().values(), stopped.state_dict().values(), strict=True)
    speed = {"images_per_second": found["images_per_second"], "not deterministic": free["images_per_second"]}
    return {"same": all(torch.equal(*pair) for pair in pairs), **speed}


def core(bench: Bench) -> Figures:
    """Return what a single core delivers per second of CPU time, and what the networks compute for each image.

    A core delivers panoramas from the store, augmented ones, the draws of an augmentation that a device applies, and
    views of random buildings.
    """
    sizes, images = bench.sizes, bench.images
    wanted = np.random.default_rng(0).integers(0, len(images), 2 * sizes.pairs)
    batch, generator = torch.from_numpy(images.batch(wanted)), torch.Generator().manual_seed(0)
    works: dict[str, Callable[[], Any]] = {"gathered": lambda: images.batch(wanted)}
    for name in [one for one in sizes.policies if one != "none"]:
        effect = augment.policy(name)
        works[f"augmented, {name}"] = partial(effect, batch, generator)
        works[f"drawn, {name}"] = partial(_packed, effect, batch, generator)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        found = {name: 1000 * len(batch) / milliseconds(work, sizes.repeats)["cpu_ms"] for name, work in works.items()}
    finally:
        torch.set_num_threads(threads)
    quick(0, sizes.views)  # warm-up
    views, seconds = quick(1, sizes.views)
    found["views"] = views / seconds
    print(f"  per second: {shown(found)}")
    needed = {name: flops(bench.build(name), sizes.image) for name in sizes.networks}
    needed["pretraining"] = flops(RECIPE.build(sizes.rendered), sizes.rendered)
    return {"per_second": found, "flops_per_image": needed}


def _packed(effect: augment.Effect, batch: torch.Tensor, generator: torch.Generator) -> None:
    effect.program(effect.draw(generator, batch), *batch.shape[2:])
