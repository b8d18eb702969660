"""20,000 frames in one run of the incremental mapper: time, memory, and the cost of bounded exemplars.

Part of `python -m benchmarks.mapping --scale`. The poses are the real ones from COLD's lists; the descriptors are
drawn: smooth random functions of position (256 numbers) and of position and azimuth (256 steps of 16 bins), with
independent noise in every frame, as long as those of HOG. First the robot repeats its rounds in one building, so that
the number of nodes does not grow; then it drives through all buildings. Times are CPU times.

Targets: the last frames of the rounds take at most twice as long as those of the frames up to 2,000 that had as many
nodes; at most 10 ms per frame; memory at most three times that of the descriptors of all frames. `growth_per_node`
divides both times by the number of nodes instead, although much of a frame's time does not depend on it: where nodes
merge, as in the rounds, it makes the growth look larger.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analytic import Description, Descriptor, measures
from analytic.mapper import IncrementalMapper
from benchmarks.report import Report
from siamloc.data import FrameTable, read
from siamloc.data.frames import concatenate

FRAMES, EARLY, WINDOW = 20_000, 2_000, 500
EXEMPLARS = 20
WARM = 60
PART = 3_000
LONGEST_MS, MOST_GROWTH, MOST_MEMORY = 10.0, 2.0, 3.0
WIDTH, STEPS, BINS, HARMONICS = 256, 256, 16, 12
LENGTH_SCALE = 1.5  # metres over which appearance changes
NOISE = 0.15  # relative to the descriptors' own standard deviation
ROUNDS = ("freiburg_seq2_cloudy1", "freiburg_seq2_night1", "freiburg_seq2_sunny1")


class Drawn(Descriptor):
    """Stands for the drawn descriptors; compares them as any descriptor does."""

    name = "drawn"

    @property
    def identity(self) -> dict[str, Any]:
        return {"name": self.name}

    def describe(self, batch: ArrayLike) -> Description:
        raise NotImplementedError("descriptors are drawn from poses, not from images")


class World:
    """What a robot sees at a pose: smooth random functions, different for each building.

    Args:
        seed: seed of the functions.
    """

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        waves = 64
        self.frequency = rng.normal(0, 1 / LENGTH_SCALE, (waves, 2))
        self.phase = rng.uniform(0, 2 * np.pi, waves)
        self.to_position = rng.normal(0, 1 / np.sqrt(waves), (waves, WIDTH))
        decay = 1 / np.sqrt(1 + np.arange(HARMONICS))
        self.to_harmonics = rng.normal(0, 1 / np.sqrt(waves), (waves, 2, HARMONICS, BINS)) * decay[:, None]
        azimuth = 2 * np.pi * np.arange(STEPS) / STEPS
        self.waves = np.stack(
            [np.cos(np.outer(azimuth, np.arange(HARMONICS))), np.sin(np.outer(azimuth, np.arange(HARMONICS)))]
        )

    def describe(self, x: float, y: float, theta: float, rng: np.random.Generator) -> Description:
        seen = np.sqrt(2) * np.cos(self.frequency @ (x, y) + self.phase)
        position = 1 + 0.2 * (seen @ self.to_position + NOISE * rng.normal(size=WIDTH))
        amplitude = np.tensordot(seen, self.to_harmonics, 1)
        around = np.einsum("psh,phb->sb", self.waves, amplitude) + NOISE * rng.normal(size=(STEPS, BINS))
        turned = np.roll(around, round(theta * STEPS / (2 * np.pi)), axis=0)
        return Description(position[None].astype(np.float32), turned[None].astype(np.float32))


def run(places: Path, out: Path, quick: bool = False) -> None:
    """Measure, judge and write `mapping_scale.json`."""
    frames, early, part = (2_400, 1_200, 600) if quick else (FRAMES, EARLY, PART)
    report = Report("mapping_scale", out, packages=("scipy",))
    lists = {path.name.split(".")[0]: path for path in sorted(places.glob("*.places.lst"))}
    if not lists:
        raise SystemExit(f"{places} holds no lists of poses: give the folder with --places")
    tables = {name: read("cold", places=path) for name, path in lists.items()}
    rounds, everywhere = [tables[name] for name in ROUNDS], list(tables.values())
    drives = [
        alone("rounds in one building", cycled(rounds, frames), early),
        alone("all buildings", cycled(everywhere, frames), early),
    ]
    bounded = [
        cost_of_bound(cycled([tables[ROUNDS[0]], tables[ROUNDS[1]]], part), limit) for limit in (None, EXEMPLARS)
    ]
    for row in [*drives, *bounded]:
        print(row)
    growth, alike = drives[0]["growth"], drives[0]["early_alike"]
    what = f"rounds: time per frame at the end at most {MOST_GROWTH:g} times that of frames up to {early}"
    report.target(f"{what} with as many nodes (about {alike['nodes']}; {growth})", growth <= MOST_GROWTH)
    for row in drives:
        ms = row["late_ms"]
        report.target(f"{row['what']}: at most {LONGEST_MS:g} ms per frame at the end ({ms})", ms <= LONGEST_MS)
        more = row["memory_share"]
        report.target(
            f"{row['what']}: memory at most {MOST_MEMORY:g} times the descriptors ({more})", more <= MOST_MEMORY
        )
    report.write({"frames": frames, "exemplars": EXEMPLARS, "drives": drives, "bounded": bounded})


def alone(what: str, frames: FrameTable, early: int) -> dict[str, Any]:
    """Run a drive in its own process: memory freed by an earlier drive would be reused without being counted."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(driven, what, frames, early).result()


