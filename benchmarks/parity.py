"""Check that each branch with each head gives the same results on the robot as in torch.

Networks with random weights describe a map of 48 panoramas and 24 others, in torch and, with the bundle, in
onnxruntime. "apart" is the largest distance between the two descriptors of an image, divided by the length of torch's.
Targets: at most 1e-4, and the same nearest map frame for each image.

    siamloc simulate building=mini camera=panorama runs=[cloudy1,night1] spacing=0.3 out=data
    python -m benchmarks.parity --data data/mini
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import siamloc
from benchmarks.report import Report, parser
from siamloc.data import PanoramaLibrary
from siamloc.models import BRANCHES, HEADS
from siamloc.runtime import Localizer, export
from siamloc.runtime.exporting import TOLERANCE

SIZE, KNOWN, ASKED = (64, 256), 48, 24
WRAPPED = ("fourier", "magnitudes")


def measured(branch: str, head: str, images: PanoramaLibrary, drives: list[Any]) -> dict[str, Any]:
    """Export a network, and compare the results of both."""
    module = siamloc.models.build(branch, head, SIZE, circular=head in WRAPPED)
    network = siamloc.models.as_descriptor(module)
    known = siamloc.maps.build(network, images, drives[0], progress=False)
    panoramas = np.concatenate(list(images.batches(drives[1])))
    expected = network.describe(panoramas).position
    with tempfile.TemporaryDirectory() as folder:
        localizer = Localizer(export(network, known, folder).path, top=1)
        found = localizer.describe(panoramas).position
        nearest = [localizer.locate_panorama(panorama).candidates[0].row for panorama in panoramas]
    apart = np.linalg.norm(found - expected, axis=1) / np.linalg.norm(expected, axis=1)
    same = np.array(nearest) == known.search(expected).indices[:, 0]
    return {"apart": float(apart.max()), "same": int(same.sum()), "asked": len(panoramas)}


def main() -> None:
    """Compare every pair of branch and head, print a row for each branch, and write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="folder of a rendered building")
    arguments.add_argument("--branches", nargs="+", default=list(BRANCHES), choices=list(BRANCHES))
    options = arguments.parse_args()
    report, rows = Report("parity", options.out, ["onnxruntime"]), dict[str, Any]()
    frames = siamloc.data.read("cold", root=options.data)
    images = PanoramaLibrary(frames, image_size=SIZE)
    drives = [
        frames.select(sequence=f"*{name}").take(np.linspace(0, 99, count).astype(int))
        for name, count in (("cloudy1", KNOWN), ("night1", ASKED))
    ]
    for branch in options.branches:
        rows[branch] = {head: measured(branch, head, images, drives) for head in HEADS}
        print(branch, {head: f"{row['apart']:.0e}" for head, row in rows[branch].items()}, flush=True)
    every = [row for heads in rows.values() for row in heads.values()]
    most = max(row["apart"] for row in every)
    report.target(f"{len(every)} networks: at most {TOLERANCE:g} of the length apart ({most:.1e})", most <= TOLERANCE)
    same, asked = (sum(row[key] for row in every) for key in ("same", "asked"))
    report.target(f"the same nearest frame ({same} of {asked})", same == asked)
    report.write({"image_size": SIZE, "rows": rows})


if __name__ == "__main__":
    main()
