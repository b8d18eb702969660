"""Time exact search, for many queries and for one at a time as on a robot, and evaluating absolute localization.

    OMP_NUM_THREADS=2 python -m benchmarks.search [--out FOLDER] [--quick]

Run it on an otherwise idle machine: a matrix product on shared cores waits for its slowest thread. Target: 1,500
queries evaluated against 556 map frames in less than 50 ms, including search. The large search is compared with its
bare matrix product, and single queries with the flat index of faiss if it is installed; faiss computes in float32, so
its order is not exact.
"""

from __future__ import annotations

import importlib.util
import resource
from typing import Any

import numpy as np

from benchmarks.report import Report, milliseconds, parser
from siamloc.data.frames import FrameTable
from siamloc.evaluation.absolute import evaluate_absolute
from siamloc.maps import VectorIndex, VisualMap

WIDTHS = (5, 500, 1000)
TARGET_MS = 50.0
SINGLE = ((556, 5), (556, 500), (10_000, 128), (100_000, 128))  # map frames, values in a descriptor
NEIGHBOURS = 20


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("--repeats", type=int, default=5)
    arguments.add_argument("--quick", action="store_true", help="a tenth of the large search, as a trial")
    options = arguments.parse_args()
    report = Report("search", options.out, packages=("faiss-cpu",))
    evaluations = [evaluation(width, options.repeats) for width in WIDTHS]
    searches = [large_search(k, options.repeats, 10 if options.quick else 1) for k in (1, 20)]
    singles = [single(*size, options.repeats) for size in SINGLE]
    for row in evaluations + searches + singles:
        print(row)
    for row in evaluations:
        what = f"evaluation of 1,500 x 556 descriptors of {row['width']} values under {TARGET_MS:.0f} ms"
        report.target(f"{what} ({row['ms']:.1f})", row["ms"] < TARGET_MS)
    memory = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    report.write({"evaluation": evaluations, "search": searches, "single": singles, "peak_memory_mb": memory})


def evaluation(width: int, repeats: int) -> dict[str, Any]:
    """Time 1,500 queries against 556 map frames with given descriptors, including search and all measures."""
    rng = np.random.default_rng(0)
    known, queries = frames(rng, 556), frames(rng, 1500)
    visual_map = VisualMap(rng.normal(size=(556, width)), known)
    descriptors = rng.normal(size=(1500, width)).astype(np.float32)
    found = visual_map.search(descriptors, 20)
    return {
        "what": "evaluate absolute, 1500 x 556, 9 rooms, 3 lightings",
        "width": width,
        **milliseconds(lambda: evaluate_absolute(visual_map, queries, visual_map.search(descriptors, 20)), repeats * 4),
        "search_only": milliseconds(lambda: visual_map.search(descriptors, 20), repeats * 4),
        "without_search": milliseconds(lambda: evaluate_absolute(visual_map, queries, found), repeats * 4),
    }


def large_search(k: int, repeats: int, shrink: int) -> dict[str, Any]:
    """Time 10,000 queries in 100,000 references of 128 values, and a matrix product in blocks of 1,000 queries."""
    rng = np.random.default_rng(0)
    queries = rng.normal(size=(10_000 // shrink, 128)).astype(np.float32)
    references = rng.normal(size=(100_000, 128)).astype(np.float32)

    def product() -> None:
        for start in range(0, len(queries), 1000):
            for first in range(0, len(references), 4096):
                queries[start : start + 1000] @ references[first : first + 4096].T

    index = VectorIndex(references)
    search, bare = milliseconds(lambda: index.search(queries, k), repeats), milliseconds(product, repeats)
    return {
        "what": f"search {len(queries)} x {len(references)} x 128",
        "k": k,
        **search,
        "product": bare,
        "ratio": round(search["ms"] / bare["ms"], 2),
        "cpu_ratio": round(search["cpu_ms"] / bare["cpu_ms"], 2),
    }


def single(frames: int, width: int, repeats: int) -> dict[str, Any]:
    """Time one query at a time: in a map prepared once, in a map prepared for each query, and with faiss."""
    rng = np.random.default_rng(0)
    references = rng.normal(size=(frames, width)).astype(np.float32)
    queries = rng.normal(size=(200, width)).astype(np.float32)
    index, turn = VectorIndex(references), iter(range(10**9))

    def query() -> np.ndarray:
        place = next(turn) % len(queries)
        return queries[place : place + 1]

    row: dict[str, Any] = {
        "what": f"one query in {frames} x {width}, {NEIGHBOURS} neighbours",
        **milliseconds(lambda: index.search(query(), NEIGHBOURS), repeats * 20),
        "prepared_each_time": milliseconds(lambda: VectorIndex(references).search(query(), NEIGHBOURS), repeats),
    }
    if importlib.util.find_spec("faiss"):
        import faiss

        flat = faiss.IndexFlatL2(width)
        flat.add(references)
        found = flat.search(queries, NEIGHBOURS)[1]
        exact = index.search(queries, NEIGHBOURS).indices
        row["faiss_flat"] = milliseconds(lambda: flat.search(query(), NEIGHBOURS), repeats * 20)
        row["faiss_same_order"] = float((found == exact).all(axis=1).mean())
    return row


def frames(rng: np.random.Generator, n: int) -> FrameTable:
    rooms = np.array([f"room {i}" for i in range(9)])
    lightings = np.array(["cloudy", "night", "sunny"])
    return FrameTable(
        path=np.array([f"seq/{i:06d}.jpeg" for i in range(n)]),
        x=rng.uniform(0, 30, n),
        y=rng.uniform(0, 15, n),
        room=rooms[rng.integers(0, 9, n)],
        lighting=lightings[rng.integers(0, 3, n)],
    )


if __name__ == "__main__":
    main()
