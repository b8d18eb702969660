"""Measure what localization costs on the robot, and the effect of lower precision: start, image, memory, size, error.

The first table: a map of 2,778 frames, panoramas of 128 x 512 pixels, networks with random weights, which cost as much
as trained ones. An image of 640 x 480 pixels is unwrapped, described and searched for; reading it from a file is not
counted. "beside" is all of that except onnxruntime's own run. A start is a fresh process, from its beginning to the
first answer, with the files in the system's cache. Its memory is the most that it held, and what it holds after some
images, less what Python holds with the same packages and no bundle; scipy and torch, which a robot does not need, are
hidden from it. Part of it is pages of the packages' own files, mostly onnxruntime's code, which are read when they are
first needed: the system holds them once for all processes, and drops them when memory is short. The rest is the
bundle's own, and is compared with the bundle's size. Times are for one thread. "smallest" is a network of 60 kB with
two map frames: any bundle takes at least as much.

The second table, with --data: bundles of a cloudy drive in each precision, queried with another cloudy drive, one at
night and one in the sun. `pretrained` ships with siamloc; `alexnet` and `vgg16`, with the head `gem`, are trained on a
third cloudy drive with the recipe `modern`, for a few minutes; `hog` and `wisurf` learn nothing.

    siamloc simulate camera=panorama spacing=0.3 runs=[cloudy1,cloudy2,cloudy3,night1,sunny1] out=data
    python -m benchmarks.robot --data data/freiburg_like
"""

from __future__ import annotations

import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import analytic
import siamloc
from benchmarks.report import Report, parser
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.maps.packing import PRECISIONS
from siamloc.runtime import Bundle, Localizer, export

FRAMES, SIZE, IMAGE = 2778, (128, 512), (480, 640, 3)
NETWORKS = {
    "panoresnet": ("panoresnet", "fourier", True),
    "alexnet": ("alexnet", "fc500_500_5", False),
    "vgg16": ("vgg16", "fc500_500_5", False),
}
SMALLEST = "smallest"
ANALYTIC = ("hog", "wisurf")
TRAINED: dict[str, dict[str, Any]] = {
    "alexnet": {"epochs": 3},
    "vgg16": {"epochs": 1, "pairs": {"epoch_batches": 40}},
}
"""How long the networks of the second table are trained."""
_START = r"""
import re, sys, time
from pathlib import Path
sys.modules.update(dict.fromkeys(["scipy", "torch"]))  # what a robot lacks must not be loaded, even if it is installed
import numpy as np, cv2, onnxruntime
from siamloc.runtime import Localizer
from siamloc.runtime.stream import locate_all
def held(what):
    return 1024 * int(re.search(what + r":\s+(\d+)", Path("/proc/self/status").read_text())[1])
image, most, now, own = np.load(sys.argv[2]), held("VmHWM"), held("VmRSS"), held("RssAnon")
localizer = Localizer(sys.argv[1], threads=1)
localizer.locate(image)
seconds = time.time() - float(sys.argv[3])
for _ in range(4):
    localizer.locate(image)
print(seconds, held("VmHWM") - most, held("VmRSS") - now, own)
"""
_OWN = re.compile(r"RssAnon:\s+(\d+)")


def drive(folder: Path) -> PanoramaLibrary:
    """Return as many images as the map has frames, a few files under many names."""
    generator = np.random.default_rng(0)
    names = [f"t{row:04}.000000_x{row * 0.01:.6f}_y0.000000_a0.000000.jpeg" for row in range(FRAMES)]
    (folder / "pictures").mkdir()
    for row, name in enumerate(names):
        path = folder / "pictures" / name
        if row < 16:
            small = generator.integers(0, 256, (12, 16, 3), dtype=np.uint8)
            cv2.imwrite(str(path), cv2.resize(small, IMAGE[1::-1], interpolation=cv2.INTER_CUBIC))
        else:
            os.link(folder / "pictures" / names[row % 16], path)
    frames = FrameTable(
        path=[str(folder / "pictures" / name) for name in names], x=np.arange(FRAMES) * 0.01, y=np.zeros(FRAMES)
    )
    return PanoramaLibrary(frames, folder / "cache", image_size=SIZE, unwrap={"kind": "polar", "inner": 50})


def fresh_start(bundle: Bundle, image: Path) -> tuple[float, float, float, float]:
    """Return the seconds to the first answer, the peak memory, the memory held later, and the peak of the bundle's own.

    The last is read from here, about a thousand times a second: a peak of less than a millisecond may be missed, and
    one while packages are loaded counts too.
    """
    command = [sys.executable, "-c", _START, str(bundle.path), str(image), str(time.time())]
    most = 0
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        status = Path(f"/proc/{process.pid}/status")
        while process.poll() is None:
            found = _OWN.search(status.read_text())
            most = max(most, 1024 * int(found[1]) if found else 0)
            time.sleep(0.001)
        assert process.stdout is not None
        said = process.stdout.read()
    if process.returncode:
        raise RuntimeError(f"a start of {bundle.path} failed")
    seconds, memory, held, before = map(float, said.split())
    return seconds, memory, held, most - before


