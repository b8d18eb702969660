"""The keys that only the command line has, and their valid values; those of calls stand beside the calls."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Annotated, Literal

from siamloc.files import PICTURES, is_picture
from siamloc.models.registry import Outputs
from siamloc.settings import (
    Count,
    Natural,
    Rule,
    Seed,
    Settings,
    Size,
    Text,
    Thousand,
    Workers,
)

Folder = Annotated[str, Rule("the name of a folder", lambda value: bool(value.strip()))]
Device = Annotated[str, Rule("auto, cpu or cuda", lambda value: re.fullmatch(r"auto|cpu|cuda(:\d+)?", value))]
Images = tuple[Text, ...] | Text | None
Listed = Annotated[str, Rule("numbers between commas", lambda value: bool(re.fullmatch(r"\d+(,\d+)*,?", value)))]
Depth = Annotated[int, Rule("a whole number from 1 to 10,000", lambda value: 1 <= value <= 10_000)]
Picture = Annotated[str, Rule(f"a picture's name, ending {' '.join(PICTURES)}", is_picture)]
Several = Annotated[tuple[Text, ...], Rule("a list of one name or more", lambda value: len(value) > 0)]
Devices = Annotated[tuple[Natural, ...], Rule("a list of one number or more", lambda value: len(value) > 0)]


@dataclass(frozen=True)
class Loader(Settings):
    """How images are loaded."""

    WHERE = "loader"

    workers: Workers = 0


@dataclass(frozen=True)
class Branch(Settings):
    """The branch of a network."""

    WHERE = "model.branch"

    name: Text
    weights: Text | None = None


@dataclass(frozen=True)
class Head(Settings):
    """The head of a network."""

    WHERE = "model.head"

    name: Text
    outputs: Outputs | None = None


@dataclass(frozen=True)
class Model(Settings):
    """A network."""

    WHERE = "model"

    branch: Branch
    head: Head
    circular: bool = False
    normalize: Text | None = None
    canonical: bool = False
    relative: bool = False


@dataclass(frozen=True)
class TrainerKeys(Settings):
    """The keys of `conf/trainer`; Lightning checks other arguments of its Trainer itself."""

    WHERE = "trainer"

    accelerator: Text = "auto"
    devices: Count | Literal["auto", -1] | Devices | Listed = 1
    num_nodes: Count = 1
    strategy: Text | None = "auto"
    precision: Text | Literal[16, 32, 64] | None = "32-true"
    log_every_n_steps: Natural = 10


@dataclass(frozen=True)
class Main(Settings):
    """The keys of `conf/config.yaml` that belong to no group."""

    run: Folder | None = None
    resume: bool = False
    overwrite: bool = False
    debug: Literal["overfit", "one_batch", "profile"] | None = None
    checkpoint: Literal["best", "last"] = "best"
    device: Device = "auto"
    distance: Literal["manhattan", "euclidean", "correlation", "cosine"] | None = None
    projector: bool = False
    bundle: Folder | None = None
    precision: Literal["float32", "float16", "int8", "auto"] = "float32"
    thumbnails: bool = False
    loader: Loader = field(default_factory=Loader)


@dataclass(frozen=True)
class Pretrain(Settings):
    """The keys of `conf/pretrain.yaml` that belong to no group."""

    run: Folder = "runs/pretrained"
    resume: bool = False
    overwrite: bool = False
    image_size: Size = (64, 256)
    loader: Loader = field(default_factory=Loader)


@dataclass(frozen=True)
class Report(Settings):
    """The keys of `conf/report.yaml`."""

    run: Text | None = None
    runs: tuple[Text, ...] | Text | None = ()
    out: Text | None = None


@dataclass(frozen=True)
class Compare(Settings):
    """The keys of `conf/compare.yaml`."""

    runs: Several | Text
    by: Text | None = None
    out: Text | None = None


@dataclass(frozen=True)
class Reproduce(Settings):
    """The keys of `conf/reproduce/reproduce.yaml`."""

    id: Text | None = None
    list: bool = False
    data: Literal["cold", "freiburg_sim", "mini"] = "freiburg_sim"
    root: Text | None = None
    scale: Literal["smoke", "short", "full"] = "short"
    out: Folder = "reproduced"
    page: Text | None = None
    measure: bool = True


@dataclass(frozen=True)
class Expand(Settings):
    """The keys of `conf/expand.yaml` that belong to no group."""

    out: Folder
    depth: Depth = 16
    sequences: tuple[Text, ...] | Text | None = ()
    seed: Seed = 0
    workers: Thousand = 2
    resume: bool = False


@dataclass(frozen=True)
class Preview(Settings):
    """The keys of `conf/preview.yaml` that belong to no group."""

    out: Picture = "augmentation.png"
    images: Images = ()
    count: Thousand = 6


@dataclass(frozen=True)
class Demo(Settings):
    """The keys of `conf/demo/demo.yaml`."""

    run: Folder = "runs/demo"
    data: Text = "data"
    seed: Seed = 0
    overwrite: bool = False


OWN: dict[str, type[Settings]] = {
    "config": Main,
    "pretrain": Pretrain,
    "report": Report,
    "compare": Compare,
    "reproduce": Reproduce,
    "expand": Expand,
    "preview": Preview,
    "demo": Demo,
}
"""Keys of each main configuration file that belong to no group."""
