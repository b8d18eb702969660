"""Find ring and direction of mirrors that are drawn at random, in the pictures of drives through simulated buildings.

Mirrors differ in centre, radii, shape and size of the picture; cameras in noise, blur, exposure and JPEG quality;
struts, cables and the robot's deck hide parts; a quarter of the cameras shakes against its mirror; a third of the
drives is at night. Refused drives are counted and listed with their reasons. With the ring that was found, the shipped
network says where the front is and which way columns turn: with the poses of the drive, and where the front is without.

Targets: the centre within 1 px and both radii within 2 px in all drives that are not refused, and few refused; what is
said of the direction right in all drives of 3 m or more: the front within 15 degrees, and the way that columns turn.

    python -m benchmarks.rings --data data/rings
"""

from __future__ import annotations

import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

import siamloc
from analytic import Descriptor
from benchmarks.report import Report, parser
from benchmarks.ring_drives import LIGHTINGS, Mirror, clips, draw_mirror, draw_pictures
from siamloc.data import FrameTable, PanoramaView, PolarRing, find_centres, find_ring, unwrap
from siamloc.data.mounting import estimate, resized, usual_rows
from siamloc.errors import DataError

CENTRE, RADIUS, REFUSED = 1.0, 2.0, 0.02  # px, px, share of the drives
FRONT, LONG = 15.0, 3.0  # degrees; m from which a drive counts
_CLIPS = 36
_FEWEST = 6  # pictures of a drive


def main() -> None:
    """Find the rings, print what was missed, and write the file."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="folder of the panoramas, rendered where missing")
    arguments.add_argument("--drives", type=int, default=500)
    arguments.add_argument("--first", type=int, default=0, help="number of the first drive")
    arguments.add_argument("--workers", type=int, default=2)
    options = arguments.parse_args()
    report = Report("rings", options.out)
    clips(_CLIPS, options.data)
    with ProcessPoolExecutor(options.workers) as workers:
        drives = []
        numbers = range(options.first, options.first + options.drives)
        for drive in workers.map(partial(measured, folder=options.data), numbers):
            drives.append(drive)
            if drive["refused"] or missed(drive) or turned(drive):
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
    directions = _directions(found)
    print(directions)
    report.target(f"what is said of the direction right from {LONG:g} m on", not any(map(turned, found)))
    about = {"first": options.first, "drives": len(drives), "found": len(found), "refused": dict(refused)}
    listed = [drive for drive in drives if drive["refused"] or missed(drive) or turned(drive)]
    report.write({"rows": rows, **about, "wrong": wrong, "direction": directions, "missed": listed})


def turned(drive: dict[str, Any]) -> bool:
    """Whether what is said of the direction of a long drive is wrong."""
    if drive["refused"] or drive["metres"] < LONG:
        return False
    return max(abs(drive["front"]), abs(drive["front_unposed"])) > FRONT or drive["columns"] is False


def _directions(found: list[dict[str, Any]]) -> dict[str, Any]:
    """Return how often, and how well, the direction of long drives is known."""
    long = [drive for drive in found if drive["metres"] >= LONG]
    rows: dict[str, Any] = {"drives": len(long)}
    for name in ("front", "front_unposed"):
        off = np.abs([drive[name] for drive in long if np.isfinite(drive[name])])
        about = {"median": float(np.median(off)), "p95": float(np.percentile(off, 95)), "max": float(off.max())}
        rows[name] = {"known": len(off), **about, "right": int((off <= FRONT).sum())}
    said = [drive["columns"] for drive in long if drive["columns"] is not None]
    return {**rows, "columns": {"known": len(said), "right": sum(said)}}


def missed(drive: dict[str, Any]) -> bool:
    """Whether a ring that was found is farther off than the targets allow."""
    if drive["refused"]:
        return False
    return drive["centre"] > CENTRE or max(abs(drive["inner"]), abs(drive["outer"])) > RADIUS


def measured(number: int, folder: Path) -> dict[str, Any]:
    """Draw a drive, and return the errors of its ring in px, or why it was refused."""
    rng = np.random.default_rng([3, number])
    clip_number = int(rng.integers(_CLIPS))
    clip = clips(_CLIPS, folder, only=clip_number)[0]
    panoramas = clip.panoramas
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
    poses = clip.poses[rows]
    each = np.hypot(*(find_centres(pictures, ring) - centres).T)
    return {
        **drive,
        "centre": float(np.hypot(*(centre - centres.mean(axis=0)))),
        "inner": inner - mirror.inner,
        "outer": outer - mirror.outer,
        "each_centre": float(np.nanmax(each)) if np.isfinite(each).any() else 0.0,
        "seconds": seconds,
        "metres": float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()),
        **_direction(pictures, poses, ring, mirror),
    }


def _direction(pictures: Any, poses: Any, ring: PolarRing, mirror: Mirror) -> dict[str, Any]:
    """Return by how many degrees the front is off, with poses and without, NaN where unknown; and whether the way that
    columns turn is right, None where unknown."""
    by = _network()
    panoramas = np.stack([unwrap(picture, ring)[..., ::-1] for picture in pictures])
    usual = usual_rows(panoramas.transpose(0, 3, 1, 2), PanoramaView())
    parts = by.describe(resized(usual, by.module.image_size)).orientation
    x, y, theta = poses.T
    frames = FrameTable(path=[str(number) for number in range(len(poses))], x=x, y=y, theta=theta)
    posed, unposed = (estimate(frames, parts, by.compare, known) for known in (True, False))
    off = [
        (found.ring(ring).forward - mirror.forward + 180) % 360 - 180 if np.isfinite(found.yaw) else np.nan
        for found in (posed, unposed)
    ]
    columns = None if posed.mirrored is None else posed.ring(ring).mirrored == mirror.mirrored
    return {"front": off[0], "front_unposed": off[1], "columns": columns}


@cache
def _network() -> Descriptor:
    return siamloc.models.as_descriptor(siamloc.models.pretrained(), "cpu")


if __name__ == "__main__":
    main()
