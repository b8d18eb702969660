"""Measure how fast networks train: with siamloc, and with a loop in the style of published code, in the same run.

On the CPU, AlexNet is trained on batches of 32 pairs of panoramas of 128 x 512 pixels, by three loops in turn. The
published style decodes both images of a pair with PIL whenever the pair is requested, without workers, passes the two
through the network one after the other, and computes in single precision. Ours is `siamloc.training.fit` with
trainer={"precision": "auto"}, which is bfloat16 on CPUs that have instructions for it. The bare loop is the limit: it
computes in the precision of ours with channels last, on one batch in memory, and does nothing else. A step's time is
the median over all steps after the first two. Target: 90 % of the bare loop. CPU seconds are recorded as well, since
other programs disturb them least; with more than one thread they include threads that wait. Then a small network is
trained with and without keeping memory from step to step (`siamloc.memory`), in CPU time. The file keeps a row for
each processor.

`benchmarks.gpu` measures training on a GPU.

The image files are drawn in a temporary folder.

    python -m benchmarks.training
    python -m benchmarks.training --images 64 --steps 1 --repeats 1 --out /tmp/try  # a trial
"""

from __future__ import annotations

import resource
import statistics
import tempfile
import time
from argparse import Namespace
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest import mock

import cv2
import numpy as np
import torch
from PIL import Image
from torch.utils.data import DataLoader, Dataset

import siamloc
from augment.torchvision_compat import ensure_torchvision
from benchmarks.report import Report, hardware, parser
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.memory import kept_memory
from siamloc.models import ContrastiveLoss
from siamloc.training import PairSampler, PairSettings
from siamloc.training.trainer import check_trainer

ensure_torchvision()
from lightning.pytorch import Callback  # noqa: E402

SIZE = (128, 512)
PAIRS = PairSettings(label="room", same_room_share=0.5)
CPU_PAIRS = 32
LEAST_OF_BARE = 0.9
SKIPPED = 2  # first steps, in which memory is allocated


