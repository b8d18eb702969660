"""Time the descriptors: describing, comparing with a map, batches, and compared with scikit-image.

    OMP_NUM_THREADS=2 python -m benchmarks.descriptors [--out FOLDER] [--quick]

Panoramas of 128 x 512. The comparison is one query against 872 map frames, over all headings if the descriptor is
aligned first: the cost of localizing an image in addition to describing it. The map is described and transformed once,
in advance. scikit-image is left out if it is not installed; it gets one grey float image, and is timed in turn with
ours in the same run.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import analytic
from benchmarks.report import Report, medians, parser

try:
    from skimage.feature import hog as skimage_hog
    from skimage.transform import radon as skimage_radon
except ImportError:
    skimage_hog = skimage_radon = None

SIZE = (128, 512)
MAP = 872
BATCH = 64
ROW = 8
SETTINGS: dict[str, tuple[str, dict[str, Any], float]] = {
    "fs": ("fs", {}, 0.5),
    "hog": ("hog", {"rows": 16, "bins": 16}, 1.5),
    "gist": ("gist", {"blocks": 16, "orientations": 16}, 12.0),
    "wisurf": ("wisurf", {"rows": 4, "windows": 128}, 10.0),
    "briefgist": ("briefgist", {}, 1.0),
    "radon_fourier": ("radon_fourier", {"step": 1}, np.inf),
    "radon_poc": ("radon_poc", {"step": 1}, np.inf),
    "hsv": ("hsv", {}, np.inf),
    "gist, the best of [T]": ("gist", {}, np.inf),
    "wisurf, the best of [T]": ("wisurf", {}, np.inf),
    "radon_poc, the best of [T]": ("radon_poc", {}, np.inf),
}
COMPARISON_MS = 50.0
BATCH_RATIO = 1.5


def main() -> None:
    """Measure, print, compare with the targets, write."""
    arguments = parser(__doc__)
    arguments.add_argument("--repeats", type=int, default=30)
    arguments.add_argument("--quick", action="store_true", help="few repeats and a small map, as a trial")
    options = arguments.parse_args()
    repeats = 3 if options.quick else options.repeats
    report = Report("descriptors", options.out, ("scikit-image",))
    rng = np.random.default_rng(0)
    images = smooth(rng, BATCH)
    rows = []
    for name, (kind, parameters, _) in SETTINGS.items():
        descriptor = analytic.descriptor(kind, **parameters)
        row = {"name": name, "parameters": parameters, **rates(descriptor, images, repeats)}
        row |= comparison(descriptor, images, 64 if options.quick else MAP, repeats)
        rows.append(row)
        print(row, flush=True)
    ratio = beside_skimage(images[0], repeats)
    targets(report, rows, ratio)
    report.write({"rows": rows, "times_as_fast_as_scikit_image": ratio})


def smooth(rng: np.random.Generator, count: int) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Return colour panoramas with structure at all scales (count, 3, H, W)."""
    from scipy.ndimage import gaussian_filter

    total = np.zeros((count, 3, *SIZE))
    for sigma in (1, 4, 16):
        layer = gaussian_filter(rng.normal(size=total.shape), (0, 0, sigma, sigma), mode="wrap")
        total += layer / layer.std()
    return np.clip(128 + 32 * total, 0, 255).astype(np.uint8)


def rates(descriptor: analytic.ImageDescriptor, images: np.ndarray, repeats: int) -> dict[str, Any]:
    """Return milliseconds for an image alone and for one in a batch, and the sizes."""
    few = images[:ROW]  # one after the other, as a robot's images come
    works = {
        "one by one": lambda: [descriptor.describe(image) for image in few],
        "batch": lambda: descriptor.describe(images),
    }
    found = medians(works, repeats)
    single, batch = found["one by one"] / len(few), found["batch"]
    one = descriptor.describe(images[0])
    assert one.orientation is not None
    return {
        "single_ms": 1e3 * single,
        "batch_ms_per_image": 1e3 * batch / len(images),
        "batch_ratio": single * len(images) / batch,
        "images_per_s": len(images) / batch,
        "position_numbers": one.position.shape[1],
        "bytes": one.position.nbytes + (0 if descriptor.aligned else one.orientation.nbytes),
    }


