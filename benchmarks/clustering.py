"""Time the clustering of descriptors into compact maps, and its measures.

    OMP_NUM_THREADS=2 python -m benchmarks.clustering [--out FOLDER] [--quick]

Targets: normalized spectral clustering of 5,000 descriptors of 512 numbers into 40 clusters, from the descriptors to
the labels, with affinities between nearest neighbours only, in less than 10 s; and, on the same full affinity, at most
a quarter more time than scikit-learn's `SpectralClustering` (its default solver, k-means from 10 starts), timed in turn
with it. There are three kinds of descriptors: blocks around 40 centres, a drive along which they change steadily, and
noise, which no method clusters easily.
"""

from __future__ import annotations

import resource
import statistics
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import SpectralClustering
from sklearn.metrics import adjusted_rand_score, silhouette_score

from analytic import clustering, measures
from analytic.clustering import spectral_clustering
from benchmarks.report import Report, parser, seconds

CLUSTERS, LENGTH, NEIGHBOURS = 40, 512, 10
TARGET_S = 10.0
LIMIT = 1.25  # relative to scikit-learn, whose solvers are used
KINDS = ("blocks", "drive", "noise")


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("--repeats", type=int, default=7)
    arguments.add_argument("--quick", action="store_true", help="a fifth of the frames, as a trial")
    options = arguments.parse_args()
    report = Report("clustering", options.out, packages=("scipy", "scikit-learn"))
    shrink = 5 if options.quick else 1
    sparse = [between_neighbours(kind, 5000 // shrink, options.repeats) for kind in KINDS]
    full = [same_affinity(kind, n // shrink, options.repeats) for kind in KINDS for n in (500, 1000, 2000)]
    others = other_methods(5000 // shrink, options.repeats)
    judged = silhouettes(20_000 // shrink)
    for row in [*sparse, *full, *others, judged]:
        print(row)
    for row in sparse:
        what = f"{row['frames']} descriptors of {LENGTH} numbers ({row['kind']}) into {CLUSTERS} clusters"
        report.target(f"{what} between neighbours under {TARGET_S:.0f} s ({row['s']})", row["s"] < TARGET_S)
    for row in full:
        what = f"full affinity of {row['frames']} frames ({row['kind']}) in the time of scikit-learn"
        report.target(f"{what} (ratio {row['ratio']})", row["ratio"] <= LIMIT)
    for row in sparse + full:
        if row["kind"] == "blocks":
            report.target(f"planted partition of {row['frames']} frames found", row["planted_rand"] == 1.0)
    memory = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    figures = {"between_neighbours": sparse, "same_affinity": full, "others": others, "silhouettes": judged}
    report.write({**figures, "peak_memory_mb": memory})


def descriptors(kind: str, frames: int) -> tuple[NDArray[np.float64], NDArray[np.int64] | None]:
    """Return descriptors (frames, LENGTH), and the planted labels of blocks."""
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(frames, LENGTH))
    if kind == "blocks":
        planted = rng.integers(0, CLUSTERS, frames)
        return rng.normal(size=(CLUSTERS, LENGTH))[planted] + noise, planted
    if kind == "drive":
        corners = np.cumsum(rng.normal(size=(frames // 50 + 2, LENGTH)), axis=0)
        place = np.linspace(0, len(corners) - 1.001, frames)
        left, share = place.astype(int), (place % 1)[:, None]
        return corners[left] * (1 - share) + corners[left + 1] * share + 0.1 * noise, None
    return noise, None


def between_neighbours(kind: str, frames: int, repeats: int) -> dict[str, Any]:
    """Time clustering between nearest neighbours, from the descriptors to the labels."""
    x, planted = descriptors(kind, frames)
    times = seconds({"ours": lambda: clustering.spectral(x, CLUSTERS, neighbours=NEIGHBOURS)}, repeats)["ours"]
    labels = clustering.spectral(x, CLUSTERS, neighbours=NEIGHBOURS)
    figures = {
        "kind": kind,
        "frames": frames,
        "neighbours": NEIGHBOURS,
        "s": round(statistics.median(times), 2),
        "clusters": int(labels.max()) + 1,
        "share_of_target": round(statistics.median(times) / TARGET_S, 3),
    }
    if planted is not None:
        figures["planted_rand"] = adjusted_rand_score(planted, labels)
    return figures


def same_affinity(kind: str, frames: int, repeats: int) -> dict[str, Any]:
    """Time both on the same full affinity; the ratio is the median of the ratios of the single rounds."""
    x, planted = descriptors(kind, frames)
    similarity = clustering.affinity(x)
    theirs = SpectralClustering(CLUSTERS, affinity="precomputed", assign_labels="kmeans", n_init=10, random_state=0)
    works = {
        "ours": lambda: partition(similarity),
        "scikit-learn": lambda: theirs.fit_predict(similarity),
    }
    times = seconds(works, repeats)
    ratios = [ours / judge for ours, judge in zip(times["ours"], times["scikit-learn"], strict=True)]
    labels = partition(similarity)
    figures = {
        "kind": kind,
        "frames": frames,
        **{name: round(statistics.median(values), 3) for name, values in times.items()},
        "ratio": round(statistics.median(ratios), 2),
        "rand": adjusted_rand_score(theirs.fit_predict(similarity), labels),
    }
    if planted is not None:
        figures["planted_rand"] = adjusted_rand_score(planted, labels)
    return figures


def partition(similarity: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the clusters of frames from their similarities, by the steps that follow these in `spectral`."""
    matrix = spectral_clustering._normalized(similarity)
    return spectral_clustering._clustered(matrix, spectral_clustering._parts(matrix), CLUSTERS, 0, "kmeans")


def other_methods(frames: int, repeats: int) -> list[dict[str, Any]]:
    """Time the self-organizing map on descriptors, and on the rows of spectral clustering."""
    x, _ = descriptors("drive", frames)
    works = {
        "som 8 x 5": lambda: clustering.som(x, (8, 5)),
        "spectral, som of the rows": lambda: clustering.spectral(x, CLUSTERS, neighbours=NEIGHBOURS, assign="som"),
    }
    times = seconds(works, repeats)
    return [{"what": name, "frames": frames, "s": round(statistics.median(s), 2)} for name, s in times.items()]


def silhouettes(frames: int) -> dict[str, Any]:
    """Time the silhouette of positions, compared with scikit-learn's."""
    rng = np.random.default_rng(0)
    x, labels = rng.uniform(0, 30, (frames, 2)), rng.integers(0, CLUSTERS, frames)
    works = {
        "ours": lambda: measures.silhouette(x, labels),
        "scikit-learn": lambda: silhouette_score(x, labels),
    }
    times = seconds(works, 1)
    difference = abs(measures.silhouette(x, labels) - silhouette_score(x, labels))
    rounded = {name: round(values[0], 2) for name, values in times.items()}
    return {"what": "silhouette of positions", "frames": frames, **rounded, "difference": difference}


if __name__ == "__main__":
    main()