def main() -> None:
    """Measure, print and write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--images", type=int, default=512, help="number of JPEG files to draw (default 512)")
    arguments.add_argument("--steps", type=int, default=8, help="steps per measurement (default 8)")
    arguments.add_argument("--repeats", type=int, default=3, help="measurements of each, for the median (default 3)")
    options = arguments.parse_args()
    report = Report("training", options.out, ("pillow", "torchvision"))
    figures: dict[str, Any] = {"image_size": list(SIZE), "pairs": CPU_PAIRS, "network": "alexnet + fc500_500_5"}
    with tempfile.TemporaryDirectory(prefix="siamloc-training-") as temporary:
        frames = draw_files(Path(temporary), options.images)
        images = PanoramaLibrary(frames, Path(temporary) / "cache", image_size=SIZE)
        steps: dict[str, list[Mark]] = {"published style": [], "ours": [], "bare loop": []}
        for number in range(options.repeats):
            run = Path(temporary) / f"cpu{number}"
            steps["published style"] += published_style(frames, options.steps)
            steps["ours"] += ours(images, run, "alexnet", options.steps)
            steps["bare loop"] += bare_loop(images, options.steps)
        found = {name: rates(each) for name, each in steps.items()}
        for name, one in found.items():
            print(
                f"{name:<16}{one['images_per_second']:8.1f} images/s, {one['images_per_cpu_second']:.1f} per CPU second"
            )
        ratio, of_bare = (
            found["ours"]["images_per_second"] / found[name]["images_per_second"]
            for name in ("published style", "bare loop")
        )
        print(f"ours is {ratio:.2f} times as fast as the published style")
        report.target(f"CPU: {LEAST_OF_BARE:.0%} of the bare loop ({of_bare:.1%})", of_bare >= LEAST_OF_BARE)
        row = {"precision": precision(), "instructions": instructions(), **found, "ratio": ratio}
        row |= {"share_of_bare_loop": of_bare, "memory": memory(images, Path(temporary), options)}
        figures["rows"] = report.kept({hardware()["cpu"]: row})
    print(hardware()["cpu"])
    report.write(figures)


def draw_files(folder: Path, count: int) -> FrameTable:
    """Write JPEG files of smooth patterns, which decode about as fast as photographs do."""
    generator = np.random.default_rng(0)
    paths = [folder / f"{number:04}.jpg" for number in range(count)]
    for path in paths:
        coarse = generator.integers(0, 256, (SIZE[0] // 8, SIZE[1] // 8, 3), dtype=np.uint8)
        picture = cv2.resize(coarse, SIZE[::-1], interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(path), picture, [cv2.IMWRITE_JPEG_QUALITY, 90])
    return FrameTable(
        path=[str(path) for path in paths], room=["office", "kitchen", "corridor", "stairs"] * (count // 4)
    )


class _Decoded(Dataset[tuple[torch.Tensor, torch.Tensor, float]]):
    """Pairs whose images are opened whenever they are requested."""

    def __init__(self, frames: FrameTable, pairs: int) -> None:
        self.paths = frames.path
        self.pairs = PairSampler(frames, PairSettings(**{**PAIRS.plain(), "epoch_pairs": pairs})).epoch(0)

    def __len__(self) -> int:
        return len(self.pairs.first)

    def __getitem__(self, number: int) -> tuple[torch.Tensor, torch.Tensor, float]:
        first, second = (_opened(self.paths[rows[number]]) for rows in (self.pairs.first, self.pairs.second))
        return first, second, float(self.pairs.label[number])


def _opened(path: str) -> torch.Tensor:
    picture = np.asarray(Image.open(path).convert("RGB"), dtype=np.float32) / 255
    return torch.from_numpy(picture).permute(2, 0, 1)


Mark = tuple[float, float]
"""Seconds of the clock and of the processors, at one moment or of one step."""


def now() -> Mark:
    """Read both clocks."""
    return time.perf_counter(), time.process_time()


def steps_between(marks: list[Mark]) -> list[Mark]:
    """Return the seconds of each step but the first ones, from the moments at which the steps ended."""
    kept = marks[SKIPPED - 1 :]
    return [(after[0] - before[0], after[1] - before[1]) for before, after in pairwise(kept)]


def rates(steps: list[Mark]) -> dict[str, Any]:
    """Return the images per second and per CPU second of the median step, and the seconds of all steps."""
    clock, processors = zip(*steps, strict=True)
    return {
        "images_per_second": 2 * CPU_PAIRS / statistics.median(clock),
        "images_per_cpu_second": 2 * CPU_PAIRS / statistics.median(processors),
        "seconds": [round(one, 4) for one in clock],
        "cpu_seconds": [round(one, 4) for one in processors],
    }


class _Ends(Callback):
    """Notes when each step of a training ends."""

    def __init__(self) -> None:
        self.marks: list[Mark] = []

    def on_train_batch_end(self, *_: Any) -> None:
        self.marks.append(now())


def precision() -> str:
    """Return the precision that "auto" is on this CPU."""
    return str(check_trainer({"accelerator": "cpu", "precision": "auto"}).precision)


def instructions() -> list[str]:
    """Return the instructions for bfloat16 that this CPU has."""
    known = {"AMX": torch.cpu._is_amx_tile_supported(), "AVX512-BF16": torch.cpu._is_avx512_bf16_supported()}
    return [name for name, there in known.items() if there]


def published_style(frames: FrameTable, steps: int) -> list[Mark]:
    """Train as published code does, and return the seconds of the steps."""
    network = siamloc.models.build("alexnet", "fc500_500_5", SIZE).train()
    optimizer = torch.optim.SGD(network.parameters(), lr=0.001, momentum=0.9)
    loss = ContrastiveLoss(2.0)
    marks = []
    for first, second, label in DataLoader(_Decoded(frames, (steps + SKIPPED) * CPU_PAIRS), batch_size=CPU_PAIRS):
        optimizer.zero_grad()
        loss(network(first), network(second), label.float()).backward()
        optimizer.step()
        marks.append(now())
    return steps_between(marks)


def bare_loop(images: PanoramaLibrary, steps: int) -> list[Mark]:
    """Train on one batch in memory, in the precision of "auto" with channels last; return the seconds of the steps."""
    network = siamloc.models.build("alexnet", "fc500_500_5", SIZE).train()
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = torch.optim.SGD(network.parameters(), lr=0.001, momentum=0.9, fused=True)
    loss, half = ContrastiveLoss(2.0), precision() == "bf16-mixed"
    batch, label = torch.from_numpy(images.batch(range(2 * CPU_PAIRS))), torch.arange(CPU_PAIRS).float() % 2
    marks = []
    with kept_memory():
        for _ in range(steps + SKIPPED):
            with torch.autocast("cpu", torch.bfloat16, enabled=half):
                value = loss(*network(batch.float() / 255).chunk(2), label)
            optimizer.zero_grad()
            value.backward()
            optimizer.step()
            marks.append(now())
    return steps_between(marks)


def ours(images: PanoramaLibrary, run: Path, branch: str, steps: int) -> list[Mark]:
    """Train with `siamloc.training.fit`, and return the seconds of the steps."""
    network = siamloc.models.build(branch, "fc500_500_5", SIZE)
    ends = _Ends()
    siamloc.training.fit(
        network,
        images,
        images.frames,
        run=run,
        epochs=1,
        batch_size=CPU_PAIRS,
        pairs=PairSettings(**{**PAIRS.plain(), "epoch_pairs": (steps + SKIPPED) * CPU_PAIRS}),
        trainer={"accelerator": "cpu", "precision": "auto", "callbacks": [ends]},
    )
    return steps_between(ends.marks)


def memory(images: PanoramaLibrary, folder: Path, options: Namespace) -> dict[str, Any]:
    """Return the CPU seconds, of the program and of the system, for training a small network."""
    found: dict[str, list[dict[str, float]]] = {"kept": [], "given back": []}
    for number in range(options.repeats):
        for name, context in (("kept", kept_memory), ("given back", nullcontext)):
            with mock.patch("siamloc.training.fitting.kept_memory", context):
                before = resource.getrusage(resource.RUSAGE_SELF)
                ours(images, folder / f"{name}{number}", "simple1", 2 * options.steps)
                after = resource.getrusage(resource.RUSAGE_SELF)
            found[name].append(
                {"program": after.ru_utime - before.ru_utime, "system": after.ru_stime - before.ru_stime}
            )
    seconds = {name: statistics.median(sum(one.values()) for one in each) for name, each in found.items()}
    print(f"simple1: {seconds['kept']:.1f} s of CPU time, {seconds['given back']:.1f} s if memory is given back")
    return {**found, "ratio": seconds["given back"] / seconds["kept"]}


if __name__ == "__main__":
    main()
