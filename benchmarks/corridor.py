"""The main task on real photographs: trained on one drive through a corridor, tested on another.

`ours` is `siamloc.training.recipe("photographs")`, with the nearest frame and with the sequence filter. The published
way is AlexNet trained on pairs with metric labels, in the two settings that were tried. The analytic descriptors with
the project's settings, raw thumbnails and the untrained network are evaluated in the same way. Several seeds show the
spread; positions are counted in frames. For one seed of `ours`, these commands do the same:

    siamloc train experiment=corridor data.manifest=corridor/manifest.csv run=runs/corridor seed=0
    siamloc map run=runs/corridor
    siamloc evaluate run=runs/corridor task.filter=true task.radii=[3]

Targets for the mean of `ours` over the seeds: 75 % of the queries within 3 frames, 95 % with the sequence filter, and
more than every other row.

    python -m benchmarks.corridor --manifest corridor/manifest.csv

`--ways ours` alone writes corridor_ours.json, any other choice corridor.json.
"""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import siamloc
from analytic import AnalyticError
from benchmarks.building import mean_and_range
from benchmarks.report import Report, parser
from siamloc.data import FrameTable, PanoramaLibrary

PUBLISHED = {"trained, labels over the whole corridor": None, "trained, labels over 20 frames": 20.0}
OURS = "ours"
FILTERED = "ours, sequence filter"
BETWEEN_FRAMES, FOLLOWED = ", between frames", ", followed between frames"
BETWEEN = {"refine": "interpolate", "neighbours": 5, "place_radius": 3.0}
"""Settings for positions between frames."""
ANALYTIC = ("fs", "hog", "gist", "wisurf", "briefgist", "radon_fourier", "radon_poc", "hsv")
RADIUS = 3  # frames
LEAST_RECALL, LEAST_FILTERED = 0.75, 0.95


def main() -> None:
    """Train, evaluate, print a table and write it."""
    arguments = parser(__doc__)
    arguments.add_argument("--manifest", required=True)
    arguments.add_argument("--seeds", type=int, default=3)
    arguments.add_argument("--ways", nargs="+", default=["ours", "published"], choices=["ours", "published"])
    options = arguments.parse_args()
    report = Report("corridor_ours" if options.ways == ["ours"] else "corridor", options.out)
    frames = siamloc.data.read("manifest", manifest=options.manifest, unit="frame")
    rows: dict[str, list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(options.seeds):
            for name, result in trained(frames, seed, Path(folder), options.ways):
                rows.setdefault(name, []).append(figures(result))
                print(f"seed {seed}: {name}: {rows[name][-1]}", flush=True)
    for descriptor in (*ANALYTIC, "thumbnail"):
        name = "thumbnail 8 x 32, correlation" if descriptor == "thumbnail" else descriptor
        try:
            found = located(library(frames, (128, 160)), descriptor, filter=True, **BETWEEN)
        except AnalyticError as error:  # its settings are those for panoramas of 128 x 512
            print(f"{name} left out: {error}")
            continue
        rows[name] = [figures(found.parts["absolute"])]
        rows[f"{name}, sequence filter"] = [figures(found.parts["absolute_filtered"])]
        rows[name + BETWEEN_FRAMES] = [figures(found.parts["absolute_interpolated"])]
        rows[name + FOLLOWED] = [figures(found.parts["absolute_tracked"])]
    judge(report, rows)
    summary = {name: summarize(found) for name, found in rows.items()}
    for name, row in summary.items():
        print(f"{name:<45} mean error {row['mean_frames']}  recall@1 within 3 frames {row['recall_percent']}")
    report.write({"seeds": options.seeds, "rows": rows, "summary": summary})


def library(frames: FrameTable, size: tuple[int, int]) -> PanoramaLibrary:
    """Return the images at a size."""
    return PanoramaLibrary(frames, image_size=size, circular=False)


def trained(frames: FrameTable, seed: int, folder: Path, ways: Sequence[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Train on the first drive in each way, and yield how well the second is located."""
    ref = frames.select(sequence="ref")
    if "ours" in ways:
        yield from ours(frames, ref, seed, folder)
    images = library(frames, (120, 160))
    for name, scale in PUBLISHED.items() if "published" in ways else ():
        alexnet = siamloc.models.build("alexnet", "fc500_500_5", images.image_size, seed=seed)
        if scale is None:
            yield "untrained", located(images, alexnet).parts["absolute"]
        pairs = {"label": "distance", "same_room_share": 1.0, "epoch_pairs": 640, "scale": scale}
        siamloc.training.fit(alexnet, images, ref, run=folder / f"{name}{seed}", epochs=10, seed=seed, pairs=pairs)
        yield name, located(images, alexnet).parts["absolute"]


def ours(frames: FrameTable, ref: FrameTable, seed: int, folder: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Train with our recipe, and yield how well the second drive is located before, after, and with the filter."""
    recipe = siamloc.training.recipe("photographs")
    images = library(frames, recipe.image_size)
    network = recipe.build(seed=seed)
    yield "ours, untrained", located(images, network).parts["absolute"]
    recipe.fit(network, images, ref, run=folder / f"ours{seed}", seed=seed)
    found = located(images, network, filter=True, **BETWEEN)
    yield OURS, found.parts["absolute"]
    yield FILTERED, found.parts["absolute_filtered"]
    yield OURS + BETWEEN_FRAMES, found.parts["absolute_interpolated"]
    yield OURS + FOLLOWED, found.parts["absolute_tracked"]


def located(images: PanoramaLibrary, descriptor: Any, **options: Any) -> siamloc.evaluation.Result:
    """Map the first drive and locate the second."""
    ref, query = (images.frames.select(sequence=name) for name in ("ref", "query"))
    known = siamloc.maps.build(descriptor, images, ref, progress=False)
    return siamloc.evaluation.localization(known, images, query, radii=(RADIUS,), names=("absolute",), **options)


def judge(report: Report, rows: dict[str, list[dict[str, float]]]) -> None:
    """Compare the means over the seeds with the targets."""
    if OURS not in rows:
        return
    recall = {name: statistics.mean(row["recall"] for row in found) for name, found in rows.items()}
    others = max(
        (value, name)
        for name, value in recall.items()
        if name != OURS and not name.endswith(("filter", BETWEEN_FRAMES, FOLLOWED))
    )
    report.target(f"recall at least {LEAST_RECALL:.0%} ({recall[OURS]:.1%})", recall[OURS] >= LEAST_RECALL)
    report.target(
        f"filtered at least {LEAST_FILTERED:.0%} ({recall[FILTERED]:.1%})", recall[FILTERED] >= LEAST_FILTERED
    )
    report.target(f"more than {others[1]} ({others[0]:.1%})", recall[OURS] > others[0])


def figures(part: dict[str, Any]) -> dict[str, float]:
    """Return the figures of one row."""
    overall = part["overall"]
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
