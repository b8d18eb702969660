"""Train the demo's network with several seeds: how much the figures vary from seed to seed, on this CPU.

Trains as `siamloc demo` does (conf/experiment/demo.yaml, conf/protocol/demo.yaml) on the building that it rendered, and
measures HOG, raw thumbnails and the untrained networks on the same frames.

    siamloc demo
    python -m benchmarks.demo --data data/mini
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import siamloc
from analytic import descriptor
from benchmarks.building import LIGHTINGS, by_lighting, mean_and_range
from benchmarks.report import Report, hardware, parser
from siamloc.data import FrameTable, PanoramaLibrary
from siamloc.evaluation import Result

RECIPE = siamloc.training.recipe("modern")
SHORT = {"epochs": 5, "pairs": {"epoch_batches": 50}}  # as in conf/experiment/demo.yaml
TRAIN = ("*cloudy1", "*night1", "*sunny1")
VALIDATION, MAP = ("*cloudy3",), ("*cloudy1",)
QUERIES = ("*cloudy2", "*night2", "*sunny2")


def main() -> None:
    """Train, evaluate, print a table and write it."""
    arguments = parser(__doc__)
    arguments.add_argument("--data", type=Path, required=True, help="folder of the rendered building, mini")
    arguments.add_argument("--seeds", type=int, default=3)
    options = arguments.parse_args()
    report = Report("demo", options.out)
    frames = siamloc.data.read("cold", root=options.data, name="demo")
    images = PanoramaLibrary(frames, image_size=RECIPE.image_size)
    rows: dict[str, list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(options.seeds):
            result = trained(frames, images, seed, Path(folder) / str(seed))
            for name, one in {"network": result, **result.baselines}.items():
                found = by_lighting(one.parts["absolute"])
                if name in ("network", "untrained") or seed == 0:
                    rows.setdefault(name, []).append(found)
    summary = {
        name: {lighting: mean_and_range([one[lighting] for one in found]) for lighting in LIGHTINGS}
        for name, found in rows.items()
    }
    print(f"mean error [m], {options.seeds} seeds: mean (lowest to highest); {hardware()['cpu']}")
    print("| method | cloudy | night | sunny |\n|---|---|---|---|")
    for name, found in summary.items():
        print(f"| {name} | {' | '.join(found[lighting] for lighting in LIGHTINGS)} |")
    report.write({"seeds": options.seeds, "rows": rows, "summary": summary})


def trained(frames: FrameTable, images: PanoramaLibrary, seed: int, folder: Path) -> Result:
    """Train on three drives, map one of them and locate the others."""
    network, untrained = (RECIPE.build(seed=seed) for _ in range(2))
    train, validation, mapped, queries = (
        frames.select(sequence=list(names)) for names in (TRAIN, VALIDATION, MAP, QUERIES)
    )
    RECIPE.fit(network, images, train, validation=validation, run=folder, seed=seed, **SHORT)
    known = siamloc.maps.build(network, images, mapped)
    others = {
        "untrained": siamloc.models.as_descriptor(untrained),
        "hog": descriptor("hog"),
        "thumbnail": descriptor("thumbnail"),
    }
    return siamloc.evaluation.localization(known, images, queries, radii=(0.5,), baselines=others, seed=seed)


if __name__ == "__main__":
    main()