def starts(bundle: Bundle, image: Path, repeats: int) -> tuple[float, dict[str, float]]:
    """Return the median seconds to the first answer over several fresh starts, and the sizes of bundle and memory."""
    measured = [fresh_start(bundle, image) for _ in range(repeats)]
    seconds, memory, held, own = (statistics.median(values) for values in zip(*measured, strict=True))
    return seconds, {
        "bundle_mb": bundle.bytes / 1e6,
        "memory_mb": memory / 1e6,
        "held_mb": held / 1e6,
        "own_mb": own / 1e6,
        "own_over_bundle": own / bundle.bytes,
    }


def costs(bundle: Bundle, image: Path, repeats: int, former: dict[str, Any] | None) -> dict[str, Any]:
    """Measure a bundle with an image, but only its memory if former figures of its times are given.

    Images are timed in several rounds with a fresh start between them, so that a few slow seconds change no median.
    """
    rounds = max(3, repeats // 20)
    if former is not None:
        return {**former, **starts(bundle, image, rounds)[1]}
    localizer, pixels = Localizer(bundle.path, threads=1), np.load(image)
    network, inside = localizer._network, list[float]()
    session = network.session if network is not None else None

    class Timed:
        def run(self, *arguments: Any) -> Any:
            begin = time.perf_counter()
            found = session.run(*arguments)
            inside.append(time.perf_counter() - begin)
            return found

    if network is not None:
        network.session = Timed()
    measured, whole, runs = [], list[float](), list[float]()
    for _ in range(rounds):
        measured.append(starts(bundle, image, 1))
        for _ in range(5):  # to warm up
            localizer.locate(pixels)
        inside.clear()
        for _ in range(repeats // rounds):
            begin = time.perf_counter()
            localizer.locate(pixels)
            whole.append(time.perf_counter() - begin)
        runs += inside or [0.0] * (repeats // rounds)
    return {
        **{key: statistics.median(needs[key] for _, needs in measured) for key in measured[0][1]},
        "ms": 1000 * statistics.median(whole),
        "run_ms": 1000 * statistics.median(runs),
        "beside_ms": 1000 * statistics.median(all_ - run for all_, run in zip(whole, runs, strict=True)),
        "start_seconds": statistics.median(seconds for seconds, _ in measured),
    }


def first_table(repeats: int, former: dict[str, Any] | None) -> dict[str, Any]:
    """Return what each bundle with a large map costs, but measure only its memory if former rows are given."""
    rows, generator = dict[str, Any](), np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        images = drive(folder)
        np.save(folder / "image.npy", generator.integers(0, 256, IMAGE, dtype=np.uint8))
        by = network("simple1", "gem", False, SIZE)
        known = siamloc.maps.build(by, images, images.frames.take([0, 1]), progress=False)

        def measured(name: str, made: Bundle) -> None:
            times = None if former is None else former.get(name, {})
            rows[name] = costs(made, folder / "image.npy", repeats, times)
            print(name, json.dumps({key: round(value, 3) for key, value in rows[name].items()}), flush=True)

        measured(SMALLEST, export(by, known, folder / "bundle"))
        for name in (*NETWORKS, "hog"):
            by = analytic.descriptor(name) if name in ANALYTIC else network(*NETWORKS[name], SIZE)
            if name in ANALYTIC:
                known = siamloc.maps.build(by, images, images.frames, progress=False)
            else:  # any descriptors will do
                width = by.describe(np.zeros((1, 3, *SIZE), dtype=np.uint8)).position.shape[1]
                identity = {**by.identity, "images": images.preprocessing.parameters()}
                known = siamloc.maps.VisualMap(generator.normal(size=(FRAMES, width)), images.frames, identity)
            for precision in PRECISIONS if name in ANALYTIC else ("float32", "int8"):  # networks are never in float16
                made = export(by, known, folder / "bundle", precision=precision, images=images)
                measured(f"{name}, {precision}", made)
            shutil.rmtree(folder / "bundle")
    return rows


def network(branch: str, head: str, circular: bool, size: tuple[int, int]) -> Any:
    """Return a network with random weights, as a descriptor."""
    return siamloc.models.as_descriptor(siamloc.models.build(branch, head, size, circular=circular))


def second_table(data: Path) -> dict[str, Any]:
    """Return the memory, times and errors of bundles with working networks, in each precision."""
    rows, recipe = dict[str, Any](), siamloc.training.recipe("modern")
    frames = siamloc.data.read("cold", root=data)
    drives = {
        name: frames.select(sequence=f"*{name}") for name in ("cloudy1", "cloudy2", "cloudy3", "night1", "sunny1")
    }
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        small, large = (
            PanoramaLibrary(frames, folder / f"cache{size[0]}", image_size=size) for size in (recipe.image_size, SIZE)
        )
        for name in ("pretrained", *TRAINED, *ANALYTIC):
            images = large if name in ANALYTIC else small
            if name in TRAINED:
                by = recipe.build(branch=name, head="gem", circular=False)
                recipe.fit(
                    by, images, drives["cloudy3"], validation=drives["cloudy1"], run=folder / name, **TRAINED[name]
                )
            else:
                by = siamloc.models.pretrained() if name == "pretrained" else analytic.descriptor(name)
            known = siamloc.maps.build(by, images, drives["cloudy1"], progress=False)
            refine = "relative" if name == "pretrained" else "none"
            learned = siamloc.evaluation.localization(
                known, images, drives["night1"], validation=drives["cloudy2"], refine=refine, error_model=True
            )
            for precision in PRECISIONS if name in ANALYTIC else ("float32", "int8"):
                bundle = export(
                    by,
                    known,
                    folder / "bundle",
                    precision=precision,
                    images=images,
                    errors=learned.error_model,
                    refinement=learned.refinement,
                )
                np.save(folder / "image.npy", next(iter(images.batches(drives["cloudy2"])))[0].transpose(1, 2, 0))
                row = {**starts(bundle, folder / "image.npy", 3)[1], **errors(bundle, images, drives)}
                rows[f"{name}, {precision}"] = row
                print(name, precision, json.dumps({key: round(value, 3) for key, value in row.items()}), flush=True)
            shutil.rmtree(folder / "bundle")
    return rows


def errors(bundle: Bundle, images: PanoramaLibrary, drives: dict[str, FrameTable]) -> dict[str, Any]:
    """Return the mean error under each lighting, and the median time for an image."""
    localizer, times, row = Localizer(bundle.path, threads=1), list[float](), dict[str, Any]()
    for light in ("cloudy2", "night1", "sunny1"):
        frames = images.readable(drives[light])
        found = [localizer.locate_panorama(one) for batch in images.batches(frames) for one in batch]
        times += [one.ms for one in found]
        apart = np.array([[one.x, one.y] for one in found]) - frames.xy
        row[light] = float(np.hypot(*apart.T).mean())
    return {"ms": statistics.median(times), **row}


def main() -> None:
    """Measure each bundle, print its row, and write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--repeats", type=int, default=100)
    arguments.add_argument("--data", type=Path, help="folder of a rendered building")
    arguments.add_argument("--memory", action="store_true", help="measure only memory, and keep the file's times")
    arguments.add_argument("--errors", action="store_true", help="make only the second table, and keep the first")
    options = arguments.parse_args()
    if options.errors and not options.data:
        arguments.error("the second table is made from a rendered building: give --data")
    report = Report("robot", options.out, ["onnxruntime"])
    former = report.former("rows") if options.memory or options.errors else None
    rows = former if former is not None and options.errors else first_table(options.repeats, former)
    for name, row in rows.items():
        if row.get("run_ms"):
            beside = row["beside_ms"]
            report.target(f"{name}: at most 3 ms beside onnxruntime's run ({beside:.2f})", beside <= 3)
        if name.endswith("float32"):
            share, whole = row["own_over_bundle"], row["memory_mb"] / row["bundle_mb"]
            said = f"({share:.2f}; {whole:.2f} with pages of the packages' files)"
            report.target(f"{name}: own memory under 3 bundles {said}", share < 3)
    start = rows["alexnet, float32"]["start_seconds"]
    report.target(f"alexnet: first answer in less than 1 s ({start:.2f})", start < 1)
    faster = rows["vgg16, float32"]["run_ms"] / rows["vgg16, int8"]["run_ms"]
    report.target(f"vgg16: int8 at least 1.5 times as fast as float32 ({faster:.2f})", faster >= 1.5)
    errors_of = second_table(options.data) if options.data else report.former("errors")
    for name, row in errors_of.items():
        if name.endswith("float32") and "own_over_bundle" in row:
            share = row["own_over_bundle"]
            report.target(f"{name}, second table: own memory under 3 bundles ({share:.2f})", share < 3)
    report.write({"frames": FRAMES, "rows": rows, "errors": errors_of})


if __name__ == "__main__":
    main()
