"""Measure how fast batches of panoramas load: from the memory-mapped library, and from JPEG files decoded one by one.

Both serve random rows in the same run, in one thread. The files are drawn in a temporary folder. Targets: 3,000
panoramas/s of 3 x 128 x 512 in batches of 32 from the library, and 10 times as many as a loader that opens, decodes and
resizes each item with PIL.

    python -m benchmarks.loader [--out FOLDER]
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from PIL import Image

from benchmarks.report import Report, parser, seconds
from siamloc.data import FrameTable, PanoramaLibrary

HEIGHT, WIDTH = 128, 512
TARGET_RATE = 3000.0
TARGET_RATIO = 10.0


def main() -> None:
    options = _options()
    report = Report("loader", options.out, ("pillow",))
    results: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(prefix="siamloc-loader-") as temporary:
        for columns, rows in options.sizes:
            results.append(_measure(Path(temporary), rows, columns, options))
            _print(results[-1], options)
    for result in results:
        library = result["loaders"]["library"]
        report.target(
            f"{TARGET_RATE:,.0f} panoramas/s and {TARGET_RATIO:.0f} x PIL from JPEG {result['jpeg_size']}",
            library["panoramas_per_s"] >= TARGET_RATE and library["times_pil"] >= TARGET_RATIO,
        )
    settings = {name: value for name, value in vars(options).items() if name != "out"}
    report.write({"panorama": [3, HEIGHT, WIDTH], "settings": settings, "results": results})


def _options() -> argparse.Namespace:
    arguments = parser(__doc__)
    arguments.add_argument("--images", type=int, default=1024, help="number of JPEG files to draw (default 1024)")
    arguments.add_argument("--batch", type=int, default=32, help="panoramas per batch (default 32)")
    arguments.add_argument("--batches", type=int, default=100, help="batches per measurement (default 100)")
    arguments.add_argument("--repeats", type=int, default=7, help="measurements to take the median of (default 7)")
    arguments.add_argument("--threads", type=int, default=1, help="threads of torch (default 1)")
    arguments.add_argument(
        "--sizes",
        nargs="+",
        type=_size,
        default=[(640, 480), (512, 128)],
        help="sizes of the JPEG files as COLUMNSxROWS (default 640x480 512x128)",
    )
    return arguments.parse_args()


def _size(text: str) -> tuple[int, int]:
    columns, _, rows = text.partition("x")
    return int(columns), int(rows)


def _measure(folder: Path, rows: int, columns: int, options: argparse.Namespace) -> dict[str, Any]:
    torch.set_num_threads(options.threads)
    paths = _draw(folder / f"{columns}x{rows}", options.images, rows, columns)
    frames = FrameTable(path=paths)
    start = time.perf_counter()
    library = PanoramaLibrary(frames, folder / "cache", image_size=(HEIGHT, WIDTH))
    build_s = time.perf_counter() - start
    rng = np.random.default_rng(0)
    wanted = rng.integers(0, len(library), (options.batches, options.batch))
    few = wanted[: max(1, options.batches // 20)]
    loaders = {
        "PIL, file by file": (few, lambda batch: _decoded_by_pil(paths, batch)),
        "library": (wanted, library.batch),
        "library, torch uint8": (wanted, lambda batch: torch.from_numpy(library.batch(batch))),
        "library, torch float in [0, 1]": (
            wanted,
            lambda batch: torch.from_numpy(library.batch(batch)).float().div_(255),
        ),
    }
    works = {name: partial(_load_all, load, batches) for name, (batches, load) in loaders.items()}
    times = seconds(works, options.repeats)
    rates = {name: [loaders[name][0].size / value for value in values] for name, values in times.items()}
    reference = statistics.median(rates["PIL, file by file"])
    return {
        "jpeg_size": f"{columns}x{rows}",
        "build_panoramas_per_s": len(library) / build_s,
        "loaders": {
            name: {
                "panoramas_per_s": statistics.median(values),
                "slowest": min(values),
                "fastest": max(values),
                "times_pil": statistics.median(values) / reference,
            }
            for name, values in rates.items()
        },
    }


def _draw(folder: Path, count: int, rows: int, columns: int) -> list[str]:
    """Draw images as smooth as an indoor scene, so that decoding takes as long as for real ones."""
    folder.mkdir()
    rng = np.random.default_rng(1)
    paths = [str(folder / f"{number:06}.jpeg") for number in range(count)]
    for path in paths:
        coarse = rng.integers(0, 256, (rows // 16, columns // 16, 3), dtype=np.uint8)
        image = cv2.resize(coarse, (columns, rows), interpolation=cv2.INTER_CUBIC)
        noise = rng.normal(0, 4, image.shape)
        cv2.imwrite(path, np.clip(image + noise, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 90])
    return paths


def _decoded_by_pil(paths: list[str], rows: np.ndarray) -> np.ndarray:
    items = []
    for row in rows:
        with Image.open(paths[row]) as image:
            small = image.convert("RGB").resize((WIDTH, HEIGHT), Image.Resampling.BILINEAR)
        items.append(np.asarray(small).transpose(2, 0, 1))
    return np.stack(items)


def _load_all(load: Callable[[np.ndarray], object], batches: np.ndarray) -> None:
    for batch in batches:
        load(batch)


def _print(result: dict[str, Any], options: argparse.Namespace) -> None:
    print(f"\nJPEG {result['jpeg_size']} -> 3 x {HEIGHT} x {WIDTH}, batches of {options.batch}")
    print(f"building the library: {result['build_panoramas_per_s']:,.0f} panoramas/s")
    print(f"{'loader':<30} {'panoramas/s':>12} {'slowest':>10} {'fastest':>10} {'x PIL':>8}")
    for name, figures in result["loaders"].items():
        numbers = [figures[key] for key in ("panoramas_per_s", "slowest", "fastest")]
        print(f"{name:<30} {numbers[0]:>12,.0f} {numbers[1]:>10,.0f} {numbers[2]:>10,.0f} {figures['times_pil']:>8.1f}")


if __name__ == "__main__":
    main()
