"""The main job on real photographs: AlexNet trained on one drive through a corridor, tested on another.

Trains with several seeds, so that the spread is seen, and measures raw thumbnails and the untrained networks with the
same evaluator. Nothing is chosen on the test drive: every setting tried stands in the table. For one seed, these
commands do the same:

    siamloc train experiment=corridor data.manifest=corridor/manifest.csv run=runs/corridor seed=0
    siamloc map run=runs/corridor
    siamloc evaluate run=runs/corridor

    python -m benchmarks.corridor --manifest corridor/manifest.csv
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import siamloc
from analytic import Thumbnail
from benchmarks.building import mean_and_range
from benchmarks.report import Report, parser

SETTINGS = {"labels over the whole corridor": None, "labels over 20 frames": 20.0}
SIZE = (120, 160)


def main() -> None:
    """Train, evaluate, print a table and write it."""
    arguments = parser(__doc__)
    arguments.add_argument("--manifest", required=True)
    arguments.add_argument("--seeds", type=int, default=3)
    options = arguments.parse_args()
    report = Report("corridor", options.out)
    frames = siamloc.data.read("manifest", manifest=options.manifest, unit="frame")
    images = siamloc.data.PanoramaLibrary(frames, image_size=SIZE, circular=False)
    rows: dict[str, list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for setting, scale in SETTINGS.items():
            for seed in range(options.seeds):
                result = trained(images, scale, seed, Path(folder) / f"{setting}-{seed}")
                rows.setdefault(f"trained, {setting}", []).append(figures(result.measures))
                for name, other in result.baselines.items():
                    overall = other.measures
                    if name == "thumbnail":
                        rows["thumbnail 8 x 32, correlation"] = [figures(overall)]
                    else:
                        rows.setdefault(name, []).append(figures(overall))
    summary = {name: summarize(found) for name, found in rows.items()}
    for name, row in summary.items():
        print(f"{name:<45} mean error {row['mean_frames']}  recall@1 within 3 frames {row['recall_percent']}")
    report.write({"seeds": options.seeds, "rows": rows, "summary": summary})


def trained(images: Any, scale: float | None, seed: int, folder: Path) -> siamloc.evaluation.Result:
    """Train on the first drive, map it and locate the second."""
    ref, query = (images.frames.select(sequence=name) for name in ("ref", "query"))
    network = siamloc.models.build("alexnet", "fc500_500_5", SIZE, seed=seed)
    untrained = siamloc.models.build("alexnet", "fc500_500_5", SIZE, seed=seed)
    pairs = {"label": "distance", "same_room_share": 1.0, "epoch_pairs": 640, "scale": scale}
    siamloc.training.fit(network, images, ref, run=folder, epochs=10, seed=seed, pairs=pairs)
    known = siamloc.maps.build(network, images, ref)
    others = {"thumbnail": Thumbnail(), "untrained": siamloc.models.as_descriptor(untrained)}
    return siamloc.evaluation.localization(known, images, query, radii=(3,), baselines=others, seed=seed)


def figures(overall: dict[str, Any]) -> dict[str, float]:
    """Return the figures of one row."""
    first = next(recall for recall in overall["recall"] if recall["k"] == 1)
    return {
        "mean_frames": overall["error"]["mean"],
        "median_frames": overall["error"]["median"],
        "recall": first["recall"],
        "queries": overall["queries"],
    }


def summarize(found: list[dict[str, float]]) -> dict[str, str]:
    """Return mean and range over the seeds, as text."""
    return {
        "mean_frames": mean_and_range([row["mean_frames"] for row in found], 1),
        "median_frames": mean_and_range([row["median_frames"] for row in found], 1),
        "recall_percent": mean_and_range([100 * row["recall"] for row in found], 1),
    }


if __name__ == "__main__":
    main()
