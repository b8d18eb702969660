"""Measure how fast networks train: with siamloc, and with a loop in the style of published code, in the same run.

On the CPU, AlexNet is trained on batches of 32 pairs of panoramas of 128 x 512 pixels. The published style decodes both
images of a pair with PIL whenever the pair is requested, without workers, passes the two through the network one after
the other, and computes in single precision. Ours is `siamloc.training.fit` with trainer={"precision": "auto"}. The two
take turns, and the medians are compared. Target: 3 times as many images per second. Then a small network is trained
with and without keeping memory from step to step (`siamloc.memory`), in CPU time, which other programs disturb least.

With a GPU, VGG16 is also trained on batches of 128 pairs in bfloat16. Targets: 35 % of the rate at which the card
multiplies matrices in bfloat16, measured in the same run, and less than 5 % of the time spent waiting for data. With
`--data`, the recipe `modern` is trained on a building there, too. Target: less than 60 s. Without a GPU, the file says
so.

The image files are drawn in a temporary folder.

    python -m benchmarks.training
    siamloc simulate camera=panorama out=data
    python -m benchmarks.training --data data/freiburg_like
    python -m benchmarks.training --images 64 --steps 1 --repeats 1 --out /tmp/try  # a trial
"""

from __future__ import annotations

import resource
import statistics
import tempfile
import time
from argparse import Namespace
from contextlib import nullcontext
from pathlib import Path
from typing import Any
from unittest import mock

import cv2
import numpy as np
import torch
from PIL import Image
from torch.utils.data import DataLoader, Dataset

import siamloc
from benchmarks.report import Report, hardware, parser
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.memory import kept_memory
from siamloc.models import ContrastiveLoss
from siamloc.training import PairSampler, PairSettings
from siamloc.training.pace import Pace

SIZE = (128, 512)
PAIRS = PairSettings(label="room", same_room_share=0.5)
CPU_PAIRS, GPU_PAIRS = 32, 128
LEAST_RATIO, LEAST_SHARE, MOST_WAITING, MOST_SECONDS = 3.0, 0.35, 0.05, 60.0
NO_GPU = "no GPU"
SKIPPED = 2  # first steps, in which memory is allocated


