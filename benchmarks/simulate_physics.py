"""Check that simulated light behaves as published, by nearest-neighbour localization with gradient histograms.

    python -m benchmarks.simulate_physics data/freiburg_sim [--map cloudy3] [--every 5] [--out FOLDER]

The map is every k-th frame of one cloudy run; every frame of the other runs is located by the nearest descriptor. The
published order is: cloudy best, night worse, sunny worst.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from benchmarks.report import Report, parser
from siamloc.data.cold import read_cold
from siamloc.evaluation.metrics import error_floor


def gradient_histograms(panorama: np.ndarray, cells: int = 8, bins: int = 32) -> np.ndarray:
    """Return the histograms (cells * bins,) of gradient directions, weighted by magnitude, in horizontal cells.

    A cell spans the whole turn, so that the descriptor does not change when the robot turns on the spot.
    """
    image = panorama.astype(np.float32)
    dx = (np.roll(image, -1, axis=1) - np.roll(image, 1, axis=1)) / 2
    dy = np.gradient(image, axis=0)
    magnitude = np.hypot(dx, dy)
    bin_of = np.minimum(((np.arctan2(dy, dx) + np.pi) / (2 * np.pi) * bins).astype(int), bins - 1)
    rows = np.array_split(np.arange(len(image)), cells)
    parts = [np.bincount(bin_of[r].ravel(), weights=magnitude[r].ravel(), minlength=bins) for r in rows]
    return np.concatenate(parts)


def errors(map_d: np.ndarray, map_xy: np.ndarray, query_d: np.ndarray, query_xy: np.ndarray) -> np.ndarray:
    """Return the distance in metres of each query to the map frame with the nearest descriptor."""
    similarity = query_d @ map_d.T
    return np.linalg.norm(map_xy[np.argmax(similarity, axis=1)] - query_xy, axis=1)


def unit(descriptors: np.ndarray) -> np.ndarray:
    """Centre and normalize rows, so that products are Pearson correlations."""
    centred = descriptors - descriptors.mean(axis=1, keepdims=True)
    return centred / np.linalg.norm(centred, axis=1, keepdims=True)


def main() -> None:
    arguments = parser(__doc__)
    arguments.add_argument("root", type=Path)
    arguments.add_argument("--map", default="cloudy3")
    arguments.add_argument("--every", type=int, default=5)
    options = arguments.parse_args()
    report = Report("simulate_physics", options.out)
    table = read_cold(options.root)
    found = {name: table.select(sequence=name) for name in sorted(set(table.sequence.tolist()))}
    described = {
        name: unit(np.stack([gradient_histograms(cv2.imread(path, cv2.IMREAD_GRAYSCALE)) for path in part.path]))
        for name, part in found.items()
    }
    home = next(name for name in found if name.endswith(options.map))
    map_xy, map_d = found[home].xy[:: options.every], described[home][:: options.every]
    pooled: dict[str, list[np.ndarray]] = {}
    lines = []
    for name, part in found.items():
        if name == home:
            continue
        error = errors(map_d, map_xy, described[name], part.xy)
        floor = error_floor(map_xy, part.xy)
        pooled.setdefault(str(part.lighting[0]), []).append(error)
        lines.append({"sequence": name, "queries": len(part), "mean_m": error.mean(), "median_m": np.median(error),
                      "floor_m": floor.mean(), "over_2m": float((error > 2).mean())})  # fmt: skip
    print(f"map {home}: {len(map_xy)} frames, every {options.every}")
    for line in lines:
        print("{sequence:32s} n={queries:5d} mean {mean_m:.3f} m  median {median_m:.3f}  floor {floor_m:.3f}  "
              "above 2 m {over_2m:.1%}".format(**line))  # fmt: skip
    means = {lighting: float(np.concatenate(parts).mean()) for lighting, parts in pooled.items()}
    print("pooled: " + ", ".join(f"{lighting} {value:.3f} m" for lighting, value in means.items()))
    if "cloudy" in means and "sunny" in means:
        print(f"sunny / cloudy = {means['sunny'] / means['cloudy']:.2f}")
    order = [means[lighting] for lighting in ("cloudy", "night", "sunny") if lighting in means]
    report.target("cloudy best, night worse, sunny worst", order == sorted(order))
    report.write({"map": home, "every": options.every, "sequences": lines, "pooled": means})


if __name__ == "__main__":
    main()
