"""Search in maps of 100 to 1,000,000 frames: memory and time of exact, hierarchical and faiss search.

    OMP_NUM_THREADS=1 python -m benchmarks.scale [--out FOLDER] [--quick] [--data MAP]

Descriptors of 128 numbers lie along a drive: a smooth random path or, with `--data`, that of a map written by `siamloc
map` (projected at random to 128 numbers). The larger the map, the more densely they are drawn, with independent noise
in every frame and query. Hierarchical search has sqrt(n) nodes of neighbouring frames and searches 3 of them; IVF of
faiss has as many lists and searches 3. faiss is left out if it is not installed.

Each size and method runs in a separate process; memory is the most that the process takes beyond the map it started
with. The picture is saved next to the JSON file, or as docs/scale.png if that file is written to its usual place.

Targets: the nearest of 100,000 descriptors for 10,000 queries with less than 2 GB, and in at most twice the time of the
bare matrix product: the fastest of np.matmul into one array in blocks of 1,000 queries by 1,024, 4,096 or all
references, timed in turn with the search; hierarchical search of 1,000,000 at least 10 times as fast as exact search.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib.util
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analytic import Description
from benchmarks.report import RESULTS, Report, parser
from benchmarks.scale_picture import draw
from siamloc.data.frames import FrameTable
from siamloc.maps import CoarseLayer, HierarchicalSearch, VectorIndex, VisualMap

Vectors = NDArray[np.float32]
Find = Callable[[Vectors], NDArray[np.int64]]

SIZES = (100, 1_000, 10_000, 100_000, 1_000_000)
WIDTH, CANDIDATES, QUERIES = 128, 3, 1_000
NOISE = 0.05  # of the standard deviation of the descriptors
HNSW_LARGEST = 100_000  # a larger graph takes many minutes to build
BLOCKS = (1_024, 4_096, 100_000)
LARGEST_RATIO, LARGEST_MB, LEAST_SPEEDUP = 2.0, 2_000, 10.0


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, metavar="MAP", help="map.npz of a run, used instead")
    arguments.add_argument("--quick", action="store_true", help="maps of up to 10,000 frames, as a trial")
    arguments.add_argument("--part", help="one measurement, as JSON; used by the benchmark itself")
    options = arguments.parse_args()
    if options.part:
        print(json.dumps(_part(options.part, options.data)))
        return
    report = Report("scale", options.out, packages=("faiss-cpu",))
    methods = [name for name in METHODS if not name.startswith("faiss") or importlib.util.find_spec("faiss")]
    rows = []
    for size in SIZES[:3] if options.quick else SIZES:
        for name in methods:
            if name != "faiss HNSW" or size <= HNSW_LARGEST:
                rows.append(_in_process(f"{name}:{size}", options.data))
                print(_line(rows[-1]), flush=True)
    large = _in_process("product:" + ("10000" if options.quick else "100000"), options.data)
    print(large)
    ratio, memory = large["ratio"], large["peak_mb"]
    what = f"exact search of {large['queries']:,} in {large['frames']:,}"
    report.target(f"{what} in at most {LARGEST_RATIO:g}x the bare product ({ratio})", ratio <= LARGEST_RATIO)
    report.target(f"{what} with less than {LARGEST_MB:,} MB ({memory})", memory < LARGEST_MB)
    best = {row["method"]: row for row in rows if row["frames"] == max(r["frames"] for r in rows)}
    for asked in () if options.quick else ("batch", "single"):
        speedup = best["exact"][f"{asked}_ms"] / best["hierarchical"][f"{asked}_ms"]
        text = f"hierarchical search of {best['exact']['frames']:,} at least {LEAST_SPEEDUP:g}x exact search, {asked}"
        report.target(f"{text} ({speedup:.1f})", speedup >= LEAST_SPEEDUP)
    source = "a smooth random path"
    if options.data is not None:
        known = VisualMap.load(options.data)
        source = f"{len(known)} frames of {', '.join(np.unique(known.frames.sequence))}, {known.identity['name']}"
    report.write({"source": source, "width": WIDTH, "candidates": CANDIDATES, "maps": rows, "product": large})
    usual = options.out.resolve() == RESULTS.resolve()
    picture = RESULTS.parents[1] / "docs" / "scale.png" if usual else options.out / "scale.png"
    print(f"picture: {draw(rows, picture)}")


def exact(known: VisualMap) -> Find:
    """Compare every query with every frame."""
    known.search(known.descriptors[:1])  # prepares the map
    return lambda queries: known.search(queries).indices[:, 0]


def hierarchical(known: VisualMap) -> Find:
    """Find the best nodes by their representatives, then search the frames inside."""
    nodes = round(len(known) ** 0.5)
    layer = CoarseLayer.of_labels(known, np.arange(len(known)) * nodes // len(known))
    search = HierarchicalSearch(known, layer, candidates=CANDIDATES)

    def find(queries: Vectors) -> NDArray[np.int64]:
        return search.search(queries, search.rank(Description(queries))).found.indices[:, 0]

    return find


def faiss_index(kind: str) -> Callable[[VisualMap], Find]:
    def build(known: VisualMap) -> Find:
        import faiss

        if kind == "flat":
            index = faiss.IndexFlatL2(WIDTH)
        elif kind == "HNSW":
            index = faiss.IndexHNSWFlat(WIDTH, 32)
            index.hnsw.efSearch = 64
        else:
            index = faiss.IndexIVFFlat(faiss.IndexFlatL2(WIDTH), WIDTH, round(len(known) ** 0.5))
            index.nprobe, index.cp.min_points_per_centroid = CANDIDATES, 1
            index.train(known.descriptors)
        index.add(known.descriptors)
        return lambda queries: index.search(queries, 1)[1][:, 0]

    return build


METHODS: Mapping[str, Callable[[VisualMap], Find]] = {
    "exact": exact,
    "hierarchical": hierarchical,
    "faiss flat": faiss_index("flat"),
    "faiss IVF": faiss_index("IVF"),
    "faiss HNSW": faiss_index("HNSW"),
}


def descriptors(frames: int, queries: int, data: Path | None) -> tuple[Vectors, Vectors]:
    """Return descriptors of map frames in the order of the drive, and of queries anywhere along it."""
    rng = np.random.default_rng(0)
    if data is None:
        waves = np.arange(1, 65)
        phase, weight = rng.uniform(0, 2 * np.pi, len(waves)), rng.normal(size=(len(waves), WIDTH)) / waves[:, None]

        def along(place: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.cos(2 * np.pi * waves * place[:, None] + phase) @ weight
    else:
        known = VisualMap.load(data).descriptors.astype(np.float64)
        known = known @ rng.normal(size=(known.shape[1], WIDTH)) / np.sqrt(known.shape[1])

        def along(place: NDArray[np.float64]) -> NDArray[np.float64]:
            step = place * (len(known) - 1)
            left = np.minimum(step.astype(int), len(known) - 2)
            part = (step - left)[:, None]
            return (1 - part) * known[left] + part * known[left + 1]

    noise = NOISE * float(along(np.linspace(0, 1, 1_000)).std(axis=0).mean())
    made = []
    for places in (np.linspace(0, 1, frames), rng.uniform(0, 1, queries)):
        vectors = np.empty((len(places), WIDTH), dtype=np.float32)
        for start in range(0, len(places), 10_000):  # in parts, so that float64 never covers a whole map
            part = places[start : start + 10_000]
            vectors[start : start + 10_000] = along(part) + noise * rng.normal(size=(len(part), WIDTH))
        made.append(vectors)
    return made[0], made[1]


def _part(what: str, data: Path | None) -> dict[str, Any]:
    name, _, size = what.partition(":")
    return _beside_product(int(size), data) if name == "product" else _measured(name, int(size), data)


def _measured(name: str, frames: int, data: Path | None) -> dict[str, Any]:
    vectors, queries = descriptors(frames, QUERIES, data)
    known = VisualMap(vectors, FrameTable(path=np.array([f"{i:07d}.jpeg" for i in range(frames)])))
    METHODS[name](VisualMap(vectors[:50], known.frames.take(np.arange(50))))(queries[:2])  # loads what it needs
    del vectors
    before = _resident(reset=True)
    start = time.perf_counter()
    find = METHODS[name](known)
    built = time.perf_counter() - start
    answer = find(queries)
    growth = _resident(peak=True) - before
    batch = [_seconds(lambda: find(queries)) for _ in range(3)]
    truth = known.search(queries[:200]).indices[:, 0]
    single = [_seconds(partial(find, queries[i : i + 1])) for i in range(5 if frames > 100_000 else 25)]
    return {
        "method": name,
        "frames": frames,
        "build_s": round(built, 3),
        "batch_ms": round(1000 * statistics.median(batch) / len(queries), 5),
        "single_ms": round(1000 * statistics.median(single), 4),
        "memory_mb": round(growth / 1e6, 2),
        "map_mb": round(known.descriptors.nbytes / 1e6, 2),
        "found": round(float((answer[:200] == truth).mean()), 3),
    }


def _beside_product(frames: int, data: Path | None) -> dict[str, Any]:
    """Time exact search in turn with the bare product; ratios are within one turn, as others may slow the machine."""
    references, queries = descriptors(frames, 10_000, data)
    _resident(reset=True)
    VectorIndex(references).search(queries)
    peak = _resident(peak=True)
    out = np.empty((1_000, min(frames, max(BLOCKS))), dtype=np.float32)
    turns = []
    for _ in range(5):
        bare = {str(width): _product(queries, references, out, width) for width in BLOCKS}
        turns.append((_seconds(lambda: VectorIndex(references).search(queries)), min(bare.values()), bare))
    return {
        "queries": len(queries),
        "frames": frames,
        "peak_mb": round(peak / 1e6),
        "search_s": round(statistics.median(turn[0] for turn in turns), 2),
        "product_s": {
            width: round(statistics.median(turn[2][width] for turn in turns), 2) for width in map(str, BLOCKS)
        },
        "ratio": round(statistics.median(turn[0] / turn[1] for turn in turns), 2),
        "ratios": [round(turn[0] / turn[1], 2) for turn in turns],
    }


def _product(queries: Vectors, references: Vectors, out: Vectors, width: int) -> float:
    start = time.perf_counter()
    for first in range(0, len(references), width):
        block = references[first : first + width].T
        for row in range(0, len(queries), 1_000):
            part = queries[row : row + 1_000]
            np.matmul(part, block, out=out.ravel()[: len(part) * block.shape[1]].reshape(len(part), -1))
    return time.perf_counter() - start


def _in_process(part: str, data: Path | None) -> dict[str, Any]:
    command = [sys.executable, "-m", "benchmarks.scale", "--part", part, *(["--data", str(data)] if data else [])]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{part}: {done.stderr.strip()}")
    answer: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return answer


def _resident(*, peak: bool = False, reset: bool = False) -> int:
    """Return the resident memory of this process in bytes, or its peak since the last reset (Linux)."""
    if reset:
        with contextlib.suppress(OSError, AttributeError):  # give freed memory back to the system, if possible
            ctypes.CDLL(None).malloc_trim(0)
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    key = "VmHWM:" if peak else "VmRSS:"
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith(key))


def _seconds(work: Callable[[], Any]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _line(row: Mapping[str, Any]) -> str:
    times = f"{row['batch_ms']:>10.4f} ms/query in a batch {row['single_ms']:>10.3f} ms alone"
    memory = f"{row['memory_mb']:>8.1f} MB (map {row['map_mb']:.1f})"
    return f"{row['frames']:>9,} {row['method']:<13} {times} {memory} {100 * row['found']:>5.1f} % found"


if __name__ == "__main__":
    main()