def main() -> None:
    """Measure, print and write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--images", type=int, default=512, help="number of JPEG files to draw (default 512)")
    arguments.add_argument("--steps", type=int, default=8, help="steps per measurement (default 8)")
    arguments.add_argument("--repeats", type=int, default=3, help="measurements of each, for the median (default 3)")
    arguments.add_argument("--data", type=Path, help="folder of a rendered building, for the recipe on a GPU")
    options = arguments.parse_args()
    report = Report("training", options.out, ("pillow", "torchvision"))
    figures: dict[str, Any] = {"image_size": list(SIZE), "pairs": CPU_PAIRS, "network": "alexnet + fc500_500_5"}
    with tempfile.TemporaryDirectory(prefix="siamloc-training-") as temporary:
        frames = draw_files(Path(temporary), options.images)
        images = PanoramaLibrary(frames, Path(temporary) / "cache", image_size=SIZE)
        found: dict[str, list[dict[str, float]]] = {"published style": [], "ours": []}
        for number in range(options.repeats):
            found["published style"].append(published_style(frames, options.steps))
            found["ours"].append(ours(images, Path(temporary) / f"cpu{number}", "alexnet", CPU_PAIRS, options.steps))
        rates = {name: statistics.median(one["images_per_second"] for one in each) for name, each in found.items()}
        for name, rate in rates.items():
            print(f"{name:<16}{rate:8.1f} images/s")
        ratio = rates["ours"] / rates["published style"]
        report.target(f"CPU: {LEAST_RATIO:g} times the published style ({ratio:.2f})", ratio >= LEAST_RATIO)
        figures |= {"cpu": found, "cpu_ratio": ratio, "memory": memory(images, Path(temporary), options)}
        if torch.cuda.is_available():
            figures["gpu"] = on_gpu(report, images, Path(temporary), options.steps)
            if options.data is not None:
                figures["gpu"]["recipe"] = recipe_on_gpu(report, options.data, Path(temporary))
        else:
            figures["gpu"] = NO_GPU
            print("no GPU here: neither the rate of VGG16 in bfloat16 nor the time of the recipe was measured")
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


def published_style(frames: FrameTable, steps: int) -> dict[str, float]:
    """Train as published code does, and return the images per second."""
    network = siamloc.models.build("alexnet", "fc500_500_5", SIZE).train()
    optimizer = torch.optim.SGD(network.parameters(), lr=0.001, momentum=0.9)
    loss = ContrastiveLoss(2.0)
    begin = 0.0
    for number, (first, second, label) in enumerate(
        DataLoader(_Decoded(frames, (steps + SKIPPED) * CPU_PAIRS), batch_size=CPU_PAIRS)
    ):
        optimizer.zero_grad()
        loss(network(first), network(second), label.float()).backward()
        optimizer.step()
        if number == SKIPPED - 1:
            begin = time.monotonic()
    return {"images_per_second": 2 * steps * CPU_PAIRS / (time.monotonic() - begin)}


def ours(
    images: PanoramaLibrary, run: Path, branch: str, pairs: int, steps: int, trainer: dict[str, Any] | None = None
) -> dict[str, float]:
    """Train with `siamloc.training.fit`, and return the images per second and the share of time spent waiting."""
    network = siamloc.models.build(branch, "fc500_500_5", SIZE)
    pace = Pace()
    siamloc.training.fit(
        network,
        images,
        images.frames,
        run=run,
        epochs=1,
        batch_size=pairs,
        pairs=PairSettings(**{**PAIRS.plain(), "epoch_pairs": (steps + SKIPPED) * pairs}),
        trainer={"precision": "auto", "callbacks": [pace], **(trainer or {})},
    )
    return {"images_per_second": pace.images_per_second, "waiting": pace.waiting}


def memory(images: PanoramaLibrary, folder: Path, options: Namespace) -> dict[str, Any]:
    """Return the CPU seconds, of the program and of the system, for training a small network."""
    found: dict[str, list[dict[str, float]]] = {"kept": [], "given back": []}
    for number in range(options.repeats):
        for name, context in (("kept", kept_memory), ("given back", nullcontext)):
            with mock.patch("siamloc.training.fitting.kept_memory", context):
                before = resource.getrusage(resource.RUSAGE_SELF)
                ours(images, folder / f"{name}{number}", "simple1", CPU_PAIRS, 2 * options.steps)
                after = resource.getrusage(resource.RUSAGE_SELF)
            found[name].append(
                {"program": after.ru_utime - before.ru_utime, "system": after.ru_stime - before.ru_stime}
            )
    seconds = {name: statistics.median(sum(one.values()) for one in each) for name, each in found.items()}
    print(f"simple1: {seconds['kept']:.1f} s of CPU time, {seconds['given back']:.1f} s if memory is given back")
    return {**found, "ratio": seconds["given back"] / seconds["kept"]}


def on_gpu(report: Report, images: PanoramaLibrary, folder: Path, steps: int) -> dict[str, Any]:
    """Measure VGG16, and the rate at which the card multiplies matrices."""
    from torch.utils.flop_counter import FlopCounterMode

    network = siamloc.models.build("vgg16", "fc500_500_5", SIZE).cuda()
    with FlopCounterMode(display=False) as counter:
        network(torch.rand(2, 3, *SIZE, device="cuda")).sum().backward()
    per_image = counter.get_total_flops() / 2
    del network
    found = ours(images, folder / "gpu", "vgg16", GPU_PAIRS, 20 * steps, {"accelerator": "gpu"})
    card = matrix_rate()
    share = found["images_per_second"] * per_image / card
    print(f"vgg16: {found['images_per_second']:.0f} images/s, {share:.1%} of {card / 1e12:.0f} TFLOP/s")
    report.target(f"GPU: {LEAST_SHARE:.0%} of the matrix rate ({share:.1%})", share >= LEAST_SHARE)
    waiting = found["waiting"]
    report.target(f"GPU: less than {MOST_WAITING:.0%} waiting ({waiting:.1%})", waiting < MOST_WAITING)
    return {**found, "flops_per_image": per_image, "matrix_flops_per_second": card, "share": share}


def recipe_on_gpu(report: Report, data: Path, folder: Path) -> dict[str, Any]:
    """Train the recipe `modern` on the building, and return the time, including compilation and validations."""
    from benchmarks.building import Building
    from benchmarks.recipes import RECIPE, trained

    found = trained(Building(data, RECIPE.image_size), "ours", 0, folder / "recipe")
    seconds = 60 * found["minutes"]
    report.target(f"GPU: the recipe in less than {MOST_SECONDS:.0f} s ({seconds:.0f} s)", seconds < MOST_SECONDS)
    return found


def matrix_rate() -> float:
    """Return the floating point operations per second of the card in a product of two large bfloat16 matrices."""
    side, repeats = 8192, 20
    left, right = (torch.randn(side, side, device="cuda", dtype=torch.bfloat16) for _ in range(2))
    times = []
    for _ in range(repeats):
        torch.cuda.synchronize()
        begin = time.monotonic()
        left @ right
        torch.cuda.synchronize()
        times.append(time.monotonic() - begin)
    return 2 * side**3 / statistics.median(times)


if __name__ == "__main__":
    main()
