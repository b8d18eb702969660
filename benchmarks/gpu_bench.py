"""What the parts of `benchmarks.gpu` share: the device, how much is measured, and how errors are kept."""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

import siamloc
from benchmarks.report import seconds
from siamloc.data import PanoramaLibrary
from siamloc.pretraining import RECIPE, ViewSettings

MODERN = siamloc.training.recipe("modern")
NETWORKS: dict[str, dict[str, Any]] = {
    **{name: {"branch": name, "head": "fc500_500_5"} for name in ("vgg16", "alexnet", "densenet121")},
    "modern": dict(MODERN.model),
}
POLICIES = ("none", "thesis", "any_light")
Figures = dict[str, Any]


@dataclass(frozen=True)
class Sizes:
    """How much is measured.

    Attributes:
        image: rows and columns of the panoramas.
        frames: number of frames of each of the two drives.
        pairs: pairs in a batch.
        steps: steps of a training; the second half of them counts.
        matrix: side of the matrices that are multiplied.
        described: number of images to describe.
        repeats: number of measurements, for the median.
        rendered: rows and columns of the views of random buildings.
        views: settings of these buildings.
        seconds: longest duration of a pretraining, with each number of renderers.
        networks: names in `NETWORKS`.
        quickest: the network that needs data fastest.
        policies: of the augmentation.
    """

    image: tuple[int, int] = (128, 512)
    frames: int = 256
    pairs: int = 128
    steps: int = 60
    matrix: int = 8192
    described: int = 1024
    repeats: int = 5
    rendered: tuple[int, int] = RECIPE.image_size
    views: ViewSettings = field(default_factory=ViewSettings)
    seconds: float = 25.0
    networks: tuple[str, ...] = tuple(NETWORKS)
    quickest: str = "alexnet"
    policies: tuple[str, ...] = POLICIES


TINY = Sizes(
    image=(16, 64),
    frames=16,
    pairs=2,
    steps=2,
    matrix=64,
    described=4,
    repeats=1,
    rendered=(16, 64),
    views=ViewSettings(batches=4, held=2, together=1, drives=1, lights=1, poses=16),
    seconds=0.1,
    networks=("modern",),
    quickest="modern",
    policies=("thesis",),
)
"""The sizes of a trial."""


@dataclass(frozen=True)
class Bench:
    """Where and how much is measured.

    Attributes:
        device: what is measured.
        trainer: makes the arguments of Lightning's trainer for a training there.
        sizes: how much is measured.
        images: panoramas to train on.
        workers: number of processes that gather batches, in the measurements that have any.
        renderers: numbers of rendering processes to pretrain with.
        folder: parent of the folders with runs and bundles.
        building: folder of a rendered building, for the recipe `modern` from start to end; None for none.
    """

    device: torch.device
    trainer: Callable[[], dict[str, Any]]
    sizes: Sizes
    images: PanoramaLibrary
    workers: int
    renderers: Sequence[int]
    folder: Path
    building: Path | None = None

    @property
    def on_cuda(self) -> bool:
        """Whether the device is a GPU, rather than one for a trial."""
        return self.device.type == "cuda"

    def fresh(self) -> Path:
        """Return the path of a folder that does not exist yet."""
        return Path(tempfile.mkdtemp(dir=self.folder)) / "fresh"

    def build(self, name: str, **more: Any) -> Any:
        """Make a network of `NETWORKS` with random weights, on the CPU."""
        return siamloc.models.build(**{**NETWORKS[name], "image_size": self.sizes.image, **more})

    def median(self, work: Callable[[], Any]) -> float:
        """Return the median seconds of some work on the device, after a warm-up."""

        def finished() -> None:
            work()
            if self.on_cuda:
                torch.cuda.synchronize(self.device)

        return statistics.median(seconds({"it": finished}, self.sizes.repeats)["it"])


def attempt(work: Callable[[], Figures]) -> Figures:
    """Return the figures of some work, or its error, so that the rest is measured all the same."""
    try:
        return work()
    except Exception as error:
        return {"error": f"{type(error).__name__}: {next(iter(str(error).strip().splitlines()), '')}"}


def rows(works: Mapping[str, Callable[[], Figures]]) -> Figures:
    """Return and print the figures of each piece of work."""
    found: Figures = {}
    for name, work in works.items():
        found[name] = attempt(work)
        print(f"  {name}: {shown(found[name])}", flush=True)
    return found


def shown(value: Any) -> str:
    """Return figures as text, with three digits."""
    if isinstance(value, dict):
        return ", ".join(f"{name} {shown(one)}" for name, one in value.items())
    return f"{value:.3g}" if isinstance(value, float) else str(value)
