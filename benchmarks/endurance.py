"""Check that a long drive does not increase the robot's memory.

A drive through the simulated building is repeated at full speed, for as many images as a camera with five a second
takes in eight hours. It is played through the live page, with a browser that listens and the robot followed from image
to image. The memory is read 100 times.

    siamloc simulate building=mini camera=panorama runs=[cloudy1,cloudy2,night1] spacing=0.3 out=data
    python -m benchmarks.endurance --data data/mini
"""

from __future__ import annotations

import http.client
import math
import re
import tempfile
import threading
import time
from pathlib import Path

import siamloc
from benchmarks.report import Report, parser
from siamloc.data import PanoramaLibrary
from siamloc.models.registry import PRETRAINED_SIZE
from siamloc.runtime import Live, Localizer, export

HOURS, FPS, LOOKS = 8, 5, 100
GROWTH = 0.02
"""Largest allowed share by which the second half of the drive needs more memory than the second quarter."""


def held() -> float:
    """Return the memory that this process holds, in MB."""
    found = re.search(r"VmRSS:\s+(\d+)", Path("/proc/self/status").read_text())
    assert found is not None
    return int(found[1]) / 1024


def listen(port: int) -> None:
    """Read the events that a browser would receive, until they end."""
    connection = http.client.HTTPConnection("127.0.0.1", port)
    connection.request("GET", "/events")
    answer = connection.getresponse()
    while answer.read1(1 << 16):
        pass


def main() -> None:
    """Play the drive, print the memory, and write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="folder of a rendered building")
    arguments.add_argument("--hours", type=float, default=HOURS)
    options = arguments.parse_args()
    report = Report("endurance", options.out, ["onnxruntime", "aiohttp"])
    frames = siamloc.data.read("cold", root=options.data)
    known, validation, asked = (frames.select(sequence=f"*{name}") for name in ("cloudy1", "cloudy2", "night1"))
    network, wanted = siamloc.models.pretrained(), round(options.hours * 3600 * FPS)
    with tempfile.TemporaryDirectory() as folder:
        images = PanoramaLibrary(frames, Path(folder) / "cache", image_size=PRETRAINED_SIZE)
        here = siamloc.maps.build(network, images, known, progress=False)
        result = siamloc.evaluation.localization(
            here, images, asked, validation=validation, refine="relative", error_model=True
        )
        learned = {"errors": result.error_model, "refinement": result.refinement}
        bundle = export(network, here, Path(folder) / "bundle", images=images, thumbnails=True, **learned)
        drive = [str(path) for path in asked.path.tolist()] * math.ceil(wanted / len(asked))
        memory, begin = list[float](), time.monotonic()
        with Live(Localizer(bundle.path, threads=1), drive[:wanted], track=True, port=0, fps=0) as page:
            threading.Thread(target=listen, args=(page.port,), daemon=True).start()
            while not page.join(0.05):
                if page.count * LOOKS >= len(memory) * wanted and page.count:
                    memory.append(held())
            seconds = time.monotonic() - begin
    half = len(memory) // 2
    early, late = (max(part) for part in (memory[half // 2 : half], memory[half:]))
    print(f"{wanted} images in {seconds:.0f} s; memory {memory[0]:.0f}, {early:.0f}, {late:.0f} MB")
    report.target(
        f"{options.hours:g} hours of drive: memory grows by at most {GROWTH:.0%} ({early:.1f} to {late:.1f} MB)",
        late <= (1 + GROWTH) * early,
    )
    report.write({"images": wanted, "seconds": seconds, "memory_mb": memory})


if __name__ == "__main__":
    main()