def comparison(descriptor: analytic.ImageDescriptor, images: np.ndarray, size: int, repeats: int) -> dict[str, float]:
    """Return milliseconds for a query against a map over all headings: nearest frame with its heading, and all."""
    known = descriptor.describe(images)
    rng = np.random.default_rng(1)
    rows = rng.integers(0, len(images), size)
    shift = rng.normal(0, 1e-3, (size, 1)).astype(np.float32)
    position = (known.position[rows] * (1 + shift)).astype(known.position.dtype)
    assert known.orientation is not None
    orientation = (known.orientation[rows] * (1 + shift[..., None])).astype(known.orientation.dtype)
    references = analytic.Description(position, orientation, known.identity)
    query = known.take([0])
    descriptor.localize(query, references)  # the map is transformed once
    works = {
        "localize_ms": lambda: descriptor.localize(fresh(query), references),
        "align_ms": lambda: descriptor.align(fresh(query), references),
    }
    return {name: 1e3 * value for name, value in medians(works, repeats).items()}


def fresh(query: analytic.Description) -> analytic.Description:
    """Return a query that has not been transformed yet."""
    return analytic.Description(query.position, query.orientation, query.identity)


def beside_skimage(image: np.ndarray, repeats: int) -> dict[str, float]:
    """Return how many times as fast as scikit-image we do the same work; nothing without scikit-image."""
    if skimage_hog is None:
        print("scikit-image is not installed: no comparison with it")
        return {}
    grey = image.mean(axis=0) / 255
    hog = analytic.descriptor("hog", rows=16, bins=16)
    ratio = {}
    found = medians(
        {
            "ours": lambda: hog.describe(grey),
            "theirs": lambda: skimage_hog(
                grey, orientations=16, pixels_per_cell=(8, 512), cells_per_block=(1, 1), feature_vector=True
            ),
        },
        repeats,
    )
    ratio["hog"] = found["theirs"] / found["ours"]
    disc = np.zeros((256, 256))
    row, column = np.mgrid[:256, :256] - 127.5
    inside = np.hypot(row, column) < 127
    disc[inside] = grey[(row[inside] % 128).astype(int), (column[inside] % 512).astype(int)]
    angles = np.arange(360.0)
    for name in ("radon_fourier", "radon_poc"):
        radon = analytic.descriptor(name, step=1)
        found = medians(
            {"ours": lambda radon=radon: radon.describe(grey), "theirs": lambda: skimage_radon(disc, angles)},
            max(repeats // 10, 3),
        )
        ratio[name] = found["theirs"] / found["ours"]
    print({f"{name}, times as fast as scikit-image": round(value, 1) for name, value in ratio.items()})
    return ratio


def targets(report: Report, rows: list[dict[str, Any]], ratio: dict[str, float]) -> None:
    """Report which targets were met."""
    for row in rows:
        limit = SETTINGS[row["name"]][2]
        if np.isfinite(limit):
            report.target(
                f"{row['name']}: one image in {limit:g} ms ({row['single_ms']:.2f})", row["single_ms"] <= limit
            )
        slowest = max(row["localize_ms"], row["align_ms"])
        report.target(
            f"{row['name']}: one query against {MAP} frames in {COMPARISON_MS:g} ms ({slowest:.1f})",
            slowest <= COMPARISON_MS,
        )
        report.target(
            f"{row['name']}: a batch at {BATCH_RATIO} times the rate of single images ({row['batch_ratio']:.2f})",
            row["batch_ratio"] >= BATCH_RATIO,
        )
    for name, least in (("hog", 4), ("radon_fourier", 10), ("radon_poc", 10)):
        if name in ratio:
            report.target(f"{name}: {least} times as fast as scikit-image ({ratio[name]:.1f})", ratio[name] >= least)


if __name__ == "__main__":
    main()
