"""Find the ring of mirrors that are drawn at random, in the pictures of drives through simulated buildings.

Mirrors differ in centre, radii, shape and size of the picture; cameras in noise, blur, exposure and JPEG quality;
struts, cables and the robot's deck hide parts; a quarter of the cameras shakes against its mirror; a third of the
drives is at night. Refused drives are counted and listed with their reasons.

Targets: the centre within 1 px and both radii within 2 px in all drives that are not refused, and few refused.

    python -m benchmarks.rings --data data/rings
"""

from __future__ import annotations

import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.report import Report, parser
from benchmarks.ring_drives import LIGHTINGS, clips, draw_mirror, draw_pictures
from siamloc.data import find_centres, find_ring
from siamloc.errors import DataError

CENTRE, RADIUS, REFUSED = 1.0, 2.0, 0.02  # px, px, share of the drives
_CLIPS = 36
_FEWEST = 6  # pictures of a drive


def main() -> None:
    """Find the rings, print what was missed, and write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="folder of the panoramas, rendered where missing")
    arguments.add_argument("--drives", type=int, default=500)
    arguments.add_argument("--workers", type=int, default=2)
    options = arguments.parse_args()
    report = Report("rings", options.out)
    clips(_CLIPS, options.data)
    with ProcessPoolExecutor(options.workers) as workers:
        drives = []
        for drive in workers.map(partial(measured, folder=options.data), range(options.drives), chunksize=4):
            drives.append(drive)
            if drive["refused"] or missed(drive):
                print(drive, flush=True)
    found = [drive for drive in drives if not drive["refused"]]
    refused = Counter(drive["refused"] for drive in drives if drive["refused"])
    wrong = [drive["number"] for drive in found if missed(drive)]
    rows = {
        name: {
            "median": float(np.median([abs(drive[name]) for drive in found])),
            "p95": float(np.percentile([abs(drive[name]) for drive in found], 95)),
            "max": max(abs(drive[name]) for drive in found),
        }
        for name in ("centre", "inner", "outer", "each_centre", "seconds")
    }
    for name, row in rows.items():
        print(f"{name:12} median {row['median']:.2f}, 95 % {row['p95']:.2f}, most {row['max']:.2f}")
    print(f"{len(found)} of {len(drives)} found, refused: {dict(refused)}")
    report.target(f"centre within {CENTRE:g} px and radii within {RADIUS:g} px in all that are found", not wrong)
    few = refused.total() <= REFUSED * len(drives)
    report.target(f"no more than {REFUSED:.0%} refused ({refused.total()})", few)
    about = {"drives": len(drives), "found": len(found), "refused": dict(refused), "wrong": wrong}
    report.write({"rows": rows, **about, "missed": [drive for drive in drives if drive["refused"] or missed(drive)]})


def missed(drive: dict[str, Any]) -> bool:
    """Whether a ring that was found is farther off than the targets allow."""
    if drive["refused"]:
        return False
    return drive["centre"] > CENTRE or max(abs(drive["inner"]), abs(drive["outer"])) > RADIUS


def measured(number: int, folder: Path) -> dict[str, Any]:
    """Draw a drive, and return the errors of its ring in px, or why it was refused."""
    rng = np.random.default_rng([3, number])
    clip_number = int(rng.integers(_CLIPS))
    panoramas = clips(_CLIPS, folder, only=clip_number)[0].panoramas
    mirror = draw_mirror(rng)
    count = int(rng.integers(_FEWEST, len(panoramas) + 1))
    rows = np.linspace(0, len(panoramas) - 1, count).round().astype(int)
    pictures, centres, about = draw_pictures(rng, panoramas[rows], mirror)
    drive = {"number": number, "pictures": count, "light": LIGHTINGS[clip_number % 3], **about, "refused": ""}
    start = time.perf_counter()
    try:
        ring = find_ring(pictures).ring
    except DataError as error:
        return {**drive, "refused": str(error).partition(":")[0]}
    seconds = time.perf_counter() - start
    centre, inner, outer = np.array(ring.centre), float(ring.inner or 0), float(ring.outer or 0)
    each = np.hypot(*(find_centres(pictures, ring) - centres).T)
    return {
        **drive,
        "centre": float(np.hypot(*(centre - centres.mean(axis=0)))),
        "inner": inner - mirror.inner,
        "outer": outer - mirror.outer,
        "each_centre": float(np.nanmax(each)) if np.isfinite(each).any() else 0.0,
        "seconds": seconds,
    }


if __name__ == "__main__":
    main()
