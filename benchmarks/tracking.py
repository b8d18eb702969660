"""Track a robot with and without its odometry, on drives in which one picture in four shows nothing of the building.

The map is a cloudy drive with a frame every 0.6 m. A robot drives through it in each light, with pictures at least 0.3
m apart; one in four of them, drawn by chance, is black or comes from another building. The refined poses of the
pictures are tracked (`siamloc.maps.PoseFilter`), with simulated odometry and without. Errors are distances in m from
the true position after each picture, the bad ones included. Then the robot is carried away: after every 8 m of its
drive it goes on 15 m of way or more from there, which the wheels do not notice. `noticed` is the number of pictures of
the building, bad ones not counted, until the tracked position is within 1 m of the true one, or until the robot is
carried on. All is drawn three times.

Targets: with odometry, 95 % of the errors lie within half of the limit without it; carried away, the robot knows within
three pictures in 95 % of the cases.

    siamloc simulate camera=panorama out=data
    siamloc simulate building=random seed=102 camera=panorama spacing=0.4 runs=[cloudy1] out=data
    OMP_NUM_THREADS=1 python -m benchmarks.tracking --data data/freiburg_like --foreign data/random_102
"""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import siamloc
from analytic import Description
from benchmarks.building import LIGHTINGS
from benchmarks.report import Report, hardware, parser
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.data.moves import moves
from siamloc.maps import PoseFilter, RefinedPoses, VisualMap, build, match, refine
from siamloc.models.registry import PRETRAINED_SIZE
from siamloc.simulate.odometry import odometry

MAP, STEP = 0.6, 0.3  # m between two frames of the map, and between two pictures
BAD = 4  # one picture in as many shows nothing of the building
STAY, AWAY = 8.0, 15.0  # m of way before the robot is carried away, and how far at least
FOUND = 1.0  # m
QUERIES = {"cloudy": "*cloudy2", "night": "*night2", "sunny": "*sunny2"}
MOST = {"share": 0.5, "pictures": 3.0}


def main() -> None:
    """Track, print a table and write the file."""
    arguments = parser(__doc__, keeps=True)
    arguments.add_argument("--data", type=Path, nargs="+", required=True, help="rendered buildings")
    arguments.add_argument("--foreign", type=Path, required=True, help="another rendered building")
    arguments.add_argument("--seeds", type=int, default=3)
    options = arguments.parse_args()
    report = Report("tracking", options.out)
    rows = {data.resolve().name: measured(data, options.foreign, options.seeds) for data in options.data}
    rows = report.kept(rows) if options.keep else rows
    for name, row in rows.items():
        judge(report, name, row)
    print(f"{hardware()['cpu']}\n\n{table(rows)}")
    report.write({"rows": rows, "seeds": options.seeds})


def measured(data: Path, foreign: Path, seeds: int) -> dict[str, Any]:
    """Return the figures of a building by light, with and without odometry."""
    drives = siamloc.data.read("cold", root=data)
    known, _ = described(drives.select(sequence="*cloudy3"), MAP)
    _, strange = described(siamloc.data.read("cold", root=foreign), STEP)
    row: dict[str, Any] = {}
    for light, pattern in QUERIES.items():
        drive, seen = described(drives.select(sequence=pattern), STEP)
        row[light] = [tracked(known, drive.frames, seen, strange, seed) for seed in range(seeds)]
        print(f"{data.resolve().name}, {light}: {row[light]}", flush=True)
    return row


def described(frames: FrameTable, metres: float) -> tuple[VisualMap, Description]:
    """Return a map of a drive with frames that many metres apart, and their descriptions as queries."""
    images = PanoramaLibrary(frames, image_size=PRETRAINED_SIZE)
    made = build("pretrained", images, images.readable(frames).spaced(metres), progress=False)
    return made, made.turning()


