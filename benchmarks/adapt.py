"""Adapt the shipped network to one drive of a building without labels, and locate other drives in sparse maps.

The recipe is `siamloc.training.recipe("adapt")`, which learns from the order of the frames of the map's drive. The maps
have a frame of this drive every so many metres, several with other first frames; and all its frames. The queries are
drives under other lights. The figures are mean errors in m over the floor, the distance to the nearest map frame.
Several seeds show the spread.

Targets for the mean over the seeds: in each map at least 4 m sparse the error falls to half or less, and with all
frames it grows by at most 0.03 m.

    python -m benchmarks.adapt --data house/manifest.csv
    python -m benchmarks.adapt --data random_301 --keep
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import siamloc
from benchmarks.building import mean_and_range, opened
from benchmarks.report import Report, hardware, parser
from siamloc.data import FrameTable, PanoramaLibrary

RECIPE = siamloc.training.recipe("adapt")
MAP = "*seq2_cloudy3"
QUERIES = ("*seq2_cloudy1", "*seq2_night1", "*seq2_sunny1")
SPACINGS = (0, 4, 8, 12)
"""Metres between map frames; 0 for all frames."""
STARTS = 4
MOST_SHARE, MOST_DENSE = 0.5, 0.03


def main() -> None:
    """Adapt, locate, print a table and write the file."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--data", type=Path, required=True, help="manifest, or folder of a rendered building")
    arguments.add_argument("--seeds", type=int, default=3)
    options = arguments.parse_args()
    report = Report("adapt", options.out)
    name, frames = opened(options.data)
    images = PanoramaLibrary(frames.select(sequence=[MAP, *QUERIES]), image_size=RECIPE.image_size)
    drive, asked = images.frames.select(sequence=MAP), images.frames.select(sequence=QUERIES)
    before = located(siamloc.models.pretrained(), images, drive, asked)
    print(f"{name}, before: {before}", flush=True)
    after = [adapted(images, drive, asked, seed) for seed in range(options.seeds)]
    rows = {name: {"before": before, "after": after}}
    judge(report, rows)
    rows = report.kept(rows) if options.keep else rows
    print(f"{options.seeds} seeds: mean (lowest to highest); {hardware()['cpu']}\n\n{table(rows)}")
    report.write({"seeds": options.seeds, "rows": rows})


def adapted(images: PanoramaLibrary, drive: FrameTable, asked: FrameTable, seed: int) -> dict[str, Any]:
    """Adapt the network to a drive without its labels; return the errors afterwards and the seconds it took."""
    order = FrameTable(path=drive.path, sequence=drive.sequence)
    begin, network = time.monotonic(), RECIPE.build(seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        RECIPE.fit(network, images, order, run=Path(folder) / "run", seed=seed)
    seconds = time.monotonic() - begin
    found = {**located(network, images, drive, asked), "seconds": seconds}
    print(f"seed {seed}: {found}", flush=True)
    return found


def located(network: Any, images: PanoramaLibrary, drive: FrameTable, asked: FrameTable) -> dict[str, float]:
    """Return the mean error over the floor by the spacing of the map, in m."""
    known, queries = (siamloc.maps.build(network, images, frames, progress=False) for frames in (drive, asked))
    described = queries.turning()
    apart = np.hypot(*(asked.xy[:, None] - drive.xy).transpose(2, 0, 1))
    found = {}
    for metres in SPACINGS:
        excess = []
        for start in range(STARTS if metres else 1):
            first = start * len(drive) // (10 * STARTS)
            part = drive.take(slice(first, None))
            rows = np.flatnonzero(np.isin(drive.path, (part.spaced(metres) if metres else part).path))
            match = siamloc.maps.match(known, described, 1, within=rows).indices[:, 0]
            excess.append(apart[np.arange(len(asked)), match] - apart[:, rows].min(axis=1))
        found[str(metres)] = float(np.mean(excess))
    return found


def judge(report: Report, rows: dict[str, dict[str, Any]]) -> None:
    """Compare the means over the seeds with the targets."""
    for name, row in rows.items():
        for metres in map(str, SPACINGS):
            before, after = row["before"][metres], statistics.mean(one[metres] for one in row["after"])
            if metres == "0":
                text = f"{name}, all frames: at most {MOST_DENSE} m more ({before:.3f}, then {after:.3f})"
                report.target(text, after <= before + MOST_DENSE)
            else:
                text = f"{name}, every {metres} m: at most {MOST_SHARE} of before ({before:.2f}, then {after:.2f})"
                report.target(text, after <= MOST_SHARE * before)


def table(rows: dict[str, dict[str, Any]]) -> str:
    """Return a table with a line for each building and network."""
    lines = [f"| error over the floor [m] | all frames | {' | '.join(f'{one} m' for one in SPACINGS[1:])} |"]
    lines.append("|---" * (len(SPACINGS) + 1) + "|")
    for name, row in rows.items():
        for what, found in (("shipped", [row["before"]]), ("adapted", row["after"])):
            cells = [mean_and_range([one[str(metres)] for one in found], 3) for metres in SPACINGS]
            lines.append(f"| {name}, {what} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
