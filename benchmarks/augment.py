"""Time every effect and policy next to its equivalents in kornia and torchvision.

    OMP_NUM_THREADS=2 python -m benchmarks.augment [--out FOLDER] [--quick]

Batches of 32 panoramas, 128 x 512, uint8. torchvision gets the same bytes and, as its functions require, one parameter
for the whole batch. Where it only moves or fills bytes (occlude, and torch.roll for rotate), it goes frame by frame,
since only the place differs from frame to frame there. kornia gets the same images as float32, with the conversion not
timed, and draws parameters for every frame as we do. Drawing is part of our times and of kornia's. kornia is left out
if it is not installed. The three are timed in turn, round by round, so that a busy machine slows all of them down.
"""

from __future__ import annotations

import ctypes
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import augment
from augment.torchvision_compat import ensure_torchvision
from benchmarks.report import Report, Work, medians, parser

ensure_torchvision()
from torchvision.transforms.v2 import functional as tv  # noqa: E402

try:
    import kornia
    import kornia.augmentation as kornia_augmentation
except ImportError:
    kornia = None

BATCH = (32, 3, 128, 512)


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("--repeats", type=int, default=15)
    arguments.add_argument("--quick", action="store_true", help="three repeats, as a trial")
    options = arguments.parse_args()
    warnings.simplefilter("ignore")
    repeats = 3 if options.quick else options.repeats
    report = Report("augment", options.out, ("torchvision", "kornia"))
    batch = pictures()
    rows = [measured(name, batch, repeats) for name in (*augment.EFFECTS, *augment.POLICIES[1:])]
    on_gpu = gpu(batch, repeats) if torch.cuda.is_available() else None
    print(table(rows))
    for row in on_gpu or []:
        print(row)
    slower = [row["name"] for row in rows if min(row["to_torchvision"] or 1, row["to_kornia"] or 1) < 1]
    report.target(f"no effect slower than another library's (slower: {', '.join(slower) or 'none'})", not slower)
    device = torch.cuda.get_device_name() if torch.cuda.is_available() else None
    report.write(
        {"batch": BATCH, "torch_threads": torch.get_num_threads(), "cpu": rows, "gpu_name": device, "gpu": on_gpu}
    )


def measured(name: str, batch: Tensor, repeats: int) -> dict[str, Any]:
    """Return panoramas per second for us and the others, the ratios, and our peak memory in copies of the batch."""
    effect = augment.effect(name) if name in augment.EFFECTS else augment.policy(name)
    generator = torch.Generator().manual_seed(0)
    works = {"ours": lambda: effect(batch, generator), **others(name, batch)}
    seconds = medians(works, repeats)
    rates = {key: round(len(batch) / value) for key, value in seconds.items()}
    return {
        "name": name,
        **{key: rates.get(key) for key in ("ours", "torchvision", "kornia")},
        "to_torchvision": round(rates["ours"] / rates["torchvision"], 2) if "torchvision" in rates else None,
        "to_kornia": round(rates["ours"] / rates["kornia"], 2) if "kornia" in rates else None,
        "peak_copies": peak_copies(works["ours"], batch),
    }


def others(name: str, batch: Tensor) -> dict[str, Work]:
    """Return the equivalent work of other libraries, if they have it."""
    works: dict[str, Work] = {}
    bar = torch.zeros(3, 1, 1, dtype=torch.uint8)
    for_bytes: dict[str, Work] = {
        "brighten": lambda: tv.adjust_brightness(batch, 1.3),
        "darken": lambda: tv.adjust_brightness(batch, 0.7),
        "sharpen": lambda: tv.adjust_sharpness(batch, 2.0),
        "blur": lambda: tv.gaussian_blur(batch, [5, 5]),
        "contrast": lambda: tv.adjust_contrast(batch, 1.4),
        "equalize": lambda: tv.equalize(batch),
        "saturate": lambda: tv.adjust_saturation(batch, 1.4),
        "gamma": lambda: tv.adjust_gamma(batch, 1.4),
        "occlude": lambda: torch.stack([tv.erase(frame, 0, 100, batch.shape[2], 100, bar) for frame in batch]),
        "noise": lambda: tv.gaussian_noise(batch, 0.0, 0.1),
        "jpeg": lambda: tv.jpeg(batch, 40),
        "rotate": lambda: torch.stack([frame.roll(146, 2) for frame in batch]),
    }
    if name in for_bytes and runs(for_bytes[name]):
        works["torchvision"] = for_bytes[name]
    if kornia is not None:
        k, pictures = kornia_augmentation, batch.float() / 255
        for_floats: dict[str, Callable[[], Any]] = {
            "bulb": lambda: k.RandomGaussianIllumination(p=1.0),
            "brighten": lambda: k.RandomBrightness((1.1, 1.3), p=1.0),
            "darken": lambda: k.RandomBrightness((0.7, 0.9), p=1.0),
            "sharpen": lambda: k.RandomSharpness(2.0, p=1.0),
            "blur": lambda: k.RandomBoxBlur((5, 5), p=1.0),
            "contrast": lambda: k.RandomContrast((0.5, 1.8), p=1.0),
            "equalize": lambda: k.RandomEqualize(p=1.0),
            "saturate": lambda: k.RandomSaturation((0.2, 2.0), p=1.0),
            "rotate": lambda: k.RandomTranslate((0.1, 0.9), p=1.0),
            "noise": lambda: k.RandomGaussianNoise(0.0, 0.1, p=1.0),
            "occlude": lambda: k.RandomErasing((0.05, 0.4), p=1.0),
            "motion_blur": lambda: k.RandomMotionBlur((3, 15), 0.0, 0.0, p=1.0),
            "gamma": lambda: k.RandomGamma((0.5, 2.0), p=1.0),
            "white_balance": lambda: k.RandomPlanckianJitter(p=1.0),
            "shadow": lambda: k.RandomPlasmaShadow(p=1.0),
            "jpeg": lambda: k.RandomJPEG((10.0, 60.0), p=1.0),
        }
        if name in for_floats:
            other = for_floats[name]()
            if runs(lambda: other(pictures)):
                works["kornia"] = lambda: other(pictures)
    return works