def cycled(tables: list[FrameTable], frames: int) -> FrameTable:
    """Repeat the tables, one after the other, until there are as many frames as requested."""
    whole = concatenate(tables)
    return whole.take(np.arange(frames) % len(whole))


def described(frames: FrameTable, seed: int = 0) -> Iterator[Description]:
    """Draw descriptions of frames one by one, so that the mapper's memory is measured and not theirs."""
    worlds: dict[str, World] = {}
    for row, (x, y, theta) in enumerate(zip(frames.x, frames.y, frames.theta, strict=True)):
        building = str(frames.building[row])
        world = worlds.setdefault(building, World(seed + len(worlds)))
        yield world.describe(x, y, theta, np.random.default_rng((seed, row)))


def driven(what: str, frames: FrameTable, early: int) -> dict[str, Any]:
    """Run a drive with bounded exemplars; return time and nodes, early and late, and memory."""
    warm = IncrementalMapper(Drawn(), 2, exemplars=EXEMPLARS)
    for one in described(frames.take(np.arange(WARM))):
        warm.add(one)  # what is loaded only once does not count as memory of the map
    del warm
    gc.collect()
    before = resident()
    mapper = IncrementalMapper(Drawn(), 2, exemplars=EXEMPLARS)
    ms, nodes = np.zeros(len(frames)), np.zeros(len(frames), dtype=int)
    for row, one in enumerate(described(frames)):
        start = time.process_time()
        mapper.add(one, [float(frames.x[row]), float(frames.y[row])])
        ms[row], nodes[row] = 1000 * (time.process_time() - start), len(mapper.nodes)
    gc.collect()
    used = resident() - before
    taken = 4 * (WIDTH + STEPS * BINS) * len(frames)
    first, last = slice(early - WINDOW // 2, early + WINDOW // 2), slice(len(frames) - WINDOW, None)
    alike = with_as_many(nodes, float(nodes[last].mean()), early)
    labels = mapper.labels()
    per_node = [float(ms[part].mean() / nodes[part].mean()) for part in (first, last)]
    return {
        "what": what,
        "frames": len(frames),
        "nodes_early": round(float(nodes[first].mean()), 1),
        "nodes_late": round(float(nodes[last].mean()), 1),
        "early_ms": round(float(ms[first].mean()), 2),
        "late_ms": round(float(ms[last].mean()), 2),
        "p99_ms": round(float(np.percentile(ms, 99)), 2),
        "early_alike": {
            "frames": [alike.start, alike.stop],
            "nodes": round(float(nodes[alike].mean()), 1),
            "ms": round(float(ms[alike].mean()), 2),
        },
        "growth": round(float(ms[last].mean() / ms[alike].mean()), 2),
        "growth_per_node": round(per_node[1] / per_node[0], 2),
        "memory_mb": round(used / 2**20),
        "descriptors_mb": round(taken / 2**20),
        "memory_share": round(used / taken, 2),
        "unassigned": round(100 * float((labels < 0).mean()), 1),
        **quality(frames, labels),
    }


def with_as_many(nodes: NDArray[np.int64], count: float, early: int) -> slice:
    """Return the window of early frames whose mean number of nodes is nearest to a count; the latest of equal ones."""
    sums = np.concatenate([[0], np.cumsum(nodes[: early + WINDOW // 2])])
    apart = np.abs((sums[WINDOW:] - sums[:-WINDOW]) / WINDOW - count)
    start = int(np.flatnonzero(apart == apart.min())[-1])
    return slice(start, start + WINDOW)


def cost_of_bound(frames: FrameTable, limit: int | None) -> dict[str, Any]:
    """Map the same part of a drive with a bound on the exemplars, or without."""
    mapper = IncrementalMapper(Drawn(), 2, exemplars=limit)
    descriptions = list(described(frames))
    start = time.process_time()
    for row, one in enumerate(descriptions):
        mapper.add(one, row)
    labels = mapper.labels()
    return {
        "exemplars": limit,
        "frames": len(frames),
        "nodes": len(mapper.nodes),
        "unassigned": round(100 * float((labels < 0).mean()), 1),
        "ms_per_frame": round(1000 * (time.process_time() - start) / len(frames), 2),
        **quality(frames, labels),
    }


def quality(frames: FrameTable, labels: NDArray[np.int64]) -> dict[str, float]:
    """Return the pooled silhouette of the points, with buildings far apart, and the purity by room."""
    buildings = np.unique(frames.building, return_inverse=True)[1]
    xy = frames.xy + 200.0 * buildings[:, None]
    several = len(np.unique(labels[labels >= 0])) > 1
    silhouette = measures.silhouette(xy, labels, "pooled") if several else float("nan")
    return {"silhouette": round(silhouette, 3), "purity": round(measures.purity(labels, frames.place).overall, 3)}


def resident() -> int:
    """Return the resident memory of this process in bytes."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096