def tracked(
    known: VisualMap, drive: FrameTable, seen: Description, strange: Description, seed: int
) -> dict[str, dict[str, float]]:
    """Return the figures of one drive, with one draw of the odometry and of the bad pictures."""
    generator = np.random.default_rng(seed)
    bad = generator.random(len(drive)) < 1 / BAD
    black = known.describe(np.zeros((1, 3, *PRETRAINED_SIZE), np.uint8))
    others = Description.concatenate([black, strange])
    shown = generator.integers(len(others), size=len(drive)) * (generator.random(len(drive)) < 0.5)  # 0 is black
    mixed = Description.concatenate(
        [others.take(shown[[row]]) if bad[row] else seen.take(np.array([row])) for row in range(len(drive))]
    )
    poses = refine(known, mixed, match(known, mixed, 3))
    order = carried(drive)
    found: dict[str, dict[str, float]] = {}
    for way in ("without", "with"):
        errors = off(poses, drive, np.arange(len(drive)), way, generator)
        after = off(poses, drive, order, way, generator)
        noticed = counts(after, order, bad)
        found[way] = {
            "mean": float(errors.mean()),
            "p95": float(np.quantile(errors, 0.95)),
            "carried": float(len(noticed)),
            "noticed": float(np.mean(noticed)),
            "noticed_p95": float(np.quantile(noticed, 0.95, method="higher")),
        }
    return found


def carried(drive: FrameTable) -> NDArray[np.int64]:
    """Return the rows of a drive in the order in which a robot sees them that is carried away again and again."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(drive.xy, axis=0).T))])
    parts = [np.flatnonzero((way // STAY).astype(int) == part) for part in range(int(way[-1] // STAY))]
    half = (len(parts) + 1) // 2  # parts 0, half, 1, half + 1 ...: each is far from the one before
    order = [row for pair in zip(range(half), range(half, 2 * half), strict=True) for row in pair if row < len(parts)]
    assert (half - 1) * STAY >= AWAY
    return np.concatenate([parts[row] for row in order])


def off(
    poses: RefinedPoses, drive: FrameTable, order: NDArray[np.int64], way: str, generator: np.random.Generator
) -> NDArray[np.float64]:
    """Return the errors (n,) of the tracked positions of pictures in an order."""
    true = np.column_stack([drive.xy, drive.theta])
    motion = moves(odometry(true, generator))[order]
    motion[1:][np.diff(order) != 1] = 0.0  # the wheels do not notice that the robot is carried
    motion[0] = np.nan
    robot = PoseFilter(STEP)
    found = robot.run(poses.take(order), np.zeros(len(order)), motion if way == "with" else None)
    return np.hypot(*(found.xy - drive.xy[order]).T)


def counts(errors: NDArray[np.float64], order: NDArray[np.int64], bad: NDArray[np.bool_]) -> list[int]:
    """Return after how many pictures of the building a robot that was carried away is found again, each time."""
    starts = np.flatnonzero(np.diff(order) != 1) + 1
    found = []
    for start, end in zip(starts, [*starts[1:], len(order)], strict=True):
        right = np.flatnonzero(errors[start:end] <= FOUND)
        last = start + (int(right[0]) if len(right) else end - start - 1)
        found.append(int((~bad[order[start : last + 1]]).sum()))
    return found


def judge(report: Report, name: str, row: dict[str, Any]) -> None:
    """Compare the figures of a building with the targets."""
    for light in LIGHTINGS:
        mean = {
            way: {key: statistics.mean(one[way][key] for one in row[light]) for key in row[light][0][way]}
            for way in ("without", "with")
        }
        share = mean["with"]["p95"] / mean["without"]["p95"]
        report.target(
            f"{name}, {light}: 95 % error with odometry at most {MOST['share']:g} times that without ({share:.2f})",
            share <= MOST["share"],
        )
        noticed = max(one["with"]["noticed_p95"] for one in row[light])
        report.target(
            f"{name}, {light}: carried away, noticed within {MOST['pictures']:g} pictures ({noticed:g})",
            noticed <= MOST["pictures"],
        )


def table(rows: dict[str, Any]) -> str:
    """Return the figures as a table of Markdown."""
    heads = "| building | light | mean, 95 % without | with odometry | noticed after, without | with |"
    lines = [heads, "|---|---|---|---|---|---|"]
    for name, row in rows.items():
        for light in LIGHTINGS:
            cells = [
                f"{statistics.mean(one[way]['mean'] for one in row[light]):.2f}, "
                f"{statistics.mean(one[way]['p95'] for one in row[light]):.2f}"
                for way in ("without", "with")
            ]
            cells += [
                f"{statistics.mean(one[way]['noticed'] for one in row[light]):.1f}" for way in ("without", "with")
            ]
            lines.append(f"| {name} | {light} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