def runs(work: Work) -> bool:
    """Whether another library can do it here: some parts need compiled code that this build lacks."""
    try:
        work()
    except Exception as error:
        print(f"left out: {type(error).__name__}: {str(error).splitlines()[0][:100]}", file=sys.stderr)
        return False
    return True


def peak_copies(work: Work, batch: Tensor) -> float | None:
    """Return the peak resident memory during the work, in multiples of the batch's size, including the batch itself."""
    reset, status = Path("/proc/self/clear_refs"), Path("/proc/self/status")
    try:
        work()
        ctypes.CDLL(None).malloc_trim(0)  # memory freed before must not hide what the work needs
        reset.write_text("5")
        before = kilobytes(status, "VmRSS")
        work()
        return round(1 + (kilobytes(status, "VmHWM") - before) * 1024 / batch.numel(), 2)
    except (OSError, AttributeError):
        return None


def kilobytes(status: Path, key: str) -> int:
    line = next(line for line in status.read_text().splitlines() if line.startswith(key))
    return int(line.split()[1])


def gpu(batch: Tensor, repeats: int) -> list[dict[str, Any]]:
    """Return panoramas per second and the share of memory bandwidth, for one read and one write of every byte."""
    there = batch.repeat(8, 1, 1, 1).cuda()
    big = torch.empty(1 << 30, dtype=torch.uint8, device="cuda")
    copied = torch.empty_like(big)
    bandwidth = 2 * big.numel() / cuda_seconds(lambda: copied.copy_(big), repeats)
    rows = []
    for name in (*augment.EFFECTS, *augment.POLICIES[1:]):
        effect = augment.effect(name) if name in augment.EFFECTS else augment.policy(name)
        generator = torch.Generator().manual_seed(0)
        seconds = cuda_seconds(lambda effect=effect, generator=generator: effect(there, generator), repeats)
        share = 2 * there.numel() / seconds / bandwidth
        rows.append({"name": name, "panoramas_per_s": round(len(there) / seconds), "bandwidth_share": round(share, 3)})
    return rows


def cuda_seconds(work: Work, repeats: int) -> float:
    def synchronous() -> None:
        work()
        torch.cuda.synchronize()

    return medians({"it": synchronous}, repeats)["it"]


def pictures() -> Tensor:
    """Return panoramas with smooth and rough parts."""
    generator = torch.Generator().manual_seed(0)
    count, _, height, width = BATCH
    coarse = torch.rand(count, 3, height // 16, width // 16, generator=generator)
    smooth = torch.nn.functional.interpolate(coarse, size=(height, width), mode="bilinear")
    return ((smooth * 0.85 + 0.15 * torch.rand(BATCH, generator=generator)) * 255).to(torch.uint8)


def table(rows: list[dict[str, Any]]) -> str:
    lines = ["panoramas/s    |   ours | torchvision | kornia | to tv | to kornia | peak copies"]
    for row in rows:
        keys = ("ours", "torchvision", "kornia", "to_torchvision", "to_kornia", "peak_copies")
        cells = [row[key] for key in keys]
        texts = ["-" if cell is None else str(cell) for cell in cells]
        widths = (6, 11, 6, 5, 9, 11)
        lines.append(f"{row['name']:14s} | " + " | ".join(f"{t:>{w}s}" for t, w in zip(texts, widths, strict=True)))
    return "\n".join(lines)


if __name__ == "__main__":
    main()
