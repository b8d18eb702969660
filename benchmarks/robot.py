"""What the robot's side costs: the start, an image, and memory, with a map of 2,778 frames.

The networks have random weights, which cost what trained ones do. An image of 640 x 480 pixels is unwrapped, described
and looked for; reading it from a file is not counted. "beside" is all of that but onnxruntime's own run. A start is a
fresh process, from its begin to the first answer, with the files in the system's cache; its memory is the most that it
held, less what Python holds with the same packages and no bundle.

    python -m benchmarks.robot
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import siamloc
from benchmarks.report import Report, parser
from siamloc.data.decoding import Preprocessing
from siamloc.data.frames import FrameTable
from siamloc.maps import VisualMap

FRAMES, SIZE, IMAGE = 2778, (128, 512), (480, 640, 3)
NETWORKS = {
    "panoresnet, fourier": ("panoresnet", "fourier", True),
    "alexnet, 500-500-5": ("alexnet", "fc500_500_5", False),
    "vgg16, 500-500-5": ("vgg16", "fc500_500_5", False),
}
_START = r"""
import re, sys
from pathlib import Path
import numpy as np, cv2, onnxruntime
from siamloc.runtime import Localizer
from siamloc.runtime.stream import locate_all
def most():
    return int(re.search(r"VmHWM:\s+(\d+)", Path("/proc/self/status").read_text())[1])
held = most()
localizer = Localizer(sys.argv[1], threads=1)
localizer.locate(np.load(sys.argv[2]))
print(most() - held)
"""


def measured(name: str, folder: Path, repeats: int) -> dict[str, Any]:
    """Export a network with a map, and measure the bundle."""
    branch, head, circular = NETWORKS[name]
    network = siamloc.models.as_descriptor(siamloc.models.build(branch, head, SIZE, circular=circular))
    images = Preprocessing.checked(SIZE, {"kind": "polar", "inner": 50})
    generator = np.random.default_rng(0)
    width = network.describe(np.zeros((1, 3, *SIZE), dtype=np.uint8)).position.shape[1]
    frames = FrameTable(
        path=[f"{row:05}.jpeg" for row in range(FRAMES)], x=generator.uniform(0, 40, FRAMES), y=np.zeros(FRAMES)
    )
    known = VisualMap(
        generator.normal(size=(FRAMES, width)), frames, {**network.identity, "images": images.parameters()}
    )
    bundle = siamloc.runtime.export(network, known, folder / "bundle").path
    size = sum(file.stat().st_size for file in bundle.iterdir())
    image = generator.integers(0, 256, IMAGE, dtype=np.uint8)
    np.save(folder / "image.npy", image)
    starts, memory = [], []
    for _ in range(max(3, repeats // 20)):
        begin = time.perf_counter()
        command = [sys.executable, "-c", _START, str(bundle), str(folder / "image.npy")]
        memory.append(1024 * int(subprocess.run(command, capture_output=True, text=True, check=True).stdout))
        starts.append(time.perf_counter() - begin)
    localizer = siamloc.runtime.Localizer(bundle, threads=1)
    session, inside = localizer._session, list[float]()

    class Timed:
        def run(self, *arguments: Any) -> Any:
            begin = time.perf_counter()
            found = session.run(*arguments)
            inside.append(time.perf_counter() - begin)
            return found

    localizer._session = Timed()
    whole = []
    for _ in range(repeats + 5):
        begin = time.perf_counter()
        localizer.locate(image)
        whole.append(time.perf_counter() - begin)
    beside = [1000 * (all_ - run) for all_, run in zip(whole[5:], inside[5:], strict=True)]
    return {
        "bundle_mb": size / 1e6,
        "descriptor": width,
        "ms": 1000 * statistics.median(whole[5:]),
        "beside_ms": statistics.median(beside),
        "start_seconds": statistics.median(starts),
        "memory_mb": statistics.median(memory) / 1e6,
        "memory_over_bundle": statistics.median(memory) / size,
    }


def main() -> None:
    """Measure each network, print a row of it, and write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--repeats", type=int, default=60)
    options = arguments.parse_args()
    report, rows = Report("robot", options.out, ["onnxruntime"]), dict[str, Any]()
    for name in NETWORKS:
        with tempfile.TemporaryDirectory() as folder:
            rows[name] = measured(name, Path(folder), options.repeats)
        print(name, json.dumps({key: round(value, 3) for key, value in rows[name].items()}), flush=True)
    for name, row in rows.items():
        report.target(f"{name}: at most 3 ms beside onnxruntime's run ({row['beside_ms']:.2f})", row["beside_ms"] <= 3)
        report.target(
            f"{name}: memory under 3 bundles ({row['memory_over_bundle']:.2f})", row["memory_over_bundle"] < 3
        )
    start = rows["alexnet, 500-500-5"]["start_seconds"]
    report.target(f"alexnet: first answer in less than 1 s ({start:.2f})", start < 1)
    report.write({"frames": FRAMES, "rows": rows})


if __name__ == "__main__":
    main()
